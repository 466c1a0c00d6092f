"""Finds the program and runs it."""

from __future__ import annotations

import os
import shutil
import subprocess
import sys
import sysconfig
import warnings
from collections.abc import Mapping
from pathlib import Path
from typing import Any, Union

PathLike = Union[str, "os.PathLike[str]"]


class LvoxError(Exception):
    """A run of the program failed; another try may help.

    ``code`` is what it exited with.
    """

    def __init__(self, message: str, code: int = 1) -> None:
        super().__init__(message)
        self.code = code


class InputError(LvoxError, ValueError):
    """Something is wrong with what the program was given: a file, a scene, a setting."""


class LvoxWarning(UserWarning):
    """What the program warns of, such as what it leaves out of a picture."""


def program() -> str:
    """The path of the program.

    That of the environment variable ``LVOX_PROGRAM`` if it is set, else the one that was installed with
    this module, else the first on the search path.
    """
    named = os.environ.get("LVOX_PROGRAM")
    if named:
        return named
    name = "lvox" + (sysconfig.get_config_var("EXE") or "")
    folders = [sysconfig.get_path("scripts"), str(Path(sys.executable).parent)]
    if hasattr(sysconfig, "get_preferred_scheme"):
        folders.append(sysconfig.get_path("scripts", sysconfig.get_preferred_scheme("user")))
    for folder in folders:
        found = Path(folder) / name
        if found.is_file():
            return str(found)
    on_path = shutil.which("lvox")
    if on_path is None:
        raise FileNotFoundError("the program lvox was not found: install it, or name it by LVOX_PROGRAM")
    return on_path


def words_of(settings: Mapping[str, Any]) -> list[str]:
    """Settings as words of a command line."""
    words: list[str] = []
    for name, value in settings.items():
        if value is None or value is False:
            continue
        words.append("--" + name.replace("_", "-"))
        if value is True:
            continue
        if isinstance(value, (list, tuple)):
            if name == "resolution":
                words.append("x".join(str(v) for v in value))
            elif all(isinstance(v, str) for v in value):
                words.append(",".join(value))
            else:
                words += [str(v) for v in value]
        else:
            words.append(os.fspath(value) if isinstance(value, os.PathLike) else str(value))
    return words


def run(verb: str, *words: PathLike, **settings: Any) -> str:
    """Runs ``lvox VERB WORDS --SETTINGS`` and returns what it prints.

    Raises :class:`InputError` for what it refuses and :class:`LvoxError` for what fails; what it warns of
    becomes a :class:`LvoxWarning`.
    """
    line = [program(), verb, *(os.fspath(word) for word in words), *words_of(settings)]
    if "progress" not in settings and "quiet" not in settings:
        line += ["--progress", "none"]
    done = subprocess.run(line, capture_output=True, text=True, encoding="utf-8", errors="replace", check=False)
    told = done.stderr.splitlines()
    for text in told:
        if text.startswith("warning: "):
            warnings.warn(text[len("warning: ") :], LvoxWarning, stacklevel=3)
    if done.returncode != 0:
        errors = [text for text in told if not text.startswith("warning: ") and text.strip()]
        message = "\n".join(errors) or f"lvox {verb} ended with code {done.returncode}"
        if message.startswith("error: "):
            message = message[len("error: ") :]
        kind = InputError if done.returncode == 2 else LvoxError
        raise kind(message, done.returncode)
    return done.stdout
