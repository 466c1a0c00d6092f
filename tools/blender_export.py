#!/usr/bin/env python3
"""Exports a Blender scene for lvox: meshes as glTF, all else as TOML, frame by frame.

    python tools/blender_export.py file.blend -o folder [--frames 1-10x2]        (a Python that has bpy)
    blender -b file.blend -P tools/blender_export.py -- -o folder                (inside Blender)

Writes folder/NAME.toml and NAME.glb, or with --frames NAME.0001.toml, ... for
`lvox render folder/NAME.####.toml --frames 1-10 -o out.####.exr`. Frames of equal meshes share a file.

Taken are: meshes with their modifiers and the colours, textures and emission that glTF has (Diffuse and Emission
nodes, too); all cameras, the scene's first, and their depth of field; sun, point, spot and area lights in Blender's units (watts; area lights
become quads or disks that emit, points with a radius balls); a world of one colour or an image, turned about z by a
Mapping node; what Ray Visibility keeps from the camera, and transparent film; light groups of lamps, objects that
emit and the world; volume objects (.vdb), and meshes that are boxes, filled with Principled Volume, Volume Scatter,
Volume Absorption, Volume Coefficients, sums of these, and what they emit of a grid.
What is left out is told on stderr.
"""
import argparse
import hashlib
import math
import os
import re
import sys

import bpy
import numpy as np
from mathutils import Matrix, Vector

# Inside Blender the folder of a script is not searched.
sys.path.insert(0, os.path.dirname(os.path.abspath(__file__)))
import blender_media  # noqa: E402
from blender_media import feed, output, rows  # noqa: E402
from scene_text import copied, frames_of, table, text, warn  # noqa: E402

# Blender is z-up, glTF and lvox are y-up.
Y_UP = Matrix(((1, 0, 0, 0), (0, 0, 1, 0), (0, -1, 0, 0), (0, 0, 0, 1)))
# builtin:quad faces +y; area lights face -z.
FACING_DOWN = Matrix(((1, 0, 0, 0), (0, 0, 1, 0), (0, -1, 0, 0), (0, 0, 0, 1)))
DISK = "disk.ply"
BALL = "ball.ply"


def vector(v):
    return [v[0], v[1], v[2]]


def unscaled(matrix):
    """Place and turn alone."""
    place, turn, _ = matrix.decompose()
    return Matrix.Translation(place) @ turn.to_matrix().to_4x4()


# ---------------------------------------------------------------------------------------------------- materials


def source(socket):
    """The node that a socket is fed from, if any, through reroutes."""
    fed = feed(socket)
    return fed.node if fed else None


def prepare_materials():
    """Lets a Principled node stand for Diffuse and Emission, of which glTF has none or not all."""
    for material in bpy.data.materials:
        tree = material.node_tree
        out = output(tree) if tree else None
        node = source(out.inputs["Surface"]) if out else None
        if node is None or node.type not in ("BSDF_DIFFUSE", "EMISSION"):
            if node is not None and node.type != "BSDF_PRINCIPLED":
                warn(f"material {material.name}: {node.bl_label} is exported as glTF can")
            continue
        plain = tree.nodes.new("ShaderNodeBsdfPrincipled")
        plain.inputs["Roughness"].default_value = 1
        plain.inputs["Specular IOR Level"].default_value = 0
        color = node.inputs["Color"]
        key = "Base Color"
        if node.type == "EMISSION":
            plain.inputs["Base Color"].default_value = (0, 0, 0, 1)
            if node.inputs["Strength"].is_linked:
                warn(f"material {material.name}: the strength of its emission comes from a node: left out")
            plain.inputs["Emission Strength"].default_value = node.inputs["Strength"].default_value
            key = "Emission Color"
        plain.inputs[key].default_value = color.default_value
        if color.is_linked:
            tree.links.new(color.links[0].from_socket, plain.inputs[key])
        tree.links.new(plain.outputs["BSDF"], out.inputs["Surface"])


