#!/usr/bin/env python3
"""Writes a forest as glTF: one tree, placed many times by EXT_mesh_gpu_instancing or by nodes.

    forest.py OUT.glb [TREES [TRIANGLES [nodes|instances]]]

TREES is 1000 and TRIANGLES, of the tree, 100000 if they are not given. Needs Python alone; equal
arguments give equal bytes.
"""

import json
import math
import random
import struct
import sys
from array import array


def tree(triangles):
    """A trunk and branches of six sides, and leaves of two triangles each."""
    rng = random.Random(5)
    positions, indices = array("f"), array("I")

    def quad(a, b, c, d):
        first = len(positions) // 3
        for p in (a, b, c, d):
            positions.extend(p)
        indices.extend((first, first + 1, first + 2, first, first + 2, first + 3))

    def limb(foot, top, r, s):
        around = [k * math.tau / 6 for k in range(7)]
        ring = lambda p, r: [(p[0] + r * math.cos(t), p[1], p[2] + r * math.sin(t)) for t in around]
        low, high = ring(foot, r), ring(top, s)
        for k in range(6):
            quad(low[k], high[k], high[k + 1], low[k + 1])

    limb((0, 0, 0), (0, 6, 0), 0.22, 0.1)
    tips = []
    for _ in range(60):
        height = rng.uniform(1.5, 5.8)
        reach = 0.25 + 0.42 * (6.2 - height)
        turn = rng.uniform(0, math.tau)
        tip = (reach * math.cos(turn), height + 0.5, reach * math.sin(turn))
        limb((0, height, 0), tip, 0.05, 0.02)
        tips.append(((0, height, 0), tip))
    wood = len(indices)
    while len(indices) < 3 * triangles:
        foot, tip = rng.choice(tips)
        along = rng.random() ** 0.5
        middle = [f + along * (t - f) + rng.gauss(0, 0.14) for f, t in zip(foot, tip)]
        u = [rng.gauss(0, 1) for _ in range(3)]
        v = [rng.gauss(0, 1) for _ in range(3)]
        size = 0.035
        scale_u = size / math.sqrt(sum(x * x for x in u))
        dot = sum(x * y for x, y in zip(u, v)) / sum(x * x for x in u)
        v = [y - dot * x for x, y in zip(u, v)]
        scale_v = size / math.sqrt(sum(x * x for x in v))
        corner = lambda a, b: [m + a * scale_u * x + b * scale_v * y for m, x, y in zip(middle, u, v)]
        quad(corner(-1, -1), corner(1, -1), corner(1, 1), corner(-1, 1))
    return positions, indices, wood


