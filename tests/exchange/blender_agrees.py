#!/usr/bin/env python3
"""What tools/blender_export.py makes of scenes, held to Cycles: blender_agrees.py LVOX OUT VDB
makes scenes with lights of each kind, exports them, renders them by Cycles and by `lvox reference`, and compares means of
blocks. VDB is ../shared/data/smoke.vdb; where it is not there, smoke is left out. Needs a Python that has bpy. Ends with: N passed, N failed."""
import math
import os
import subprocess
import sys

import bpy
import numpy as np

lvox, out, vdb = sys.argv[1], sys.argv[2], sys.argv[3]
here = os.path.dirname(os.path.abspath(__file__))
sys.path.insert(0, os.path.join(here, "../acceptance/references"))
import exr  # noqa: E402

# What bpy brings lies where only Blender itself searches.
sys.path.append(
    os.path.join(bpy.utils.resource_path("LOCAL"), "python/lib/python%d.%d/site-packages" % sys.version_info[:2])
)
try:
    import openvdb  # noqa: E402
except ImportError:
    openvdb = None

BLOCK, WIDTH, HEIGHT, SPP = 8, 64, 48, 256
# Bounces in media.
DEEP = 12


def material(name, kind, **inputs):
    made = bpy.data.materials.new(name)
    if made.node_tree is None:  # Before Blender 5.
        made.use_nodes = True
    tree = made.node_tree
    tree.nodes.clear()
    end, node = tree.nodes.new("ShaderNodeOutputMaterial"), tree.nodes.new(kind)
    for key, value in inputs.items():
        node.inputs[key.replace("_", " ")].default_value = value
    tree.links.new(node.outputs[0], end.inputs["Volume" if "Volume" in kind else "Surface"])
    return made


def stage():
    """A floor, a block and a ball, before a camera."""
    bpy.ops.wm.read_factory_settings(use_empty=True)
    scene = bpy.context.scene
    scene.render.resolution_x, scene.render.resolution_y = WIDTH, HEIGHT
    for add, place, size, color in [
        (bpy.ops.mesh.primitive_plane_add, (0, 0, 0), 8, (0.6, 0.6, 0.5, 1)),
        (bpy.ops.mesh.primitive_cube_add, (-0.8, 0.6, 0.5), 1, (0.7, 0.2, 0.1, 1)),
        (bpy.ops.mesh.primitive_ico_sphere_add, (0.8, -0.2, 0.5), None, (0.2, 0.4, 0.8, 1)),
    ]:
        add(location=place, **({"size": size} if size else {"radius": 0.5, "subdivisions": 4}))
        made = material("m", "ShaderNodeBsdfDiffuse", Color=color)
        bpy.context.object.data.materials.append(made)
    view = bpy.data.objects.new("view", bpy.data.cameras.new("view"))
    view.location, view.rotation_euler = (0.5, -5.5, 2.4), (math.radians(72), 0, math.radians(5))
    view.data.angle = math.radians(50)
    scene.collection.objects.link(view)
    scene.camera = view
    scene.world = bpy.data.worlds.new("world")
    sky = background()
    sky.inputs["Color"].default_value = (0, 0, 0, 1)
    return scene


def background():
    world = bpy.context.scene.world
    if world.node_tree is None:
        world.use_nodes = True
    return world.node_tree.nodes["Background"]


def lamp(kind, energy, place=(0, 0, 4), turn=(0.3, 0.2, 0), seen=True, **more):
    data = bpy.data.lights.new(kind, kind)
    data.energy, data.color = energy, (1, 0.8, 0.6)
    for key, value in more.items():
        setattr(data, key, value)
    made = bpy.data.objects.new(kind, data)
    made.location, made.rotation_euler, made.visible_camera = place, turn, seen
    bpy.context.scene.collection.objects.link(made)


def sky_image():
    image = bpy.data.images.new("sky", 128, 64, float_buffer=True)
    v, u = np.mgrid[0:64, 0:128]
    texels = np.stack([0.2 + 0.8 * (u < 40), 0.3 + 0.01 * v, 0.2 + 0.7 * (u > 80), np.ones_like(u)], -1)
    image.pixels.foreach_set(texels.astype(np.float32).ravel())
    image.pack()
    tree = bpy.context.scene.world.node_tree
    node, place = tree.nodes.new("ShaderNodeTexEnvironment"), tree.nodes.new("ShaderNodeMapping")
    coordinates = tree.nodes.new("ShaderNodeTexCoord")
    node.image = image
    place.inputs["Rotation"].default_value = (0, 0, math.radians(50))
    tree.links.new(coordinates.outputs["Generated"], place.inputs["Vector"])
    tree.links.new(place.outputs["Vector"], node.inputs["Vector"])
    tree.links.new(node.outputs["Color"], background().inputs["Color"])
    background().inputs["Strength"].default_value = 0.7


