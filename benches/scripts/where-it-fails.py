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


# Why blocks are among the worst, and what was done about that cause: the text of docs/where-it-fails.md.
CAUSES = {
    "crease": ("crease between floor and wall: gathers of single corners",
        "surfaces that the lattice missed gather for themselves; twice the rays there were 35 % slower for 2 to 3 % less error"),
    "smoke": ("dark side of smoke",
        "direct light falls as the depth between vertices says, and rays to lamps pass cells of small volumes: a block of A +4.3 to +0.5 %"),
    "bunny": ("shaded side of the dense bunny",
        "vertices of sweeps 1.4 optical depths apart, cubics between rays: C 9.8e-4 to 9.2e-4; 0.7 apart is 1.7 times as slow"),
    "penumbra": ("penumbra",
        "three rays more where the 16 corners differ, samples of its own where it is narrow: B 8.9e-5 to 7.5e-5"),
    "contact": ("contact shadow: penumbra",
        "the same as in penumbrae"),
    "cross": ("meshes that cross: disks",
        "nothing by default: cut by short rays, disks left a corner 6 and not 17 % too dark, but mouldings beside it 3 to 12 %; without disks that the other mesh stands before it is -7 %; `bake --surfels 2000000`"),
    "ear": ("ear of the dense bunny: few rays in media",
        "nothing by default: with `--volume-samples 64` it is -0.1 %"),
    "mouldings": ("silhouettes and mouldings",
        "16 samples of its own where corners of a pixel differ: C_novol 1.1e-3 to 6.3e-4 beside 4"),
    "corner": ("dark corner: blur of the lattice",
        "weights end at a quarter of the distance to what is seen; `--lattice 1` takes the rest away, in five times the time"),
    "behind": ("strip of ceiling behind the lamp, a pixel wide: corners that neighbours share",
        "nothing by default: with `--pixel-samples 64` it is -0.8 %"),
    "not noise": ("smoke, not noise",
        "nothing: more samples of any kind change it by a tenth at most"),
    "haze": ("haze on a floor: patches, and corners that neighbours share",
        "nothing by default: `--quality best --lattice 1 --samples 256 --pixel-samples 64 --max-solid-angle 0` leaves a quarter"),
    "reference": ("noise of the reference",
        "nothing: settings differ among each other by a tenth of it"),
    "lamp": ("beside a lamp",
        "borders of lamps in closed form: `lights100` bias -1.0 % to 0.0 %"),
    "lights": ("grain of many lights",
        "a tree over lights in place of 64 chosen by power: 3.5e-3 to 1.0e-3"),
    "border": ("border of smoke",
        "media of a pixel from the cubic through corners: C 1.02e-3 to 9.8e-4"),
    "slats": ("slats",
        "16 samples of its own where corners of a pixel differ; indirect light at such pixels stays that of few gathers (`--lattice 1`)"),
    "slats2": ("slats and the penumbra below",
        "as of slats and penumbrae"),
    "shadow": ("border of a shadow",
        "16 samples of its own where some corners of a pixel see the light and some do not"),
    "small face": ("small face of a capital: few gathers",
        "nothing by default: a patch of it is 21 % too green, with `--lattice 1` or `--samples 160` at most 1 %"),
    "silhouette": ("silhouette",
        "16 samples of its own where corners of a pixel differ"),
}

# What was found to be wrong in a block: scene, corner. Others have to be looked at first.
BLOCKS = {
    "A": {(400, 448): "crease", (160, 240): "smoke", (176, 224): "smoke", (224, 256): "smoke", (144, 432): "penumbra",
          (432, 448): "reference", (448, 464): "reference", (240, 48): "reference", (288, 48): "behind"},
    "B": {(400, 448): "crease", (272, 48): "behind", (256, 48): "behind", (240, 48): "behind", (224, 48): "behind"},
    "C": {(496, 128): "cross", (400, 48): "mouldings", (352, 144): "mouldings", (368, 144): "mouldings",
          (208, 192): "bunny", (160, 224): "bunny", (160, 240): "bunny", (240, 128): "ear"},
    "C_novol": {(496, 128): "cross", (400, 48): "mouldings", (352, 144): "mouldings",
                (208, 144): "corner"},
    "curved": {(96, 160): "penumbra", (112, 160): "penumbra", (144, 160): "contact", (32, 144): "contact",
               (96, 144): "contact"},
    "lights100": {(80, 16): "lamp", (112, 112): "lights", (208, 48): "silhouette", (176, 32): "small face"},
    "volumes": {(80, 32): "border", (96, 32): "not noise", (96, 48): "not noise", (64, 48): "smoke",
                (80, 48): "smoke", (64, 128): "haze"},
    "thin": {(80, 112): "slats", (64, 112): "slats", (80, 144): "slats", (64, 144): "slats2", (48, 144): "slats2",
             (32, 144): "slats2"},
    "outdoor": {(80, 160): "shadow", (208, 112): "silhouette", (128, 112): "shadow", (112, 112): "shadow",
                (96, 112): "shadow"},
}


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


def why(scene, block, told):
    """Cause and what was done, which is said once; causes that were said are added to `told`."""
    kind = BLOCKS.get(scene, {}).get((block["x0"], block["y0"]))
    if kind is None:
        return "not looked at", ""
    cause, done = CAUSES[kind]
    is_new = kind not in told
    told.add(kind)
    return cause, done if is_new else "as above"


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

    print("\n| scene | block | reference | difference | relMSE | cause | what was done |"
          "\n| --- | --- | --- | --- | --- | --- | --- |")
    told = set()
    for scene in scenes:
        for i, b in enumerate(worst[scene]):
            name = scene if i == 0 else ""
            share = b["error"] / b["reference"] if b["reference"] else math.nan
            print(f"| {name} | {b['x0']} {b['y0']} | {b['reference']:.3g} | {b['error']:+.2g} ({100 * share:+.1f} %) "
                  f"| {short(b['relmse'])} | {' | '.join(why(scene, b, told))} |")

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
