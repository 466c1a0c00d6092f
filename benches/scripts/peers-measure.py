#!/usr/bin/env python3
"""peers-measure.py RESULTS: lvox and path tracers with a denoiser, in turn, on scenes A, B, C, C_novol and E. Adds a line to
RESULTS for each run, from which benches/scripts/peers.py makes tables.

Needs ../shared beside the repository, and Mitsuba 3 and Blender as ../shared/peers/README.md sets them up: PEERS_PY,
PEERS_PY_BPY and DRJIT_LIBLLVM_PATH. For 1920x1080 it needs the references that benches/scripts/large-frame.sh makes.

PEERS_WORK    trees and images [target/peers]
PEERS_LARGE   the folder of benches/scripts/large-frame.sh [target/large-frame]
PEERS_WHAT    small (the film of the reference images), large (1920x1080), flicker, bounces (light of all bounces) [all]
PEERS_SCENES  scenes [A B C C_novol]
PEERS_OF      peers [mitsuba cycles]
PEERS_LVOX    the program [that of cargo build --release]
PEERS_ROUNDS  times that each run is timed, with another seed each [3]
PEERS_FIRST   number of the first round, if others are there already [1]
PEERS_TRIES   runs of each at most: it is run again where other programs took more than 5 % of the cores [1]
PEERS_WAIT    seconds at most to wait before each run until other programs, but for niced ones, take less than 5 % [0]
PEERS_TIMED   a command in front of what is timed, to wait for a quiet machine [none]
PEERS_NOTE    a sentence on the machine, for the head of RESULTS"""

import csv
import datetime
import json
import os
import resource
import subprocess
import sys
import time
import tomllib
from pathlib import Path

ROOT = Path(__file__).resolve().parents[2]
SHARED = (ROOT / "../shared").resolve()
COLUMNS = "measure scene film renderer setting round cpu_secs wall_secs others relmse_trimmed flip bias change".split()
PRESETS = ("draft", "good", "best")
LARGE = "1920x1080"
# The two parts of the picture that benches/scripts/large-frame.sh has references of.
PARTS = ((480, 405, 720, 540), (1200, 540, 1440, 675))
# Renderer and samples per pixel.
PEERS = {
    "A": [("mitsuba", 4), ("mitsuba", 16), ("cycles", 4), ("cycles", 16)],
    "B": [("mitsuba", 4), ("mitsuba", 16)],
    "C": [("mitsuba", 4), ("mitsuba", 16), ("cycles", 4), ("cycles", 16)],
    "C_novol": [("mitsuba", 4), ("mitsuba", 16)],
    "E": [("mitsuba", 4), ("mitsuba", 16)],
}


def run(command, **more):
    return subprocess.run([str(c) for c in command], check=True, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True, **more).stdout


def busy_secs(niced=True):
    """CPU seconds of all programs of the machine since it started, and of those that this one has called."""
    user, nice, system, _, _, interrupts, soft = (int(n) for n in Path("/proc/stat").read_text().split()[1:8])
    own = resource.getrusage(resource.RUSAGE_CHILDREN)
    return (user + niced * nice + system + interrupts + soft) / os.sysconf("SC_CLK_TCK"), own.ru_utime + own.ru_stime


