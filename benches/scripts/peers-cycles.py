"""A scene as Cycles shows it: peers-cycles.py SCENE.toml SAMPLES OUTPUT.exr [--denoise] [--seed N]

Knows what tests/acceptance/scenes/general/fire.toml and tree.toml have: built-in and PLY meshes, opacity textures, a sun, a
sky of one colour, a flame and a plume; one bounce, as lvox with --bounces 1. Prints CPU seconds of the render call, without
loading. Needs a Python that has bpy (Blender 5.0.1)."""
import argparse
import math
import os
import struct
import sys
import time
import tomllib

import bpy
import numpy as np
from mathutils import Euler, Matrix, Vector

sys.path.append(
    os.path.join(bpy.utils.resource_path("LOCAL"), "python/lib/python%d.%d/site-packages" % sys.version_info[:2])
)
import openvdb  # noqa: E402

WIDTH_OF = {"c": "b", "uchar": "B", "uint8": "B", "ushort": "H", "uint16": "H", "int": "i", "uint": "I", "float": "f"}


# The built-in volumes, as src/scene/builtin has them.


def smooth(x):
    x = np.clip(x, 0, 1)
    return x * x * (3 - 2 * x)


def stack(*columns):
    return np.stack(np.broadcast_arrays(*columns), -1).astype(np.float64)


def noise(p):
    cell = np.floor(p)
    f = smooth(p - cell)
    cell = cell.astype(np.int32)

    def corner(number):
        h = np.full(p.shape[:-1], 0x9E3779B9, np.uint32)
        for axis in range(3):
            h ^= (cell[..., axis] + (number >> axis & 1)).astype(np.uint32)
            h = h * np.uint32(0x85EBCA6B)
            h ^= h >> np.uint32(15)
            h = h * np.uint32(0xC2B2AE35)
            h ^= h >> np.uint32(13)
        return h / 4294967295.0

    values = [corner(number) for number in range(8)]
    for axis in range(3):
        values = [a + (b - a) * f[..., axis] for a, b in zip(values[::2], values[1::2])]
    return values[0]


def turbulence(p):
    total, weight = 0, 0.5
    for _ in range(4):
        total = total + weight * noise(p)
        weight, p = weight / 2, p * 2.03 + 5.2
    return total / (1 - 2 * weight)


def plume(p):
    height = p[..., 1]
    wobble = stack(noise(stack(0.5, 2.5 * height, 7.3)) - 0.5, 0, noise(stack(9.1, 2.5 * height, 3.7)) - 0.5)
    warp = stack(*(noise(p * 3 + offset) - 0.5 for offset in (11, 23, 37)))
    q = p + 0.3 * np.minimum(0.15 + height, 1)[..., None] * warp + 0.35 * height[..., None] * wobble
    detail = turbulence(q * np.array([6, 5, 6.0]))
    from_axis = np.hypot(q[..., 0] - 0.5, q[..., 2] - 0.5)
    depth = 0.10 + 0.30 * height - from_axis + 0.45 * np.minimum(0.15 + height, 1) * (detail - 0.5)
    fade = smooth(height / 0.03) * smooth((1 - height) / 0.3)
    for x in (p[..., 0], p[..., 2]):
        fade = fade * smooth((x - 0.01) / 0.06) * smooth((0.99 - x) / 0.06)
    return smooth(depth / 0.14) * (0.45 + 0.55 * detail) * (1 - 0.4 * height) * fade


def flame(p):
    height = p[..., 1]
    stretched = p * np.array([4, 2.2, 4])
    warp = stack(turbulence(stretched + 3) - 0.5, 0, turbulence(stretched + 17) - 0.5)
    sway = stack(noise(stack(4.1, 2 * height, 1.3)) - 0.5, 0, noise(stack(2.7, 2 * height, 8.9)) - 0.5)
    q = p + warp * (0.06 + 0.5 * height)[..., None] + sway * (0.5 * height)[..., None]
    radius = 0.26 * np.sqrt(np.minimum(height / 0.12, 1)) * np.maximum(1 - height, 0)
    licks = turbulence(q * np.array([9, 4, 9.0]))
    depth = radius - np.hypot(q[..., 0] - 0.5, q[..., 2] - 0.5) + 0.3 * height * (licks - 0.5)
    hot = smooth(depth / 0.07) * smooth((1 - height) / 0.2) * smooth(height / 0.02)
    return hot * (0.75 + 0.25 * smooth(depth / 0.16)) * (1 - 0.25 * height)


BUILTIN_VOLUMES = {"builtin:plume": (plume, (96, 128, 96), "density"), "builtin:flame": (flame, (64, 128, 64), "temperature")}


