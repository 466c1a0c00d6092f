#!/usr/bin/env bash
# Scenes of other programs: lvox and these programs render the same file, and their pictures agree within noise.
# Needs ../shared beside the repository, and Pythons that have mitsuba, bpy and usd-core: python3, or those that
# MITSUBA_PYTHON, BPY_PYTHON and USD_PYTHON name. Ends with: N passed, N failed.
set -u
cd "$(dirname "$0")/../.." || exit 1

out=$(mktemp -d)
trap 'rm -rf "$out"' EXIT
. tests/support/checks.sh

cargo build --release || exit 1
lvox=$(realpath "${CARGO_TARGET_DIR:-target}/release/lvox")

# python MODULE VARIABLE: one that has the module, or nothing.
python() {
    local program=${!2:-python3}
    if ! command -v "$program" >/dev/null || ! "$program" -c "import $1" >/dev/null 2>&1; then
        printf 'SKIPPED: tests/exchange/run.sh: needs a Python that has %s, which %s may name\n' "$1" "$2" >&2
        return 1
    fi
    printf '%s\n' "$program"
}

if [ ! -d ../shared/refs/geom ]; then
    printf 'SKIPPED: tests/exchange/run.sh: Mitsuba needs ../shared/refs/geom\n'
elif program=$(python mitsuba MITSUBA_PYTHON); then
    mkdir "$out/mitsuba"
    check 'one file, two programs' "$program" tests/exchange/mitsuba_agrees.py "$lvox" "$out/mitsuba" \
        "$(realpath ../shared/refs/geom)"
fi
if program=$(python bpy BPY_PYTHON); then
    mkdir "$out/blender"
    check 'what Blender exports' "$program" tests/exchange/blender_agrees.py "$lvox" "$out/blender" \
        "$(realpath ..)/shared/data/smoke.vdb"
fi
if program=$(python pxr.UsdLux USD_PYTHON); then
    mkdir "$out/usd"
    check 'what comes of USD' "$program" tests/exchange/usd_agrees.py "$lvox" "$out/usd"
fi
told