# ------------------------------------------------------------------------------------------------------- lights


def light(obj, folder):
    title, keys = light_keys(obj, folder)
    return table(title, grouped(obj, keys))


def grouped(obj, keys):
    """With the light group that an object or a world is in."""
    name = re.sub("[^A-Za-z0-9_-]", "_", getattr(obj, "lightgroup", ""))
    return keys | {"group": name} if name else keys


def light_keys(obj, folder):
    lamp, to_world = obj.data, Y_UP @ obj.matrix_world
    color = [c * lamp.energy * 2.0 ** getattr(lamp, "exposure", 0.0) for c in lamp.color]
    if getattr(lamp, "use_temperature", False):
        color = [c * t for c, t in zip(color, lamp.temperature_color)]
    if not getattr(lamp, "normalize", True):
        warn(f"light {obj.name}: its power is taken as of all its area")
    if getattr(lamp, "use_nodes", False) and lamp.node_tree and len(lamp.node_tree.nodes) > 2:
        warn(f"light {obj.name}: its nodes are left out")
    place = vector(to_world.translation)
    ahead = vector(-to_world.col[2].to_3d().normalized())
    if lamp.type == "SUN":
        keys = {"type": "directional", "direction": ahead, "irradiance": color}
        if lamp.angle > 0:
            keys["angular_radius_deg"] = min(math.degrees(lamp.angle / 2), 89)
        return "[[light]]", keys
    if lamp.type == "AREA":
        return area_light(obj, color, to_world, folder)
    if lamp.type == "POINT" and lamp.shadow_soft_size > 0:
        return ball_light(obj, color, place, folder)
    if lamp.shadow_soft_size > 0:
        warn(f"light {obj.name}: its radius of {lamp.shadow_soft_size:g} is left out")
    # Watts all around, whatever the cone of a spot.
    intensity = [c / (4 * math.pi) for c in color]
    if lamp.type == "POINT":
        return "[[light]]", {"type": "point", "position": place, "intensity": intensity}
    outer = math.cos(lamp.spot_size / 2)
    inner = min(outer + (1 - outer) * max(lamp.spot_blend, 1e-4), 1)
    keys = {"type": "spot", "position": place, "direction": ahead, "intensity": intensity}
    keys["inner_deg"] = math.degrees(math.acos(inner))
    keys["outer_deg"] = math.degrees(lamp.spot_size / 2)
    return "[[light]]", keys


def area_light(obj, color, to_world, folder):
    lamp = obj.data
    across = lamp.size
    down = lamp.size_y if lamp.shape in ("RECTANGLE", "ELLIPSE") else lamp.size
    is_round = lamp.shape in ("DISK", "ELLIPSE")
    scale = to_world.to_scale()
    size = across * scale[0] * down * scale[1] * (math.pi / 4 if is_round else 1)
    if lamp.spread < math.pi - 1e-3:
        warn(f"light {obj.name}: its spread is left out")
    radiance = [c / (math.pi * size) for c in color]
    name = "builtin:quad"
    if is_round:
        name = DISK
        write_disk(os.path.join(folder, DISK))
    place = to_world @ FACING_DOWN @ Matrix.Diagonal((across, 1, down, 1))
    return lamp_mesh(obj, {"file": name, "transform": rows(place)}, radiance)


def lamp_mesh(obj, keys, radiance):
    keys |= {"name": obj.name, "albedo": [0, 0, 0], "emission": radiance}
    if not obj.visible_camera:
        keys["visible"] = False
    return "[[mesh]]", keys


def ball_light(obj, color, place, folder):
    radius = obj.data.shadow_soft_size
    area = write_ball(os.path.join(folder, BALL)) * radius**2
    # What sends watts all around through the quarter of its area that each direction sees.
    radiance = [c / (math.pi * area) for c in color]
    return lamp_mesh(obj, {"file": BALL, "scale": radius, "translate": place}, radiance)


