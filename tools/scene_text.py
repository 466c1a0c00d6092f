"""What exporters share: scene files as text, warnings, ranges of frames."""

import json
import sys

told = set()


def warn(what):
    """Says what is left out, once."""
    if what not in told:
        told.add(what)
        print("warning: " + what, file=sys.stderr)


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
