#!/usr/bin/env python3
"""Exports a USD stage for lvox: meshes as PLY, all else as TOML, frame by frame. Needs `pip install usd-core`.

    python tools/usd_export.py file.usd -o folder [--frames 1-10x2] [--density 10]

Writes folder/NAME.toml, or with --frames NAME.0001.toml, ... for
`lvox render folder/NAME.####.toml --frames 1-10 -o out.####.exr`. Meshes that do not change share a file.

Taken are: meshes, cubes and spheres, with instances and point instancers, as they are in the world, with displayColor
or the diffuse and emissive colours and textures of UsdPreviewSurface; cameras with their depth of field; DistantLight,
DomeLight (of a colour or a lat-long image), RectLight, DiskLight and SphereLight, whose shapes emit and are seen by the
camera, or which with a cone are spots; meshes that are lights; OpenVDB fields of volumes, with --density as the
extinction where a value is 1. Polygons are cut by lvox; subdivision, curves, points and skinning are
left out, as all else that is told on stderr.
"""
import argparse
import hashlib
import math
import os
import struct
import sys

try:
    from pxr import Ar, Gf, Usd, UsdGeom, UsdLux, UsdRender, UsdShade, UsdVol
except ImportError:
    sys.exit("usd_export.py needs USD's Python module: pip install usd-core")
from scene_text import copied, frames_of, table, text, warn


def columns(matrix):
    """Rows for column vectors: USD has row vectors."""
    return [[matrix[j][i] for j in range(4)] for i in range(3)] + [[0, 0, 0, 1]]


