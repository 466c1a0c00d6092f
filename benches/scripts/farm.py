"""What a job costs that is split: bakes in parts, frames in tiles.

farm.py LVOX SCENE FOLDER [--resolution WxH] [--surfels N] [--bounces N] [--parts 1,2,4,8] [--tiles 1,4,16,64] [--caches] [--no-scatter]
    bakes SCENE in FOLDER, whole and in parts, packs it, and shades its frame whole, in tiles of equal area and in tiles of
    equal work, one process after the other. Parts and tiles are held to the bytes of the whole. Prints two tables: CPU
    seconds of all processes over those of one, and of the slowest over the mean. With --caches tiles share a radiance
    cache, which a frame before has filled, and a gather cache, as tiles of one machine can. --no-scatter is for scenes whose
    media all have phase functions.
"""

import argparse
import json
import subprocess
from pathlib import Path


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("lvox", type=Path)
    parser.add_argument("scene", type=Path)
    parser.add_argument("folder", type=Path)
    parser.add_argument("--resolution", default="1920x1080")
    parser.add_argument("--surfels")
    parser.add_argument("--bounces", default="all")
    parser.add_argument("--parts", default="1,2,4,8")
    parser.add_argument("--tiles", default="1,4,16,64")
    parser.add_argument("--caches", action="store_true")
    parser.add_argument("--no-scatter", action="store_true")
    options = parser.parse_args()
    options.folder.mkdir(parents=True, exist_ok=True)
    run = Runner(options)
    packed = run.prepare()
    print(run.parts())
    print(run.tiles(packed))


class Runner:
    def __init__(self, options):
        self.options = options
        self.film = ["--resolution", options.resolution]

    def at(self, name):
        return str(self.options.folder / name)

    def lvox(self, *words):
        """Runs a verb; its report."""
        report = self.options.folder / "report.json"
        command = [self.options.lvox.resolve(), *words, "--progress", "none", "--report", report]
        subprocess.run([str(word) for word in command], check=True)
        return json.loads(report.read_text())

    def bake(self, output, *more):
        surfels = ["--surfels", self.options.surfels] if self.options.surfels else []
        return self.lvox("bake", self.options.scene, *surfels, *more, "-o", self.at(output), "--force")

    def prepare(self):
        """The packed scene, with the light of all bounces and, if it has media, scattered light."""
        scene, name = self.options.scene, self.at
        self.whole = self.bake("cloud.lvc")
        self.built = self.lvox("build", name("cloud.lvc"), "-o", name("built.lvt"), "--force")
        bounces = ["--bounces", self.options.bounces]
        self.lvox("bounce", scene, "-t", name("built.lvt"), *bounces, "-o", name("tree.lvt"), "--force")
        light = []
        if self.whole["stages"][0]["counts"]["volumes"] and not self.options.no_scatter:
            self.lvox("scatter", scene, "-t", name("tree.lvt"), "-o", name("light.lvs"), "--force")
            light = ["--scatter", name("light.lvs")]
        packed = name("scene.lvp")
        self.lvox("pack", scene, *self.film, "-t", name("tree.lvt"), *light, "-o", packed, "--force")
        return packed

    def parts(self):
        rows = ["| parts | bake, all over one | slowest over mean | build of parts over build |", "| --- | --- | --- | --- |"]
        for count in map(int, self.options.parts.split(",")):
            names = [f"part.{i}.lvc" for i in range(count)]
            if count == 1:
                secs = [self.whole["cpu_secs"]]
                build = self.built
            else:
                secs = [self.bake(name, "--part", f"{i}/{count}")["cpu_secs"] for i, name in enumerate(names)]
                build = self.lvox("build", *map(self.at, names), "-o", self.at("parts.lvt"), "--force")
                same(self.at("parts.lvt"), self.at("built.lvt"))
            over_one = sum(secs) / self.whole["cpu_secs"]
            rows.append(f"| {count} | {over_one:.2f} | {slowest(secs):.2f} | {build['cpu_secs'] / self.built['cpu_secs']:.2f} |")
        return "\n".join(rows) + f"\n\nOne bake: {self.whole['cpu_secs']:.2f} CPU s; one build: {self.built['cpu_secs']:.2f}.\n"

    def shade(self, packed, output, *more):
        caches = []
        if self.options.caches:
            caches = ["--radiance-cache", self.at("radiance"), "--gather-cache", self.at("gathers")]
        return self.lvox("shade", packed, *caches, *more, "-o", self.at(output))

    def tiles(self, packed):
        """A frame in tiles of either kind. The gathers of a frame before would be those of all its tiles."""
        for name in ("radiance", "gathers"):
            Path(self.at(name)).unlink(missing_ok=True)
        if self.options.caches:
            self.shade(packed, "whole.exr")
        one = self.fresh(packed, "whole.exr")
        rows = [
            "| tiles | equal areas: all over one | slowest over mean | equal work: all over one | slowest over mean | MB read a tile |",
            "| --- | --- | --- | --- | --- | --- |",
        ]
        for count in map(int, self.options.tiles.split(",")):
            cells = []
            for kind in ("area", "work"):
                listed, cut = [], 0.0
                if kind == "work":
                    tiles = ["tiles", packed, "--count", str(count), "-o", self.at("tiles.txt")]
                    cut = self.lvox(*tiles)["cpu_secs"]
                    listed = ["--tiles", self.at("tiles.txt")]
                Path(self.at("gathers")).unlink(missing_ok=True)
                names = [f"tile.{i}.exr" for i in range(count)]
                reports = [self.shade(packed, name, "--tile", f"{i}/{count}", *listed) for i, name in enumerate(names)]
                self.lvox("merge", *map(self.at, names), "-o", self.at("merged.exr"))
                same(self.at("merged.exr"), self.at("whole.exr"))
                secs = [report["cpu_secs"] for report in reports]
                cells += [f"{(sum(secs) + cut) / one['cpu_secs']:.2f}", f"{slowest(secs):.2f}"]
            read = sum(bytes_read(report) for report in reports) / count / 1e6
            rows.append(f"| {count} | {' | '.join(cells)} | {read:.1f} |")
        return "\n".join(rows) + f"\n\nOne process: {one['cpu_secs']:.2f} CPU s.\n"

    def fresh(self, packed, output):
        Path(self.at("gathers")).unlink(missing_ok=True)
        return self.shade(packed, output)


def slowest(secs):
    return max(secs) * len(secs) / sum(secs)


def bytes_read(report):
    counts = [stage["counts"] for stage in report["stages"]]
    return sum(c.get("page_bytes_read", 0) for c in counts)


def same(a, b):
    if Path(a).read_bytes() != Path(b).read_bytes():
        raise SystemExit(f"{a} and {b} differ")


if __name__ == "__main__":
    main()
