#!/usr/bin/env bash
# Measures the six scenes of Table 1 of Gibson & Wood (2011), a CT bunny and a CT head in Sponza, and writes docs/table1.md.
# Needs ../shared beside the repository; run it on a quiet machine. After a stop, the same command goes on.
#
# TABLE1_WORK        scenes, trees and studies; a folder for each build of lvox [target/table1]
# TABLE1_REFERENCES  converged images, kept for every build of the same path tracer [references in the former]
# TABLE1_SPP         their samples per pixel; raise it to go on from what is there [512]
# TABLE1_SCENES      all by default
# TABLE1_QUALITY     base settings of lvox [good]
# TABLE1_RUNS        samples per pixel of the Monte Carlo runs [4,16,64,256]
# TABLE1_ROUNDS      times that each run is timed [3]
# TABLE1_SCATTER     whether light of media is made beforehand, yes or no [yes]
# TABLE1_NOTE        a sentence on the state of the machine, for the page
set -eu
cd "$(dirname "$0")/../.."

work=${TABLE1_WORK:-target/table1}
mkdir -p "$work"
work=$(realpath "$work")
references=${TABLE1_REFERENCES:-$work/references}
mkdir -p "$references"
references=$(realpath "$references")
spp=${TABLE1_SPP:-512}
scenes=${TABLE1_SCENES:-bunny_64 bunny_128 bunny_512 head_64 head_128 head_256}
quality=${TABLE1_QUALITY:-good}
runs=${TABLE1_RUNS:-4,16,64,256}
rounds=${TABLE1_ROUNDS:-3}
scatter=${TABLE1_SCATTER:-yes}
case $scatter in
yes) beforehand=--scatter ;;
no) beforehand= ;;
*)
    printf 'TABLE1_SCATTER must be yes or no, found %s\n' "$scatter" >&2
    exit 2
    ;;
esac

cargo build --release
lvox=$(realpath "${CARGO_TARGET_DIR:-target}/release/lvox")
# Times of different builds must not mix.
build=$work/$quality-$scatter-$(sha256sum "$lvox" | cut -c 1-12)
mkdir -p "$build"
# Of the first run of this build: a later one goes on with it.
if ! [ -s "$build/made" ]; then
    changed=$(git status --porcelain --untracked-files=no -- src formats Cargo.toml Cargo.lock .cargo)
    printf '%s %s\n' "$(date -u +%F)" "$(git rev-parse --short HEAD || echo unknown)${changed:+ and changes}" >"$build/made"
fi
read -r made commit <"$build/made"

# Scene C of the acceptance tests with other media. The link keeps paths, and so the scenes' hashes, the same everywhere.
ln -sfn "$(realpath ../shared)" "$work/shared"
for scene in $scenes; do
    grid=${scene#*_}
    case $scene in
    bunny_*) height=3.3387246182940653 ;;
    head_*) height=2.825 ;; # 226 / 256 of its width
    esac
    sed -e '1d' -e "s|^name = \"C\"|name = \"$scene\"|" -e 's|\.\./\.\./\.\./\.\./shared|shared|' \
        -e "s|refs/geom/bunny_density_128.nrrd|data/${scene%_*}_density_$grid.nrrd|" \
        -e "s|\[0.0, 3.3387246182940653, 0.0, 0.15999999999999992\]|[0.0, $height, 0.0, 0.16]|" \
        tests/acceptance/scenes/C.toml >"$work/$scene.toml"
done

for scene in $scenes; do
    "$lvox" reference "$work/$scene.toml" --max-depth 3 --spp "$spp" -o "$references/$scene.exr"
done

for scene in $scenes; do
    # The paper allows 2^3 to 4^3 voxels for an lvoxel. That gives a fine grid more lvoxels for its surfels than the memory
    # in the paper's table has room for: here it gets 8^3.
    case ${scene#*_} in
    64 | 128) voxels=4 ;;
    *) voxels=8 ;;
    esac
    "$lvox" study "$work/$scene.toml" --reference "$references/$scene.exr" --base-only --paper-cloud "$voxels" \
        ${beforehand:+"$beforehand"} --quality "$quality" --spp "$runs" --rounds "$rounds" --long 8 -o "$build/$scene"
done

# What front-to-back order is worth, on both clouds of bunny_128.
for cloud in surfels-500000-depth-0.7 surfels-2500000-voxels-4; do
    tree=$build/bunny_128/trees/$cloud.lvt
    if [ -f "$tree" ] && ! [ -s "$build/order.$cloud.txt" ]; then
        LVOX_BENCH_TREE=$tree cargo bench --bench kernels -- order >"$work/order.txt"
        mv "$work/order.txt" "$build/order.$cloud.txt"
    fi
done

# What the page is made of is kept, without the paths of this machine.
record=benches/results/$made-table1
rm -rf benches/results/*-table1
mkdir -p "$record"
cp "$build"/order.*.txt "$record"
for scene in $scenes; do
    mkdir "$record/$scene"
    sed -E 's|"[^"]*/([^"/]+)\.exr"|"\1.exr"|' "$build/$scene/study.json" >"$record/$scene/study.json"
done
python3 -c '
import json, sys
date, commit, note, *values = sys.argv[1:]
settings = dict(zip(("spp", "scenes", "quality", "runs", "rounds", "scatter"), values))
print(json.dumps({"date": date, "commit": commit, "note": note, "settings": settings}, indent=2))' \
    "$made" "$commit" "${TABLE1_NOTE:-}" "$spp" "$scenes" "$quality" "$runs" "$rounds" "$scatter" >"$record/made.json"
python3 benches/scripts/table1.py "$record" >"$work/table1.md"
cp "$work/table1.md" docs/table1.md
printf 'see docs/table1.md\n' >&2
