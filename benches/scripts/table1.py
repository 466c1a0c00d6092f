"""Writes docs/table1.md from the studies that benches/scripts/table1.sh has made: table1.py FOLDER"""

import json
import math
import re
import sys
from pathlib import Path

# Table 1 of Gibson & Wood (2011): seconds of Monte Carlo, of surfels alone and of surfels with lvoxels.
PAPER_SECS = {
    "bunny_64": (3229, 348, 433),
    "bunny_128": (3297, 348, 402),
    "bunny_512": (3674, 348, 417),
    "head_64": (10150, 348, 756),
    "head_128": (15811, 348, 755),
    "head_256": (31373, 348, 864),
}
METHODS = {
    "traditional-base": "default, surfels alone",
    "extended-base": "default",
    "extended-paper": "like the paper's",
}


def figure(value):
    """Three digits that mean something."""
    if value is None:
        return "–"
    if value >= 100 or value == 0:
        return f"{value:.0f}"
    return f"{value:.3g}" if value < 0.001 else f"{value:.{2 - math.floor(math.log10(value))}f}"


def percent(value):
    return "–" if value is None else figure(100 * value)


def times(versus):
    if versus is None or versus["speed_up"] is None:
        return "–"
    text = figure(versus["speed_up"]) + "x"
    if versus.get("capped"):
        return f"(> {text})"
    return f"({text})" if versus["extrapolated"] else text


def row(cells):
    return "| " + " | ".join(cells) + " |"


def table(head, rows):
    return "\n".join([row(head), row(["---"] * len(head))] + [row(r) for r in rows]) + "\n"


class Scene:
    def __init__(self, folder, name):
        self.name = name
        self.study = json.loads((folder / name / "study.json").read_text())
        self.runs = {r["name"]: r for r in self.study["runs"]}
        self.clouds = {c["name"]: c for c in self.study["clouds"]}

    def secs(self, run):
        times = sorted(t["cpu_secs"] for t in run["rounds"])
        middle = len(times) // 2
        return times[middle] if len(times) % 2 else (times[middle - 1] + times[middle]) / 2

    def versus(self, run, metric):
        found = [v for v in self.study["findings"]["versus"] if (v["run"], v["metric"]) == (run, metric)]
        return found[0] if found else None

    def errors(self, run):
        return self.runs[run]["errors"]

    def lvoxel_share(self, run):
        """Of the surfels alone, as in the paper."""
        cloud = self.clouds[self.runs[run]["cloud"]]
        return cloud["lvoxel_bytes"] / (cloud["tree_bytes"] - cloud["lvoxel_bytes"])


def main_table(scenes, before):
    head = ["scene", "cloud", f"{before} s", "render s", "pdiff %", "relMSE", "faster at equal pdiff", "at equal relMSE",
            "lvoxels over surfels"]
    rows = []
    for scene in scenes:
        for i, (name, label) in enumerate(METHODS.items()):
            run, errors = scene.runs[name], scene.errors(name)
            cloud = scene.clouds[run["cloud"]]
            # A cloud without lvoxels is not measured apart.
            is_alone = name == "traditional-base"
            secs = "–" if is_alone else figure(cloud["bake"]["cpu_secs"] + cloud["build"]["cpu_secs"])
            rows.append([
                "" if i else scene.name, label, secs, figure(scene.secs(run)), percent(errors["pdiff"]), figure(errors["relmse"]),
                times(scene.versus(name, "pdiff")), times(scene.versus(name, "relmse")),
                "–" if is_alone else f"{100 * scene.lvoxel_share(name):.2f} %",
            ])
    return table(head, rows)


def paper_table(scenes):
    head = ["scene", "paper: Monte Carlo s", "with lvoxels s", "speed-up", "ours: at equal pdiff", "at equal relMSE",
            "over the longest run", "time of lvoxels: paper", "ours"]
    rows = []
    for scene in scenes:
        carlo, alone, extended = PAPER_SECS[scene.name]
        ours = scene.secs(scene.runs["extended-base"])
        longest = max(scene.secs(r) for r in scene.study["runs"] if r["method"] == "monte carlo")
        ratio = ours / scene.secs(scene.runs["traditional-base"])
        rows.append([scene.name, str(carlo), str(extended), f"{carlo / extended:.1f}x",
                     times(scene.versus("extended-base", "pdiff")), times(scene.versus("extended-base", "relmse")),
                     figure(longest / ours) + "x", f"x{extended / alone:.2f}", f"x{ratio:.2f}"])
    return table(head, rows)


def bars(scenes):
    """What has to hold, the worst value found, and whether it does."""
    rows = []

    def add(what, value, text, holds):
        held = value is not None and holds(value)
        rows.append([what, "not measured" if value is None else text(value), "yes" if held else "**no**"])

    for kind, least in (("head", 36), ("bunny", 10)):
        of_kind = [s for s in scenes if s.name.startswith(kind)]
        if not of_kind:
            continue
        for metric in ("relmse", "pdiff"):
            found = [s.versus("extended-base", metric)["speed_up"] for s in of_kind]
            worst = None if None in found else min(found)
            name = {"relmse": "relMSE", "pdiff": "pdiff"}[metric]
            add(f"{kind}: at least {least}x faster than Monte Carlo at equal {name}", worst,
                lambda v: f"{v:.1f}x", lambda v, least=least: v >= least)
    worst = max(s.errors("extended-base")["pdiff"] for s in scenes)
    add("pdiff at most 2.1 %", worst, lambda v: f"{100 * v:.2f} %", lambda v: v <= 0.021)
    share = max(s.lvoxel_share("extended-paper") for s in scenes)
    add("lvoxels at most 1 % of the surfels in a cloud like the paper's", share, lambda v: f"{100 * v:.2f} %", lambda v: v <= 0.01)
    return table(["bar", "our worst", "held"], rows)


