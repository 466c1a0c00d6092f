#!/usr/bin/env python3
"""The volume of a scene as a .vol file of Mitsuba, numbers from 0 to 1:
volume.py SOURCE.raw|SOURCE.nrrd OUT.vol. A .raw file is a cube of float32, an .nrrd file uint8, gzip."""
import struct
import sys
import zlib

source, out = sys.argv[1:]
content = open(source, "rb").read()
if source.endswith(".raw"):
    side = round((len(content) // 4) ** (1 / 3))
    sizes, values = [side] * 3, content
else:
    head, _, packed = content.partition(b"\n\n")
    fields = dict(line.split(": ", 1) for line in head.decode().splitlines() if ": " in line)
    assert (fields["type"], fields["encoding"]) == ("uint8", "gzip"), fields
    sizes = [int(word) for word in fields["sizes"].split()]
    voxels = zlib.decompress(packed, 31)
    values = struct.pack(f"<{len(voxels)}f", *(v / 255 for v in voxels))
with open(out, "wb") as file:
    file.write(b"VOL\3" + struct.pack("<5i6f", 1, *sizes, 1, 0, 0, 0, 1, 1, 1) + values)