def glow():
    """A plane that emits, and a plain sky."""
    background().inputs["Color"].default_value = (0.1, 0.15, 0.2, 1)
    bpy.ops.mesh.primitive_plane_add(size=1, location=(1.5, 1, 1.5), rotation=(0, math.radians(-60), 0))
    made = material("glow", "ShaderNodeEmission", Color=(1, 0.5, 0.2, 1), Strength=6)
    bpy.context.object.data.materials.append(made)


def keyed(owner, name, *values):
    """A value that changes from frame 1 to frame 9."""
    for frame, value in zip((1, 9), values):
        setattr(owner, name, value)
        owner.keyframe_insert(name, frame=frame)


def moving():
    """A plane that moves and emits, a lamp and a camera that change, at frame 9."""
    glow()
    plane = bpy.context.object
    keyed(plane, "location", (-1.5, 1, 0.8), (1.5, 0.4, 1.2))
    emission = plane.data.materials[0].node_tree.nodes["Emission"]
    keyed(emission.inputs["Strength"], "default_value", 0, 6)
    lamp("SUN", 0)
    keyed(bpy.data.objects["SUN"].data, "energy", 0, 1.5)
    keyed(bpy.context.scene.camera, "location", (2, -5.5, 2.4), (0.5, -5.5, 2.4))
    bpy.context.scene.frame_set(9)


def instances():
    """A block and a lamp of a collection, cubes that geometry nodes and particles place, and metaballs."""
    scene, group = bpy.context.scene, bpy.data.collections.new("group")
    background().inputs["Color"].default_value = (0.2, 0.25, 0.3, 1)
    lamp("POINT", 30, place=(0, -0.5, 0.8), shadow_soft_size=0)
    parts = [scene.objects["POINT"]]
    for made, color in (("block", (0.2, 0.6, 0.3, 1)), ("grain", (0.8, 0.3, 0.2, 1))):
        bpy.ops.mesh.primitive_cube_add(size=0.3, location=(0, 0, 0.15))
        bpy.context.object.data.materials.append(material(made, "ShaderNodeBsdfDiffuse", Color=color))
        parts.append(bpy.context.object)
    for part in parts[:2]:
        scene.collection.objects.unlink(part)
        group.objects.link(part)
    # What is turned and then stretched is sheared.
    parts[1].rotation_euler.z, parts[2].location.z = 0.5, -9
    for x, stretch in ((-1.6, (1, 1, 2)), (0.1, (2, 1, 1)), (1.8, (-1, 1, 1))):
        made = bpy.data.objects.new("copy", None)
        made.instance_type, made.instance_collection = "COLLECTION", group
        made.location, made.rotation_euler, made.scale = (x, -1.2, 0), (0, 0, x), stretch
        scene.collection.objects.link(made)
    bpy.ops.mesh.primitive_grid_add(x_subdivisions=2, y_subdivisions=2, size=1.5, location=(-2, 1.6, 0.6))
    bpy.context.object.modifiers.new("points", "NODES").node_group = on_points(parts[2])
    bpy.ops.mesh.primitive_plane_add(size=1.5, location=(2, 1.6, 0.6))
    bpy.context.object.modifiers.new("grains", "PARTICLE_SYSTEM")
    grains = bpy.context.object.particle_systems[0].settings
    grains.type, grains.count, grains.render_type, grains.instance_object = "HAIR", 9, "OBJECT", parts[2]
    grains.use_advanced_hair, grains.particle_size = True, 0.7
    bpy.ops.object.metaball_add(radius=0.5, location=(0, 1.8, 0.5))


