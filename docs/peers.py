#!/usr/bin/env python3
"""peers.py TABLE: what docs/peers.md shows, from what `cargo bench --bench error_time` printed.

For each peer (a path tracer of few samples with a denoiser behind it) it takes the cheapest preset of lvox that has no
larger error, and sets times beside times. Prints Markdown."""

import re
import sys

# Scene, peer, its CPU seconds of one render call, its trimmed relMSE, its FLIP (None where not measured), and how many times
# faster lvox is meant to be in shading alone. Measured by the scripts of ../shared/peers.
PEERS = [
    ("A", "Mitsuba 3, 4 spp + OIDN", 2.42, 2.6e-4, 0.036, 10),
    ("A", "Mitsuba 3, 16 spp + OIDN", 7.14, 1.5e-4, 0.027, 14),
    ("B", "Mitsuba 3, 4 spp + OIDN", 1.27, 1.7e-4, None, 4),
    ("B", "Mitsuba 3, 16 spp + OIDN", 1.9, 6.0e-5, None, 3),
    ("C", "Cycles 5, 4 spp + OIDN", 9.09, 2.7e-3, 0.052, 10),
    ("C", "Cycles 5, 16 spp + OIDN", 18.29, 1.6e-3, 0.039, 10),
    ("C_novol", "Mitsuba 3, 4 spp + OIDN", 2.0, 1.7e-3, None, 4),
    ("C_novol", "Mitsuba 3, 16 spp + OIDN", 3.6, 8.2e-4, None, 4),
]

def measured(path):
    """Trimmed relMSE, FLIP, CPU seconds of shading and of all by (scene, preset)."""
    found = {}
    for line in open(path):
        match = re.match(r"(\w+)\s+(draft|good|best)\s+(.*)", line)
        if match:
            numbers = [float(n) for n in match[3].split()]
            found[match[1], match[2]] = (numbers[1], numbers[4], numbers[5], numbers[6])
    return found


def short(number):
    """Two digits, as the rest of these pages write them."""
    return f"{number:.1e}".replace("e-0", "e-")


def main():
    found = measured(sys.argv[1])
    print("| scene | peer: relMSE trimmed, FLIP | CPU s | lvox: preset, relMSE trimmed, FLIP | shade, CPU s | times faster | meant | "
          "with bake and build, CPU s | times faster |")
    print("| --- | --- | --- | --- | --- | --- | --- | --- | --- |")
    for scene, peer, secs, relmse, flip, meant in PEERS:
        # To the last digit that is told of the peer.
        def reaches(preset):
            got = found[scene, preset]
            return float(f"{got[0]:.1e}") <= relmse and (flip is None or round(got[1], 3) <= flip)

        preset = next((p for p in ("draft", "good", "best") if reaches(p)), None)
        told = short(relmse) + (f", {flip:.3f}" if flip else "")
        if preset is None:
            best = found[scene, "best"]
            print(f"| {scene} | {peer}: {told} | {secs:.2f} | not reached: best has {short(best[0])} | – | – | {meant} | – | – |")
            continue
        error, our_flip, shade, total = found[scene, preset]
        print(f"| {scene} | {peer}: {told} | {secs:.2f} | {preset}, {short(error)}, {our_flip:.3f} | {shade:.2f} | {secs / shade:.1f} | {meant} | "
              f"{total:.2f} | {secs / total:.1f} |")


main()
