#!/usr/bin/env bash
# Shades the scenes of the reference images at the size of their film and at 1920x1080 from the same trees, beside a path
# tracer at both, and writes a table of time per pixel and of error. Needs ../shared beside the repository.
#
# LARGE_WORK    trees, images and reports; what is there is not made again [target/large-frame]
# LARGE_SCENES  scenes [A B C C_novol]
# LARGE_SPP     samples per pixel of the references at 1920x1080 [1024]; the small ones have twice as many; 0 for times only
# LARGE_ROUNDS  times that each run is timed; the least counts [2]
# LARGE_TIMED   a command in front of what is timed, LARGE_HEAVY of what is not: to wait for a quiet machine [none]
set -eu
cd "$(dirname "$0")/../.."

work=${LARGE_WORK:-target/large-frame}
mkdir -p "$work"
work=$(realpath "$work")
spp=${LARGE_SPP:-1024}
rounds=${LARGE_ROUNDS:-2}
timed=${LARGE_TIMED:-}
heavy=${LARGE_HEAVY:-}

$heavy cargo build --release
lvox=$(realpath "${CARGO_TARGET_DIR:-target}/release/lvox")

# once REPORT COMMAND...: runs unless the report is there.
once() {
    local report=$1
    shift
    [ -s "$report" ] || "$@" --report "$report" --progress none
}

for scene in ${LARGE_SCENES:-A B C C_novol}; do
    toml=tests/acceptance/scenes/$scene.toml
    at=$work/$scene
    [ -s "$at.lvt" ] || {
        $heavy "$lvox" bake "$toml" -o "$at.lvc" --progress none --force
        $heavy "$lvox" build "$at.lvc" -o "$at.lvt" --progress none --force
    }
    height=$(sed -n 's/^height = //p' "$toml" | head -n 1)
    for size in "512x$height" 1920x1080; do
        for ((i = 0; i < rounds; i++)); do
            once "$at.$size.$i.json" $timed "$lvox" shade "$toml" -t "$at.lvt" --resolution "$size" -o "$at.$size.exr" --float
            once "$at.$size.$i.path.json" $timed "$lvox" reference "$toml" --resolution "$size" --spp 1 --max-depth 3 \
                -o "$at.$size.path.exr" --force
        done
        [ "$spp" -gt 0 ] || continue
        # The same two parts of the picture at both sizes.
        if [ "$size" = 1920x1080 ]; then
            parts='480 405 720 540 1200 540 1440 675'
            samples=$spp
        else
            middle=$((height / 2))
            parts="128 $((middle - 36)) 192 $middle 320 $middle 384 $((middle + 36))"
            samples=$((2 * spp))
        fi
        # shellcheck disable=SC2086 # words
        set -- $parts
        for part in 0 1; do
            once "$at.$size.part$part.json" $heavy "$lvox" reference "$toml" --resolution "$size" --region "$1" "$2" "$3" "$4" \
                --spp "$samples" --max-depth 3 -o "$at.$size.part$part.exr"
            "$lvox" compare "$at.$size.exr" "$at.$size.part$part.exr" --region "$1" "$2" "$3" "$4" --json \
                >"$at.$size.part$part.scores.json"
            shift 4
        done
    done
done

python3 - "$work" "${LARGE_SCENES:-A B C C_novol}" "$rounds" "$spp" <<'PYTHON'
import glob, json, sys

work, scenes, rounds, spp = sys.argv[1], sys.argv[2].split(), int(sys.argv[3]), int(sys.argv[4])


def stage(path, name):
    return next(s for s in json.load(open(path))["stages"] if s["stage"] == name)


def cpu(at, name, kind):
    return min(stage(f"{at}.{i}{kind}.json", name)["cpu_secs"] for i in range(rounds))


print("| scene | film | shade, CPU s | CPU us a pixel | ratio | path tracer, CPU us a sample | ratio | relMSE trimmed | noise of the reference |")
print("| --- | --- | --- | --- | --- | --- | --- | --- | --- |")
for scene in scenes:
    first = None
    sizes = {f.split(".")[-3] for f in glob.glob(f"{work}/{scene}.*x*.0.json")}
    for size in sorted(sizes, key=lambda s: int(s.split("x")[0])):
        width, height = map(int, size.split("x"))
        at = f"{work}/{scene}.{size}"
        shade, path = cpu(at, "shade", ""), cpu(at, "reference", ".path")
        each, sample = shade / (width * height) * 1e6, path / (width * height) * 1e6
        first = first or (each, sample)
        error = noise = 0.0
        for part in (0, 1) if spp else ():
            error += 0.5 * json.load(open(f"{at}.part{part}.scores.json"))["relmse_trimmed"]
            noise += 0.5 * stage(f"{at}.part{part}.json", "reference")["counts"]["relmse_estimate"]
        print(f"| {scene} | {width} x {height} | {shade:.2f} | {each:.2f} | {each / first[0]:.2f} | {sample:.2f} | "
              f"{sample / first[1]:.2f} | {error:.1e} | {noise:.1e} |")
PYTHON
