"""What a picture of a Blender scene shows, as Blender hands it to render engines.

Instances of collections, of geometry nodes and of particles stand in the world one by one, modifiers have the
settings of renders, and what is left out of renders is not there, whatever the viewport shows.
"""
import hashlib
import os
from contextlib import contextmanager
from dataclasses import dataclass

import bpy
from mathutils import Matrix

from blender_lights import light
from blender_media import Y_UP, box, filling, grouped, volume
from scene_text import table, warn

# What of Ray Visibility makes a difference here.
RAYS = {"shadow": "shadows", "diffuse": "diffuse rays", "volume_scatter": "rays in volumes"}


class Engine(bpy.types.RenderEngine):
    """Renders nothing, but hands on what it is to render."""

    bl_idname = "LVOX_EXPORT"
    bl_label = "Export for lvox"
    hand_on, failure = None, None

    def render(self, depsgraph):
        # Blender prints what is raised here, and goes on.
        try:
            Engine.hand_on(depsgraph)
        except Exception as error:
            Engine.failure = error


@contextmanager
def changed(*changes):
    """Properties of other values for a while: of an owner, by name."""
    before = [(owner, name, getattr(owner, name)) for owner, name, _ in changes]
    try:
        for owner, name, value in changes:
            setattr(owner, name, value)
        yield
    finally:
        for owner, name, value in reversed(before):
            setattr(owner, name, value)


def render(scene, hand_on):
    """Calls `hand_on` with the dependency graph of a picture of the view layer."""
    layer, kept = bpy.context.view_layer, scene.camera
    if sum(other.use for other in scene.view_layers) > 1:
        warn(f"of the view layers {layer.name} alone is exported")
    if layer.material_override:
        warn(f"the material override of the view layer {layer.name} is left out")
    changes = [(other, "use", other == layer) for other in scene.view_layers]
    changes += [(scene.render, "engine", Engine.bl_idname), (scene.render, "use_multiview", False)]
    changes += [(scene.render, "use_compositing", False), (scene.render, "use_sequencer", False)]
    changes += [(scene.render, "use_freestyle", False)] if hasattr(scene.render, "use_freestyle") else []
    Engine.hand_on, Engine.failure = hand_on, None
    bpy.utils.register_class(Engine)
    stand_in = None if kept else bpy.data.objects.new("camera", bpy.data.cameras.new("camera"))
    try:
        if stand_in:
            scene.collection.objects.link(stand_in)
            scene.camera = stand_in
        with changed(*changes):
            bpy.ops.render.render(scene=scene.name)
    finally:
        if stand_in:
            scene.camera = None
            bpy.data.cameras.remove(stand_in.data)
        bpy.utils.unregister_class(Engine)
    if Engine.failure:
        raise Engine.failure


@dataclass
class Solid:
    """A mesh at a place, and what has to be the same in a file: light group, whether cameras see it."""

    name: str
    mesh: bpy.types.Mesh
    place: Matrix
    group: str
    is_unseen: bool

    def part(self):
        return self.group, self.is_unseen


class Shown:
    """Tables of lamps and volumes, of cameras by name, and meshes."""

    def __init__(self, folder, camera):
        self.folder, self.camera = folder, camera
        self.cameras, self.solids, self.made = {}, [], {}
        self.lights = self.volumes = ""

    def take(self, depsgraph):
        cameras = [obj for obj in depsgraph.objects if obj.type == "CAMERA"]
        self.cameras = {obj.name: self.camera(obj) for obj in cameras}
        for instance in depsgraph.object_instances:
            obj, to_world = instance.object, instance.matrix_world.copy()
            if instance.show_particles:
                tell_hair(obj)
            if not instance.show_self:
                continue
            if obj.type == "LIGHT":
                tell_left_out(obj)
                self.lights += light(obj, Y_UP @ to_world, self.folder)
            elif obj.type == "VOLUME":
                tell_left_out(obj)
                self.volumes += volume(obj, self.folder, Y_UP @ to_world)
            elif obj.type == "MESH":
                tell_left_out(obj)
                self.take_mesh(instance, obj, to_world)
            elif obj.type in ("CURVES", "POINTCLOUD", "GREASEPENCIL"):
                warn(f"object {obj.name}: hair, points and strokes are left out")
            # Curves, texts, surfaces and metaballs come a second time, as meshes.

    def take_mesh(self, instance, obj, to_world):
        mesh = self.mesh(obj)
        if not mesh.polygons:
            return
        medium = filling(mesh.materials)
        if medium:
            self.volumes += box(obj.name, mesh, medium, self.folder, Y_UP @ to_world)
            return
        is_seen = obj.visible_camera and (instance.parent is None or instance.parent.visible_camera)
        self.solids.append(Solid(obj.name, mesh, to_world, grouped(obj, {}).get("group", ""), not is_seen))

    def mesh(self, obj):
        """A copy of what an object is after its modifiers, one for all instances that look alike."""
        slots = enumerate(obj.material_slots)
        own = {i: slot.material.original for i, slot in slots if slot.link == "OBJECT" and slot.material}
        key = (obj.data.as_pointer(), *((i, material.name) for i, material in own.items()))
        if key not in self.made:
            made = bpy.data.meshes.new_from_object(obj)
            if not made.materials:
                made.materials.append(None)
            for i, material in enumerate(made.materials):
                made.materials[i] = own.get(i, material) or bare()
            self.made[key] = made
        return self.made[key]

    def meshes(self, name, known):
        """The tables of the meshes, which are written as glTF; those of a `known` file share it."""
        out = ""
        for part in sorted({solid.part() for solid in self.solids}):
            group, is_unseen = part
            file = name + (f".{group}" if group else "") + (".unseen" if is_unseen else "") + ".glb"
            solids = [solid for solid in self.solids if solid.part() == part]
            keys = {"file": written(solids, self.folder, file, known)}
            keys |= {"visible": False} if is_unseen else {}
            out += table("[[mesh]]", keys | ({"group": group} if group else {}))
        bpy.data.batch_remove(list(self.made.values()))
        return out


