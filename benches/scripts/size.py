"""What bake, build and shade take as assets grow, and docs/size.md from that.

size.py measure LVOX ASSETS FOLDER [--peer COMMAND | --peer-of EARLIER] [--most SURFELS] [--only KIND ...]
    runs LVOX on clouds and terrains in ASSETS (cloud_N.vdb and terrain_N.ply, as ../shared/tools/make_big.py makes them) and
    on tests/acceptance/scenes/C.toml with more and more surfels; FOLDER gets sizes.json, in which what is there is not
    measured again. COMMAND gets "cloud" or "terrain", the asset, 4 samples a pixel and a picture's name, and prints
    "total cpu S, peak M MiB", as ../shared/peers/peer_big.py does with Cycles and OIDN. KIND: cloud, close, terrain, surfels.
    Instead, figures of the peer may be those of an EARLIER folder, of the same machine.
size.py page FOLDER
    writes docs/size.md and docs/size/*.svg.
"""

import json
import math
import re
import shlex
import subprocess
import sys
import tempfile
from pathlib import Path

ROOT = Path(__file__).resolve().parent.parent.parent
LIGHT = """[film]
width = {width}
height = {height}

[[camera]]
name = "front"
position = {position}
target = {target}
fov_x_deg = {fov}

[[light]]
type = "directional"
direction = {direction}
irradiance = [5, 5, 5]
"""
CLOUD = LIGHT.format(width=320, height=240, position=[1, 1, 4], target=[1, 0.62, 1], fov=40, direction=[0.5, -0.7, -0.5]) + """
[[light]]
type = "environment"
radiance = [0.2, 0.3, 0.5]

[[volume]]
file = "{file}"
sigma_t_scale = 60
albedo = [0.99, 0.99, 0.99]
"""
# The camera is at the edge of the cloud, in its box.
CLOSE = CLOUD.replace("position = [1, 1, 4]", "position = [1, 1.5, 1.6]").replace("target = [1, 0.62, 1]", "target = [1, 0.6, 0.8]")
TERRAIN = LIGHT.format(width=640, height=480, position=[0, 3, 7], target=[0, 0, 0], fov=50, direction=[0.5, -0.4, -0.5]) + """
[[mesh]]
file = "{file}"
albedo = [0.5, 0.5, 0.5]
"""
SURFELS = (1_000_000, 5_000_000, 20_000_000, 100_000_000)
# Memory that `build` may take.
BUILD_LIMIT = "1G"
# Samples a pixel of the pictures that errors are beside.
SAMPLES = 32


def run(lvox, folder, *words):
    """The report of a run: CPU seconds and peak memory of the whole process, loading included."""
    report = folder / "report.json"
    done = subprocess.run([lvox, *map(str, words), "--progress", "none", "--force", "--report", report], capture_output=True, text=True)
    if done.returncode != 0:
        sys.exit(f"{' '.join(map(str, words))}: {done.stderr}")
    told = json.loads(report.read_text())
    counts = {name: count for stage in told["stages"] for name, count in stage["counts"].items()}
    return {"cpu_secs": told["cpu_secs"], "peak_bytes": told["peak_memory_bytes"], "counts": counts}


def stages(lvox, folder, toml, surfels=None, has_media=False):
    cloud, tree, light, image = (folder / f"a.{kind}" for kind in ("lvc", "lvt", "lvs", "exr"))
    bake = run(lvox, folder, "bake", toml, "-o", cloud, *([] if surfels is None else ["--surfels", surfels]))
    build = run(lvox, folder, "build", cloud, "-o", tree, "--memory-limit", BUILD_LIMIT)
    cloud_bytes, tree_bytes = cloud.stat().st_size, tree.stat().st_size
    cloud.unlink()
    shade = run(lvox, folder, "shade", toml, "--tree", tree, "-o", image)
    packed = {}

    def lit(scene, name):
        """With light inside media that is made once, before all frames."""
        scatter = run(lvox, folder, "scatter", scene, "--tree", tree, "-o", light)
        return {f"{name}scatter": scatter,
                f"{name}lit": run(lvox, folder, "shade", scene, "--tree", tree, "--scatter", light, "-o", folder / f"{name}lit.exr")}

    if has_media:
        packed = lit(toml, "")
    if surfels is None:
        scene, again = folder / "a.lvp", folder / "b.exr"
        pack = run(lvox, folder, "pack", toml, "-o", scene)
        packed |= {"pack": pack, "packed_bytes": scene.stat().st_size,
                  "packed_bake": run(lvox, folder, "bake", scene, "-o", cloud),
                  "packed_shade": run(lvox, folder, "shade", scene, "--tree", tree, "-o", again)}
        if image.read_bytes() != again.read_bytes():
            sys.exit(f"{toml}: the picture of the packed scene is another one")
        if has_media:
            packed |= lit(scene, "packed_")
            if (folder / "lit.exr").read_bytes() != (folder / "packed_lit.exr").read_bytes():
                sys.exit(f"{toml}: the lit picture of the packed scene is another one")
    return {**packed, "bake": bake, "build": build, "shade": shade, "cloud_bytes": cloud_bytes, "tree_bytes": tree_bytes}


