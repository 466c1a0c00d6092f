"""``python -m lvox``: the program itself."""

import os
import subprocess
import sys

from ._program import program

if __name__ == "__main__":
    words = [program(), *sys.argv[1:]]
    if os.name == "posix":
        os.execv(words[0], words)
    sys.exit(subprocess.call(words))
