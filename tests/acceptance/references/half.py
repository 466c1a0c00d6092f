#!/usr/bin/env python3
"""half.py REFERENCE HALF: the colours of an image that `lvox reference` wrote, as 16-bit floats, with its attributes but
without variance. Prints spp, the expected relMSE against the truth from the variance (whole, and of the 99.9 % of pixels
with the least), and the scene's hash."""

import struct
import sys
import zlib

from exr import read

ROWS = 16  # rows of a block of ZIP compression


def zip_up(data):
    raw = bytearray(data[0::2] + data[1::2])
    for i in range(len(raw) - 1, 0, -1):
        raw[i] = (raw[i] - raw[i - 1] + 128) & 255
    packed = zlib.compress(bytes(raw), 9)
    return packed if len(packed) < len(data) else data


def write(name, attributes, rows):
    names = sorted(rows)
    width, height = len(rows[names[0]][0]), len(rows[names[0]])
    channels = b"".join(n.encode() + b"\0" + struct.pack("<iB3x2i", 1, 0, 1, 1) for n in names) + b"\0"
    head = b"\x76\x2f\x31\x01" + struct.pack("<i", 2)
    for key, kind, value in attributes:
        value = channels if key == "channels" else value
        head += key.encode() + b"\0" + kind.encode() + b"\0" + struct.pack("<i", len(value)) + value
    head += b"\0"
    blocks = []
    for y in range(0, height, ROWS):
        lines = [struct.pack(f"<{width}e", *(max(-65504.0, min(v, 65504.0)) for v in rows[n][j]))
                 for j in range(y, min(y + ROWS, height)) for n in names]
        packed = zip_up(b"".join(lines))
        blocks.append(struct.pack("<2i", y, len(packed)) + packed)
    at, table = len(head) + 8 * len(blocks), b""
    for block in blocks:
        table += struct.pack("<Q", at)
        at += len(block)
    with open(name, "wb") as exr:
        exr.write(head + table + b"".join(blocks))


def main():
    attributes, rows = read(sys.argv[1])
    compression = next(v for key, _, v in attributes if key == "compression")
    assert compression == b"\3", "ZIP compression was expected"
    colours = {n: rows[n] for n in "RGB"}
    relative = []
    for y in range(len(rows["R"])):
        for x in range(len(rows["R"][0])):
            pairs = ((rows[c][y][x], rows["variance." + c][y][x]) for c in "RGB")
            relative.append(sum(v / (m * m + 0.01) for m, v in pairs) / 3)
    relative.sort()
    kept = relative[: int(len(relative) * 0.999)]
    write(sys.argv[2], attributes, colours)
    texts = {key: v.decode("utf-8", "replace") for key, kind, v in attributes if key.startswith("lvox/")}
    print(f"{texts['lvox/spp']} {sum(relative) / len(relative):.1e} {sum(kept) / len(kept):.1e} {texts['lvox/scene']}")


main()
