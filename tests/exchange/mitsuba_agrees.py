#!/usr/bin/env python3
"""One file, two programs: mitsuba_agrees.py LVOX OUT DATA
renders the acceptance scenes A, B and C, shapes.xml and colored.xml by Mitsuba and by `lvox reference`, compares means of
blocks, and holds them to what two runs of Mitsuba differ by. DATA is the folder of refs/geom. Needs a Python that has mitsuba.
Ends with: N passed, N failed."""
import os
import subprocess
import sys

import mitsuba as mi
import numpy as np

lvox, out, data = sys.argv[1], sys.argv[2], sys.argv[3]
here = os.path.dirname(os.path.abspath(__file__))
scenes = os.path.join(here, "../acceptance/scenes")
sys.path.insert(0, os.path.join(here, "../acceptance/references"))
import exr  # noqa: E402

BLOCK = 8
mi.set_variant("scalar_rgb")
mi.set_log_level(mi.LogLevel.Error)


def vol(source):
    path = os.path.join(out, source.split(".")[0] + ".vol")
    script = os.path.join(scenes, "volume.py")
    subprocess.run([sys.executable, script, os.path.join(data, source), path], check=True)
    return path


def shapes():
    """A sky that is brighter on one side, and tiles, beside a copy of shapes.xml."""
    v, u = np.mgrid[0:64, 0:128].astype(np.float32)
    sky = np.stack([0.3 + 0.5 * (u > 90), 0.4 + 0.002 * v, 0.6 - 0.004 * v], -1).astype(np.float32)
    mi.Bitmap(sky).write(os.path.join(out, "sky.exr"))
    y, x = np.mgrid[0:32, 0:48]
    tiles = np.stack([80 + 3 * x, 60 + 5 * y, 200 - 2 * x], -1).astype(np.uint8)
    mi.Bitmap(tiles).write(os.path.join(out, "tiles.png"))
    path = os.path.join(out, "shapes.xml")
    with open(os.path.join(here, "shapes.xml")) as source, open(path, "w") as copy:
        copy.write(source.read())
    return path


def colored():
    """A ball of three channels beside a copy of colored.xml."""
    n = 24
    p = (np.indices((n, n, n)) + 0.5) / n * 2 - 1
    depth = np.clip((1 - np.sqrt((p**2).sum(0))) * 3, 0, 1)
    smoke = (depth[..., None] * [1, 0.5, 0.2]).astype("<f4")
    head = np.array([1, n, n, n, 3], "<i4").tobytes() + np.array([0, 0, 0, 1, 1, 1], "<f4").tobytes()
    with open(os.path.join(out, "ball.vol"), "wb") as file:
        file.write(b"VOL\3" + head + smoke.tobytes())
    path = os.path.join(out, "colored.xml")
    with open(os.path.join(here, "colored.xml")) as source, open(path, "w") as copy:
        copy.write(source.read())
    return path


def blocks(image):
    h, w = (n // BLOCK for n in image.shape[:2])
    cut = image[: h * BLOCK, : w * BLOCK]
    return cut.reshape(h, BLOCK, w, BLOCK, 3).mean((1, 3))


def by_mitsuba(path, spp, seed, parameters):
    return np.array(mi.render(mi.load_file(path, **parameters), spp=spp, seed=seed)).astype(np.float64)


def by_lvox(path, spp, depth, parameters):
    image = os.path.join(out, "lvox.exr")
    words = [lvox, "reference", path, "-o", image, "--force", "--spp", str(spp), "--max-depth", str(depth)]
    words += ["--progress", "none"]
    for key, value in parameters.items():
        words += ["--set", f"{key}={value}"]
    subprocess.run(words, check=True)
    rows = exr.read(image)[1]
    return np.stack([np.array(rows[c], np.float64) for c in "RGB"], -1)


passed = failed = 0
wanted = sys.argv[4:]
rows = [
    ("A", f"{scenes}/A.xml", 3, {"data": data, "volume": vol("smoke64.raw"), "width": 64, "height": 64}),
    ("B", f"{scenes}/B.xml", 3, {"data": data, "width": 64, "height": 64}),
    ("C", f"{scenes}/C.xml", 3, {"data": data, "volume": vol("bunny_density_128.nrrd"), "width": 64, "height": 48}),
    ("shapes", shapes(), 0, {}),
    ("colored", colored(), 8, {}),
]
for name, path, depth, parameters in rows:
    if wanted and name not in wanted:
        continue
    spp = 256
    runs = [blocks(by_mitsuba(path, spp, seed, parameters)) for seed in (1, 2)]
    mine = blocks(by_lvox(path, spp, depth, parameters))
    theirs = (runs[0] + runs[1]) / 2
    scale = np.maximum(theirs, theirs.mean())
    noise = np.sqrt(np.mean(((runs[0] - runs[1]) / scale) ** 2) / 2)
    apart = np.sqrt(np.mean(((mine - theirs) / scale) ** 2))
    mean = mine.mean() / theirs.mean() - 1
    # The noise of one run, that of the mean of two, and as much again.
    is_near = apart < 2.5 * noise + 0.01 and abs(mean) < 0.02
    passed, failed = passed + is_near, failed + (not is_near)
    told = "" if is_near else "FAILED: "
    print(f"{told}{name}: blocks differ by {apart:.4f}, two runs of Mitsuba by {1.414 * noise:.4f}; means by {mean:+.4f}")
    if not is_near:
        np.save(os.path.join(out, name + ".npy"), np.stack([mine, theirs]))
print(f"\n{passed} passed, {failed} failed")
sys.exit(failed > 0)