class Bench:
    def __init__(self, results):
        self.results = Path(results).resolve()
        self.work = Path(os.environ.get("PEERS_WORK", ROOT / "target/peers")).resolve()
        self.large = Path(os.environ.get("PEERS_LARGE", ROOT / "target/large-frame")).resolve()
        self.timed = os.environ.get("PEERS_TIMED", "").split()
        self.tries = int(os.environ.get("PEERS_TRIES", 1))
        self.wait_secs = float(os.environ.get("PEERS_WAIT", 0))
        first = int(os.environ.get("PEERS_FIRST", 1))
        self.rounds = range(first, first + int(os.environ.get("PEERS_ROUNDS", 3)))
        self.work.mkdir(parents=True, exist_ok=True)
        self.lvox = os.environ.get("PEERS_LVOX")
        if not self.lvox:
            run(["cargo", "build", "--release"], cwd=ROOT)
            self.lvox = ROOT / os.environ.get("CARGO_TARGET_DIR", "target") / "release/lvox"
        # The peers' scripts look here for scenes that they do not have.
        self.env = os.environ | {
            "PEERS_SHARED": str(SHARED),
            "PEERS_EXTRA": str(self.work),
            "PEERS_OUT": str(self.work),
            "PYTHONDONTWRITEBYTECODE": "1",
        }
        if not self.results.exists():
            self.begin()

    def begin(self):
        commit = run(["git", "rev-parse", "--short", "HEAD"], cwd=ROOT).strip()
        head = [
            f"# lvox beside path tracers with a denoiser, {datetime.date.today()}, of commit {commit}",
            f"# {os.environ.get('PEERS_NOTE', 'CPU seconds of all threads')}",
            "# python3 benches/scripts/peers-measure.py RESULTS; python3 benches/scripts/peers.py RESULTS prints the tables of docs/peers.md",
            ",".join(COLUMNS),
        ]
        self.results.write_text("\n".join(head) + "\n")

    def record(self, **row):
        """Numbers with the digits that they are worth."""
        told = {k: f"{v:.4g}" if isinstance(v, float) else v for k, v in row.items()}
        with open(self.results, "a", newline="") as file:
            csv.DictWriter(file, COLUMNS, lineterminator="\n").writerow(told)
        print(*told.values(), flush=True)

    def scene_file(self, scene):
        return ROOT / f"tests/acceptance/scenes/{scene}.toml"

    def scene(self, scene):
        return tomllib.loads(self.scene_file(scene).read_text())

    def film(self, scene):
        film = self.scene(scene)["film"]
        return f"{film['width']}x{film['height']}"

    def description(self, scene, suffix, change):
        """Writes a changed description of a scene for the peers, and returns its name."""
        text = json.loads((SHARED / f"refs/{scene}.json").read_text())
        change(text)
        for part in text["meshes"] + text["lights"] + [text.get("volume") or {}]:
            if "file" in part:
                part["file"] = str(SHARED / "refs" / part["file"])
        name = f"{scene}_{suffix}"
        (self.work / f"{name}.json").write_text(json.dumps(text))
        return name

    def tree(self, scene, bounces=False):
        """CPU and wall seconds of bake and build, and of all bounces."""
        at = self.work / scene
        common = ["--progress", "none", "--force", "--report", f"{at}.json"]
        secs = [0.0, 0.0]
        verbs = [["bake", self.scene_file(scene), "-o", f"{at}.lvc"], ["build", f"{at}.lvc", "-o", f"{at}.lvt"]]
        if bounces:
            verbs.append(["bounce", self.scene_file(scene), "-t", f"{at}.lvt", "-o", f"{at}.all.lvt"])
        for verb in verbs:
            run([*self.timed, self.lvox, *verb, *common])
            stage = next(s for s in json.loads(Path(f"{at}.json").read_text())["stages"] if s["stage"] == verb[0])
            secs = [secs[0] + stage["cpu_secs"], secs[1] + stage["wall_secs"]]
        return None, secs

    def scatter(self, scene):
        """CPU and wall seconds of lighting media for all cameras."""
        at = self.work / scene
        run([*self.timed, self.lvox, "scatter", self.scene_file(scene), "-t", f"{at}.lvt", "-o", f"{at}.lvs", "--progress", "none",
             "--force", "--report", f"{at}.json"])  # fmt: skip
        stage = next(s for s in json.loads(Path(f"{at}.json").read_text())["stages"] if s["stage"] == "scatter")
        return None, [stage["cpu_secs"], stage["wall_secs"]]

    def shade(self, scene, preset, film, *more, tree=""):
        """An image, and CPU and wall seconds of `shade`."""
        image = self.work / f"{scene}.{film}.{preset}.exr"
        report = image.with_suffix(".json")
        run([*self.timed, self.lvox, "shade", self.scene_file(scene), "-t", self.work / f"{scene}{tree}.lvt", "--quality", preset,
             "--resolution", film, "-o", image, "--float", "--progress", "none", "--report", report, *more])  # fmt: skip
        stage = next(s for s in json.loads(report.read_text())["stages"] if s["stage"] == "shade")
        return image, [stage["cpu_secs"], stage["wall_secs"]]

    def peer(self, renderer, name, samples, seed, depth=3):
        """An image, and CPU and wall seconds of one render call, the denoiser with it."""
        python, script, denoise = {
            "mitsuba": ("PEERS_PY", "peer_mitsuba.py", ["--oidn", "aux"]),
            "cycles": ("PEERS_PY_BPY", "peer_cycles.py", ["--denoise"]),
        }[renderer]
        tag = f"{name}_{renderer}_{samples}_{seed}"
        printed = run([*self.timed, self.env[python], SHARED / "peers" / script, name, "--spp", samples, "--depth", depth, "--reps", 1,
                       "--seed", seed, "--tag", tag, *denoise], env=self.env)  # fmt: skip
        told = next(line for line in reversed(printed.splitlines()) if line.startswith(("{", "JSON {")))
        told = json.loads(told.removeprefix("JSON "))
        image = self.work / f"{tag}.exr"
        convert = "import sys, numpy, common; common.write_exr(sys.argv[2], numpy.load(sys.argv[1]), half=False)"
        run([self.env["PEERS_PY"], "-c", convert, self.work / f"{tag}.npy", image], env=self.env | {"PYTHONPATH": str(SHARED / "peers")})
        (self.work / f"{tag}.npy").unlink()
        return image, [told["cpu_s"], told["wall_s"]]

    def compare(self, image, reference, *more):
        return json.loads(run([self.lvox, "compare", image, reference, "--json", "--progress", "none", *more]))

    def errors(self, scene, film, image, bounces):
        """Against the reference image, or against those of two parts of the large frame."""
        if film == LARGE:
            scores = [self.compare(image, self.large / f"{scene}.{LARGE}.part{i}.exr", "--region", *part) for i, part in enumerate(PARTS)]
        else:
            scores = [self.compare(image, SHARED / f"refs/{scene}_{'full' if bounces else 'd3'}.exr")]
        return {key: sum(s[key] for s in scores) / len(scores) for key in ("relmse_trimmed", "flip", "bias")}

    def frames(self, scene, film, presets, peers):
        def resize(text):
            text["film"]["width"], text["film"]["height"] = (int(n) for n in film.split("x"))

        name = self.description(scene, LARGE, resize) if film == LARGE else scene
        for at in self.rounds:
            common = {"scene": scene, "film": film, "round": at}
            if film != LARGE or not (self.work / f"{scene}.lvt").exists():
                self.undisturbed(lambda: self.tree(scene), measure="tree", **common, renderer="lvox", setting="tree")
            lit = film != LARGE and "volume" in self.scene(scene)
            if lit:
                self.undisturbed(lambda: self.scatter(scene), measure="tree", **common, renderer="lvox", setting="scatter")
            for preset in presets:
                self.undisturbed(lambda: self.shade(scene, preset, film), measure="frame", **common, renderer="lvox", setting=preset)
                if lit:
                    more = ["--scatter", self.work / f"{scene}.lvs"]
                    self.undisturbed(lambda: self.shade(scene, preset, film, *more), measure="frame", **common, renderer="lvox",
                                     setting=f"{preset}, scatter")  # fmt: skip
            for renderer, samples in peers:
                self.undisturbed(lambda: self.peer(renderer, name, samples, at), measure="frame", **common, renderer=renderer,
                                 setting=f"{samples} spp")  # fmt: skip

    def bounces(self, scene, peers):
        """Light of all bounces."""
        for at in self.rounds:
            common = {"measure": "bounces", "scene": scene, "film": self.film(scene), "round": at}
            self.undisturbed(lambda: self.tree(scene, bounces=True), **common, renderer="lvox", setting="tree")
            for preset in PRESETS:
                self.undisturbed(lambda: self.shade(scene, preset, common["film"], tree=".all"), **common, renderer="lvox", setting=preset)
            for renderer, samples in peers:
                self.undisturbed(lambda: self.peer(renderer, scene, samples, at, depth=-1), **common, renderer=renderer,
                                 setting=f"{samples} spp")  # fmt: skip

    def undisturbed(self, task, **row):
        """Records a task, and does it again where other programs were busy meanwhile."""
        for _ in range(self.tries):
            end = time.monotonic() + self.wait_secs
            while time.monotonic() < end:
                busy, _ = busy_secs(niced=False)
                time.sleep(1)
                if busy_secs(niced=False)[0] - busy < 0.05 * os.cpu_count():
                    break
            (busy, own), begin = busy_secs(), time.monotonic()
            image, (cpu, wall) = task()
            (busy_after, own_after), end = busy_secs(), time.monotonic()
            others = max(0.0, (busy_after - busy) - (own_after - own)) / ((end - begin) * os.cpu_count())
            errors = self.errors(row["scene"], row["film"], image, row["measure"] == "bounces") if image else {}
            self.record(**row, cpu_secs=cpu, wall_secs=wall, others=others, **errors)
            if others <= 0.05:
                break

    def flicker(self, scene):
        """Mean absolute change over the mean, of indirect light and of the whole picture: of lvox for a camera that turns by a
        hundredth of a pixel, of a path tracer for another seed, and for the camera with the seed kept."""
        film = self.film(scene)
        common = {"measure": "flicker", "scene": scene, "film": film}
        still, _ = self.shade(scene, "good", film, "--aov", "indirect")
        still = still.rename(still.with_suffix(".still.exr"))
        moved, _ = self.shade(scene, "good", film, "--aov", "indirect", "--camera", "nudged")
        for part, layer in (("indirect", ["--layer", "indirect"]), ("whole", [])):
            self.record(**common, renderer="lvox", setting=f"good, {part}, moved", round=1, change=self.compare(moved, still, *layer)["relmae"])

        nudged = next(c for c in self.scene(scene)["camera"] if c["name"] == "nudged")
        moved_name = self.description(scene, "nudged", lambda text: text["camera"].update(camera_to_world=look_at(nudged)))
        for samples in (4, 16):
            frames = {"first": (scene, 1), "seed": (scene, 2), "moved": (moved_name, 1)}
            for part in ("indirect", "whole"):
                images = {}
                for key, (name, seed) in frames.items():
                    if part == "whole":
                        images[key], _ = self.peer("mitsuba", name, samples, seed)
                    else:
                        images[key] = self.work / f"{name}.indirect.{samples}.{seed}.exr"
                        run([*self.timed, self.env["PEERS_PY"], ROOT / "benches/scripts/peers-indirect.py", name, samples, seed, images[key]], env=self.env)
                for key in ("seed", "moved"):
                    self.record(**common, renderer="mitsuba", setting=f"{samples} spp, {part}, {key}", round=1,
                                change=self.compare(images[key], images["first"])["relmae"])  # fmt: skip


