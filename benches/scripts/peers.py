#!/usr/bin/env python3
"""peers.py RESULTS: the tables of docs/peers.md, from the runs that benches/scripts/peers-measure.py wrote down.

For each peer (a path tracer of few samples with a denoiser behind it) it takes the cheapest preset of lvox that has no
larger error, in trimmed relMSE nor in FLIP, and sets times beside times. Prints Markdown."""

import csv
import statistics
import sys

SCENES = ("A", "B", "C", "C_novol")
PRESETS = ("draft", "good", "best")
LARGE = "1920x1080"
NAMES = {"mitsuba": "Mitsuba 3", "cycles": "Cycles 5"}
# How many times faster lvox is meant to be than the peer in shading alone, at the film of the reference images.
MEANT = {
    ("A", "mitsuba", "4 spp"): 10,
    ("A", "mitsuba", "16 spp"): 14,
    ("B", "mitsuba", "4 spp"): 4,
    ("B", "mitsuba", "16 spp"): 3,
    ("C", "cycles", "4 spp"): 10,
    ("C", "cycles", "16 spp"): 10,
    ("C_novol", "mitsuba", "4 spp"): 4,
    ("C_novol", "mitsuba", "16 spp"): 4,
}
# Part of the machine's cores that other programs may take before a time is not one of a quiet machine.
DISTURBED = 0.1


class Run:
    """The median of equal runs, by what they measure."""

    def __init__(self, rows):
        def median(key, of):
            found = [float(row[key]) for row in of if row[key]]
            return statistics.median(found) if found else None

        least = min(float(row["others"] or 0) for row in rows)
        quiet = [row for row in rows if float(row["others"] or 0) <= max(DISTURBED, least)]
        self.others = least
        self.secs = median("cpu_secs", quiet)
        self.relmse = median("relmse_trimmed", rows)
        self.flip = median("flip", rows)
        self.change = median("change", rows)
        secs = [float(row["cpu_secs"]) for row in quiet if row["cpu_secs"]]
        self.spread = (max(secs) - min(secs)) / self.secs if secs else 0

    def reaches(self, peer):
        """To the digits that are told of the peer."""
        return float(f"{self.relmse:.1e}") <= float(f"{peer.relmse:.1e}") and round(self.flip, 3) <= round(peer.flip, 3)

    def errors(self):
        return f"{short(self.relmse)}, {self.flip:.3f}"

    def time(self):
        """With a star where the machine was never quiet."""
        return f"{self.secs:.2f}" + ("*" if self.others > DISTURBED else "")


def short(number):
    """Two digits, as the rest of these pages write them."""
    return f"{number:.1e}".replace("e-0", "e-")


def percent(number):
    return f"{100 * number:.2f} %" if number < 0.005 else f"{100 * number:.1f} %"


def load(path):
    """Runs by what was measured, scene, film, renderer and setting."""
    lines = [line for line in open(path) if not line.startswith("#")]
    groups = {}
    for row in csv.DictReader(lines):
        key = tuple(row[k] for k in ("measure", "scene", "film", "renderer", "setting"))
        groups.setdefault(key, []).append(row)
    return {key: Run(rows) for key, rows in groups.items()}


def scenes(runs, measure, film=None):
    """Those of which there are such runs."""
    keys = [key for key in runs if key[0] == measure and film in (None, key[2])]
    return [scene for scene in SCENES if any(key[1] == scene for key in keys)]


def films(runs, scene):
    """The film of the reference image, and the large one where it was measured."""
    return sorted({key[2] for key in runs if key[:2] == ("frame", scene)}, key=lambda film: film == LARGE)


def peers(runs, scene, film):
    return [(key[3], key[4], run) for key, run in runs.items() if key[:3] == ("frame", scene, film) and key[3] != "lvox"]


def title(renderer, setting):
    return f"{NAMES[renderer]}, {setting} + OIDN"


def ways(runs, scene, film):
    """Without and, where it was measured, with light of media made beforehand: what presets are called then, and CPU seconds before
    any frame."""
    tree = runs["tree", scene, film, "lvox", "tree"]
    yield "", tree.secs, tree.others
    scatter = runs.get(("tree", scene, film, "lvox", "scatter"))
    if scatter:
        yield ", scatter", tree.secs + scatter.secs, max(tree.others, scatter.others)


def own(runs):
    print("| scene | before any frame | draft: CPU s; relMSE trimmed, FLIP | good | best |\n| --- | --- | --- | --- | --- |")
    for scene in scenes(runs, "frame"):
        film = films(runs, scene)[0]
        for way, before, others in ways(runs, scene, film):
            cells = [runs["frame", scene, film, "lvox", preset + way] for preset in PRESETS]
            told = " | ".join(f"{run.time()}; {run.errors()}" for run in cells)
            print(f"| {scene}{way} | {before:.2f}{'*' * (others > DISTURBED)} | {told} |")