def taken(scene, folder, camera):
    """What a picture of the scene shows at its frame; `camera` makes the table of a camera."""
    shown = Shown(folder, camera)
    render(scene, shown.take)
    return shown


def bare():
    """What meshes without a material look like."""
    name = "no material"
    found = bpy.data.materials.get(name)
    if found is None:
        found = bpy.data.materials.new(name)
        found.use_nodes = True
        found.node_tree.nodes["Principled BSDF"].inputs["Base Color"].default_value = (0.8, 0.8, 0.8, 1)
    return found


def tell_left_out(obj):
    for key, kind in (("is_holdout", "holdout"), ("is_shadow_catcher", "shadow catcher")):
        # All lamps are said to catch shadows.
        if obj.type != "LIGHT" and getattr(obj, key, False):
            warn(f"object {obj.name}: it is drawn, though it is a {kind}")
    linking = getattr(obj, "light_linking", None)
    if linking and (linking.receiver_collection or linking.blocker_collection):
        warn(f"object {obj.name}: its light linking is left out")
    for key, rays in RAYS.items():
        if not getattr(obj, "visible_" + key, True):
            warn(f"object {obj.name}: it meets {rays}, which its Ray Visibility leaves out")


def tell_hair(obj):
    for system in obj.particle_systems:
        if system.settings.type == "HAIR" and system.settings.render_type == "PATH":
            warn(f"object {obj.name}: the hair of {system.name} is left out")


def upright(solid):
    """The mesh and place of an object; where glTF's places, of turn and scale, do not have it, its mesh is moved."""
    plain = Matrix.LocRotScale(*solid.place.decompose())
    size = max(abs(c) for row in solid.place.to_3x3() for c in row)
    apart = max(abs(a - b) for p, q in zip(plain, solid.place) for a, b in zip(p, q))
    if apart <= 1e-5 * size or not size:
        return solid.mesh, solid.place, False
    mesh = solid.mesh.copy()
    mesh.transform(solid.place)
    if solid.place.determinant() < 0:
        mesh.flip_normals()
    return mesh, Matrix.Identity(4), True


def written(solids, folder, name, known):
    """Writes meshes; the file that has them, an earlier one if it is the same."""
    path = os.path.join(folder, name)
    window = bpy.context.window
    before, layer = window.scene, window.view_layer
    scene = bpy.data.scenes.new("lvox")
    # Or else materials become those of its first frame.
    scene.frame_set(before.frame_current, subframe=before.frame_subframe)
    made = [scene]
    for number, solid in enumerate(solids):
        mesh, place, is_own = upright(solid)
        obj = bpy.data.objects.new(f"{solid.name}.{number}", mesh)
        obj.matrix_world = place
        scene.collection.objects.link(obj)
        made += [obj, mesh] if is_own else [obj]
    try:
        window.scene = scene
        bpy.ops.export_scene.gltf(
            filepath=path, export_format="GLB", use_active_scene=True, export_cameras=False, export_lights=False,
            export_animations=False, export_current_frame=True, export_yup=True,
        )
    finally:
        window.scene, window.view_layer = before, layer
        bpy.data.batch_remove(made)
    with open(path, "rb") as file:
        digest = hashlib.sha256(file.read()).hexdigest()
    if known.setdefault(digest, name) != name:
        os.remove(path)
    return known[digest]
