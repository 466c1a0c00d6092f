#!/usr/bin/env bash
# Remakes the references by lvox itself: direct light and one indirect bounce of scenes/general, and light of all bounces
# (NAME_full). Takes about 40 CPU minutes. With names, only those: references/make.sh thin K_full. Sums stay in $REFERENCES_OUT if that names a folder: after a
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
    set -- curved lights100 volumes thin outdoor studio tree fire neon lens colored-smoke K_full thin_full fire_full \
        neon_full colored-smoke_full lights100_full ruin_full C_novol_full
fi
scenes=tests/acceptance/scenes

cargo build --release
lvox=${CARGO_TARGET_DIR:-target}/release/lvox
for name in "$@"; do
    case $name in
        K_full) made=("$scenes/K.toml" --resolution 96x96 --max-depth 0) ;;
        C_novol_full) made=("$scenes/C_novol.toml" --resolution 256x192 --max-depth 0) ;;
        ruin_full) made=("$scenes/ruin.toml" --resolution 128x96 --max-depth 0) ;;
        *_full) made=("$scenes/general/${name%_full}.toml" --max-depth 0) ;;
        *) made=("$scenes/general/$name.toml" --max-depth 3) ;;
    esac
    "$lvox" reference "${made[@]}" -o "$out/$name.exr" --spp "$spp"
    printf '%s ' "$name"
    case $name in
        *_full) half=$here/$name.exr ;;
        *) half=$here/${name}_d3.exr ;;
    esac
    python3 "$here/half.py" "$out/$name.exr" "$half"
done
