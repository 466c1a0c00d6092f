"""Reads scan-line OpenEXR files of 16 or 32-bit floats, not compressed or by ZIP, with nothing but Python."""

import struct
import zlib

ROWS = {0: 1, 2: 1, 3: 16}  # rows of a chunk by compression: none, ZIPS, ZIP
CODES = {1: ("e", 2), 2: ("f", 4)}  # of struct, and bytes, by type of channel: half, float


def unzip(data, size):
    if len(data) == size:
        return data
    raw = bytearray(zlib.decompress(data))
    for i in range(1, len(raw)):
        raw[i] = (raw[i - 1] + raw[i] - 128) & 255
    out = bytearray(size)
    middle = (size + 1) // 2
    out[0::2], out[1::2] = raw[:middle], raw[middle:]
    return bytes(out)


def read(name):
    """Attributes (name, type, bytes) in order, and rows of floats by channel."""
    with open(name, "rb") as exr:
        data = exr.read()
    at, attributes = 8, []

    def text():
        nonlocal at
        end = data.index(b"\0", at)
        found, at = data[at:end].decode(), end + 1
        return found

    while data[at]:
        key, kind = text(), text()
        (size,) = struct.unpack_from("<i", data, at)
        attributes.append((key, kind, data[at + 4 : at + 4 + size]))
        at += 4 + size
    at += 1
    value = {key: v for key, _, v in attributes}
    x0, y0, x1, y1 = struct.unpack("<4i", value["dataWindow"])
    width, height = x1 - x0 + 1, y1 - y0 + 1
    channels, kinds, i = value["channels"], [], 0
    while channels[i]:
        end = channels.index(b"\0", i)
        (kind,) = struct.unpack_from("<i", channels, end + 1)
        kinds.append((channels[i:end].decode(), *CODES[kind]))
        i = end + 17
    rows = {name: [] for name, _, _ in kinds}
    lines = ROWS[value["compression"][0]]
    size = sum(width * step for _, _, step in kinds)
    for offset in struct.unpack_from(f"<{(height + lines - 1) // lines}Q", data, at):
        y, packed = struct.unpack_from("<2i", data, offset)
        count = min(lines, y1 + 1 - y)
        block = unzip(data[offset + 8 : offset + 8 + packed], size * count)
        start = 0
        for _ in range(count):
            for channel, code, step in kinds:
                rows[channel].append(struct.unpack_from(f"<{width}{code}", block, start))
                start += width * step
    return attributes, rows
