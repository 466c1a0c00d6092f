#!/usr/bin/env bash
# Holds the program that is compiled for any x86-64 to the one for x86-64-v3, byte for byte, and tries the latter on an older
# processor, which qemu-user plays. Ends with: N passed, N failed.
# The other program is built in a folder of its own, target/any-x86-64, which takes some minutes the first time.
set -u
cd "$(dirname "$0")/../.." || exit 1

if [ "$(uname -sm)" != 'Linux x86_64' ]; then
    printf 'SKIPPED: tests/processors/run.sh: needs Linux on x86-64\n0 passed, 0 failed\n'
    exit 0
fi

out=$(mktemp -d)
trap 'rm -rf "$out"' EXIT
. tests/support/checks.sh

target=${CARGO_TARGET_DIR:-target}
# As more units: it is not built for its speed.
any() { env RUSTFLAGS='-C target-cpu=x86-64' cargo build --release --target-dir "$target/any-x86-64" \
    --config 'profile.release.package.lvox.codegen-units=16'; }
cargo build --release && any || exit 1
new=$target/release/lvox
any=$target/any-x86-64/release/lvox

# make PROGRAM FOLDER: a cloud, trees, light in media, pictures and a reference of the demo, and a picture of a sunlit room.
make() {
    local program folder=$2
    program=$(realpath "$1")
    mkdir "$folder"
    run() { "$program" "$@" --progress none || { printf 'FAILED: lvox %s\n' "$*"; return 1; }; }
    (
        cd "$folder" &&
            run bake --demo -o demo.lvc --surfels 50000 &&
            run build demo.lvc -o one.lvt &&
            run bounce --demo -t one.lvt -o demo.lvt &&
            run scatter --demo -t demo.lvt -o demo.lvs &&
            run shade --demo -t demo.lvt --resolution 160x120 -o own.exr --float &&
            run shade --demo -t demo.lvt --scatter demo.lvs --resolution 160x120 -o lit.exr --float &&
            run shade --demo -t one.lvt --resolution 96x72 --kernel cone -o cone.exr --float &&
            run tiles --demo -t demo.lvt --scatter demo.lvs --count 9 -o tiles.txt &&
            run pack --demo -t demo.lvt --scatter demo.lvs -o demo.lvp &&
            run reference --demo --resolution 64x48 --spp 4 -o reference.exr
    )
}
check 'the program for x86-64-v3 runs' make "$new" "$out/new"
check 'the program for any x86-64 runs' make "$any" "$out/any"
for file in demo.lvc one.lvt demo.lvt demo.lvs own.exr lit.exr cone.exr tiles.txt demo.lvp reference.exr; do
    check "$file has the same bytes" cmp "$out/new/$file" "$out/any/$file"
done

# An older processor: the program says what it lacks, and the other one runs there.
if ! command -v qemu-x86_64 >/dev/null; then
    apt-get install -y --no-install-recommends qemu-user >"$out/apt.log" 2>&1
fi
if command -v qemu-x86_64 >/dev/null; then
    # refused CPU: one error and one hint, exit code 2. qemu tells on stderr, too, what it cannot play.
    refused() {
        qemu-x86_64 -cpu "$1" "$new" --version >"$out/stdout" 2>"$out/all"
        local code=$?
        grep -v '^qemu-x86_64: warning:' "$out/all" >"$out/stderr"
        [ $code -eq 2 ] && [ ! -s "$out/stdout" ] && [ "$(grep -c . "$out/stderr")" -eq 2 ] &&
            grep -q '^error: .*x86-64-v3' "$out/stderr" && grep -q '^hint: ' "$out/stderr"
    }
    for cpu in Conroe Nehalem SandyBridge; do
        check "refused on $cpu" refused "$cpu"
        check "the other program runs on $cpu" qemu-x86_64 -cpu "$cpu" "$any" --version
    done
    check 'accepted on max' qemu-x86_64 -cpu max "$new" --version
else
    printf 'SKIPPED: tests/processors/run.sh, an older processor: needs qemu-user\n'
fi

told