def places(count):
    """A place on a jittered square grid, a turn about the vertical and a size for each tree."""
    rng = random.Random(7)
    side = math.ceil(math.sqrt(count))
    for k in range(count):
        x, z = (k % side - side / 2 + 0.5) * 4, (k // side - side / 2 + 0.5) * 4
        place = (x + rng.uniform(-1.4, 1.4), 0.0, z + rng.uniform(-1.4, 1.4))
        half = rng.uniform(0, math.pi)
        turn = (0.0, math.sin(half), 0.0, math.cos(half))
        size = rng.uniform(0.7, 1.3)
        yield place, turn, (size, size * rng.uniform(0.9, 1.2), size)


def main():
    out = sys.argv[1]
    count = int(sys.argv[2]) if len(sys.argv) > 2 else 1000
    triangles = int(sys.argv[3]) if len(sys.argv) > 3 else 100_000
    as_nodes = len(sys.argv) > 4 and sys.argv[4] == "nodes"
    blob, views, accessors = bytearray(), [], []

    def accessor(values, kind, width, **more):
        content = values.tobytes()
        views.append({"buffer": 0, "byteOffset": len(blob), "byteLength": len(content)})
        blob.extend(content)
        component = 5126 if values.typecode == "f" else 5125
        entry = {"bufferView": len(views) - 1, "componentType": component, "type": kind}
        accessors.append(entry | {"count": len(values) // width} | more)
        return len(accessors) - 1

    positions, indices, wood = tree(triangles)
    ends = {"min": [-9.0, -9.0, -9.0], "max": [9.0, 9.0, 9.0]}
    of_tree = accessor(positions, "VEC3", 3, **ends)
    trunk = accessor(indices[:wood], "SCALAR", 1)
    leaves = accessor(indices[wood:], "SCALAR", 1)
    extent = 3.0 * math.ceil(math.sqrt(count))
    square = array("f", [-extent, 0, -extent, -extent, 0, extent, extent, 0, extent, extent, 0, -extent])
    of_ground = accessor(square, "VEC3", 3, min=[-extent, 0.0, -extent], max=[extent, 0.0, extent])
    ground = accessor(array("I", [0, 1, 2, 0, 2, 3]), "SCALAR", 1)
    all_places = list(places(count))
    used = []
    if as_nodes:
        trees = [{"mesh": 0, "translation": p, "rotation": q, "scale": s} for p, q, s in all_places]
    else:
        lists = [array("f", [x for place in all_places for x in place[i]]) for i in range(3)]
        kinds = [("TRANSLATION", "VEC3", 3), ("ROTATION", "VEC4", 4), ("SCALE", "VEC3", 3)]
        attributes = {name: accessor(v, kind, n) for v, (name, kind, n) in zip(lists, kinds)}
        trees = [{"mesh": 0, "extensions": {"EXT_mesh_gpu_instancing": {"attributes": attributes}}}]
        used = ["EXT_mesh_gpu_instancing"]
    primitive = lambda at, of, material: {"attributes": {"POSITION": at}, "indices": of, "material": material}
    color = lambda name, rgb: {
        "name": name,
        "doubleSided": True,
        "pbrMetallicRoughness": {"baseColorFactor": [*rgb, 1], "metallicFactor": 0},
    }
    back = extent * 0.55
    camera = {"camera": 0, "translation": [0, 9, back], "rotation": [-0.12, 0, 0, 0.9928]}
    sun = {"extensions": {"KHR_lights_punctual": {"light": 0}}, "rotation": [-0.46, 0.2, 0.1, 0.86]}
    nodes = [*trees, {"mesh": 1}, camera, sun]
    document = {
        "asset": {"version": "2.0", "generator": "lvox examples/forest.py"},
        "extensionsUsed": ["KHR_lights_punctual", *used],
        "extensionsRequired": used,
        "extensions": {"KHR_lights_punctual": {"lights": [{"type": "directional", "intensity": 3.0}]}},
        "scene": 0,
        "scenes": [{"nodes": list(range(len(nodes)))}],
        "nodes": nodes,
        "cameras": [{"type": "perspective", "perspective": {"yfov": 0.8, "znear": 0.1}}],
        "materials": [
            color("wood", (0.25, 0.16, 0.09)),
            color("leaves", (0.12, 0.35, 0.08)),
            color("ground", (0.3, 0.26, 0.18)),
        ],
        "meshes": [
            {"name": "tree", "primitives": [primitive(of_tree, trunk, 0), primitive(of_tree, leaves, 1)]},
            {"name": "ground", "primitives": [primitive(of_ground, ground, 2)]},
        ],
        "accessors": accessors,
        "bufferViews": views,
        "buffers": [{"byteLength": len(blob)}],
    }
    if not used:
        del document["extensionsRequired"]
    text = json.dumps(document, separators=(",", ":")).encode()
    text += b" " * (-len(text) % 4)
    blob += b"\0" * (-len(blob) % 4)
    with open(out, "wb") as file:
        file.write(struct.pack("<4sII", b"glTF", 2, 28 + len(text) + len(blob)))
        file.write(struct.pack("<I4s", len(text), b"JSON") + text)
        file.write(struct.pack("<I4s", len(blob), b"BIN\0") + blob)


main()
