"""Scenes as Python values: written as a scene file, with arrays as the files that it names."""

from __future__ import annotations

import json
import math
import os
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any, Union

import numpy as np

from ._exr import write_exr
from ._program import PathLike

Scene = Union[PathLike, Mapping[str, Any]]

#: Keys whose values are names of files, or, of `opacity`, may be.
_FILES = ("file", "image", "texture", "opacity", "emission_texture", "transfer")
#: Keys that may be given many times.
_TABLES = ("camera", "light", "mesh", "volume")


@contextmanager
def scene_file(scene: Scene) -> Iterator[list[str]]:
    """The words that name a scene on a command line; files that are made for it go when it is left."""
    if not isinstance(scene, Mapping):
        yield ["--demo"] if scene == "demo" else [str(scene)]
        return
    with TemporaryDirectory(prefix="lvox-") as folder:
        path = Path(folder) / "scene.toml"
        path.write_text(to_toml(scene, Path(folder)), encoding="utf-8")
        yield [str(path)]


def to_toml(scene: Mapping[str, Any], folder: Path) -> str:
    """The text of a scene file; arrays become files in a folder, other names of files absolute."""
    plain, tables = [], []
    for key, value in scene.items():
        if key in _TABLES:
            many = [value] if isinstance(value, Mapping) else value
            for i, table in enumerate(many):
                table = _with_files(key, table, folder / f"{key}{i}")
                tables.append(f"\n[[{key}]]\n" + _lines(table))
        elif isinstance(value, Mapping):
            tables.append(f"\n[{key}]\n" + _lines(value))
        elif key == "packed":
            plain.append(f"packed = {_value(key, str(Path(value).absolute()))}\n")
        else:
            plain.append(f"{_key(key)} = {_value(key, value)}\n")
    return "".join(plain + tables)


def _with_files(kind: str, table: Mapping[str, Any], path: Path) -> dict[str, Any]:
    """A table with files in place of arrays, and files by absolute names."""
    found = dict(table)
    if kind == "volume" and "density" in found:
        found["file"] = _write_nrrd(path.with_suffix(".nrrd"), found.pop("density"))
        if "world_from_index" not in found:
            found.setdefault("unitcube_to_world", np.eye(4))
    if kind == "mesh" and "vertices" in found:
        vertices, triangles = found.pop("vertices"), found.pop("triangles")
        found["file"] = _write_ply(path.with_suffix(".ply"), vertices, triangles)
    if kind == "light" and isinstance(found.get("image"), np.ndarray):
        found["image"] = _write_sky(path.with_suffix(".exr"), found["image"])
    if isinstance(found.get("emission"), Mapping):
        found["emission"] = _with_files("emission", found["emission"], path)
    for name in _FILES:
        value = found.get(name)
        if isinstance(value, (str, os.PathLike)):
            if not str(value).startswith("builtin:"):
                found[name] = str(Path(value).absolute())
        elif isinstance(value, np.ndarray) and value.ndim > 0:
            raise TypeError(f"{name} of a {kind}: expected the name of a file, found an array")
    return found


def _lines(table: Mapping[str, Any]) -> str:
    return "".join(f"{_key(key)} = {_value(key, value)}\n" for key, value in table.items() if value is not None)


def _key(key: str) -> str:
    is_bare = key and all(c.isascii() and (c.isalnum() or c in "_-") for c in key)
    return key if is_bare else _string(key)


def _string(text: str) -> str:
    return json.dumps(text, ensure_ascii=False).replace("\x7f", "\\u007f")


def _value(key: str, value: Any) -> str:
    if isinstance(value, np.generic):
        value = value.item()
    if isinstance(value, bool):
        return "true" if value else "false"
    if isinstance(value, (int, str)):
        return str(value) if isinstance(value, int) else _string(value)
    if isinstance(value, float):
        if not math.isfinite(value):
            raise ValueError(f"{key}: expected a finite number, found {value}")
        return repr(value)
    if isinstance(value, Path):
        return _string(str(value))
    if isinstance(value, Mapping):
        return "{ " + ", ".join(f"{_key(k)} = {_value(k, v)}" for k, v in value.items()) + " }"
    if isinstance(value, (list, tuple, np.ndarray)):
        return "[" + ", ".join(_value(key, v) for v in value) + "]"
    raise TypeError(f"{key}: expected a number, a text, a list or a table, found {type(value).__name__}")


def _write_nrrd(path: Path, density: Any) -> str:
    """Writes values by [x, y, z] as a volume of the unit cube."""
    values = np.asarray(density, dtype="<f4")
    if values.ndim != 3 or 0 in values.shape:
        raise ValueError(f"density: expected values by [x, y, z], found the shape {values.shape}")
    sizes = " ".join(map(str, values.shape))
    head = f"NRRD0004\ntype: float\ndimension: 3\nsizes: {sizes}\nendian: little\nencoding: raw\n\n"
    path.write_bytes(head.encode() + values.tobytes(order="F"))
    return str(path)


def _write_sky(path: Path, image: Any) -> str:
    """Writes height x width x 3 as the image of an environment."""
    try:
        write_exr(path, image)
    except (TypeError, ValueError) as error:
        raise ValueError(f"image of a light: {error}") from error
    return str(path)


def _write_ply(path: Path, vertices: Any, triangles: Any) -> str:
    """Writes a mesh of N x 3 positions and M x 3 indices."""
    points = np.asarray(vertices, dtype="<f8")
    corners = np.asarray(triangles)
    if points.ndim != 2 or points.shape[1] != 3:
        raise ValueError(f"vertices: expected N x 3, found the shape {points.shape}")
    if corners.ndim != 2 or corners.shape[1] != 3 or corners.dtype.kind not in "iu":
        raise ValueError(f"triangles: expected M x 3 of integers, found {corners.dtype} of shape {corners.shape}")
    if len(corners) and not 0 <= corners.min() <= corners.max() < len(points):
        raise ValueError(f"triangles: expected indices from 0 to {len(points) - 1}")
    faces = np.empty(len(corners), np.dtype([("n", "u1"), ("v", "<i4", 3)]))
    faces["n"], faces["v"] = 3, corners
    head = (
        "ply\nformat binary_little_endian 1.0\n"
        f"element vertex {len(points)}\nproperty double x\nproperty double y\nproperty double z\n"
        f"element face {len(corners)}\nproperty list uchar int vertex_indices\nend_header\n"
    )
    path.write_bytes(head.encode() + points.tobytes() + faces.tobytes())
    return str(path)