def look_at(camera):
    """Rows of camera to world: the camera looks along its -z, y is up."""

    def unit(v):
        length = sum(x * x for x in v) ** 0.5
        return [x / length for x in v]

    def cross(a, b):
        return [a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]]

    z = unit([p - t for p, t in zip(camera["position"], camera["target"])])
    x = unit(cross(camera["up"], z))
    y = cross(z, x)
    return [[*column, camera["position"][i]] for i, column in enumerate(zip(x, y, z))] + [[0, 0, 0, 1]]


def main():
    bench = Bench(sys.argv[1])
    scenes = os.environ.get("PEERS_SCENES", " ".join(PEERS)).split()
    of = os.environ.get("PEERS_OF", "mitsuba cycles").split()
    wanted = os.environ.get("PEERS_WHAT", "small large flicker bounces").split()
    for scene in scenes:
        peers = [p for p in PEERS[scene] if p[0] in of]
        if "bounces" in wanted and (SHARED / f"refs/{scene}_full.exr").exists():
            bench.bounces(scene, peers)
        if scene == "E":
            continue
        if "small" in wanted:
            bench.frames(scene, bench.film(scene), PRESETS, peers)
        if "large" in wanted:
            bench.frames(scene, LARGE, PRESETS[:2], [p for p in peers if p[1] == 4])
        if "flicker" in wanted:
            bench.flicker(scene)


main()