def write_ball(path, rings=8, sides=16):
    """Of radius 1; its area."""
    at = lambda i, j: (  # noqa: E731
        math.sin(math.pi * i / rings) * math.sin(2 * math.pi * j / sides),
        math.cos(math.pi * i / rings),
        math.sin(math.pi * i / rings) * math.cos(2 * math.pi * j / sides),
    )
    points = [at(i, j) for i in range(rings + 1) for j in range(sides)]
    faces = []
    for i in range(rings):
        for j in range(sides):
            a, b = i * sides + j, i * sides + (j + 1) % sides
            below = [(a, a + sides, b + sides)] if i < rings - 1 else []
            faces += below + ([(a, b + sides, b)] if i > 0 else [])
    write_ply(path, points, faces)
    return sum(triangle_area(*(points[k] for k in face)) for face in faces)


def triangle_area(a, b, c):
    return (Vector(b) - Vector(a)).cross(Vector(c) - Vector(a)).length / 2


def write_disk(path, sides=128):
    """Of diameter 1 around y, facing +y."""
    turns = [2 * math.pi * i / sides for i in range(sides)]
    write_ply(path, [(math.sin(t) / 2, 0, math.cos(t) / 2) for t in turns], [range(sides)])


def write_ply(path, points, faces):
    head = f"ply\nformat ascii 1.0\nelement vertex {len(points)}\n"
    head += "".join(f"property float {axis}\n" for axis in "xyz")
    head += f"element face {len(faces)}\nproperty list uchar int vertex_indices\nend_header\n"
    with open(path, "w") as file:
        file.write(head)
        file.writelines("{:.9g} {:.9g} {:.9g}\n".format(*point) for point in points)
        file.writelines(f"{len(face)} " + " ".join(map(str, face)) + "\n" for face in faces)


def world(scene, folder):
    keys = sky(scene, folder)
    visibility = getattr(scene.world, "cycles_visibility", None)
    if scene.render.film_transparent or not getattr(visibility, "camera", True):
        keys["visible"] = False
    return table("[[light]]", grouped(scene.world, keys))


def sky(scene, folder):
    none = {"type": "environment", "radiance": [0, 0, 0]}
    if scene.world is None:
        return none
    tree = scene.world.node_tree
    out = output(tree, "OUTPUT_WORLD") if tree else None
    if out and out.inputs["Volume"].is_linked:
        warn("the volume of the world is left out")
    node = source(out.inputs["Surface"]) if out else None
    if node is None:
        return none
    if node.type != "BACKGROUND":
        warn(f"the world is a {node.bl_label}: it is left out")
        return none
    strength = node.inputs["Strength"].default_value
    image = source(node.inputs["Color"])
    if image is None:
        color = [c * strength for c in node.inputs["Color"].default_value[:3]]
        return {"type": "environment", "radiance": color}
    if image.type != "TEX_ENVIRONMENT" or image.image is None or image.projection != "EQUIRECTANGULAR":
        warn(f"the colour of the world is a {image.bl_label}: it is left out")
        return none
    keys = {"type": "environment", "image": sky_file(image.image, folder), "radiance": [strength] * 3}
    # The middle of Blender's image is +x, of ours +z.
    keys["rotate_deg"] = (90 - turn_of(image) + 180) % 360 - 180
    return keys


def turn_of(image):
    mapping = source(image.inputs["Vector"])
    if mapping is None or mapping.type == "TEX_COORD":
        return 0.0
    if mapping.type != "MAPPING":
        warn(f"the world is placed by a {mapping.bl_label}: it is left out")
        return 0.0
    turn = mapping.inputs["Rotation"].default_value
    if abs(turn[0]) + abs(turn[1]) > 1e-6:
        warn("the world is turned about x or y: that is left out")
    return math.degrees(turn[2])