def placed(table):
    turn = Euler([math.radians(v) for v in table.get("rotate_deg", (0, 0, 0))], "XYZ").to_matrix().to_4x4()
    return Matrix.Translation(table.get("translate", (0, 0, 0))) @ turn @ Matrix.Diagonal((*table.get("scale", (1, 1, 1)), 1))


def nodes_of(name):
    made = bpy.data.materials.new(name)
    made.use_nodes = True
    made.node_tree.nodes.clear()
    return made, made.node_tree, made.node_tree.nodes.new("ShaderNodeOutputMaterial")


def surface(table, folder):
    made, tree, end = nodes_of("surface")
    diffuse = tree.nodes.new("ShaderNodeBsdfDiffuse")
    diffuse.inputs["Color"].default_value = (*table.get("albedo", (1, 1, 1)), 1)
    tree.links.new(diffuse.outputs[0], end.inputs["Surface"])
    if "texture" in table:
        image = tree.nodes.new("ShaderNodeTexImage")
        image.image = bpy.data.images.load(os.path.join(folder, table["texture"]))
        tree.links.new(image.outputs["Color"], diffuse.inputs["Color"])
        over = tree.nodes.new("ShaderNodeMath")
        over.operation = "GREATER_THAN"
        over.inputs[1].default_value = table["opacity_cutoff"]
        clear, mix = tree.nodes.new("ShaderNodeBsdfTransparent"), tree.nodes.new("ShaderNodeMixShader")
        tree.links.new(image.outputs["Alpha"], over.inputs[0])
        for output, entry in zip((over.outputs[0], clear.outputs[0], diffuse.outputs[0]), mix.inputs):
            tree.links.new(output, entry)
        tree.links.new(mix.outputs[0], end.inputs["Surface"])
    return made


def from_ply(path):
    """A mesh of triangles, with texture coordinates where the file has them."""
    data = open(path, "rb").read()
    header, body = data.split(b"end_header\n", 1)
    lines = [line.split() for line in header.decode().splitlines()]
    counts = {line[1]: int(line[2]) for line in lines if line[0] == "element"}
    of_vertex = [(line[2], WIDTH_OF[line[1]]) for line in lines if line[0] == "property" and line[1] != "list"]
    vertices = np.frombuffer(body, np.dtype(of_vertex), counts["vertex"])
    at, faces = vertices.nbytes, []
    [index] = [WIDTH_OF[line[3]] for line in lines if line[:2] == ["property", "list"]]
    for _ in range(counts["face"]):
        n = body[at]
        faces.append(struct.unpack_from("<%d%s" % (n, index), body, at + 1))
        at += 1 + n * struct.calcsize(index)
    mesh = bpy.data.meshes.new("ply")
    mesh.from_pydata(np.stack([vertices[axis] for axis in "xyz"], -1).tolist(), [], faces)
    if "u" in vertices.dtype.names:
        uv = np.stack([vertices[c].astype(np.float32) for c in "uv"], -1)
        layer = mesh.uv_layers.new()
        layer.data.foreach_set("uv", uv[[i for face in faces for i in face]].ravel())
    made = bpy.data.objects.new("ply", mesh)
    bpy.context.collection.objects.link(made)
    return made


def add_mesh(table, folder):
    match table["file"]:
        case "builtin:cube":
            bpy.ops.mesh.primitive_cube_add(size=1)
        case "builtin:sphere":
            bpy.ops.mesh.primitive_uv_sphere_add(radius=0.5, segments=64, ring_count=32)
            bpy.context.object.data.shade_smooth()
        case "builtin:quad":
            bpy.ops.mesh.primitive_plane_add(size=1)
            bpy.context.object.data.transform(Matrix.Rotation(math.radians(-90), 4, "X"))
    is_builtin = table["file"].startswith("builtin:")
    made = bpy.context.object if is_builtin else from_ply(os.path.join(folder, table["file"]))
    made.matrix_world = placed(table)
    made.data.materials.append(surface(table, folder))
    if isinstance(table.get("normals"), dict):
        made.data.shade_smooth()
        made.data.set_sharp_from_angle(angle=math.radians(table["normals"]["crease_deg"]))