class Export:
    def __init__(self, stage, folder, density):
        self.stage, self.folder, self.density = stage, folder, density
        self.known = {}
        turn = Gf.Rotation(Gf.Vec3d(1, 0, 0), -90 if UsdGeom.GetStageUpAxis(stage) == "Z" else 0)
        self.y_up = Gf.Matrix4d().SetRotate(turn)

    def write(self, name, time):
        self.time = time
        self.cache = UsdGeom.XformCache(time)
        # The prototype that is walked, and where its instance stands.
        self.prototype = None
        self.parts = {}
        self.tables = {"camera": [], "mesh": [], "light": [], "volume": []}
        self.walk(self.stage.GetPseudoRoot(), Usd.TraverseInstanceProxies())
        # A stage without light is dark.
        lights = self.tables["light"] or [table("[[light]]", {"type": "environment", "radiance": [0, 0, 0]})]
        parts = self.tables["camera"] + self.tables["mesh"] + lights + self.tables["volume"]
        with open(os.path.join(self.folder, name + ".toml"), "w") as file:
            file.write(f"name = {text(name)}\n" + self.film() + "".join(parts))

    def walk(self, root, predicate):
        """Adds the tables of a prim and of all below it."""
        walk = iter(Usd.PrimRange(root, predicate))
        for prim in walk:
            image = UsdGeom.Imageable(prim)
            is_instancer = prim.IsA(UsdGeom.PointInstancer)
            if is_instancer:
                # Its prototypes are drawn where it puts them alone.
                walk.PruneChildren()
            if not image or not self.is_drawn(image):
                continue
            if is_instancer:
                self.instances(prim)
            else:
                self.add(prim)

    def is_drawn(self, image):
        if self.prototype is None:
            is_visible = image.ComputeVisibility(self.time) != "invisible"
        else:
            # What hides the place where a prototype is kept hides no instance.
            is_visible, prim = True, image.GetPrim()
            while is_visible and prim:
                shown = UsdGeom.Imageable(prim)
                is_visible = not shown or shown.GetVisibilityAttr().Get(self.time) != "invisible"
                prim = None if prim == self.prototype[0] else prim.GetParent()
        return is_visible and image.ComputePurpose() in (UsdGeom.Tokens.default_, UsdGeom.Tokens.render)

    def instances(self, prim):
        instancer = UsdGeom.PointInstancer(prim)
        roots = [self.stage.GetPrimAtPath(path) for path in instancer.GetPrototypesRel().GetForwardedTargets()]
        kinds = instancer.GetProtoIndicesAttr().Get(self.time) or []
        all_of_them = UsdGeom.PointInstancer.IgnoreMask
        places = instancer.ComputeInstanceTransformsAtTime(self.time, self.time, applyMask=all_of_them)
        mask = instancer.ComputeMaskAtTime(self.time) or [True] * len(kinds)
        if len(places) != len(kinds) or max(kinds, default=-1) >= len(roots):
            warn(f"{prim.GetPath()}: its instances are left out, as its arrays do not fit together")
            return
        outer, world = self.prototype, self.world(prim)
        for kind, place, is_there in zip(kinds, places, mask):
            if is_there and roots[kind]:
                self.prototype = (roots[kind], place * world)
                # Prototypes may be classes, or overs.
                self.walk(roots[kind], Usd.TraverseInstanceProxies(Usd.PrimIsActive & Usd.PrimIsLoaded))
        self.prototype = outer

    def add(self, prim):
        tables, time = self.tables, self.time
        if prim.IsA(UsdGeom.Camera):
            tables["camera"].append(self.camera(prim))
        elif prim.IsA(UsdGeom.Mesh):
            tables["mesh"] += self.mesh(prim)
        elif prim.IsA(UsdGeom.Cube):
            tables["mesh"].append(self.builtin(prim, "builtin:cube", UsdGeom.Cube(prim).GetSizeAttr().Get(time)))
        elif prim.IsA(UsdGeom.Sphere):
            size = 2 * UsdGeom.Sphere(prim).GetRadiusAttr().Get(time)
            tables["mesh"].append(self.builtin(prim, "builtin:sphere", size))
        elif prim.HasAPI(UsdLux.LightAPI):
            kind, told_light = self.light(prim)
            tables[kind].append(told_light)
        elif prim.IsA(UsdVol.Volume):
            tables["volume"] += self.volume(prim)
        elif prim.IsA(UsdGeom.Gprim):
            warn(f"{prim.GetPath()}: a {prim.GetTypeName()} is left out")

    def film(self):
        size = (640, 480)
        for prim in self.stage.Traverse():
            if prim.IsA(UsdRender.Settings):
                size = UsdRender.Settings(prim).GetResolutionAttr().Get(self.time) or size
        self.aspect = size[0] / size[1]
        return table("[film]", {"width": int(size[0]), "height": int(size[1])})

    def world(self, prim):
        if self.prototype is None:
            return self.cache.GetLocalToWorldTransform(prim) * self.y_up
        root, place = self.prototype
        return self.cache.ComputeRelativeTransform(prim, root)[0] * place

    def camera(self, prim):
        found = UsdGeom.Camera(prim).GetCamera(self.time)
        if found.projection != Gf.Camera.Perspective:
            warn(f"{prim.GetPath()}: a camera that is not perspective is left out")
            return ""
        place = self.world(prim).RemoveScaleShear()
        fov = found.GetFieldOfView(Gf.Camera.FOVHorizontal)
        keys = {"name": prim.GetName(), "camera_to_world": columns(place), "fov_x_deg": fov}
        if found.fStop > 0 and found.focusDistance > 0:
            # The focal length is in tenths of a unit, over the f-stop it is the width of the lens.
            keys["aperture"] = found.focalLength * Gf.Camera.FOCAL_LENGTH_UNIT / found.fStop / 2
            keys["focus_distance"] = found.focusDistance
        return table("[[camera]]", keys)

    # ------------------------------------------------------------------------------------------------ surfaces

    def look(self, prim):
        """What a mesh has of its material: albedo or texture, emission and its texture."""
        shown = UsdGeom.Gprim(prim).GetDisplayColorAttr().Get(self.time) if prim.IsA(UsdGeom.Gprim) else None
        if shown and len(shown) > 1:
            warn(f"{prim.GetPath()}: of its colours the first is taken")
        keys = {"albedo": list(shown[0]) if shown else [0.5] * 3}
        material = UsdShade.MaterialBindingAPI(prim).ComputeBoundMaterial()[0]
        shader = material.ComputeSurfaceSource()[0] if material else None
        if shader and shader.GetIdAttr().Get() == "UsdPreviewSurface":
            color, texture = self.color(shader, "diffuseColor")
            keys["albedo"] = color or [0.18] * 3
            if texture:
                keys["texture"] = texture
            color, texture = self.color(shader, "emissiveColor")
            if color and max(color) > 0:
                keys["emission"] = color
                if texture:
                    keys["emission_texture"] = texture
            for key in ("metallic", "opacity"):
                value, source = self.input(shader, key)
                if source or (value is not None and value != (key == "opacity")):
                    warn(f"{material.GetPath()}: `{key}` is left out")
        elif shader:
            warn(f"{material.GetPath()}: a surface that is no UsdPreviewSurface is taken by its displayColor")
        keys["albedo"] = [min(max(c, 0.0), 1.0) for c in keys["albedo"]]
        return keys

    def color(self, shader, key):
        """The colour of an input, a factor on the texture if there is one."""
        value, source = self.input(shader, key)
        if source is None:
            return (list(value) if value is not None else None), None
        if source.GetIdAttr().Get() != "UsdUVTexture":
            warn(f"{source.GetPath()}: `{key}` of a {source.GetIdAttr().Get()} is left out")
            return None, None
        file = self.input(source, "file")[0]
        if not file or not file.resolvedPath:
            warn(f"{source.GetPath()}: the file of `{key}` is not there: it is left out")
            return None, None
        factor = self.input(source, "scale")[0]
        bias = self.input(source, "bias")[0]
        if bias is not None and any(bias):
            warn(f"{source.GetPath()}: its bias is left out")
        return (list(factor)[:3] if factor is not None else [1.0] * 3), self.copied(file)

    def input(self, shader, key):
        """The value of an input, and the shader that it comes from."""
        found = shader.GetInput(key)
        if not found:
            return None, None
        attributes = found.GetValueProducingAttributes()
        for attribute in attributes:
            source = UsdShade.Shader(attribute.GetPrim())
            if source and attribute.GetPrim() != shader.GetPrim() and UsdShade.Output.IsOutput(attribute):
                return None, source
            return attribute.Get(self.time), None
        return found.Get(self.time), None

    def copied(self, asset):
        """The name of a copy of a file, which may lie within a package (.usdz)."""
        path = asset.resolvedPath
        if not Ar.IsPackageRelativePath(path):
            return copied(path, self.folder)
        name = os.path.basename(Ar.SplitPackageRelativePathInner(path)[1])
        with Ar.GetResolver().OpenAsset(Ar.ResolvedPath(path)) as packed:
            return copied(path, self.folder, name, bytes(packed.GetBuffer()))

    def builtin(self, prim, file, size):
        place = Gf.Matrix4d().SetScale(size) * self.world(prim)
        keys = {"file": file, "name": prim.GetName(), "transform": columns(place)}
        return table("[[mesh]]", keys | self.untextured(prim, self.look(prim)))

    def untextured(self, prim, look):
        """A look without the textures, for what has no coordinates for them."""
        if "texture" in look or "emission_texture" in look:
            warn(f"{prim.GetPath()}: its texture needs coordinates `st`: it is left out")
        left_out = {"texture", "emission_texture"} | ({"emission"} if "emission_texture" in look else set())
        return {key: value for key, value in look.items() if key not in left_out}

    def mesh(self, prim):
        """The tables of a mesh, one for each of its materials."""
        path = prim.GetPath()
        if path not in self.parts:
            self.parts[path] = self.mesh_parts(prim)
        place, emission = {"transform": columns(self.world(prim))}, self.mesh_light(prim)
        out = []
        for keys, look in self.parts[path]:
            if emission:
                look = look | {"emission": [a * b for a, b in zip(emission, look.get("emission", [1.0] * 3))]}
            out.append(table("[[mesh]]", keys | place | look))
        return out

    def mesh_parts(self, prim):
        """Files and looks of a mesh, the same at all its places."""
        mesh, time = UsdGeom.Mesh(prim), self.time
        points = mesh.GetPointsAttr().Get(time)
        counts, indices = mesh.GetFaceVertexCountsAttr().Get(time), mesh.GetFaceVertexIndicesAttr().Get(time)
        if not points or not counts:
            return []
        st = UsdGeom.PrimvarsAPI(prim).FindPrimvarWithInheritance("st")
        uvs = st.ComputeFlattened(time) if st and st.HasValue() else None
        if uvs and len(uvs) not in (len(points), len(indices)):
            uvs = None
        turned = mesh.GetOrientationAttr().Get(time) == UsdGeom.Tokens.leftHanded
        subsets = UsdShade.MaterialBindingAPI(prim).GetMaterialBindSubsets()
        starts = [0]
        for count in counts:
            starts.append(starts[-1] + count)
        rest, parts = set(range(len(counts))), []
        for subset in subsets:
            faces = [f for f in subset.GetIndicesAttr().Get(time) or [] if f in rest]
            rest -= set(faces)
            parts.append((subset.GetPrim(), faces))
        parts.append((prim, sorted(rest)))
        out = []
        for number, (owner, faces) in enumerate(parts):
            if not faces:
                continue
            bound = UsdShade.MaterialBindingAPI(owner).ComputeBoundMaterial()[0]
            look = self.look(owner if bound else prim)
            look = look if uvs else self.untextured(prim, look)
            name = prim.GetPath().pathString.strip("/").replace("/", "_") + (f".{number}" if subsets else "")
            file = self.ply(name, points, [range(starts[f], starts[f + 1]) for f in faces], indices, uvs, turned)
            out.append(({"file": file, "name": name}, look))
        return out

    def mesh_light(self, prim):
        """What a mesh sends as a light, a factor on what its material does."""
        if not prim.HasAPI(UsdLux.LightAPI):
            return None
        color, is_normal = self.strength(prim)
        if not is_normal:
            return color
        mesh, world = UsdGeom.Mesh(prim), self.world(prim)
        at = [world.Transform(Gf.Vec3d(*point)) for point in mesh.GetPointsAttr().Get(self.time) or []]
        indices, area, start = mesh.GetFaceVertexIndicesAttr().Get(self.time), 0.0, 0
        for count in mesh.GetFaceVertexCountsAttr().Get(self.time) or []:
            face = [at[i] for i in indices[start : start + count]]
            area += sum(Gf.Cross(b - face[0], c - face[0]).GetLength() / 2 for b, c in zip(face[1:], face[2:]))
            start += count
        return [c / area for c in color] if area > 0 else None

    def ply(self, name, points, faces, indices, uvs, turned):
        """A binary file of these faces; corners of their own where texture coordinates are of corners."""
        by_corner = uvs is not None and len(uvs) == len(indices)
        vertices, numbers, body = [], {}, bytearray()
        for face in faces:
            face = list(face)[::-1] if turned else list(face)
            row = []
            for corner in face:
                key = (corner if by_corner else indices[corner])
                if key not in numbers:
                    numbers[key] = len(vertices)
                    uv = () if uvs is None else tuple(uvs[key])[:2]
                    vertices.append(struct.pack(f"<{3 + len(uv)}f", *points[indices[corner]], *uv))
                row.append(numbers[key])
            body += struct.pack(f"<I{len(row)}I", len(row), *row)
        more = "property float u\nproperty float v\n" if uvs is not None else ""
        head = f"ply\nformat binary_little_endian 1.0\nelement vertex {len(vertices)}\n"
        head += f"property float x\nproperty float y\nproperty float z\n{more}element face {len(faces)}\n"
        head += "property list uint uint vertex_indices\nend_header\n"
        content = head.encode() + b"".join(vertices) + bytes(body)
        digest = hashlib.sha256(content).hexdigest()
        if digest not in self.known:
            taken = set(self.known.values())
            file, count = name + ".ply", 2
            while file in taken:
                file, count = f"{name}.{count}.ply", count + 1
            self.known[digest] = file
            with open(os.path.join(self.folder, file), "wb") as out:
                out.write(content)
        return self.known[digest]

    # ---------------------------------------------------------------------------------------- lights and volumes

    def strength(self, prim):
        """The light of each direction, or of the whole area if that is said."""
        lamp, time = UsdLux.LightAPI(prim), self.time
        strength = lamp.GetIntensityAttr().Get(time) * 2.0 ** lamp.GetExposureAttr().Get(time)
        if lamp.GetEnableColorTemperatureAttr().Get(time):
            warn(f"{prim.GetPath()}: its colour temperature is left out")
        return [c * strength for c in lamp.GetColorAttr().Get(time)], lamp.GetNormalizeAttr().Get(time)

    def light(self, prim):
        """Whether it is a light or a mesh that emits, and its table."""
        time, world = self.time, self.world(prim)
        color, is_normal = self.strength(prim)
        if prim.IsA(UsdLux.DistantLight):
            half = math.radians(UsdLux.DistantLight(prim).GetAngleAttr().Get(time)) / 2
            # A radiance, unless it is normalized or has no extent.
            if not is_normal and half > 0:
                color = [c * math.pi * math.sin(half) ** 2 for c in color]
            keys = {"type": "directional", "direction": list(world.TransformDir(Gf.Vec3d(0, 0, -1)))}
            return "light", table("[[light]]", keys | {"irradiance": color, "angular_radius_deg": math.degrees(half)})
        if prim.IsA(UsdLux.DomeLight):
            return "light", self.dome(prim, color, world)
        shape = self.lamp_shape(prim, world)
        if shape is None:
            warn(f"{prim.GetPath()}: a {prim.GetTypeName()} is left out")
            return "light", ""
        file, size, area, across = shape
        if area <= 0:
            warn(f"{prim.GetPath()}: a light of no size is left out")
            return "light", ""
        if is_normal:
            color = [c / area for c in color]
        cone = self.cone(prim)
        if cone:
            keys = {"type": "spot", "position": list(world.ExtractTranslation())}
            keys |= {"direction": list(world.TransformDir(Gf.Vec3d(0, 0, -1)))}
            return "light", table("[[light]]", keys | {"intensity": [c * across for c in color]} | cone)
        down = Gf.Matrix4d(1, 0, 0, 0, 0, 0, -1, 0, 0, 1, 0, 0, 0, 0, 0, 1)
        place = Gf.Matrix4d().SetScale(Gf.Vec3d(*size)) * down * world
        keys = {"file": file, "name": prim.GetName(), "transform": columns(place), "albedo": [0, 0, 0]}
        return "mesh", table("[[mesh]]", keys | {"emission": color})

    def dome(self, prim, color, world):
        file = UsdLux.DomeLight(prim).GetTextureFileAttr().Get(self.time)
        keys = {"type": "environment", "radiance": color}
        if file and file.resolvedPath:
            ahead = world.TransformDir(Gf.Vec3d(0, 0, 1))
            keys |= {"image": self.copied(file)}
            keys["rotate_deg"] = math.degrees(math.atan2(ahead[0], ahead[2]))
            if UsdGeom.GetStageUpAxis(self.stage) == "Z" or abs(ahead[1]) > 1e-6:
                warn(f"{prim.GetPath()}: a sky that is turned about another axis than y is not turned so")
        return table("[[light]]", keys)

    def lamp_shape(self, prim, world):
        """The mesh of a lamp, its size, its area in the world and that seen from ahead."""
        time = self.time
        scale = [world.TransformDir(Gf.Vec3d(*axis)).GetLength() for axis in ((1, 0, 0), (0, 1, 0), (0, 0, 1))]
        if prim.IsA(UsdLux.RectLight):
            rect = UsdLux.RectLight(prim)
            x, y = rect.GetWidthAttr().Get(time), rect.GetHeightAttr().Get(time)
            area = x * scale[0] * y * scale[1]
            return "builtin:quad", (x, 1, y), area, area
        if prim.IsA(UsdLux.DiskLight):
            d = 2 * UsdLux.DiskLight(prim).GetRadiusAttr().Get(time)
            area = math.pi / 4 * d * d * scale[0] * scale[1]
            return self.disk(), (d, 1, d), area, area
        if prim.IsA(UsdLux.SphereLight):
            d = 2 * UsdLux.SphereLight(prim).GetRadiusAttr().Get(time)
            area = math.pi * (d * scale[0]) ** 2
            return "builtin:sphere", (d, d, d), area, area / 4
        return None

    def cone(self, prim):
        """The half angles of a spot, if a lamp is shaped so."""
        if not prim.HasAPI(UsdLux.ShapingAPI):
            return None
        shaping, time = UsdLux.ShapingAPI(prim), self.time
        ies = shaping.GetShapingIesFileAttr().Get(time)
        if (shaping.GetShapingFocusAttr().Get(time) or 0) > 0 or (ies and ies.path):
            warn(f"{prim.GetPath()}: its focus and its profile are left out")
        cut = shaping.GetShapingConeAngleAttr()
        angle = cut.Get(time)
        # By itself it is 90 degrees.
        if angle is None or angle >= (180 if prim.IsA(UsdLux.SphereLight) and cut.HasAuthoredValue() else 90):
            return None
        softness = min(max(shaping.GetShapingConeSoftnessAttr().Get(time) or 0.0, 0.0), 1.0)
        warn(f"{prim.GetPath()}: with a cone it is a point: its extent is left out")
        return {"inner_deg": angle * min(1 - softness, 0.999), "outer_deg": angle}

    def disk(self, sides=128):
        """Of diameter 1, facing +y."""
        turns = [2 * math.pi * i / sides for i in range(sides)]
        points = [(math.sin(t) / 2, 0, math.cos(t) / 2) for t in turns]
        return self.ply("disk", points, [range(sides)], range(sides), None, False)

    def volume(self, prim):
        out = []
        for name, path in UsdVol.Volume(prim).GetFieldPaths().items():
            asset = UsdVol.OpenVDBAsset(self.stage.GetPrimAtPath(path))
            if name != "density" or not asset:
                warn(f"{prim.GetPath()}: its field `{name}` is left out")
                continue
            file = asset.GetFilePathAttr().Get(self.time)
            if not file or not file.resolvedPath:
                warn(f"{prim.GetPath()}: the file of its density is not there: it is left out")
                continue
            keys = {"file": self.copied(file), "name": prim.GetName()}
            keys["grid"] = asset.GetFieldNameAttr().Get(self.time) or "density"
            keys |= {"sigma_t_scale": self.density, "albedo": [0.9, 0.9, 0.9], "transform": columns(self.world(prim))}
            out.append(table("[[volume]]", keys))
        return out


def main(words):
    parser = argparse.ArgumentParser(description="Exports a USD stage for lvox.")
    parser.add_argument("file", help="a .usd, .usda, .usdc or .usdz file")
    parser.add_argument("-o", "--output", required=True, help="write into this folder")
    parser.add_argument("--frames", type=frames_of, help="frames, as 1-10, 1-10x2 or 1,5,9; without it the first")
    parser.add_argument("--density", type=float, default=10.0, help="extinction where a volume has the value 1")
    args = parser.parse_args(words)
    if not os.path.exists(args.file):
        parser.error(f"{args.file} is not there")
    stage = Usd.Stage.Open(args.file)
    os.makedirs(args.output, exist_ok=True)
    name = os.path.splitext(os.path.basename(args.file))[0]
    export = Export(stage, args.output, args.density)
    if args.frames is None:
        export.write(name, Usd.TimeCode(stage.GetStartTimeCode()))
        return
    for frame in args.frames:
        export.write(f"{name}.{frame:04d}", Usd.TimeCode(frame))


if __name__ == "__main__":
    main(sys.argv[1:])
