#!/usr/bin/env bash
# Reads pictures by the programs that they are for: OpenImageIO and Blender have to agree with lvox on layers, names of
# channels, colour space and values. The array of the same frame is what they are held to. Blender is that of the Python in
# LVOX_BPY (python3 unless told), with its module bpy; what is missing is SKIPPED. Ends with: N passed, N failed.
set -u
cd "$(dirname "$0")/../.." || exit 1

cargo build --release || exit 1
lvox=$(realpath "${CARGO_TARGET_DIR:-target}/release/lvox")
blender=$(realpath tests/pictures/blender.py)
bpy=${LVOX_BPY:-python3}
. tests/support/checks.sh
out=$(mktemp -d)
trap 'rm -rf "$out"' EXIT
cd "$out" || exit 1

skip() { printf 'SKIPPED: tests/pictures/run.sh, %s\n' "$1"; }
quiet() { "$@" >"$out/log" 2>&1 || { tail -n 20 "$out/log"; return 1; }; }

# A ball before a sky, far from the origin, with something thin before both.
cat >scene.toml <<'SCENE'
[film]
width = 96
height = 64
[[camera]]
position = [100.5, 1.1, 3]
target = [100, 0, 0]
fov_x_deg = 40
[[light]]
type = "environment"
radiance = [0.5, 0.75, 1]
[[mesh]]
file = "builtin:sphere"
translate = [100, 0, 0]
albedo = [0.25, 0.5, 0.75]
[[volume]]
file = "fog.raw"
dims = [1, 1, 1]
dtype = "u8"
sigma_t_scale = 1
albedo = [0.8, 0.8, 0.8]
unitcube_to_world = [[0.5, 0, 0, 100.3], [0, 0.5, 0, 0], [0, 0, 0.5, 0.6], [0, 0, 0, 1]]
SCENE
printf '\001' >fog.raw
layers=(--alpha --aov 'direct,environment,indirect,volume,depth,distance,normal,position,albedo')
made() {
    "$lvox" render scene.toml --surfels 5000 --keep-tree t.lvt --quality draft -o half.exr "${layers[@]}" &&
        "$lvox" shade scene.toml -t t.lvt --quality draft -o float.exr --float "${layers[@]}" &&
        "$lvox" shade scene.toml -t t.lvt --quality draft -o array.npy "${layers[@]}"
}
check 'lvox makes the pictures' quiet made

by_oiiotool() {
    local info names
    info=$(oiiotool --info -v half.exr) || return 1
    names=$(sed -n 's/ *channel list: //p' <<<"$info")
    for channel in {R,G,B,A}' (half)' {direct,environment,indirect,volume,albedo}.{R,G,B}' (half)' normal.{X,Y,Z}' (half)' \
        {depth,distance}.Z' (float)' position.{X,Y,Z}' (float)'; do
        [[ ", $names," == *", $channel,"* ]] || { echo "no $channel in $names"; return 1; }
    done
    for attribute in 'colorInteropID: "lin_rec709_scene"' 'compression: "zip"' 'worldToCamera: ' 'worldToNDC: '; do
        grep -qF "$attribute" <<<"$info" || { echo "no $attribute"; return 1; }
    done
    ! grep -q chromaticities <<<"$info" || return 1
    oiiotool half.exr --ch depth.Z --printstats | grep 'Stats Max: 1\(0000000000\|e+10\)' || return 1
    oiiotool half.exr --ch A --printstats | grep -E 'Stats Min: 0\.0+ ' || return 1
    oiiotool half.exr --ch A --printstats | grep -E 'Stats Max: 1\.0+ '
}
if command -v oiiotool >/dev/null; then
    check 'OpenImageIO reads layers, colour space and depth' quiet by_oiiotool
else
    skip 'OpenImageIO: needs oiiotool'
fi

if "$bpy" -c 'import bpy, numpy' >/dev/null 2>&1; then
    check 'Blender reads passes and colour space by itself' quiet "$bpy" "$blender" half.exr array.npy 1e-3
    check 'Blender reads the values of the array' quiet "$bpy" "$blender" float.exr array.npy 0
else
    skip 'Blender: needs a Python with bpy, as LVOX_BPY=PYTHON'
fi

told
