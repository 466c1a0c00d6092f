#!/usr/bin/env python3
"""Writes the meshes and volumes of the scenes in this folder, into this folder. They are committed, since sines differ in
the last digit between machines and references belong to a scene's exact bytes: run this only to change a scene, and remake
its reference then (../../references/make.sh)."""

import math
import os
import struct
import zlib
from math import cos, pi, sin, sqrt

HERE = os.path.dirname(os.path.abspath(__file__))


def path(name):
    return os.path.join(HERE, name)


def noise(x, y, z, seed):
    """Smooth random values in [0,1] over a lattice of step 1."""

    def at(i, j, k):
        h = (i * 374761393 + j * 668265263 + k * 2147483647 + seed * 1274126177) & 0xFFFFFFFF
        h = ((h ^ (h >> 13)) * 1103515245) & 0xFFFFFFFF
        h = ((h ^ (h >> 16)) * 2246822519) & 0xFFFFFFFF
        return ((h ^ (h >> 15)) & 0xFFFFFF) / 0xFFFFFF

    i, j, k = math.floor(x), math.floor(y), math.floor(z)
    u, v, w = (t * t * (3 - 2 * t) for t in (x - i, y - j, z - k))
    total = 0.0
    for a in (0, 1):
        for b in (0, 1):
            for c in (0, 1):
                total += at(i + a, j + b, k + c) * (u if a else 1 - u) * (v if b else 1 - v) * (w if c else 1 - w)
    return total


def turbulence(x, y, z, seed, octaves=4):
    total, weight = 0.0, 0.5
    for octave in range(octaves):
        total += weight * noise(x, y, z, seed + octave)
        x, y, z, weight = 2.03 * x + 5.2, 2.03 * y + 5.2, 2.03 * z + 5.2, weight / 2
    return total / (1 - 2 * weight)


# Meshes ------------------------------------------------------------------------------------------------------------


def write_ply(name, vertices, normals, faces):
    """Binary PLY; `normals` may be None."""
    extra = "property float nx\nproperty float ny\nproperty float nz\n" if normals else ""
    with open(path(name), "wb") as ply:
        ply.write(
            f"ply\nformat binary_little_endian 1.0\nelement vertex {len(vertices)}\nproperty float x\nproperty float y\n"
            f"property float z\n{extra}element face {len(faces)}\nproperty list uchar ushort vertex_indices\n"
            "end_header\n".encode()
        )
        for i, v in enumerate(vertices):
            ply.write(struct.pack("<3f", *v))
            if normals:
                ply.write(struct.pack("<3f", *normals[i]))
        for f in faces:
            ply.write(struct.pack(f"<B{len(f)}H", len(f), *f))


def normalized(v):
    length = sqrt(sum(c * c for c in v)) or 1.0
    return tuple(c / length for c in v)


def cross(a, b):
    return (a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0])


def grid(surface, across, down, normals=True):
    """`surface(u, v)` over the unit square; the front is on the side of d/du x d/dv."""
    vertices, directions = [], []
    e = 1e-4
    for j in range(down + 1):
        for i in range(across + 1):
            u, v = i / across, j / down
            vertices.append(surface(u, v))
            du = [b - a for a, b in zip(surface(u - e, v), surface(u + e, v))]
            dv = [b - a for a, b in zip(surface(u, v - e), surface(u, v + e))]
            directions.append(normalized(cross(du, dv)))
    faces = []
    for j in range(down):
        for i in range(across):
            a = j * (across + 1) + i
            b, c, d = a + 1, a + across + 1, a + across + 2
            faces += [(a, b, d), (a, d, c)]
    return vertices, directions if normals else None, faces