def small(runs):
    print("| scene | peer: relMSE trimmed, FLIP | CPU s | lvox: preset, relMSE trimmed, FLIP | shade, CPU s | times faster | meant | "
          "with what is before, CPU s | times faster |")  # fmt: skip
    print("| --- | --- | --- | --- | --- | --- | --- | --- | --- |")
    for scene in scenes(runs, "frame"):
        film = films(runs, scene)[0]
        for renderer, setting, peer in peers(runs, scene, film):
            for way, before, _ in ways(runs, scene, film):
                ours = {preset: runs["frame", scene, film, "lvox", preset + way] for preset in PRESETS}
                preset = next((p for p in PRESETS if ours[p].reaches(peer)), None)
                meant = MEANT.get((scene, renderer, setting), "–")
                told = f"| {scene} | {title(renderer, setting)}: {peer.errors()} | {peer.time()} |"
                if preset is None:
                    print(f"{told} not reached: best{way} has {ours['best'].errors()} | – | – | {meant} | – | – |")
                    continue
                run = ours[preset]
                total = run.secs + before
                print(f"{told} {preset}{way}, {run.errors()} | {run.time()} | {peer.secs / run.secs:.1f} | {meant} | {total:.2f} | {peer.secs / total:.1f} |")


def large(runs):
    print("| scene | peer: relMSE trimmed, FLIP | CPU s | lvox: preset, relMSE trimmed, FLIP | error not above the peer's | shade, CPU s | "
          "times faster | same two at the smaller film | with bake and build | at the smaller film |")  # fmt: skip
    print("| --- | --- | --- | --- | --- | --- | --- | --- | --- | --- |")
    for scene in scenes(runs, "frame", LARGE):
        film = films(runs, scene)[0]
        tree = runs["tree", scene, film, "lvox", "tree"].secs
        for renderer, setting, peer in peers(runs, scene, LARGE):
            before = runs["frame", scene, film, renderer, setting]
            for preset in PRESETS[:2]:
                run, run_before = runs["frame", scene, LARGE, "lvox", preset], runs["frame", scene, film, "lvox", preset]
                print(f"| {scene} | {title(renderer, setting)}: {peer.errors()} | {peer.time()} | {preset}, {run.errors()} | "
                      f"{'yes' if run.reaches(peer) else 'no'} | {run.time()} | {peer.secs / run.secs:.1f} | {before.secs / run_before.secs:.1f} | {peer.secs / (run.secs + tree):.1f} | "
                      f"{before.secs / (run_before.secs + tree):.1f} |")  # fmt: skip


def bounces(runs):
    """Light of all bounces, for each preset."""
    print("| scene | peer: relMSE trimmed, FLIP | CPU s | lvox: preset, relMSE trimmed, FLIP | not above the peer's | shade, CPU s | times faster | "
          "with all before, CPU s | times faster |")  # fmt: skip
    print("| --- | --- | --- | --- | --- | --- | --- | --- | --- |")
    of = {key[1:]: run for key, run in runs.items() if key[0] == "bounces"}
    for (scene, film, renderer, setting), peer in of.items():
        if renderer == "lvox":
            continue
        before = of[scene, film, "lvox", "tree"].secs
        for preset in PRESETS[:2]:
            run = of[scene, film, "lvox", preset]
            total = run.secs + before
            print(f"| {scene} | {title(renderer, setting)}: {peer.errors()} | {peer.time()} | {preset}, {run.errors()} | {'yes' if run.reaches(peer) else 'no'} | "
                  f"{run.time()} | {peer.secs / run.secs:.1f} | {total:.2f} | {peer.secs / total:.1f} |")  # fmt: skip


def flicker(runs):
    print("| scene | of | lvox, camera moved | Mitsuba 3, 4 spp + OIDN, other seed | 16 spp | times less than 4 spp | than 16 spp | "
          "4 spp, seed kept, camera moved | 16 spp |")  # fmt: skip
    print("| --- | --- | --- | --- | --- | --- | --- | --- | --- |")
    for scene in scenes(runs, "flicker"):
        film = films(runs, scene)[0]
        for part in ("indirect", "whole"):
            common = ("flicker", scene, film)
            ours = runs[*common, "lvox", f"good, {part}, moved"].change
            seed = [runs[*common, "mitsuba", f"{samples} spp, {part}, seed"].change for samples in (4, 16)]
            moved = [runs[*common, "mitsuba", f"{samples} spp, {part}, moved"].change for samples in (4, 16)]
            cells = [percent(ours), *map(percent, seed), *(f"{s / ours:.0f}" for s in seed), *map(percent, moved)]
            print(f"| {scene} | {'indirect light' if part == 'indirect' else 'the whole'} | {' | '.join(cells)} |")


def main():
    runs = load(sys.argv[1])
    is_small = bool(scenes(runs, "frame"))
    is_bounced = any(key[0] == "bounces" for key in runs)
    for table, is_there in ((own, is_small), (small, is_small), (bounces, is_bounced), (large, scenes(runs, "frame", LARGE)), (flicker, scenes(runs, "flicker"))):
        if is_there:
            table(runs)
            print()
    spread = sorted(run.spread for key, run in runs.items() if key[0] in ("frame", "bounces"))
    print(f"Largest less least time of equal runs, over their median: {percent(spread[len(spread) // 2])} in the middle, {percent(spread[-1])} at most")


main()
