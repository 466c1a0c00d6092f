"""Reads and writes the OpenEXR images that lvox makes: one part, scan lines, ZIP or no compression."""

from __future__ import annotations

import struct
import zlib
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from ._program import PathLike

_MAGIC = 20000630
_HALF, _FLOAT = 1, 2
_ORDERS = ("RGBA", "XYZ")


def read_exr(path: PathLike) -> dict[str, NDArray[np.float32]]:
    """The layers of an image, by their names.

    The main layer is ``beauty``. A layer with channels R G B, R G B A or X Y Z is height x width x channels,
    in this order; one of a single channel is height x width.

    Raises ``ValueError`` for a file that is none, or of a kind that lvox does not write.
    """
    data = Path(path).read_bytes()
    if len(data) < 8 or struct.unpack_from("<I", data)[0] != _MAGIC:
        raise ValueError(f"{path}: no OpenEXR image")
    if struct.unpack_from("<I", data, 4)[0] & 0x1A00:
        raise ValueError(f"{path}: expected scan lines of one part, found tiles, deep data or several parts")
    try:
        header, at = _header(data, 8)
        channels = _channels(header["channels"])
        planes = _planes(data, at, header, channels)
    except (KeyError, IndexError, struct.error, zlib.error) as error:
        raise ValueError(f"{path}: the file is damaged: {error}") from error
    return _layers(planes)


def write_exr(path: PathLike, image: NDArray[np.floating]) -> None:
    """Writes an array of height x width x 3 as an image of 32-bit floats."""
    pixels = np.ascontiguousarray(image, dtype="<f4")
    if pixels.ndim != 3 or pixels.shape[2] != 3 or 0 in pixels.shape:
        raise ValueError(f"expected height x width x 3, found {' x '.join(map(str, pixels.shape))}")
    height, width, _ = pixels.shape
    channels = b"".join(name + b"\0" + struct.pack("<iIii", _FLOAT, 0, 1, 1) for name in (b"B", b"G", b"R")) + b"\0"
    window = struct.pack("<iiii", 0, 0, width - 1, height - 1)
    attributes = [
        (b"channels", b"chlist", channels),
        (b"compression", b"compression", b"\0"),
        (b"dataWindow", b"box2i", window),
        (b"displayWindow", b"box2i", window),
        (b"lineOrder", b"lineOrder", b"\0"),
        (b"pixelAspectRatio", b"float", struct.pack("<f", 1.0)),
        (b"screenWindowCenter", b"v2f", struct.pack("<ff", 0.0, 0.0)),
        (b"screenWindowWidth", b"float", struct.pack("<f", 1.0)),
    ]
    head = struct.pack("<II", _MAGIC, 2)
    for name, kind, value in attributes:
        head += name + b"\0" + kind + b"\0" + struct.pack("<I", len(value)) + value
    head += b"\0"
    line_bytes = width * 3 * 4
    first = len(head) + 8 * height
    offsets = first + (8 + line_bytes) * np.arange(height, dtype="<u8")
    planar = pixels[:, :, ::-1].transpose(0, 2, 1)
    with open(path, "wb") as file:
        file.write(head + offsets.tobytes())
        for y in range(height):
            file.write(struct.pack("<iI", y, line_bytes) + planar[y].tobytes())


def _text(data: bytes, at: int) -> tuple[str, int]:
    end = data.index(b"\0", at)
    return data[at:end].decode("utf-8", "replace"), end + 1


def _header(data: bytes, at: int) -> tuple[dict[str, bytes], int]:
    found: dict[str, bytes] = {}
    while data[at] != 0:
        name, at = _text(data, at)
        _, at = _text(data, at)
        (size,) = struct.unpack_from("<I", data, at)
        found[name] = data[at + 4 : at + 4 + size]
        at += 4 + size
    return found, at + 1


def _channels(data: bytes) -> list[tuple[str, np.dtype]]:
    kinds = {_HALF: np.dtype("<f2"), _FLOAT: np.dtype("<f4")}
    found, at = [], 0
    while data[at] != 0:
        name, at = _text(data, at)
        (kind,) = struct.unpack_from("<i", data, at)
        found.append((name, kinds[kind]))
        at += 16
    return found


def _planes(
    data: bytes, at: int, header: dict[str, bytes], channels: list[tuple[str, np.dtype]]
) -> dict[str, NDArray[np.float32]]:
    x0, y0, x1, y1 = struct.unpack("<iiii", header["dataWindow"])
    width, height = x1 - x0 + 1, y1 - y0 + 1
    lines_of = {0: 1, 2: 1, 3: 16}
    compression = header["compression"][0]
    if compression not in lines_of:
        raise ValueError("expected ZIP or no compression")
    lines = lines_of[compression]
    planes = {name: np.empty((height, width), np.float32) for name, _ in channels}
    line_bytes = sum(kind.itemsize for _, kind in channels) * width
    for offset in struct.unpack_from(f"<{-(-height // lines)}Q", data, at):
        y, size = struct.unpack_from("<iI", data, offset)
        count = min(lines, height - (y - y0))
        block = data[offset + 8 : offset + 8 + size]
        if size < count * line_bytes:
            block = _unzipped(block)
        row = 0
        for line in range(y - y0, y - y0 + count):
            for name, kind in channels:
                planes[name][line] = np.frombuffer(block, kind, width, row)
                row += width * kind.itemsize
    return planes


def _unzipped(block: bytes) -> bytes:
    """Undoes ZIP, the differences between bytes, and their split into halves."""
    steps = np.frombuffer(zlib.decompress(block), np.uint8).astype(np.int64)
    steps[1:] -= 128
    split = np.cumsum(steps).astype(np.uint8)
    joined = np.empty_like(split)
    middle = (len(split) + 1) // 2
    joined[0::2], joined[1::2] = split[:middle], split[middle:]
    return joined.tobytes()


def _layers(planes: dict[str, NDArray[np.float32]]) -> dict[str, NDArray[np.float32]]:
    groups: dict[str, dict[str, NDArray[np.float32]]] = {}
    for name, plane in planes.items():
        layer, _, channel = name.rpartition(".")
        groups.setdefault(layer or "beauty", {})[channel] = plane
    layers = {}
    for layer, found in groups.items():
        order = next((o for o in _ORDERS if len(found) > 1 and set(found) <= set(o)), None)
        names = sorted(found, key=order.index) if order else sorted(found)
        layers[layer] = found[names[0]] if len(names) == 1 else np.stack([found[n] for n in names], axis=-1)
    return layers
