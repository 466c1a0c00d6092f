"""Indirect light alone as Mitsuba 3 with OIDN shows it: peers-indirect.py SCENE SAMPLES SEED OUTPUT.exr

Paths with one bounce less paths without, of the same random numbers, so that direct light cancels sample by sample and
nothing is below 0; then the denoiser, with albedo and normals as ../shared/peers has them. Run by $PEERS_PY."""

import sys
from pathlib import Path

import numpy as np

sys.path.insert(0, str(Path(__file__).resolve().parents[2] / "../shared/peers"))

import mitsuba
import pyoidn
from common import load_desc, write_exr
from peer_mitsuba import build, render

AUX_SAMPLES = 8


def main():
    name, samples, seed, output = sys.argv[1], int(sys.argv[2]), int(sys.argv[3]), sys.argv[4]
    mitsuba.set_variant("llvm_ad_rgb")
    scene = load_desc(name)
    both, direct = (render(mitsuba, build(mitsuba, scene, depth, samples, "volpath"), samples, seed, 16) for depth in (3, 2))
    aux = np.array(mitsuba.render(build(mitsuba, scene, 2, AUX_SAMPLES, "volpath", aov=True, novol=True), spp=AUX_SAMPLES, seed=99 + seed))
    albedo, normal = (np.ascontiguousarray(aux[..., first : first + 3]) for first in (3, 6))
    indirect = np.ascontiguousarray((both - direct)[..., :3])
    write_exr(output, pyoidn.denoise(indirect, hdr=True, albedo=albedo, normal=normal), half=False)


main()
