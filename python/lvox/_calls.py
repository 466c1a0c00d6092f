"""One function for each thing that people do with lvox from Python."""

from __future__ import annotations

import json
from collections.abc import Sequence
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any, Optional, Union

import numpy as np
from numpy.typing import NDArray

from ._exr import read_exr, write_exr
from ._program import PathLike, run
from ._scene import Scene, scene_file

Layers = dict[str, NDArray[np.float32]]


def render(scene: Scene, *, tree: Optional[PathLike] = None, **settings: Any) -> Layers:
    """Renders a scene and returns the layers of the image.

    ``scene`` is the path of a scene file, ``"demo"`` for the scene that is built in, or a dict with the keys
    of a scene file (docs/scene.md). In a dict a volume may have ``density``, an array of values by
    ``[x, y, z]``, in place of ``file``, which fill the unit cube unless ``unitcube_to_world`` or
    ``world_from_index`` place them, a mesh ``vertices`` (N x 3) and ``triangles`` (M x 3), and the ``image`` of an
    environment may be an array of height x width x 3. Names of files in a dict are relative to the working
    directory.

    With ``tree``, made by :func:`tree` of the same scene, only the frame is made: ``lvox shade``. Without,
    everything is made anew: ``lvox render``. ``settings`` are the options of these verbs.

    The result has ``beauty``, height x width x 3, in linear Rec.709 radiance (float32), ``direct``,
    ``indirect`` and others, and those that ``aov=["depth", "normal"]`` asks for.
    """
    with scene_file(scene) as words, TemporaryDirectory(prefix="lvox-") as folder:
        output = Path(folder) / "image.exr"
        if tree is None:
            run("render", *words, output=output, float=True, **settings)
        else:
            run("shade", *words, tree=tree, output=output, float=True, **settings)
        return read_exr(output)


def reference(scene: Scene, **settings: Any) -> Layers:
    """Renders a scene by the unbiased path tracer of lvox and returns the layers of the image.

    ``settings`` are the options of ``lvox reference``, as ``spp=64`` and ``max_depth=3``. The layer
    ``variance`` is that of each pixel's mean.
    """
    with scene_file(scene) as words, TemporaryDirectory(prefix="lvox-") as folder:
        output = Path(folder) / "image.exr"
        run("reference", *words, output=output, **settings)
        return read_exr(output)


def bake(scene: Scene, output: PathLike, **settings: Any) -> Path:
    """Bakes a scene into a cloud (.lvc) and returns its path; ``settings`` are those of ``lvox bake``."""
    with scene_file(scene) as words:
        run("bake", *words, output=output, **settings)
    return Path(output)


def tree(
    scene: Scene, output: PathLike, *, bounces: Union[int, str] = "all", force: bool = False, **settings: Any
) -> Path:
    """Makes the tree (.lvt) that frames of a scene and gathers are made from, and returns its path.

    ``bounces`` is the number of bounces of its light; with 1, frames have direct light and one bounce.
    ``settings`` are the options of ``lvox bake``.
    """
    with scene_file(scene) as words, TemporaryDirectory(prefix="lvox-") as folder:
        cloud, built = Path(folder) / "scene.lvc", Path(folder) / "built.lvt"
        run("bake", *words, output=cloud, **settings)
        if str(bounces) == "1":
            run("build", cloud, output=output, force=force)
        else:
            run("build", cloud, output=built)
            run("bounce", *words, tree=built, output=output, bounces=bounces, force=force)
    return Path(output)


def gather(
    tree: PathLike,
    points: Union[NDArray[np.floating], Sequence[Sequence[float]]],
    normals: Union[NDArray[np.floating], Sequence[Sequence[float]], None] = None,
    **settings: Any,
) -> Layers:
    """Gathers the light that surfaces and media send to points, from a tree alone.

    ``points`` and ``normals`` are N x 3, in world space. The result has ``irradiance`` (W/m2), N x 3, for
    points with normals, and ``mean_radiance`` (W/m2/sr) for those without. ``occlusion=True`` and
    ``distance=True`` add arrays of N. ``settings`` are the options of ``lvox gather``.
    """
    places = _rows("points", points)
    rows = places if normals is None else np.hstack([places, _rows("normals", normals, len(places))])
    of_sphere = normals is None or settings.get("over") == "sphere"
    with TemporaryDirectory(prefix="lvox-") as folder:
        given, output = Path(folder) / "points.npy", Path(folder) / "light.npy"
        np.save(given, rows)
        run("gather", tree, given, output=output, **settings)
        found = np.load(output)
    light: Layers = {"mean_radiance" if of_sphere else "irradiance": found[:, :3]}
    names = [name for name in ("occlusion", "distance") if settings.get(name)]
    for i, name in enumerate(names):
        light[name] = found[:, 3 + i]
    return light


def compare(
    image: Union[PathLike, NDArray[np.floating]], reference: Union[PathLike, NDArray[np.floating]], **settings: Any
) -> dict[str, Any]:
    """Compares an image with a reference and returns the metrics by their names.

    Each is the path of an image, or an array of height x width x 3; alpha is left out. relMSE is the mean over pixels and
    channels of (image - reference)^2 / (reference^2 + 0.01); ``lvox help compare`` has all formulas.
    """
    with TemporaryDirectory(prefix="lvox-") as folder:

        def path_of(given: Any, name: str) -> Path:
            if not isinstance(given, np.ndarray):
                return Path(given)
            path = Path(folder) / name
            has_alpha = given.ndim == 3 and given.shape[2] == 4
            write_exr(path, given[:, :, :3] if has_alpha else given)
            return path

        paths = path_of(image, "image.exr"), path_of(reference, "reference.exr")
        found: dict[str, Any] = json.loads(run("compare", *paths, json=True, **settings))
    return found


def _rows(what: str, values: Any, count: Optional[int] = None) -> NDArray[np.float64]:
    found = np.asarray(values, dtype=np.float64)
    if found.ndim != 2 or found.shape[1] != 3 or (count is not None and len(found) != count):
        expected = "N" if count is None else str(count)
        raise ValueError(f"{what}: expected {expected} x 3, found the shape {found.shape}")
    return found
