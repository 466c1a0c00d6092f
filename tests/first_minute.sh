#!/usr/bin/env bash
# Runs what the README says to try first, as it stands there; what needs a Blender file is tests/exchange/run.sh's.
# Ends with: N passed, N failed.
set -u
cd "$(dirname "$0")/.." || exit 1

out=$(mktemp -d)
trap 'rm -rf "$out"' EXIT
. tests/support/checks.sh

cargo build --release || exit 1
lvox=$(realpath "${CARGO_TARGET_DIR:-target}/release/lvox")
commands=$(awk '/^## The first minute/ { here = 1 } here && /^```/ { n++ } here && n == 1 && /^\$lvox/ { print } n == 2 { exit }' README.md |
    grep -v ' shot')
[ "$(grep -c . <<<"$commands")" -ge 5 ] || { printf 'FAILED: the README has no first minute\n0 passed, 1 failed\n'; exit 1; }
ln -s "$PWD/examples" "$out"
while read -r line; do
    command=${line//'$lvox'/"$lvox"}
    check "$line" bash -c "cd '$out' && $command --progress none >'$out/told'"
done <<<"$commands"
for file in room.exr truth.exr phantom.png; do
    check "$file is there" test -s "$out/$file"
done

told