def on_points(what):
    """Nodes that put an object on each point of a mesh, in its place."""
    tree = bpy.data.node_groups.new("points", "GeometryNodeTree")
    for way in ("INPUT", "OUTPUT"):
        tree.interface.new_socket("Geometry", in_out=way, socket_type="NodeSocketGeometry")
    kinds = ("NodeGroupInput", "GeometryNodeInstanceOnPoints", "GeometryNodeObjectInfo", "NodeGroupOutput")
    mesh, copies, info, end = [tree.nodes.new(kind) for kind in kinds]
    info.inputs["Object"].default_value, info.inputs["As Instance"].default_value = what, True
    tree.links.new(mesh.outputs[0], copies.inputs["Points"])
    tree.links.new(info.outputs["Geometry"], copies.inputs["Instance"])
    tree.links.new(copies.outputs[0], end.inputs[0])
    return tree


def as_rendered():
    """What the viewport shows otherwise: what is hidden there, or only in renders, and modifiers."""
    scene, off = bpy.context.scene, bpy.data.collections.new("off")
    background().inputs["Color"].default_value = (0.2, 0.25, 0.3, 1)
    lamp("SUN", 3)
    ball = scene.objects["Icosphere"]
    smooth = ball.modifiers.new("smooth", "SUBSURF")
    smooth.levels, smooth.render_levels = 0, 1
    block = scene.objects["Cube"]
    row = block.modifiers.new("row", "ARRAY")
    row.count, row.relative_offset_displace, row.show_viewport = 2, (0, 0, 1.1), False
    for hidden in (block, scene.objects["SUN"]):
        hidden.hide_set(True)
    scene.collection.children.link(off)
    lamp("POINT", 500, shadow_soft_size=0)
    bpy.ops.mesh.primitive_cube_add(location=(0, -1, 0.5))
    for made in (scene.objects["POINT"], bpy.context.object):
        scene.collection.objects.unlink(made)
        off.objects.link(made)
    off.hide_render = True


def fed_by(look, key, kind, value):
    """A node of one value before a socket of a material's first node but the output."""
    made = look.node_tree.nodes.new(kind)
    made.outputs[0].default_value = value
    look.node_tree.links.new(made.outputs[0], look.node_tree.nodes[1].inputs[key])
    return look


def joined(look, kind, second, share=None):
    """A material's first node with another, added or mixed, where the share is that of the first."""
    tree = look.node_tree
    both, other, end = tree.nodes.new(kind), tree.nodes.new(second), tree.nodes[0]
    tree.links.new(tree.nodes[1].outputs[0], both.inputs[-1])
    tree.links.new(other.outputs[0], both.inputs[-2])
    tree.links.new(both.outputs[0], end.inputs["Surface"])
    if share is not None:
        both.inputs[0].default_value = share
    return other


def mixtures():
    """Diffuse and emission, what is there in part, and values and colours of nodes, of the world, too."""
    tree = background().id_data
    for key, kind, value in (("Color", "ShaderNodeRGB", (0.1, 0.2, 0.3, 1)), ("Strength", "ShaderNodeValue", 1.5)):
        made = tree.nodes.new(kind)
        made.outputs[0].default_value = value
        tree.links.new(made.outputs[0], background().inputs[key])
    red = {"Color": (0.8, 0.2, 0.1, 1)}
    part = material("part", "ShaderNodeBsdfDiffuse", **red)
    joined(part, "ShaderNodeMixShader", "ShaderNodeBsdfTransparent", 0.4)
    both = material("both", "ShaderNodeBsdfDiffuse", **red)
    joined(both, "ShaderNodeAddShader", "ShaderNodeEmission").inputs["Strength"].default_value = 0.7
    lit = fed_by(material("lit", "ShaderNodeEmission", **red), "Strength", "ShaderNodeValue", 3)
    blue = fed_by(material("blue", "ShaderNodeBsdfDiffuse", **red), "Color", "ShaderNodeRGB", (0.1, 0.2, 0.8, 1))
    for i, look in enumerate((part, both, lit, blue)):
        bpy.ops.mesh.primitive_plane_add(size=0.9, location=(i - 1.4, -1.5, 0.6), rotation=(1.2, 0, 0.2))
        bpy.context.object.data.materials.append(look)