def error(lvox, folder, toml):
    """Of the pictures that were just made, beside a path tracer's of direct light and one bounce."""
    reference = folder / "reference.exr"
    run(lvox, folder, "reference", toml, "-o", reference, "--max-depth", 3, "--spp", SAMPLES)


    def beside(image):
        told = subprocess.run([lvox, "compare", folder / image, reference, "--json"], capture_output=True, text=True, check=True)
        told = json.loads(told.stdout)
        return {name: told[name] for name in ("relmse_trimmed", "bias", "reference_noise")}

    return {"error": beside("a.exr"), "lit_error": beside("lit.exr")}


def peer(command, kind, asset, folder):
    done = subprocess.run([*shlex.split(command), kind, asset, "4", folder / "peer.png"], capture_output=True, text=True)
    found = re.search(r"total cpu ([\d.]+), peak (\d+) MiB", done.stdout)
    if not found:
        sys.exit(f"{command}: {done.stdout[-500:]}{done.stderr[-500:]}")
    return {"cpu_secs": float(found[1]), "peak_bytes": int(found[2]) << 20}


def measure(lvox, assets, folder, command, earlier, most, only):
    lvox, folder = str(Path(lvox).resolve()), Path(folder)
    folder.mkdir(parents=True, exist_ok=True)
    kept = folder / "sizes.json"
    rows = json.loads(kept.read_text()) if kept.exists() else []
    commit = subprocess.run(["git", "rev-parse", "--short", "HEAD"], cwd=ROOT, capture_output=True, text=True, check=True)
    commit = commit.stdout.strip()
    peers = {}
    if earlier:
        told = json.loads((Path(earlier) / "sizes.json").read_text())
        peers = {(r["kind"], r["size"]): r["peer"] for r in told if "peer" in r}
        (folder / "peer-commit").write_text(next(r["commit"] for r in told if "peer" in r) + "\n")

    def add(kind, size, toml, surfels=None, asset=None):
        if any((r["kind"], r["size"]) == (kind, size) for r in rows):
            return
        with tempfile.TemporaryDirectory(dir=folder) as work:
            work = Path(work)
            row = {"kind": kind, "size": size, "commit": commit, **stages(lvox, work, toml, surfels, kind in ("cloud", "close"))}
            if kind in ("cloud", "close"):
                row |= error(lvox, work, toml)
            if command and asset:
                row["peer"] = peer(command, kind, asset, work)
            elif (kind, size) in peers:
                row["peer"] = peers[kind, size]
        rows.append(row)
        kept.write_text(json.dumps(rows, indent=1) + "\n")
        print(kind, size, *(f"{stage} {row[stage]['cpu_secs']:.1f}" for stage in ("bake", "build", "shade")), flush=True)

    for kind, text, files in (("cloud", CLOUD, "cloud_*.vdb"), ("close", CLOSE, "cloud_*.vdb"), ("terrain", TERRAIN, "terrain_*.ply")):
        found = [(int(p.stem.split("_")[1]), p.resolve()) for p in Path(assets).glob(files)]
        for number, asset in sorted(found) if kind in only else ():
            with tempfile.NamedTemporaryFile("w", suffix=".toml") as toml:
                toml.write(text.format(file=asset))
                toml.flush()
                add(kind, 2 * (number - 1) ** 2 if kind == "terrain" else number, toml.name, asset=None if kind == "close" else str(asset))
    for count in SURFELS if "surfels" in only else ():
        if count > most:
            continue
        add("surfels", count, ROOT / "tests/acceptance/scenes/C.toml", surfels=count)


def figure(value):
    return f"{value:.0f}" if value >= 100 else f"{value:.{max(0, 1 - math.floor(math.log10(value)))}f}"


def table(head, rows):
    lines = [head, ["---"] * len(head), *rows]
    return "\n".join("| " + " | ".join(cells) + " |" for cells in lines) + "\n"