def sky_file(image, folder):
    path = bpy.path.abspath(image.filepath)
    kind = os.path.splitext(path)[1].lower()
    if kind in (".exr", ".hdr") and os.path.exists(path):
        return copied(path, folder, "sky" + kind)
    # In Blender's memory, or of another format.
    width, height = image.size
    texels = np.empty(width * height * 4, np.float32)
    image.pixels.foreach_get(texels)
    if not image.is_float and image.colorspace_settings.name == "sRGB":
        color = texels.reshape(-1, 4)[:, :3]
        color[:] = np.where(color <= 0.04045, color / 12.92, ((color + 0.055) / 1.055) ** 2.4)
    copy = bpy.data.images.new("sky", width, height, float_buffer=True, is_data=True)
    copy.pixels.foreach_set(texels)
    copy.filepath_raw, copy.file_format = os.path.join(folder, "sky.exr"), "OPEN_EXR"
    copy.save()
    bpy.data.images.remove(copy)
    return "sky.exr"


# -------------------------------------------------------------------------------------------------------- scene


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


def visible(scene):
    layer = bpy.context.view_layer
    return [obj for obj in layer.objects if not obj.hide_render and obj.visible_get(view_layer=layer)]


def meshes(folder, name, known, left_out):
    """Writes the meshes but for some; the file that has them, an earlier one if it is the same."""
    path = os.path.join(folder, name)
    for obj in left_out:
        obj.hide_render = True
    bpy.ops.export_scene.gltf(
        filepath=path, export_format="GLB", use_renderable=True, export_cameras=False, export_lights=False,
        export_animations=False, export_current_frame=True, export_apply=True, export_yup=True,
    )
    for obj in left_out:
        obj.hide_render = False
    with open(path, "rb") as file:
        digest = hashlib.sha256(file.read()).hexdigest()
    if known.setdefault(digest, name) != name:
        os.remove(path)
    return known[digest]


def mesh_part(obj):
    """What objects of one file have in common: their light group, and whether cameras do not see them."""
    return grouped(obj, {}).get("group", ""), not obj.visible_camera


def export(folder, name, known):
    scene = bpy.context.scene
    render = scene.render
    side = lambda n: max(1, int(n * render.resolution_percentage / 100))  # noqa: E731
    film = {"width": side(render.resolution_x), "height": side(render.resolution_y)}
    film["exposure"] = 2.0 ** scene.view_settings.exposure
    out = f"name = {text(name)}\n" + table("[film]", film)
    objects = visible(scene)
    cameras = [obj for obj in scene.objects if obj.type == "CAMERA"]
    cameras.sort(key=lambda obj: (obj != scene.camera, obj.name))
    out += "".join(camera(scene, obj) for obj in cameras)
    solid = [obj for obj in objects if obj.type in ("MESH", "CURVE", "SURFACE", "META", "FONT")]
    filled = {obj: blender_media.filling(obj) for obj in solid}
    filled = {obj: material for obj, material in filled.items() if material}
    solid = [obj for obj in solid if obj not in filled]
    for part in sorted({mesh_part(obj) for obj in solid}):
        group, is_unseen = part
        file = name + (f".{group}" if group else "") + (".unseen" if is_unseen else "") + ".glb"
        others = [obj for obj in solid if mesh_part(obj) != part] + list(filled)
        keys = {"file": meshes(folder, file, known, others)}
        keys |= {"visible": False} if is_unseen else {}
        out += table("[[mesh]]", keys | ({"group": group} if group else {}))
    out += world(scene, folder)
    out += "".join(light(obj, folder) for obj in objects if obj.type == "LIGHT")
    place = lambda obj: Y_UP @ obj.matrix_world  # noqa: E731
    out += "".join(blender_media.volume(obj, folder, place(obj)) for obj in objects if obj.type == "VOLUME")
    out += "".join(blender_media.box(obj, material, folder, place(obj)) for obj, material in filled.items())
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