def icosphere(levels):
    t = (1 + sqrt(5)) / 2
    vertices = [normalized(v) for v in (
        (-1, t, 0), (1, t, 0), (-1, -t, 0), (1, -t, 0), (0, -1, t), (0, 1, t),
        (0, -1, -t), (0, 1, -t), (t, 0, -1), (t, 0, 1), (-t, 0, -1), (-t, 0, 1))]
    faces = [(0, 11, 5), (0, 5, 1), (0, 1, 7), (0, 7, 10), (0, 10, 11), (1, 5, 9), (5, 11, 4), (11, 10, 2), (10, 7, 6),
             (7, 1, 8), (3, 9, 4), (3, 4, 2), (3, 2, 6), (3, 6, 8), (3, 8, 9), (4, 9, 5), (2, 4, 11), (6, 2, 10),
             (8, 6, 7), (9, 8, 1)]
    for _ in range(levels):
        middle = {}

        def between(a, b):
            key = (min(a, b), max(a, b))
            if key not in middle:
                middle[key] = len(vertices)
                vertices.append(normalized([x + y for x, y in zip(vertices[a], vertices[b])]))
            return middle[key]

        split = []
        for a, b, c in faces:
            ab, bc, ca = between(a, b), between(b, c), between(c, a)
            split += [(a, ab, ca), (ab, b, bc), (ca, bc, c), (ab, bc, ca)]
        faces = split
    return vertices, faces


class Obj:
    """Quads and triangles by material."""

    def __init__(self, material_file):
        self.lines = [f"mtllib {material_file}"]
        self.count = 0

    def material(self, name):
        self.lines.append(f"usemtl {name}")

    def polygon(self, *corners):
        for c in corners:
            self.lines.append("v " + " ".join(f"{v:.5g}" for v in c))
        self.lines.append("f " + " ".join(str(self.count + i + 1) for i in range(len(corners))))
        self.count += len(corners)

    def box(self, low, high, turn_deg=0.0, axis="z", inside_out=False, open_sides=()):
        """Faces point outwards; turned about its centre. `open_sides` are left out, such as "+z"."""
        middle = [(a + b) / 2 for a, b in zip(low, high)]
        s, c = sin(turn_deg * pi / 180), cos(turn_deg * pi / 180)

        def turned(p):
            x, y, z = (a - m for a, m in zip(p, middle))
            if axis == "z":
                x, y = c * x - s * y, s * x + c * y
            elif axis == "x":
                y, z = c * y - s * z, s * y + c * z
            else:
                z, x = c * z - s * x, s * z + c * x
            return (x + middle[0], y + middle[1], z + middle[2])

        for a in range(3):
            b, d = (a + 1) % 3, (a + 2) % 3
            for sign, side in (("+", high), ("-", low)):
                if sign + "xyz"[a] in open_sides:
                    continue
                corners = []
                for s1, s2 in ((low, low), (high, low), (high, high), (low, high)):
                    p = [0.0, 0.0, 0.0]
                    p[a], p[b], p[d] = side[a], s1[b], s2[d]
                    corners.append(turned(p))
                if (sign == "-") != inside_out:
                    corners.reverse()
                self.polygon(*corners)

    def write(self, name):
        with open(path(name), "w", newline="\n") as obj:
            obj.write("\n".join(self.lines) + "\n")


def write_mtl(name, materials):
    with open(path(name), "w", newline="\n") as mtl:
        for material, (kd, ke) in materials.items():
            mtl.write(f"newmtl {material}\nKd {kd[0]:g} {kd[1]:g} {kd[2]:g}\n")
            if ke:
                mtl.write(f"Ke {ke[0]:.5g} {ke[1]:.5g} {ke[2]:.5g}\n")


# Scenes ------------------------------------------------------------------------------------------------------------