def unseen():
    """Lamps and a plane in the picture, and a world, none of which the camera sees."""
    towards = (math.radians(-90), 0, 0)
    lamp("AREA", 60, place=(0.3, -1, 1.6), turn=towards, seen=False, shape="RECTANGLE", size=0.8, size_y=0.6)
    lamp("POINT", 60, place=(-0.4, -1, 1.7), seen=False, shadow_soft_size=0.2)
    bpy.ops.mesh.primitive_plane_add(size=0.7, location=(1, -1.5, 0.8), rotation=(math.radians(90), 0, 0))
    bpy.context.object.data.materials.append(material("m", "ShaderNodeBsdfDiffuse", Color=(0.8, 0.1, 0.1, 1)))
    bpy.context.object.visible_camera = False
    background().inputs["Color"].default_value = (0.2, 0.25, 0.3, 1)
    bpy.context.scene.world.cycles_visibility.camera = False


def smoke():
    """Smoke from a VDB file, turned and scaled."""
    lamp("SUN", 3, angle=0.0)
    background().inputs["Color"].default_value = (0.2, 0.2, 0.25, 1)
    cloud(Density=12.0, Anisotropy=0.3)


def fire():
    """The same, as bright as it is dense and without other light."""
    node = cloud(Density=4.0, Emission_Color=(1, 0.4, 0.1, 1))
    tree = node.id_data
    grid, times = tree.nodes.new("ShaderNodeAttribute"), tree.nodes.new("ShaderNodeMath")
    grid.attribute_name, times.operation = "density", "MULTIPLY"
    times.inputs[1].default_value = 3.0
    tree.links.new(grid.outputs["Fac"], times.inputs[0])
    tree.links.new(times.outputs[0], node.inputs["Emission Strength"])


def cloud(**more):
    bpy.ops.object.volume_import(filepath=vdb, location=(0.1, -1.2, 1.0))
    made = bpy.context.object
    made.scale, made.rotation_euler = (0.015, 0.015, 0.015), (math.radians(90), 0, 0.5)
    made.data.render.space = "WORLD"
    kind = {"Color": (0.9, 0.7, 0.5, 1), **more}
    look = material("smoke", "ShaderNodeVolumePrincipled", **kind)
    made.data.materials.append(look)
    return next(node for node in look.node_tree.nodes if node.type == "PRINCIPLED_VOLUME")


def booth(size=(1.6, 1.2, 1.4), turn=0.3):
    """A box between a lamp and a camera in the dark, and a white plane far behind, for a medium to dim."""
    scene = bpy.context.scene
    for made in [made for made in scene.objects if made.type == "MESH"]:
        bpy.data.objects.remove(made)
    scene.camera.location, scene.camera.rotation_euler = (0, -5, 0), (math.radians(90), 0, 0)
    scene.camera.data.angle = math.radians(28)
    lamp("AREA", 150, place=(-2, -3, 2), turn=(math.radians(60), 0, math.radians(-35)), seen=False, size=0.5)
    bpy.context.scene.objects["AREA"].data.color = (1, 1, 1)
    bpy.ops.mesh.primitive_plane_add(size=3, location=(1.2, 20, 0), rotation=(math.radians(90), 0, 0))
    bpy.context.object.data.materials.append(material("white", "ShaderNodeEmission", Color=(1, 1, 1, 1), Strength=1))
    bpy.ops.mesh.primitive_cube_add(size=1, rotation=(0, 0, turn))
    bpy.context.object.scale = size
    return bpy.context.object


TINT = (0.8, 0.4, 0.2, 1)
SCATTER = ("ShaderNodeVolumeScatter", {"Color": TINT, "Density": 1.2, "Anisotropy": 0.3})
ABSORPTION = ("ShaderNodeVolumeAbsorption", {"Color": TINT, "Density": 0.8})
PRINCIPLED = ("ShaderNodeVolumePrincipled", {"Color": TINT, "Density": 1.5})


def box_of(*nodes, join="ShaderNodeAddShader", **more):
    """The box filled with a node, or with two that are joined."""
    kind, inputs = nodes[0]
    look = material("medium", kind, **{key.replace(" ", "_"): value for key, value in (inputs | more).items()})
    if len(nodes) > 1:
        tree = look.node_tree
        both, second = tree.nodes.new(join), tree.nodes.new(nodes[1][0])
        for key, value in nodes[1][1].items():
            second.inputs[key].default_value = value
        if join == "ShaderNodeMixShader":
            both.inputs[0].default_value = 0.3
        end = next(node for node in tree.nodes if node.type == "OUTPUT_MATERIAL")
        tree.links.new(end.inputs["Volume"].links[0].from_socket, both.inputs[-2])
        tree.links.new(second.outputs[0], both.inputs[-1])
        tree.links.new(both.outputs[0], end.inputs["Volume"])
    booth().data.materials.append(look)