def short(number):
    if number < 10_000:
        return f"{number:.0f}"
    for unit, word in ((1e9, " G"), (1e6, " M"), (1e3, " k")):
        if number >= unit:
            return f"{number / unit:.3g}{word}"
    return str(number)


COLOURS = {"bake and build": "#b35c1e", "shade": "#1e6fb3", "Cycles": "#777777"}


def plot(rows, what, label, value):
    """Curves over the size, both axes logarithmic."""
    width, height, left, right, top, bottom = 420, 260, 52, 110, 14, 40
    curves = {name: [(r["size"], value(r, name)) for r in rows] for name in COLOURS}
    curves = {name: [(x, y) for x, y in points if y] for name, points in curves.items()}
    curves = {name: points for name, points in curves.items() if points}
    xs = [x for points in curves.values() for x, _ in points]
    ys = [y for points in curves.values() for _, y in points]
    x_from, x_to = math.log10(min(xs)), math.log10(max(xs))
    y_from, y_to = math.floor(math.log10(min(ys))), math.ceil(math.log10(max(ys)))

    def at(x, y):
        across = (math.log10(x) - x_from) / max(x_to - x_from, 1e-9)
        up = (math.log10(y) - y_from) / max(y_to - y_from, 1)
        return left + across * (width - left - right), height - bottom - up * (height - top - bottom)

    lines = [f'<svg xmlns="http://www.w3.org/2000/svg" width="{width}" height="{height}" font-family="sans-serif" font-size="11">',
             f'<rect width="{width}" height="{height}" fill="white"/>']
    for decade in range(y_from, y_to + 1):
        y = at(min(xs), 10.0**decade)[1]
        lines.append(f'<line x1="{left}" x2="{width - right}" y1="{y:.1f}" y2="{y:.1f}" stroke="#ddd"/>')
        lines.append(f'<text x="{left - 6}" y="{y + 4:.1f}" text-anchor="end">{10.0**decade:g}</text>')
    for x in sorted(set(xs)):
        across = at(x, 10.0**y_from)[0]
        lines.append(f'<text x="{across:.1f}" y="{height - bottom + 16}" text-anchor="middle">{short(x)}</text>')
    lines.append(f'<text x="{left}" y="{height - 6}">{what}</text>')
    lines.append(f'<text x="6" y="{height - bottom + 4}" transform="rotate(-90 12 {height - bottom})">{label}</text>')
    ends = []
    for name, points in curves.items():
        places = [at(x, y) for x, y in points]
        path = " ".join(f"{x:.1f},{y:.1f}" for x, y in places)
        lines.append(f'<polyline points="{path}" fill="none" stroke="{COLOURS[name]}" stroke-width="2"/>')
        lines.extend(f'<circle cx="{x:.1f}" cy="{y:.1f}" r="2.5" fill="{COLOURS[name]}"/>' for x, y in places)
        ends.append([places[-1][1] + 4, name])
    ends.sort()
    for i, (y, name) in enumerate(ends):
        y = ends[i][0] = max(y, ends[i - 1][0] + 13) if i else y
        lines.append(f'<text x="{width - right + 8}" y="{y:.1f}" fill="{COLOURS[name]}">{name}</text>')
    return "\n".join([*lines, "</svg>"]) + "\n"


def cpu_secs(row, name):
    of = {"bake and build": ("bake", "build"), "shade": ("shade",), "Cycles": ("peer",)}[name]
    return sum(row[stage]["cpu_secs"] for stage in of) if all(stage in row for stage in of) else None


def peak_mb(row, name):
    of = {"bake and build": ("bake", "build"), "shade": ("shade",), "Cycles": ("peer",)}[name]
    return max(row[stage]["peak_bytes"] for stage in of) / 1e6 if all(stage in row for stage in of) else None


KINDS = {
    "cloud": ("Clouds", "voxels along an edge",
              "One cloud of noise at 320 x 240, a sun and a sky of one colour; about 30 % of its voxels are active (205 M of 1024)."),
    "close": ("Clouds from close by", "voxels along an edge",
              "The same clouds before a camera at their edge, and beside a path tracer of as many samples."),
    "terrain": ("Terrain", "triangles", "A height field at 640 x 480, a sun."),
    "surfels": ("Surfels", "surfels",
                "Scene C (Sponza and a CT bunny) at 512 x 384, from clouds of more and more surfels; `build` within 1 GiB. "
                "1 G was made beside other work on a slower machine, its tree at commit b28d375."),
}


