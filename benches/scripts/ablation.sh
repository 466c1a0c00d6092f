#!/usr/bin/env bash
# Shades scenes with one setting changed at a time and prints a table of time and error: what each technique of
# docs/gather.md is worth that a setting can switch off. Needs ../shared beside the repository for A, B, C and C_novol.
#
# ABLATION_WORK    trees, images and reports; what is there is not made again [target/ablation]
# ABLATION_SCENES  these, or curved, lights100, volumes, thin, outdoor [A B C C_novol]
# ABLATION_TIMED   a command in front of what is timed, ABLATION_HEAVY of the build: to wait for a quiet machine [none]
set -eu
cd "$(dirname "$0")/../.."

work=${ABLATION_WORK:-target/ablation}
mkdir -p "$work"
work=$(realpath "$work")
scenes=${ABLATION_SCENES:-A B C C_novol}

# Name, and options: of bake if they begin with "bake", else of shade.
rows='default|
--lattice 1: a gather at every pixel|--lattice 1
--samples 128: three times the rays|--samples 128
--kernel cone: rays end at nodes and surfels|--kernel cone
--kernel plain: rays end at surfels, as in the paper|--kernel plain
--max-solid-angle 0: patches as small as disks, no node whole|--max-solid-angle 0
--pixel-samples 4: no corners that neighbours share|--pixel-samples 4
--edge-samples 4: fewer samples at edges|--edge-samples 4
--volume-samples 32: five times the rays in media|--volume-samples 32
--max-dist 1e9: no sweeps, a finite reach switches them off|--max-dist 1e9
--method traditional: no lvoxels in gathers|--method traditional
bake --surfels 125000|bake --surfels 125000
bake --surfels 2000000|bake --surfels 2000000
bake --block-depth 0.35: lvoxels half as deep|bake --block-depth 0.35'

${ABLATION_HEAVY:-} cargo build --release
lvox=$(realpath "${CARGO_TARGET_DIR:-target}/release/lvox")

measure() {
    local scene toml options name tree image i
    for scene in $scenes; do
        toml=tests/acceptance/scenes/$scene.toml
        [ -e "$toml" ] || toml=tests/acceptance/scenes/general/$scene.toml
        i=0
        while IFS='|' read -r name options; do
            image=$work/$scene.$i
            i=$((i + 1))
            [ ! -s "$image.json" ] || continue
            tree=$work/$scene.lvt
            case $options in
            'bake '*) tree=$image.lvt ;;
            esac
            if [ ! -s "$tree" ]; then
                # shellcheck disable=SC2086 # words
                "$lvox" bake "$toml" -o "$work/cloud.lvc" --force --progress none \
                    $(case $options in 'bake '*) echo "${options#bake }" ;; esac)
                "$lvox" build "$work/cloud.lvc" -o "$tree" --force --progress none
            fi
            # shellcheck disable=SC2086 # words
            "$lvox" shade "$toml" -t "$tree" -o "$image.exr" --report "$image.json" --progress none \
                $(case $options in 'bake '*) ;; *) echo "$options" ;; esac) </dev/null
        done <<<"$rows"
    done
}
export -f measure
export lvox work scenes rows
${ABLATION_TIMED:-} bash -euc measure

for scene in $scenes; do
    reference=../shared/refs/${scene}_d3.exr
    [ -e "$reference" ] || reference=tests/acceptance/references/${scene}_d3.exr
    for image in "$work/$scene".*.exr; do
        "$lvox" compare "$image" "$reference" --json >"${image%.exr}.scores"
    done
done

python3 - "$work" "$rows" $scenes <<'PYTHON'
import json, sys

work, rows, scenes = sys.argv[1], sys.argv[2].splitlines(), sys.argv[3:]
print("| CPU s, trimmed relMSE, bias | " + " | ".join(scenes) + " |")
print("| --- |" + " --- |" * len(scenes))
for i, row in enumerate(rows):
    cells = []
    for scene in scenes:
        stages = json.load(open(f"{work}/{scene}.{i}.json"))["stages"]
        secs = next(s["cpu_secs"] for s in stages if s["stage"] == "shade")
        scores = json.load(open(f"{work}/{scene}.{i}.scores"))
        error = f"{scores['relmse_trimmed']:.1e}".replace("e-0", "e-")
        cells.append(f"{secs:.2f}, {error}, {100 * scores['bias']:+.2f} %")
    flag, _, what = row.split("|")[0].partition(":")
    name = flag if flag == "default" else f"`{flag}`{':' if what else ''}{what}"
    print(f"| {name} | " + " | ".join(cells) + " |")
PYTHON