def puff(tinted):
    """A ball of a .vdb, scaled unevenly as objects are by default, that scatters; or whose colour is a grid."""
    n = 32
    p = (np.indices((n, n, n)) + 0.5) / n * 2 - 1
    depth = np.clip((1 - np.sqrt((p**2).sum(0))) * 3, 0, 1).astype(np.float32)
    density, colors = openvdb.FloatGrid(), openvdb.Vec3SGrid()
    density.name, colors.name = "density", "Cd"
    density.copyFromArray(depth, ijk=(-n // 2,) * 3)
    red = 0.3 + 0.5 * p[0] / (1 + np.abs(p[0]))
    colors.copyFromArray(np.stack([red, 0.5 + 0 * red, 1 - red], -1).astype(np.float32), ijk=(-n // 2,) * 3)
    for grid in (density, colors):
        grid.transform = openvdb.createLinearTransform(voxelSize=1.6 / n)
    path = os.path.join(out, "puff.vdb")
    openvdb.write(path, grids=[density, colors])
    bpy.data.objects.remove(booth())
    bpy.ops.object.volume_import(filepath=path)
    made = bpy.context.object
    made.scale, made.rotation_euler = (1.3, 0.7, 0.8), (0.2, 0.3, 0.4)
    if tinted:
        look = material("puff", "ShaderNodeVolumePrincipled", Density=3.0, Color_Attribute="Cd", Color=(1, 1, 1, 1))
    else:
        look = material("puff", "ShaderNodeVolumeScatter", Color=TINT)
        tree, grid = look.node_tree, look.node_tree.nodes.new("ShaderNodeAttribute")
        times, scatter = tree.nodes.new("ShaderNodeMath"), tree.nodes[1]
        grid.attribute_name, times.operation, times.inputs[1].default_value = "density", "MULTIPLY", 3.0
        tree.links.new(grid.outputs["Fac"], times.inputs[0])
        tree.links.new(times.outputs[0], scatter.inputs["Density"])
    made.data.materials.append(look)


def namesakes():
    """Two balls of fog, of files that are named alike."""
    bpy.data.objects.remove(booth())
    away = np.sqrt((((np.indices((24, 24, 24)) + 0.5) / 12 - 1) ** 2).sum(0))
    ball = np.clip((1 - away) * 3, 0, 1).astype(np.float32)
    for folder, place, depth in (("here", -1.1, 0.4), ("there", 0.3, 1.0)):
        grid = openvdb.FloatGrid()
        grid.name, grid.transform = "density", openvdb.createLinearTransform(voxelSize=0.04)
        grid.copyFromArray(depth * ball)
        path = os.path.join(out, folder, "fog.vdb")
        os.makedirs(os.path.dirname(path), exist_ok=True)
        openvdb.write(path, grids=[grid])
        bpy.ops.object.volume_import(filepath=path, location=(place, 0, -0.5))
        bpy.context.object.data.materials.append(material("fog", "ShaderNodeVolumePrincipled", Density=3.0))


def cycles(path, bounces):
    scene = bpy.context.scene
    scene.render.engine = "CYCLES"
    engine = scene.cycles
    engine.device, engine.samples, engine.use_denoising, engine.use_adaptive_sampling = "CPU", SPP, False, False
    for key in ("max_bounces", "diffuse_bounces", "glossy_bounces", "transmission_bounces", "volume_bounces"):
        setattr(engine, key, bounces)
    engine.pixel_filter_type = "BOX"
    engine.filter_width = 1.0
    engine.sample_clamp_direct = engine.sample_clamp_indirect = 0
    engine.light_sampling_threshold = 0
    if hasattr(engine, "volume_biased"):
        engine.volume_biased = False
    image = scene.render.image_settings
    image.file_format, image.color_depth = "OPEN_EXR", "32"
    image.exr_codec = "NONE"
    scene.view_settings.view_transform = "Raw" if "Raw" in views() else "Standard"
    scene.render.filepath = path
    bpy.ops.render.render(write_still=True)
    return picture(path)


def views():
    kinds = bpy.types.ColorManagedViewSettings.bl_rna.properties["view_transform"].enum_items
    return [kind.identifier for kind in kinds]


def picture(path):
    rows = exr.read(path)[1]
    return np.stack([np.array(rows[c], np.float64) for c in "RGB"], -1)


def blocks(image):
    h, w = (n // BLOCK for n in image.shape[:2])
    return image[: h * BLOCK, : w * BLOCK].reshape(h, BLOCK, w, BLOCK, 3).mean((1, 3))


def export(blend, folder, *more):
    script = os.path.join(here, "../../tools/blender_export.py")
    words = [sys.executable, script, blend, "-o", folder, *more]
    done = subprocess.run(words, stdout=subprocess.DEVNULL, stderr=subprocess.PIPE, text=True)
    if done.returncode:
        sys.exit(done.stderr)
    return done.stderr


def compared(name, make, limit, bounces=1):
    stage()
    make()
    blend = os.path.join(out, name + ".blend")
    bpy.ops.wm.save_as_mainfile(filepath=blend)
    theirs = blocks(cycles(os.path.join(out, name + "-cycles.exr"), bounces))
    folder, image = os.path.join(out, name), os.path.join(out, name + "-lvox.exr")
    export(blend, folder)
    words = ["reference", os.path.join(folder, name + ".toml"), "-o", image, "--spp", str(SPP)]
    words += ["--max-depth", str(bounces + 2)]
    subprocess.run([lvox, *words, "--force", "--progress", "none"], check=True)
    mine = blocks(picture(image))
    scale = np.maximum(theirs, theirs.mean())
    apart = np.sqrt(np.mean(((mine - theirs) / scale) ** 2))
    mean = mine.mean((0, 1)) / theirs.mean((0, 1)) - 1
    is_near = apart < limit and np.abs(mean).max() < 0.02
    told = "" if is_near else "FAILED: "
    means = " ".join(f"{channel:+.4f}" for channel in mean)
    print(f"{told}{name}: blocks differ by {apart:.4f}, means by {means}", flush=True)
    return is_near


def frames():
    """A camera and a light that move, meshes that do not: one file of meshes for both frames."""
    scene = stage()
    lamp("SUN", 3)
    for frame in (1, 3):
        scene.camera.location.x = frame
        scene.camera.keyframe_insert("location", frame=frame)
    blend, folder = os.path.join(out, "move.blend"), os.path.join(out, "move")
    bpy.ops.wm.save_as_mainfile(filepath=blend)
    export(blend, folder, "--frames", "1-3x2")
    files = sorted(os.listdir(folder))
    words = ["inspect", os.path.join(folder, "move.####.toml"), "--frames", "1-3x2"]
    done = subprocess.run([lvox, *words], capture_output=True, text=True)
    is_right = files == ["move.0001.glb", "move.0001.toml", "move.0003.toml"] and done.returncode == 0
    print(f"{'' if is_right else 'FAILED: '}frames: {', '.join(files)}", done.stderr)
    return is_right


def later():
    """What is emitted at a frame is the same whether frames were exported before or not."""
    stage()
    moving()
    blend = os.path.join(out, "later.blend")
    bpy.ops.wm.save_as_mainfile(filepath=blend)
    whole, alone = os.path.join(out, "later"), os.path.join(out, "later-alone")
    export(blend, whole, "--frames", "1-9x8")
    export(blend, alone)
    first, ninth, single = (
        open(os.path.join(folder, name), "rb").read()
        for folder, name in ((whole, "later.0001.glb"), (whole, "later.0009.glb"), (alone, "later.glb"))
    )
    is_right = ninth == single and first != single
    print(f"{'' if is_right else 'FAILED: '}later: {len(single)} bytes of meshes")
    return is_right


def told():
    """What an export leaves out has a line each that names it."""
    scene = stage()
    scene.render.pixel_aspect_x, scene.cycles.film_exposure, scene.view_settings.exposure = 2, 3, 1
    scene.render.use_border = True
    lamp("POINT", 30, shadow_soft_size=0, use_shadow=False)
    names = ("Cube", "Icosphere", "Plane")
    block, ball, floor = (scene.objects[name] for name in names)
    block.is_holdout, ball.visible_shadow = True, False
    floor.modifiers.new("fur", "PARTICLE_SYSTEM")
    floor.particle_systems[0].settings.type = "HAIR"
    look = material("wood", "ShaderNodeBsdfDiffuse")
    noise, change = look.node_tree.nodes.new("ShaderNodeTexNoise"), look.node_tree.nodes.new("ShaderNodeHueSaturation")
    look.node_tree.links.new(noise.outputs["Color"], change.inputs["Color"])
    look.node_tree.links.new(change.outputs[0], look.node_tree.nodes[1].inputs["Color"])
    floor.data.materials[0] = look
    ball.data.materials[0] = material("silk", "ShaderNodeBsdfSheen", Color=(0.3, 0.4, 0.5, 1))
    blend, folder = os.path.join(out, "told.blend"), os.path.join(out, "told")
    bpy.ops.wm.save_as_mainfile(filepath=blend)
    lines = export(blend, folder).splitlines()
    wanted = ["object Cube: it is drawn", "object Icosphere: it meets shadows", "light POINT: it casts shadows"]
    wanted += ["pixels that are not square", "object Plane: the hair of", "material wood: the Hue/Saturation"]
    wanted += ["material wood: the Noise Texture", "material silk: Sheen BSDF is taken as diffuse"]
    wanted += ["the render region is left out"]
    missing = [what for what in wanted if sum("warning: " + what in line for line in lines) != 1]
    with open(os.path.join(folder, "told.toml")) as file:
        missing += [] if "exposure = 6\n" in file.read() else ["exposure"]
    print(f"told: {len(wanted)} lines" if not missing else f"FAILED: told: not once: {', '.join(missing)}")
    return not missing


rows = [
    ("sun", lambda: lamp("SUN", 3, angle=math.radians(8)), 0.03),
    ("point", lambda: lamp("POINT", 400, shadow_soft_size=0.0), 0.03),
    ("spot", lambda: lamp("SPOT", 900, spot_size=1.0, spot_blend=0.4, shadow_soft_size=0.0), 0.03),
    ("area", lambda: lamp("AREA", 300, shape="RECTANGLE", size=1.5, size_y=0.8), 0.03),
    ("disk", lambda: lamp("AREA", 300, shape="DISK", size=1.5), 0.03),
    ("ball", lambda: lamp("POINT", 200, (0.4, -0.5, 2), shadow_soft_size=0.4, use_soft_falloff=False), 0.03),
    ("unseen", unseen, 0.03),
    ("glow", glow, 0.05),
    ("moving", moving, 0.05),
    ("instances", instances, 0.03),
    ("as_rendered", as_rendered, 0.03),
    ("mixtures", mixtures, 0.03),
    ("sky", sky_image, 0.03),
    ("smoke", smoke, 0.05),
    ("fire", fire, 0.05),
    ("scatter", lambda: box_of(SCATTER), 0.05, DEEP),
    ("absorption", lambda: box_of(ABSORPTION), 0.03, DEEP),
    ("principled", lambda: box_of(PRINCIPLED), 0.05, DEEP),
    ("shadow", lambda: box_of(PRINCIPLED, Absorption_Color=(0.1, 0.5, 0.9, 1)), 0.05, DEEP),
    ("sum", lambda: box_of(SCATTER, ABSORPTION), 0.05, DEEP),
    ("two", lambda: box_of(SCATTER, PRINCIPLED), 0.05, DEEP),
    ("mix", lambda: box_of(SCATTER, ABSORPTION, join="ShaderNodeMixShader"), 0.05, DEEP),
    ("puff", lambda: puff(False), 0.05, DEEP),
    ("tinted", lambda: puff(True), 0.05, DEEP),
    ("namesakes", namesakes, 0.05, DEEP),
]
if not os.path.exists(vdb):
    print("SKIPPED: tests/exchange/run.sh: smoke of Blender needs ../shared/data/smoke.vdb")
    rows = [row for row in rows if row[0] not in ("smoke", "fire")]
if openvdb is None:
    print("SKIPPED: tests/exchange/run.sh: volumes of Blender need a bpy that has openvdb")
    rows = [row for row in rows if row[0] not in ("puff", "tinted", "namesakes")]
wanted = sys.argv[4:]
results = [compared(*row) for row in rows if not wanted or row[0] in wanted]
if not wanted or "frames" in wanted:
    results.append(frames())
if not wanted or "later" in wanted:
    results.append(later())
if not wanted or "told" in wanted:
    results.append(told())
print(f"\n{sum(results)} passed, {len(results) - sum(results)} failed")
sys.exit(not all(results))
