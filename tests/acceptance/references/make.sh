#!/usr/bin/env bash
# Remakes the references of scenes/general by lvox itself: direct light and one indirect bounce. Takes about 20 CPU
# minutes. With names, only those: references/make.sh thin. Sums stay in $REFERENCES_OUT if that names a folder: after a
# stop, or with a higher SPP, the work goes on from there.
set -eu
cd "$(dirname "$0")/../../.." || exit 1

spp=${SPP:-4096}
here=tests/acceptance/references
if [ -n "${REFERENCES_OUT:-}" ]; then
    out=$REFERENCES_OUT
    mkdir -p "$out"
else
    out=$(mktemp -d)
    trap 'rm -rf "$out"' EXIT
fi
if [ $# -eq 0 ]; then
    set -- curved lights100 volumes thin outdoor studio
fi

cargo build --release
lvox=${CARGO_TARGET_DIR:-target}/release/lvox
for scene in "$@"; do
    "$lvox" reference "tests/acceptance/scenes/general/$scene.toml" -o "$out/$scene.exr" \
        --max-depth 3 --spp "$spp"
    printf '%s ' "$scene"
    python3 "$here/half.py" "$out/$scene.exr" "$here/${scene}_d3.exr"
done
