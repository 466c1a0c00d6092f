#!/usr/bin/env bash
# Builds the wheel, installs it into an empty environment of Python as `pip install` does, and tries the module there.
# Ends with: N passed, N failed.
set -u
cd "$(dirname "$0")/../.." || exit 1

out=$(mktemp -d)
trap 'rm -rf "$out"' EXIT
. tests/support/checks.sh

skip() {
    printf 'SKIPPED: tests/python/run.sh: needs %s\n0 passed, 0 failed\n' "$1"
    exit 0
}
python3 -c 'import sys; sys.exit(sys.version_info < (3, 9))' 2>/dev/null || skip 'Python 3.9'
python3 -m venv "$out/venv" >/dev/null 2>&1 || skip "Python's venv"
"$out/venv/bin/pip" install --quiet 'maturin>=1.7,<2' numpy matplotlib >"$out/pip.log" 2>&1 ||
    skip "maturin, numpy and matplotlib from Python's packages"

if ! "$out/venv/bin/maturin" build --release --locked --out "$out/wheels" >"$out/maturin.log" 2>&1; then
    cat "$out/maturin.log"
    exit 1
fi
wheel=$(echo "$out"/wheels/lvox-*.whl)
check 'the wheel installs' "$out/venv/bin/pip" install --quiet --no-deps "$wheel"
# Away from the sources, so that what is installed is tried.
tests=$PWD/tests/python/test_lvox.py
at_home() { (cd "$out" && env -u LVOX_PROGRAM "$@"); }
check 'the program is on the path of the environment' at_home "$out/venv/bin/lvox" --version
check 'python -m lvox is the program' at_home "$out/venv/bin/python" -m lvox --version
check 'the module does what it says' at_home "$out/venv/bin/python" "$tests"
example=$PWD/examples/error_over_time.py
check 'the example plots error over time' at_home "$out/venv/bin/python" "$example"
# `cargo package` leaves nothing out that a build needs.
sources() {
    "$out/venv/bin/maturin" sdist --out "$out/sources" >"$out/sdist.log" 2>&1 || { cat "$out/sdist.log"; return 1; }
    tar -tzf "$out"/sources/lvox-*.tar.gz | grep -q '/\.cargo/config\.toml$'
}
check 'the source package is whole' sources

told