def order(folder):
    """The fastest of the bench, near first and as stored: what other work on the machine disturbs least."""
    units = {"ns": 1e-3, "µs": 1.0, "ms": 1e3, "s": 1e6}
    rows = []
    for path in sorted(folder.glob("order.*.txt")):
        fastest = {}
        for line in path.read_text().splitlines():
            for name in ("front to back", "as stored"):
                if name in line:
                    cells = line.split(name)[1].split("│")
                    number, unit = re.findall(r"([\d.]+) (ns|µs|ms|s)\b", cells[0])[0]
                    fastest[name] = float(number) * units[unit]
        if len(fastest) == 2:
            near, stored = fastest["front to back"], fastest["as stored"]
            cloud = path.name[len("order."):-len(".txt")]
            rows.append([f"`{cloud}`", figure(near / 4.096), figure(stored / 4.096), f"{100 * (1 - near / stored):.0f} %"])
    return table(["cloud", "front to back, ns a ray", "as stored, ns a ray", "saved by order"], rows)


def made(tells):
    """When, from what and with which settings."""
    settings = [f"`TABLE1_{name.upper()}={value}`" for name, value in tells["settings"].items() if name != "scenes"]
    return (f"Made by `bash benches/scripts/table1.sh` on {tells['date']} from commit {tells['commit']} with " + ", ".join(settings))


def main():
    folder = Path(sys.argv[1])
    tells = json.loads((folder / "made.json").read_text())
    scenes = [Scene(folder, name) for name in tells["settings"]["scenes"].split()]
    first = scenes[0].study
    machine, (width, height) = first["machine"], first["film"]
    noise = [s.study["reference"]["relmse"] for s in scenes]
    note = " " + tells["note"] if tells.get("note") else ""
    scatters = tells["settings"].get("scatter") == "yes"
    carlo = [[r for r in s.study["runs"] if r["method"] == "monte carlo"][-1] for s in scenes]
    secs = [s.secs(r) for s, r in zip(scenes, carlo)]
    longest = f"{figure(min(secs))} to {figure(max(secs))} s"
    errors = [r["errors"]["relmse"] for r in carlo]
    least = f"{figure(min(errors))} to {figure(max(errors))}"
    made_once = "baking, building and lighting media beforehand (`lvox scatter`)" if scatters else "baking and building"
    print(f"""# Table 1: lvox beside Monte Carlo, and beside the paper

The six scenes of Table 1 of Gibson & Wood, *An Approach to Point Based Approximate Color Bleeding with Volumes* (2011):
Sponza with a CT bunny and with a CT head as media, at three resolutions each; {width} x {height} pixels, one sun, albedo 0.9,
direct light and one bounce.

{made(tells)}:
{machine["processor"]} ({machine["system"]}), {machine["threads"]} threads. Times are CPU seconds, medians of rounds in which the methods
take turns, without loading the scene.{note}

- **Monte Carlo** is `lvox reference`, path tracing with next-event estimation and Sobol points; its longest run takes {longest}
  and has relMSE {least}.
- **Errors** are against images of `lvox reference` whose own noise is relMSE {figure(min(noise))} to {figure(max(noise))}.
- **Faster** is Monte Carlo's time over ours of rendering, without {made_once},
  which all images of a scene share. At equal relMSE: Monte Carlo's error is noise of the reference + constant / time. At equal pdiff: by
  straight lines in logarithms between its runs. In brackets where the time is outside of what was measured.
- A cloud **like the paper's** has 2.5 million surfels, and lvoxels of 4^3 voxels (8^3 where the grid has 256^3 or more); the
  default has 500,000 surfels, and lvoxels of at most 0.7 optical depths.
""")
    print(main_table(scenes, "bake, build and scatter" if scatters else "bake and build"))
    print("## Bars\n\nOf the default settings, the worst of the scenes.\n")
    print(bars(scenes))
    print("""## Beside the paper

The paper's machine and its Monte Carlo renderer were others, and its Monte Carlo was not stopped at equal error, so only
ratios can be compared. Its pdiff is 2.1 % to 4.3 % with lvoxels and 5.6 % to 14.4 % with surfels alone; its lvoxels
take 0.02 % to 0.36 % of the bytes of its surfels.
""")
    print(paper_table(scenes))
    print("""## Front-to-back order

The plain kernel (the paper's ray cast) on the trees of `bunny_128`, media left out: children sorted by distance or
visited as stored. The paper saves 18 %. `LVOX_BENCH_TREE=FILE.lvt cargo bench --bench kernels -- order` measures it.
""")
    print(order(folder), end="")


main()