def curved():
    def drape(u, v):
        fold = 0.16 * sin(5 * 2 * pi * u) * (0.35 + 0.65 * (1 - v)) + 0.05 * sin(2 * pi * (2 * u + 0.7 * v))
        return (-1.35 + 1.5 * u, 0.15 + 1.9 * v, -1.2 + fold)

    write_ply("drape.ply", *grid(drape, 90, 24))

    def vase(u, v):
        # Up the outside, over the lip and down the inside: one closed sheet 2 cm thick.
        outside = v < 0.52
        h = v / 0.52 if outside else (1 - v) / 0.48
        radius = 0.16 + 0.20 * sin(pi * (0.12 + 0.74 * h)) ** 2 + 0.10 * h**6
        radius *= min(1.0, 6 * h + 0.55)
        if not outside:
            radius, h = max(radius - 0.02, 0.0) * min(1.0, 12 * h), 0.03 + 0.97 * h
        a = 2 * pi * u
        return (radius * sin(a), 0.75 * h, radius * cos(a))

    write_ply("vase.ply", *grid(vase, 72, 36))
    vertices, faces = icosphere(1)
    write_ply("bulb.ply", vertices, vertices, faces)


def lights100():
    hall = Obj("hall.mtl")
    hall.material("stone")
    hall.box((-5, 0, -3), (5, 4, 3), inside_out=True)
    hall.material("plaster")
    for x in (-3.6, -1.2, 1.2, 3.6):
        for z in (-1.7, 1.7):
            hall.box((x - 0.32, 0, z - 0.32), (x + 0.32, 0.25, z + 0.32), open_sides=("-y",))
            sides = 10
            for i in range(sides):
                a, b = (2 * pi * k / sides for k in (i, i + 1))
                r0, r1 = 0.24, 0.19
                hall.polygon((x + r0 * sin(a), 0.25, z + r0 * cos(a)), (x + r0 * sin(b), 0.25, z + r0 * cos(b)),
                             (x + r1 * sin(b), 3.4, z + r1 * cos(b)), (x + r1 * sin(a), 3.4, z + r1 * cos(a)))
            hall.box((x - 0.28, 3.4, z - 0.28), (x + 0.28, 3.6, z + 0.28))
    hall.material("oak")
    for z0, z1 in ((-2.0, -1.4), (1.4, 2.0)):
        hall.box((-5, 3.6, z0), (5, 3.99, z1), open_sides=("-x", "+x"))
    # A gallery along the far wall, with balusters, and stairs that lead to it.
    hall.box((2.0, 2.0, -2.99), (4.99, 2.15, -2.05))
    for i in range(16):
        x = 2.1 + 0.185 * i
        hall.box((x, 2.15, -2.12), (x + 0.05, 2.85, -2.07))
    hall.box((2.0, 2.85, -2.15), (4.99, 2.93, -2.04))
    for i in range(10):
        hall.box((0.05 + 0.2 * i, 0, -2.9), (0.25 + 0.2 * i, 0.2 * (i + 1), -2.1), open_sides=("-y",))
    hall.material("red")
    hall.box((-4.2, 0, -0.5), (-2.4, 0.75, 0.5), turn_deg=14, axis="y")
    hall.material("blue")
    hall.box((-0.6, 0, 0.2), (0.4, 0.45, 1.0), turn_deg=-30, axis="y")
    hall.write("hall.obj")
    write_mtl("hall.mtl", {
        "stone": ((0.62, 0.60, 0.56), None), "plaster": ((0.75, 0.74, 0.70), None), "oak": ((0.38, 0.25, 0.14), None),
        "red": ((0.60, 0.08, 0.06), None), "blue": ((0.07, 0.14, 0.50), None)})

    lamps, materials = Obj("lamps.mtl"), {}
    for k in range(100):
        a, b, c, d = (noise(k, i, 7, 40 + i) for i in range(4))
        # Along the beams, around the columns, below the gallery, and low along the walls.
        kind = k % 4
        if kind == 0:
            at, facing = (-4.7 + 9.4 * a, 3.55, (-1.7, 1.7)[k % 8 == 0] + 0.5 * (b - 0.5)), (0, -1, 0)
        elif kind == 1:
            column = ((-3.6, -1.2, 1.2, 3.6)[k // 4 % 4], (-1.7, 1.7)[k // 16 % 2])
            turn = 2 * pi * b
            facing = (sin(turn), 0.0, cos(turn))
            at = (column[0] + 0.3 * facing[0], 0.7 + 2.4 * a, column[1] + 0.3 * facing[2])
        elif kind == 2:
            at, facing = (2.2 + 2.6 * a, 1.97, -2.9 + 0.7 * b), (0, -1, 0)
        else:
            wall = k // 4 % 3
            at, facing = (((-4.9 + 9.8 * a, 0.3 + 3 * b, -2.97), (0, 0, 1)), ((-4.97, 0.3 + 3 * b, -2.8 + 5.6 * a), (1, 0, 0)),
                          ((4.97, 0.3 + 1.4 * b, -2.8 + 5.6 * a), (-1, 0, 0)))[wall]
        side = 0.03 + 0.07 * c
        x = normalized(cross((0.3, 1, 0.2), facing))
        y = cross(facing, x)
        corner = lambda s: tuple(p + side * (cos(s) * u + sin(s) * v) for p, u, v in zip(at, x, y))
        # Power over a range of about 40, in warm, cold and coloured light.
        radiance = 30 * 6 ** (2 * d - 1)
        hue = 2 * pi * noise(k, 4, 7, 44)
        tint = [1 + 0.45 * cos(hue - 2 * pi * i / 3) for i in range(3)]
        name = f"lamp{k}"
        materials[name] = ((0, 0, 0), [radiance * t for t in tint])
        lamps.material(name)
        lamps.polygon(corner(0.0), corner(2 * pi / 3), corner(4 * pi / 3))
    lamps.write("lamps.obj")
    write_mtl("lamps.mtl", materials)


def volumes():
    def ball(x, y, z):
        r = sqrt((x - 0.5) ** 2 + (y - 0.5) ** 2 + (z - 0.5) ** 2)
        return (0.47 - r) / 0.14 + 2.2 * (turbulence(5 * x, 5 * y, 5 * z, 3) - 0.5)

    write_raw("puff.raw", 36, 36, 36, ball)

    def layer(x, y, z):
        sides = min(x, 1 - x, z, 1 - z) / 0.08
        return min(sides, y / 0.06, (1 - y) / 0.5, 1) * (0.25 + 1.1 * turbulence(3 * x, 2 * y, 3 * z, 9, 3) ** 2)

    write_raw("haze.raw", 32, 14, 32, layer)


def write_raw(name, nx, ny, nz, density):
    with open(path(name), "wb") as raw:
        for k in range(nz):
            for j in range(ny):
                for i in range(nx):
                    value = density((i + 0.5) / nx, (j + 0.5) / ny, (k + 0.5) / nz)
                    raw.write(bytes([round(255 * min(max(value, 0), 1))]))


def thin():
    room = Obj("thin.mtl")
    # Walls are 4 mm sheets of board; the room is 4 x 2.5 x 3, open behind the camera. All lengths in metres.
    t = 0.004
    room.material("white")
    room.box((-2, -t, -1.5), (2, 0, 1.5))
    room.box((-2, 2.5, -1.5), (2, 2.5 + t, 1.5))
    room.box((-2, 0, -1.5 - t), (2, 2.5, -1.5))
    room.material("red")
    room.box((-2 - t, 0, -1.5), (-2, 2.5, 1.5))
    room.material("green")
    room.box((2, 0, -1.5), (2 + t, 2.5, 1.5))
    # A partition with 3 mm left below, above and behind it; what is right of it gets its light over and through that.
    room.material("white")
    room.box((0.7, 0.003, -1.497), (0.7 + t, 2.497, 0.35))
    # A lit chest below louvres: slats of 4 mm, a chamber of light behind.
    room.material("grey")
    room.box((-1.6, 0, -1.2), (-0.6, 0.004, -0.6))
    room.box((-1.6, 0, -1.2), (-1.596, 0.9, -0.6))
    room.box((-0.604, 0, -1.2), (-0.6, 0.9, -0.6))
    room.box((-1.6, 0, -1.2), (-0.6, 0.9, -1.196))
    room.box((-1.6, 0.896, -1.2), (-0.6, 0.9, -0.6))
    for i in range(10):
        y = 0.05 + 0.085 * i
        room.box((-1.59, y - 0.002, -0.65), (-0.61, y + 0.002, -0.57), turn_deg=35, axis="x")
    # Boards that stand 3 mm apart on the floor, a shelf 3 mm off the wall, and a sheet of paper leaning.
    room.material("oak")
    for i in range(8):
        x = -0.3 + 0.083 * i
        room.box((x, 0.003, -0.35), (x + 0.08, 0.55, -0.33))
    room.box((-0.35, 1.2, -1.497), (0.55, 1.22, -1.2))
    room.material("white")
    room.polygon((1.15, 0.001, 0.2), (1.65, 0.001, 0.0), (1.75, 0.6, 0.2), (1.25, 0.6, 0.4))
    room.material("lamp")
    # A panel 3 mm below the ceiling, and a tube of light inside the chest.
    room.polygon((-1.2, 2.497, -0.5), (0.1, 2.497, -0.5), (0.1, 2.497, 0.3), (-1.2, 2.497, 0.3))
    room.material("tube")
    room.polygon((-1.5, 0.7, -1.15), (-0.7, 0.7, -1.15), (-0.7, 0.74, -1.15), (-1.5, 0.74, -1.15))
    room.write("thin.obj")
    write_mtl("thin.mtl", {
        "white": ((0.74, 0.73, 0.71), None), "red": ((0.58, 0.09, 0.07), None), "green": ((0.12, 0.42, 0.14), None),
        "grey": ((0.5, 0.5, 0.52), None), "oak": ((0.42, 0.28, 0.15), None), "lamp": ((0, 0, 0), (7, 6.6, 5.8)),
        "tube": ((0, 0, 0), (60, 40, 22))})


def outdoor():
    def ground(u, v):
        x, z = 24 * (u - 0.5), 24 * (0.5 - v)
        hills = 2.6 * turbulence(x / 7 + 9, 0.3, z / 7 + 9, 5, 5) + 0.35 * turbulence(x, 0.7, z, 8, 3)
        valley = min(1.0, (x * x + (z - 6) ** 2) / 60)
        return (x, (hills - 1.2) * (0.25 + 0.75 * valley), z)

    vertices, _, faces = grid(ground, 88, 88, normals=False)
    write_ply("ground.ply", vertices, None, faces)
    vertices, faces = icosphere(4)

    def rock(p):
        r = 0.75 + 0.6 * turbulence(1.6 * p[0] + 7, 1.6 * p[1] + 7, 1.6 * p[2] + 7, 21, 4)
        return tuple(r * c for c in p)

    write_ply("rock.ply", [rock(v) for v in vertices], None, faces)

    def cloud(x, y, z):
        r = sqrt(((x - 0.5) / 0.44) ** 2 + ((y - 0.4) / 0.42) ** 2 + ((z - 0.5) / 0.44) ** 2)
        return 2.5 * (1 - r) + 3.4 * (turbulence(6 * x, 3 * y, 6 * z, 13, 4) - 0.5)

    write_raw("cloud.raw", 40, 20, 40, cloud)


def lampshade():
    # Radius at the foot and at the top, 0.35 above it.
    def ring(u, radius, y):
        return (radius * sin(2 * pi * u), y, radius * cos(2 * pi * u))

    vertices, _, faces = grid(lambda u, v: ring(u, 0.18 - 0.06 * v, 0.35 * v), 48, 1, normals=False)
    write_ply("shade_sheet.ply", vertices, None, faces)
    # Up the outside, over the rim, down the inside and back to the foot: a wall of 6 mm.
    profile = [(0.18, 0.0), (0.12, 0.35), (0.114, 0.35), (0.174, 0.0), (0.18, 0.0)]
    vertices, _, faces = grid(lambda u, v: ring(u, *profile[round(4 * v)]), 48, 4, normals=False)
    write_ply("shade_wall.ply", vertices, None, faces)


def write_png(name, side, texel):
    """A PNG of what `texel` says of each place: three bytes of colour, and one of alpha if it has four."""
    rows = [[texel(x, y) for x in range(side)] for y in range(side)]
    kind = 2 if len(rows[0][0]) == 3 else 6
    raw = b"".join(b"\0" + bytes(c for place in row for c in place) for row in rows)

    def chunk(name, body):
        return struct.pack(">I", len(body)) + name + body + struct.pack(">I", zlib.crc32(name + body))

    with open(path(name), "wb") as png:
        png.write(b"\x89PNG\r\n\x1a\n" + chunk(b"IHDR", struct.pack(">2I5B", side, side, 8, kind, 0, 0, 0))
                  + chunk(b"IDAT", zlib.compress(raw)) + chunk(b"IEND", b""))


def tiles():
    write_png("tiles.png", 128, lambda x, y: ((230, 60, 40), (30, 60, 210))[(x // 4 + y // 4) % 2])
    write_png("grain.png", 64, lambda x, y: [int(40 + 200 * noise(x + 0.5, y + 0.5, c, 31)) for c in range(3)])


def studio():
    """A dark room all around with two soft boxes, a thousand times as bright as the rest, and a blue panel."""

    def box(u, v, left, right, top, bottom):
        """1 inside, falling to 0 over a texel or two beyond the borders."""
        edge = 0.012
        across = min(u - left, right - u) / edge + 0.5
        down = min(v - top, bottom - v) / edge + 0.5
        return max(0.0, min(1.0, across)) * max(0.0, min(1.0, down))

    def radiance(u, v):
        room = 0.05 + 0.1 * max(0.0, cos(pi * v))
        key = 60 * box(u, v, 0.30, 0.36, 0.18, 0.34)
        fill = 8 * box(u, v, 0.66, 0.80, 0.26, 0.48)
        panel = 3 * box(u, v, 0.95, 0.99, 0.20, 0.60)
        light = (key + fill + room, 0.93 * key + fill + room, 0.82 * key + 1.1 * fill + 1.2 * room)
        return tuple(c + p * panel for c, p in zip(light, (0.1, 0.3, 1.0)))

    def rgbe(color):
        brightest = max(color)
        exponent = math.frexp(brightest)[1]
        return tuple(int(c * 256 / 2.0**exponent) for c in color) + (exponent + 128,)

    def runs(values):
        """The run length encoding of Radiance."""
        coded, i = bytearray(), 0
        while i < len(values):
            n = 1
            while n < 127 and i + n < len(values) and values[i + n] == values[i]:
                n += 1
            coded += bytes((128 + n, values[i]))
            i += n
        return coded

    width, height = 256, 128
    with open(path("studio.hdr"), "wb") as hdr:
        hdr.write(f"#?RADIANCE\nFORMAT=32-bit_rle_rgbe\n\n-Y {height} +X {width}\n".encode())
        for y in range(height):
            row = [rgbe(radiance((x + 0.5) / width, (y + 0.5) / height)) for x in range(width)]
            hdr.write(bytes((2, 2, width >> 8, width & 255)))
            for channel in range(4):
                hdr.write(runs([texel[channel] for texel in row]))


def tree():
    """A tree: a trunk with boughs, and cards on which twigs of seven leaves are painted, with alpha around these."""
    leaves = [(0.5, 0.55, 0.5, 0.03), (0.5, 0.75, 0.1, 0.38), (0.5, 0.75, 0.9, 0.38), (0.5, 0.85, 0.08, 0.68),
              (0.5, 0.85, 0.92, 0.68), (0.5, 0.92, 0.16, 0.94), (0.5, 0.92, 0.84, 0.94)]

    def leaf(u, v):
        """Of the leaf that a place is on: how far along it is, and how far across; a stem has neither."""
        for number, (x0, y0, x1, y1) in enumerate(leaves):
            x, y = x1 - x0, y1 - y0
            length = sqrt(x * x + y * y)
            along = ((u - x0) * x + (v - y0) * y) / length**2
            across = ((u - x0) * y - (v - y0) * x) / length
            if 0 < along < 1 and abs(across) < 0.085 * sin(pi * along**0.75) ** 0.8:
                return number, along, across
        return (-1, 0, 0) if abs(u - 0.5) < 0.012 and v > 0.3 else None

    def texel(x, y):
        parts = 4
        found = [leaf((x + (i + 0.5) / parts) / 128, (y + (j + 0.5) / parts) / 128)
                 for i in range(parts) for j in range(parts)]
        there = [f for f in found if f]
        alpha = round(255 * len(there) / len(found))
        number, along, across = there[0] if there else (0, 0.5, 0.1)
        shade = 0.85 + 0.3 * noise(number * 3.7, along * 6, across * 40, 71)
        vein = 1.25 if abs(across) < 0.006 else 1.0
        color = (120, 90, 60) if number < 0 else (96 * shade * vein, 150 * shade * vein, 52 * shade)
        return tuple(min(255, int(c)) for c in color) + (alpha,)

    write_png("leaf.png", 128, texel)

    def random(i, k):
        return noise(i, k, 0, 73)

    def tube(points, radii, around):
        """Rings about points that rise."""
        vertices, faces = [], []
        for (x, y, z), r in zip(points, radii):
            vertices += [(x + r * cos(2 * pi * k / around), y, z + r * sin(2 * pi * k / around)) for k in range(around)]
        for ring in range(len(points) - 1):
            for k in range(around):
                a, b = ring * around + k, ring * around + (k + 1) % around
                faces.append((a, a + around, b + around, b))
        return vertices, faces

    vertices, faces = [], []

    def add(part):
        first = len(vertices)
        vertices.extend(part[0])
        faces.extend(tuple(first + i for i in face) for face in part[1])

    add(tube([(0.12 * sin(t), 2.6 * t / 8, 0.08 * sin(2 * t)) for t in range(9)],
             [0.24 - 0.018 * t + (0.1 if t == 0 else 0) for t in range(9)], 12))
    boughs = []
    for i in range(14):
        turn, height = 2.4 * i, 1.5 + 0.085 * i
        reach = 1.3 - 0.045 * i
        tip = (reach * cos(turn), height + 0.55 + 0.9 * random(i, 1), reach * sin(turn))
        boughs.append(((0.0, height, 0.0), tip))
        points = [tuple(b * t / 4 + a * (1 - t / 4) for a, b in zip((0.0, height, 0.0), tip)) for t in range(5)]
        add(tube(points, [0.09 - 0.019 * t for t in range(5)], 7))
    write_ply("trunk.ply", vertices, None, faces)

    with open(path("leaves.ply"), "wb") as ply:
        cards = 2000
        ply.write(
            f"ply\nformat binary_little_endian 1.0\nelement vertex {4 * cards}\nproperty float x\nproperty float y\n"
            f"property float z\nproperty uchar u\nproperty uchar v\nelement face {cards}\n"
            "property list uchar ushort vertex_indices\nend_header\n".encode()
        )
        for i in range(cards):
            start, tip = boughs[i % len(boughs)]
            t = 0.45 + 0.65 * sqrt(random(i, 2))
            spread = [1.1 * (random(i, k) - 0.5) for k in (3, 4, 5)]
            middle = [a + (b - a) * t + s for a, b, s in zip(start, tip, spread)]
            out = normalized((middle[0] + 0.8 * spread[0], 0.5 + random(i, 6), middle[2] + 0.8 * spread[2]))
            turn = 2 * pi * random(i, 7)
            side = normalized(cross(out, (cos(turn), 0.4, sin(turn))))
            up = cross(side, out)
            half = 0.13 + 0.06 * random(i, 8)
            for u, v in ((0, 0), (1, 0), (1, 1), (0, 1)):
                at = [m + half * ((2 * u - 1) * a + (2 * v - 1) * b) for m, a, b in zip(middle, side, up)]
                ply.write(struct.pack("<3f2B", *at, u, v))
        for i in range(cards):
            ply.write(struct.pack("<B4H", 4, *range(4 * i, 4 * i + 4)))


def neon():
    """A sign of bright tubes on black, a picture for a screen, and the windows of a house, most of them dark."""
    sign = 128
    heart = [(0.26 + 0.011 * 16 * sin(t) ** 3,
              0.47 - 0.02 * (13 * cos(t) - 5 * cos(2 * t) - 2 * cos(3 * t) - cos(4 * t)))
             for t in (2 * pi * k / 40 for k in range(41))]
    letters = [[(0.52, 0.2), (0.52, 0.5), (0.62, 0.5)], [(0.65, 0.2), (0.70, 0.5), (0.75, 0.2)],
               [(0.78, 0.35), (0.83, 0.2), (0.88, 0.35), (0.83, 0.5), (0.78, 0.35)], [(0.9, 0.2), (0.97, 0.5)],
               [(0.97, 0.2), (0.9, 0.5)]]
    tubes = [(heart, (255, 40, 90))] + [(letter, (60, 190, 255)) for letter in letters]
    tubes.append(([(0.5, 0.68), (0.95, 0.68), (0.9, 0.62)], (255, 190, 60)))

    def away(p, a, b):
        """From a place to a line, in the unit of the height: the sign is twice as wide."""
        (px, py), (ax, ay), (bx, by) = ((2 * x, y) for x, y in (p, a, b))
        t = ((px - ax) * (bx - ax) + (py - ay) * (by - ay)) / ((bx - ax) ** 2 + (by - ay) ** 2)
        t = max(0.0, min(1.0, t))
        return sqrt((px - ax - t * (bx - ax)) ** 2 + (py - ay - t * (by - ay)) ** 2)

    def tube(x, y):
        p = ((x + 0.5) / sign, (y + 0.5) / sign)
        for line, color in tubes:
            if min(away(p, a, b) for a, b in zip(line, line[1:])) < 0.018:
                return color
        return (0, 0, 0)

    def picture(x, y):
        u, v = (x + 0.5) / 96, (y + 0.5) / 96
        hill = 0.62 + 0.12 * noise(4 * u, 0.0, 0.0, 81) - 0.06
        if v > hill:
            grain = noise(30 * u, 40 * v, 0.0, 82)
            return (int(20 + 40 * grain), int(70 + 90 * grain * (1.3 - v)), 30)
        if (u - 0.68) ** 2 + 0.4 * (v - 0.3) ** 2 < 0.006:
            return (255, 240, 180)
        return (int(60 + 150 * v), int(90 + 70 * v), int(230 - 120 * v))

    def window(x, y):
        i, j, a, b = x // 8, y // 8, x % 8, y % 8
        lit = noise(i * 1.7, j * 2.3, 0.5, 83) > 0.66
        if not lit or not (2 <= a < 6 and 1 <= b < 6):
            return (0, 0, 0)
        warm = noise(i * 3.1, j * 1.3, 0.2, 84)
        return (255, int(150 + 90 * warm), int(60 + 150 * warm))

    write_png("sign.png", sign, tube)
    write_png("picture.png", 96, picture)
    write_png("windows.png", 64, window)


for scene in (curved, lights100, volumes, thin, outdoor, lampshade, tiles, studio, tree, neon):
    scene()
