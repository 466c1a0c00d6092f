"""Lights of Blender, in lvox's units: lamps, and the world."""
import math
import os

import bpy
import numpy as np
from mathutils import Matrix, Vector

from blender_media import color, grouped, number, output, rows, source
from scene_text import copied, table, warn

# builtin:quad faces +y; area lights face -z.
FACING_DOWN = Matrix(((1, 0, 0, 0), (0, 0, 1, 0), (0, -1, 0, 0), (0, 0, 0, 1)))
DISK = "disk.ply"
BALL = "ball.ply"


def light(obj, to_world, folder):
    """The table of a lamp that stands at a place, with y up."""
    title, keys = light_keys(obj, to_world, folder)
    return table(title, grouped(obj, keys))


def light_keys(obj, to_world, folder):
    lamp = obj.data
    color = [c * lamp.energy * 2.0 ** getattr(lamp, "exposure", 0.0) for c in lamp.color]
    if getattr(lamp, "use_temperature", False):
        color = [c * t for c, t in zip(color, lamp.temperature_color)]
    if not getattr(lamp, "normalize", True):
        warn(f"light {obj.name}: its power is taken as of all its area")
    if not getattr(lamp, "use_shadow", True):
        warn(f"light {obj.name}: it casts shadows, though it is said to cast none")
    if getattr(lamp, "use_nodes", False) and lamp.node_tree and len(lamp.node_tree.nodes) > 2:
        warn(f"light {obj.name}: its nodes are left out")
    place = list(to_world.translation)
    ahead = list(-to_world.col[2].to_3d().normalized())
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
    found = number(node.inputs["Strength"])
    if found is None or found[1]:
        warn("the nodes of the strength of the world are left out")
        found = (node.inputs["Strength"].default_value, None)
    strength, even = found[0], color(node.inputs["Color"])
    if even and not even[1]:
        return {"type": "environment", "radiance": [c * strength for c in even[0]]}
    image = source(node.inputs["Color"])
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
    if image.source in ("SEQUENCE", "MOVIE"):
        warn("the image of the world changes from frame to frame: one is taken for all")
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
