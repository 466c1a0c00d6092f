"""lvox renders colour bleeding in scenes with smoke, cloud and CT volumes.

This module runs the program ``lvox``, which comes with it, and gives its results as numpy arrays::

    import lvox

    image = lvox.render("scene.toml", quality="draft", aov=["depth"])
    image["beauty"]        # height x width x 3, linear Rec.709 radiance
    image["depth"]         # height x width

Settings are the options of the program by their long names, with ``_`` for ``-``: ``lvox help render``
lists them. What is wrong with a scene or a setting is an :class:`InputError` that says so in one line.
"""

from ._calls import bake, compare, gather, reference, render, tree
from ._exr import read_exr, write_exr
from ._scene import scene_file
from ._program import InputError, LvoxError, LvoxWarning, program, run

__all__ = [
    "InputError",
    "LvoxError",
    "LvoxWarning",
    "bake",
    "compare",
    "gather",
    "program",
    "read_exr",
    "reference",
    "render",
    "run",
    "scene_file",
    "tree",
    "write_exr",
]
