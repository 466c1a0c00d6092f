#!/usr/bin/env python3
"""Exports a Blender scene for lvox: meshes as glTF, all else as TOML, frame by frame.

    python tools/blender_export.py file.blend -o folder [--frames 1-10x2]        (a Python that has bpy)
    blender -b file.blend -P tools/blender_export.py -- -o folder                (inside Blender)

Writes folder/NAME.toml and NAME.glb, or with --frames NAME.0001.toml, ... for
`lvox render folder/NAME.####.toml --frames 1-10 -o out.####.exr`. Frames of equal meshes share a file.

What renders show is taken, not what the viewport does, with all instances.
Taken are: meshes with their modifiers and the colours, textures and emission that glTF has (Diffuse and
Emission nodes, too); all cameras, the scene's first, and their depth of field; sun, point, spot and area
lights in Blender's units (watts; area lights become quads or disks that emit, points with a radius balls); a
world of one colour or an image, turned about z by a Mapping node; what Ray Visibility keeps from the camera,
and transparent film; light groups of lamps, objects that emit and the world; volume objects (.vdb), and
meshes that are boxes, filled with Principled Volume, Volume Scatter, Volume Absorption, Volume Coefficients,
sums of these, and what they emit of a grid.
What is left out is told on stderr.
"""
import argparse
import math
import os
import sys

try:
    import bpy
except ImportError:
    sys.exit("blender_export.py needs Blender's Python module: pip install bpy, or run it by blender -b FILE -P")
from mathutils import Matrix

# Inside Blender the folder of a script is not searched.
sys.path.insert(0, os.path.dirname(os.path.abspath(__file__)))
from blender_lights import world  # noqa: E402
from blender_materials import prepare_materials, refresh_materials  # noqa: E402
from blender_media import Y_UP, rows  # noqa: E402
from blender_objects import taken  # noqa: E402
from scene_text import frames_of, table, text, warn  # noqa: E402


def unscaled(matrix):
    """Place and turn alone."""
    place, turn, _ = matrix.decompose()
    return Matrix.Translation(place) @ turn.to_matrix().to_4x4()


def camera(scene, obj):
    frame = obj.data.view_frame(scene=scene)
    x = max(abs(corner.x) for corner in frame)
    z = abs(frame[0].z)
    if obj.data.type != "PERSP":
        warn(f"camera {obj.name} is not perspective: it is left out")
        return ""
    if abs(obj.data.shift_x) + abs(obj.data.shift_y) > 1e-6:
        warn(f"camera {obj.name}: its shift is left out")
        x = max(c.x for c in frame) - min(c.x for c in frame)
        x /= 2
    place = Y_UP @ unscaled(obj.matrix_world)
    keys = {"name": obj.name, "camera_to_world": rows(place), "fov_x_deg": math.degrees(2 * math.atan(x / z))}
    return table("[[camera]]", keys | lens(obj))


def lens(obj):
    """Depth of field as Cycles has it: the focal length, in millimetres, over twice the f-stop is the radius."""
    dof = obj.data.dof
    if not dof.use_dof:
        return {}
    distance = dof.focus_distance
    if dof.focus_object:
        axis = obj.matrix_world.to_3x3().col[2].normalized()
        away = dof.focus_object.matrix_world.translation - obj.matrix_world.translation
        distance = abs(axis.dot(away))
    if dof.aperture_blades or abs(dof.aperture_ratio - 1) > 1e-6:
        warn(f"camera {obj.name}: its opening is taken as round")
    radius = obj.data.lens * 1e-3 / (2 * max(dof.aperture_fstop, 1e-5))
    return {"aperture": radius, "focus_distance": max(distance, 1e-5)}


def film(scene):
    render = scene.render
    if abs(render.pixel_aspect_x / render.pixel_aspect_y - 1) > 1e-6:
        warn("pixels that are not square are taken as square")
    if render.use_border:
        warn("the render region is left out: `--region` of lvox renders a part")
    side = lambda n: max(1, int(n * render.resolution_percentage / 100))  # noqa: E731
    keys = {"width": side(render.resolution_x), "height": side(render.resolution_y)}
    of_film = getattr(getattr(scene, "cycles", None), "film_exposure", 1.0)
    return table("[film]", keys | {"exposure": of_film * 2.0**scene.view_settings.exposure})


def export(folder, name, known):
    scene = bpy.context.scene
    refresh_materials()
    shown = taken(scene, folder, lambda obj: camera(scene, obj))
    cameras = [obj for obj in scene.objects if obj.type == "CAMERA"]
    cameras.sort(key=lambda obj: (obj != scene.camera, obj.name))
    out = f"name = {text(name)}\n" + film(scene)
    # Those that are not rendered are not among what is shown.
    out += "".join(shown.cameras[obj.name] if obj.name in shown.cameras else camera(scene, obj) for obj in cameras)
    out += shown.meshes(name, known) + world(scene, folder) + shown.lights + shown.volumes
    with open(os.path.join(folder, name + ".toml"), "w") as file:
        file.write(out)


def main(words):
    parser = argparse.ArgumentParser(description="Exports a Blender scene for lvox.")
    parser.add_argument("file", nargs="?", help="a .blend file; without it the scene that is open")
    parser.add_argument("-o", "--output", required=True, help="write into this folder")
    parser.add_argument("--frames", type=frames_of, help="frames, as 1-10, 1-10x2 or 1,5,9; without it the current one")
    args = parser.parse_args(words)
    if args.file and not os.path.exists(args.file):
        parser.error(f"{args.file} is not there")
    if args.file:
        bpy.ops.wm.open_mainfile(filepath=os.path.abspath(args.file))
    os.makedirs(args.output, exist_ok=True)
    name = os.path.splitext(os.path.basename(bpy.data.filepath))[0] or "scene"
    prepare_materials()
    known = {}
    if args.frames is None:
        export(args.output, name, known)
        return
    for frame in args.frames:
        bpy.context.scene.frame_set(frame)
        export(args.output, f"{name}.{frame:04d}", known)


if __name__ == "__main__":
    main(sys.argv[sys.argv.index("--") + 1 :] if "--" in sys.argv else sys.argv[1:])
