#!/usr/bin/env python3
"""where-it-fails.py FOLDER [LVOX]: what docs/where-it-fails.md shows, from an acceptance run that kept its images:

    ACCEPTANCE_OUT=FOLDER bash tests/acceptance/run.sh
    python3 benches/scripts/where-it-fails.py FOLDER

Writes docs/fails/*.png and prints the tables of scores, of the worst blocks, and of places with other settings. Needs
nothing but Python; LVOX is target/release/lvox unless named."""

import json
import math
import os
import struct
import subprocess
import sys
import zlib

sys.path.append(os.path.join(os.path.dirname(__file__), os.pardir, os.pardir, "tests", "acceptance", "references"))
import exr  # noqa: E402, beside the references

SHARED = ("A", "B", "C", "C_novol")
GENERAL = ("curved", "lights100", "volumes", "thin", "outdoor")

# Pictures: scene, region (x0, y0, x1, y1), relative difference of full colour.
PICTURES = {
    "slats": ("thin", (36, 96, 148, 166), 0.5),
    "ceiling": ("thin", (36, 12, 166, 52), 0.2),
    "wall": ("thin", (164, 24, 256, 150), 0.5),
    "crevice": ("outdoor", (64, 84, 160, 168), 0.2),
    "cloud": ("outdoor", (0, 0, 176, 64), 0.2),
    "media": ("volumes", (40, 24, 168, 124), 0.2),
    "penumbra": ("curved", (24, 116, 216, 168), 0.2),
    "lights": ("lights100", (48, 16, 144, 136), 0.2),
}

# Places measured with other settings: name, scene, region, and options of shade or, after "bake", of bake.
PLACES = (
    ("penumbrae", "curved", (24, 132, 120, 168),
     ("", "--edge-samples 64", "--quality best", "--pixel-samples 64")),
    ("100 lights", "lights100", (80, 64, 136, 128), ("", "--quality best", "--pixel-samples 64")),
    ("slats", "thin", (38, 106, 92, 156), ("", "--lattice 1", "--quality best", "--lattice 1 --pixel-samples 64")),
    ("slits", "thin", (106, 131, 147, 162), ("", "--quality best", "--pixel-samples 16", "--pixel-samples 64")),
    ("ceiling at a wall", "thin", (104, 25, 154, 30), ("", "--lattice 2", "--lattice 1")),
    ("crevices", "outdoor", (72, 100, 150, 126), ("", "--lattice 2", "--lattice 1")),
    ("behind a thin wall", "thin", (174, 30, 250, 140),
     ("", "--quality best", "--max-solid-angle 0", "--max-solid-angle 0 --samples 256")),
    ("meshes that cross", "C", (496, 128, 512, 144), ("", "--quality best", "bake --surfels 2000000")),
    ("dense CT on a floor", "C", (208, 320, 224, 336),
     ("", "--quality best", "bake --block-depth 0.35", "bake --surfels 2000000")),
    ("shaded side of dense CT", "C", (208, 192, 224, 240), ("", "--quality best", "bake --surfels 2000000")),
    ("dark corner", "C_novol", (208, 128, 224, 160), ("", "--lattice 1", "bake --surfels 2000000")),
    ("dark side of smoke", "volumes", (120, 76, 148, 112),
     ("", "--quality best", "bake --block-depth 0.35", "bake --surfels 2000000")),
    ("haze on a floor", "volumes", (40, 100, 160, 140), ("", "--quality best", "--volume-samples 64")),
    ("under a cloud", "outdoor", (10, 32, 150, 56), ("", "--quality best", "--volume-samples 64")),
)


def read(name):
    """Rows of (r, g, b)."""
    _, rows = exr.read(name)
    return [list(zip(*colours)) for colours in zip(*(rows[c] for c in "RGB"))]


def write_png(name, rows):
    """Rows of (r, g, b) from 0 to 255."""

    def chunk(kind, body):
        return struct.pack(">I", len(body)) + kind + body + struct.pack(">I", zlib.crc32(kind + body))

    raw = b"".join(b"\0" + bytes(c for pixel in row for c in pixel) for row in rows)
    with open(name, "wb") as png:
        png.write(b"\x89PNG\r\n\x1a\n" + chunk(b"IHDR", struct.pack(">2I5B", len(rows[0]), len(rows), 8, 2, 0, 0, 0))
                  + chunk(b"IDAT", zlib.compress(raw, 9)) + chunk(b"IEND", b""))


def tone(pixel, exposure):
    return [round(255 * min(max(exposure * v, 0), 1) ** (1 / 2.2)) for v in pixel]


def signed(a, b, full):
    """White where alike, red where `a` is brighter, blue where it is darker; full colour at that share of `b`."""
    mean_a, mean_b = sum(a) / 3, sum(b) / 3
    share = (mean_a - mean_b) / (full * max(mean_b, 1e-3))
    rest = round(255 * (1 - min(abs(share), 1)))
    return [255, rest, rest] if share > 0 else [rest, rest, 255]


