"""What exporters share: scene files as text, warnings, ranges of frames."""

import json
import os
import shutil
import sys

told = set()
# Names of files in the folder of the export, by where they come from.
copies = {}


def warn(what):
    """Says what is left out, once."""
    if what not in told:
        told.add(what)
        print("warning: " + what, file=sys.stderr)


def copied(path, folder, name=None, content=None):
    """The name in the folder of a copy of a file, or of its content: the same file once, others of its name
    numbered apart."""
    path = os.path.realpath(path)
    if path in copies:
        return copies[path]
    name = name or os.path.basename(path)
    stem, kind = os.path.splitext(name)
    count = 2
    while name in copies.values():
        name, count = f"{stem}.{count}{kind}", count + 1
    copies[path] = name
    target = os.path.join(folder, name)
    if content is not None:
        with open(target, "wb") as file:
            file.write(content)
    elif os.path.realpath(target) != path:
        shutil.copyfile(path, target)
    return name


def text(value):
    """A value as TOML has it."""
    if isinstance(value, str):
        return json.dumps(value, ensure_ascii=False).replace("\x7f", "\\u007f")
    if isinstance(value, bool):
        return "true" if value else "false"
    if isinstance(value, (list, tuple)):
        return "[" + ", ".join(text(v) for v in value) + "]"
    if isinstance(value, dict):
        return "{ " + ", ".join(f"{key} = {text(v)}" for key, v in value.items()) + " }"
    return repr(value) if isinstance(value, int) else f"{value:.9g}"


def table(title, keys):
    return f"\n{title}\n" + "".join(f"{key} = {text(value)}\n" for key, value in keys.items())


def frames_of(words):
    """As lvox reads them: 1-10, 1-10x2, 1,5,9."""
    numbers = []
    for word in words.split(","):
        span, _, step = word.replace(":", "x").partition("x")
        first, dash, last = span[1:].partition("-")
        first = span[:1] + first
        numbers += range(int(first), int(last if dash else first) + 1, int(step or 1))
    return numbers