def page(folder):
    rows = json.loads((Path(folder) / "sizes.json").read_text())
    out = ROOT / "docs/size.md"
    plots = ROOT / "docs/size"
    plots.mkdir(exist_ok=True)
    other = Path(folder) / "peer-commit"
    session = f"at commit {other.read_text().strip()} on the same machine" if other.exists() else "in the same session"
    text = [f"""# What grows with assets

CPU seconds and peak memory of whole processes on two cores, loading included, at the
default settings, once each; Cycles with 4 samples a pixel and OIDN {session}.
Errors are trimmed relMSE and bias beside a path tracer's picture of direct light and one bounce, whose own
noise is the last column. Peak memory counts mapped files.
"""]
    for kind, (title, size, about) in KINDS.items():
        of_kind = sorted((r for r in rows if r["kind"] == kind), key=lambda r: r["size"])
        if not of_kind:
            continue
        has_peer = any("peer" in r for r in of_kind)
        has_error = any("error" in r for r in of_kind)
        head = [size, "bake s", "build s", "shade s", "bake MB", "build MB", "shade MB", "tree MB"]
        head += ["Cycles s", "Cycles MB"] * has_peer + ["error", "bias", "noise"] * has_error
        body = []
        for r in of_kind:
            names = ("bake", "build", "shade")
            cells = [short(r["size"])]
            cells += [figure(r[s]["cpu_secs"]) for s in names] + [figure(r[s]["peak_bytes"] / 1e6) for s in names]
            cells.append(figure(r["tree_bytes"] / 1e6))
            if has_peer:
                cells += [figure(r["peer"]["cpu_secs"]), figure(r["peer"]["peak_bytes"] / 1e6)] if "peer" in r else ["–", "–"]
            if has_error:
                e = r["error"]
                cells += [f"{e['relmse_trimmed']:.1e}", f"{100 * e['bias']:+.2f} %", f"{e['reference_noise']:.1e}"]
            body.append(cells)
        commits = ", ".join(sorted({r["commit"] for r in of_kind}))
        text.append(f"## {title}\n\n{about} Commit {commits}.\n\n" + table(head, body))
        of_packed = [r for r in of_kind if "pack" in r]
        if of_packed:
            text.append("From a packed scene, to the same bytes:\n\n" + table(
                [size, "pack s", "packed MB", "bake s", "shade s", "bake MB", "shade MB"],
                [[short(r["size"]), figure(r["pack"]["cpu_secs"]), figure(r["packed_bytes"] / 1e6),
                  *(figure(r[s]["cpu_secs"]) for s in ("packed_bake", "packed_shade")),
                  *(figure(r[s]["peak_bytes"] / 1e6) for s in ("packed_bake", "packed_shade"))] for r in of_packed]))
        of_lit = [r for r in of_kind if "lit" in r]
        if of_lit:
            stages_of_lit = ("scatter", "lit", "packed_scatter", "packed_lit")
            text.append("With light inside media made once, for all frames:\n\n" + table(
                [size, "scatter s", "shade s", "packed: scatter s", "shade s", "scatter MB", "shade MB", "packed: scatter MB", "shade MB", "error", "bias"],
                [[short(r["size"]),
                  *(figure(r[s]["cpu_secs"]) for s in stages_of_lit), *(figure(r[s]["peak_bytes"] / 1e6) for s in stages_of_lit),
                  f"{r['lit_error']['relmse_trimmed']:.1e}", f"{100 * r['lit_error']['bias']:+.2f} %"] for r in of_lit]))
        (plots / f"{kind}-time.svg").write_text(plot(of_kind, size, "CPU seconds", cpu_secs))
        (plots / f"{kind}-memory.svg").write_text(plot(of_kind, size, "peak MB", peak_mb))
        text.append(f"![CPU seconds over {size}](size/{kind}-time.svg) ![peak memory over {size}](size/{kind}-memory.svg)\n")
    text.append(f"""## How to make this page

```sh
cargo build --release
python3 benches/scripts/size.py measure target/release/lvox ASSETS FOLDER --peer COMMAND
python3 benches/scripts/size.py page {Path(folder).resolve().relative_to(ROOT)}
```

The head of the script says what `ASSETS` and `COMMAND` are.
""")
    out.write_text("\n".join(text))


def main():
    match sys.argv[1:]:
        case ["page", folder]:
            page(folder)
        case ["measure", lvox, assets, folder, *rest]:
            def after(option):
                return rest[rest.index(option) + 1] if option in rest else None

            most = int(after("--most") or SURFELS[-1])
            only = rest[rest.index("--only") + 1:] if "--only" in rest else list(KINDS)
            measure(lvox, assets, folder, after("--peer"), after("--peer-of"), most, only)
        case _:
            sys.exit(__doc__)


main()