def picture(name, image, reference, region, exposure, full, scale=3):
    """lvox, reference and difference side by side, pixels enlarged."""
    x0, y0, x1, y1 = region
    out = []
    for y in range(y0, y1):
        a, b = image[y][x0:x1], reference[y][x0:x1]
        gap = [[255, 255, 255]] * 2
        row = [tone(p, exposure) for p in a] + gap + [tone(p, exposure) for p in b] + gap
        row += [signed(p, q, full) for p, q in zip(a, b)]
        out += [[p for p in row for _ in range(scale)]] * scale
    write_png(name, out)


def toml_of(scene):
    folder = "tests/acceptance/scenes" + ("" if scene in SHARED else "/general")
    return f"{folder}/{scene}.toml"


def reference_of(scene):
    return f"../shared/refs/{scene}_d3.exr" if scene in SHARED else f"tests/acceptance/references/{scene}_d3.exr"


def exposure_of(scene):
    lines = open(toml_of(scene)).read().splitlines()
    return float(next(line.split("=")[1] for line in lines if line.startswith("exposure")))


def image_of(folder, scene):
    return f"{folder}/{scene}.exr" if scene in SHARED else f"{folder}/{scene}.good.exr"


class Runner:
    def __init__(self, folder, lvox):
        self.folder, self.lvox = folder, lvox

    def call(self, *words):
        return subprocess.run([self.lvox, *words], check=True, capture_output=True, text=True).stdout

    def scores(self, scene, image, region=None, worst=0):
        words = ["compare", image, reference_of(scene), "--json", "--exposure", str(exposure_of(scene))]
        words += ["--region", *map(str, region)] if region else []
        return json.loads(self.call(*words, "--worst", str(worst)))

    def shaded(self, scene, options):
        """The image of a scene with other settings, and the CPU seconds of shading it."""
        words = options.split()
        key = f"{self.folder}/place.{scene}.{'_'.join(words).replace('-', '') or 'default'}"
        if not os.path.exists(key + ".json"):
            tree = f"{self.folder}/{scene}.lvt"
            if words[:1] == ["bake"]:
                end = words.index("shade") if "shade" in words else len(words)
                tree = key + ".lvt"
                self.call("bake", toml_of(scene), "-o", key + ".lvc", "--force", "--progress", "none", *words[1:end])
                self.call("build", key + ".lvc", "-o", tree, "--force", "--progress", "none")
                words = words[end + 1 :]
            self.call("shade", toml_of(scene), "-t", tree, "-o", key + ".exr", "--report", key + ".json",
                      "--progress", "none", *words)
        stages = json.load(open(key + ".json"))["stages"]
        return key + ".exr", next(s["cpu_secs"] for s in stages if s["stage"] == "shade")


def short(value):
    return f"{value:.1e}".replace("e-0", "e-")


def difference(scores):
    return f"{100 * scores['bias']:+.1f} %"


def main():
    folder = os.path.realpath(sys.argv[1])
    os.chdir(os.path.join(os.path.dirname(os.path.realpath(__file__)), "..", ".."))
    runner = Runner(folder, os.path.realpath(sys.argv[2] if len(sys.argv) > 2 else "target/release/lvox"))
    # A clone without ../shared has the general scenes alone.
    scenes = [s for s in SHARED + GENERAL if os.path.exists(reference_of(s)) and os.path.exists(image_of(folder, s))]

    print("| scene | relMSE trimmed | pdiff | bias | FLIP |\n| --- | --- | --- | --- | --- |")
    worst = {}
    for scene in scenes:
        s = runner.scores(scene, image_of(folder, scene), worst=3)
        worst[scene] = s["worst"]
        print(f"| {scene} | {short(s['relmse_trimmed'])} | {100 * s['pdiff']:.2f} % | {100 * s['bias']:+.2f} % | {s['flip']:.3f} |")

    print("\n| scene | block | reference | difference | relMSE |\n| --- | --- | --- | --- | --- |")
    for scene in scenes:
        for i, b in enumerate(worst[scene]):
            name = scene if i == 0 else ""
            share = b["error"] / b["reference"] if b["reference"] else math.nan
            print(f"| {name} | {b['x0']} {b['y0']} | {b['reference']:.3g} | {b['error']:+.2g} ({100 * share:+.1f} %) "
                  f"| {short(b['relmse'])} |")

    print("\n| place | scene, pixels | settings | difference | relMSE | shade, CPU s |\n| --- | --- | --- | --- | --- | --- |")
    for name, scene, region, settings in PLACES:
        if scene not in scenes:
            continue
        for i, options in enumerate(settings):
            image, secs = runner.shaded(scene, options)
            s = runner.scores(scene, image, region)
            where = f"{scene}, {' '.join(map(str, region))}"
            first = f"{name} | {where}" if i == 0 else " | "
            print(f"| {first} | {f'`{options}`' if options else 'default'} | {difference(s)} | {short(s['relmse'])} | {secs:.2f} |")

    for name, (scene, region, full) in PICTURES.items():
        image, reference = read(image_of(folder, scene)), read(reference_of(scene))
        picture(f"docs/fails/{name}.png", image, reference, region, exposure_of(scene), full)


main()