def add_volume(table, folder):
    density, dims, name = BUILTIN_VOLUMES[table["file"]]
    centers = np.meshgrid(*((np.arange(n) + 0.5) / n for n in dims), indexing="ij")
    grid = openvdb.FloatGrid()
    grid.copyFromArray(density(np.stack(centers, -1)).astype(np.float32))
    grid.name = name
    step = [s / n for s, n in zip(table["scale"], dims)]
    first = [t + s / 2 for t, s in zip(table["translate"], step)]
    rows = [[step[0], 0, 0, 0], [0, step[1], 0, 0], [0, 0, step[2], 0], [*first, 1]]
    grid.transform = openvdb.createLinearTransform(rows)
    path = os.path.join(folder, name + ".vdb")
    openvdb.write(path, grids=[grid])
    bpy.ops.object.volume_import(filepath=path)
    made = bpy.context.object
    made.matrix_world = Matrix.Identity(4)
    made.data.render.space = "WORLD"
    medium, tree, end = nodes_of(name)
    principled = tree.nodes.new("ShaderNodeVolumePrincipled")
    tree.links.new(principled.outputs[0], end.inputs["Volume"])
    principled.inputs["Density"].default_value = table["sigma_t_scale"]
    principled.inputs["Color"].default_value = (*table["albedo"], 1)
    if "emission" in table:
        for other in ("Density Attribute", "Temperature Attribute"):
            principled.inputs[other].default_value = ""
        share, kelvin = tree.nodes.new("ShaderNodeAttribute"), tree.nodes.new("ShaderNodeMath")
        share.attribute_name, kelvin.operation = name, "MULTIPLY"
        kelvin.inputs[1].default_value = table["emission"]["kelvin"]
        tree.links.new(share.outputs["Fac"], kelvin.inputs[0])
        tree.links.new(kelvin.outputs[0], principled.inputs["Temperature"])
        principled.inputs["Blackbody Intensity"].default_value = table["emission"]["scale"]
    made.data.materials.clear()
    made.data.materials.append(medium)


def add_light(table):
    if table["type"] == "environment":
        bpy.context.scene.world.use_nodes = True
        sky = bpy.context.scene.world.node_tree.nodes["Background"]
        sky.inputs["Color"].default_value, sky.inputs["Strength"].default_value = (*table["radiance"], 1), 1
        return
    sun = bpy.data.lights.new("sun", "SUN")
    sun.energy, sun.color = 1, table["irradiance"]
    sun.angle = math.radians(2 * table.get("angular_radius_deg", 0))
    made = bpy.data.objects.new("sun", sun)
    made.rotation_euler = Vector(table["direction"]).to_track_quat("-Z", "Y").to_euler()
    bpy.context.collection.objects.link(made)


def add_camera(table, film):
    scene = bpy.context.scene
    made = bpy.data.objects.new("camera", bpy.data.cameras.new("camera"))
    scene.collection.objects.link(made)
    scene.camera = made
    position = Vector(table["position"])
    back = (position - Vector(table["target"])).normalized()
    right = Vector((0, 1, 0)).cross(back).normalized()
    axes = Matrix((right, back.cross(right), back)).transposed().to_4x4()
    made.matrix_world = Matrix.Translation(position) @ axes
    made.data.sensor_fit, made.data.angle = "HORIZONTAL", math.radians(table["fov_x_deg"])
    render = scene.render
    render.resolution_x, render.resolution_y, render.resolution_percentage = film["width"], film["height"], 100


def settings(samples, seed, is_denoised):
    scene = bpy.context.scene
    scene.render.engine = "CYCLES"
    cycles = scene.cycles
    cycles.device, cycles.samples, cycles.seed = "CPU", samples, seed
    cycles.use_adaptive_sampling = False
    cycles.pixel_filter_type, cycles.filter_width = "BOX", 1
    for kind in ("max", "diffuse", "glossy", "transmission", "volume"):
        setattr(cycles, kind + "_bounces", 1)
    cycles.transparent_max_bounces = 1024
    cycles.sample_clamp_direct = cycles.sample_clamp_indirect = cycles.light_sampling_threshold = 0
    cycles.use_denoising = is_denoised
    if is_denoised:
        cycles.denoiser, cycles.denoising_input_passes = "OPENIMAGEDENOISE", "RGB_ALBEDO_NORMAL"
    image = scene.render.image_settings
    image.file_format, image.color_depth, image.exr_codec = "OPEN_EXR", "32", "NONE"
    scene.view_settings.view_transform = "Raw"


def main():
    arguments = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    arguments.add_argument("scene")
    arguments.add_argument("samples", type=int)
    arguments.add_argument("output")
    arguments.add_argument("--denoise", action="store_true")
    arguments.add_argument("--seed", type=int, default=0)
    given = arguments.parse_args()
    with open(given.scene, "rb") as file:
        scene = tomllib.load(file)
    bpy.ops.wm.read_factory_settings(use_empty=True)
    bpy.context.scene.world = bpy.data.worlds.new("world")
    folder, output = os.path.dirname(os.path.abspath(given.scene)), os.path.abspath(given.output)
    for table in scene["mesh"]:
        add_mesh(table, folder)
    for table in scene["light"]:
        add_light(table)
    for table in scene.get("volume", []):
        add_volume(table, os.path.dirname(output))
    add_camera(scene["camera"][0], scene["film"])
    settings(given.samples, given.seed, given.denoise)
    bpy.context.scene.render.filepath = output
    start = time.process_time()
    bpy.ops.render.render(write_still=True)
    print(f"cpu_s {time.process_time() - start:.2f}")


main()
