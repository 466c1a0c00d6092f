#!/usr/bin/env python3
"""Exports a USD stage for lvox: meshes as PLY, all else as TOML, frame by frame. Needs `pip install usd-core`.

    python tools/usd_export.py file.usd -o folder [--frames 1-10x2] [--density 10]

Writes folder/NAME.toml, or with --frames NAME.0001.toml, ... for
`lvox render folder/NAME.####.toml --frames 1-10 -o out.####.exr`. Meshes that do not change share a file.

Taken are: meshes, cubes and spheres, with instances, as they are in the world, with displayColor or the diffuse and
emissive colour and the diffuse texture of UsdPreviewSurface; cameras; DistantLight, DomeLight (of a colour or a lat-long
image), RectLight, DiskLight and SphereLight, whose shapes emit and are seen by the camera; OpenVDB fields of volumes, with
--density as the extinction where a value is 1. Polygons are cut by lvox; subdivision, curves, points and skinning are
left out, as all else that is told on stderr.
"""
import argparse
import hashlib
import math
import os
import struct
import sys

from pxr import Gf, Usd, UsdGeom, UsdLux, UsdRender, UsdShade, UsdVol
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
        stage = self.stage
        purposes = [UsdGeom.Tokens.default_, UsdGeom.Tokens.render]
        cameras, meshes, lights, volumes = [], [], [], []
        for prim in Usd.PrimRange(stage.GetPseudoRoot(), Usd.TraverseInstanceProxies()):
            image = UsdGeom.Imageable(prim)
            if not image or image.ComputeVisibility(time) == "invisible" or image.ComputePurpose() not in purposes:
                continue
            if prim.IsA(UsdGeom.Camera):
                cameras.append(self.camera(prim))
            elif prim.IsA(UsdGeom.Mesh):
                meshes += self.mesh(prim)
            elif prim.IsA(UsdGeom.Cube):
                size = UsdGeom.Cube(prim).GetSizeAttr().Get(time)
                meshes.append(self.builtin(prim, "builtin:cube", size))
            elif prim.IsA(UsdGeom.Sphere):
                radius = UsdGeom.Sphere(prim).GetRadiusAttr().Get(time)
                meshes.append(self.builtin(prim, "builtin:sphere", 2 * radius))
            elif prim.HasAPI(UsdLux.LightAPI):
                kind, told_light = self.light(prim)
                (lights if kind == "light" else meshes).append(told_light)
            elif prim.IsA(UsdVol.Volume):
                volumes += self.volume(prim)
            elif prim.IsA(UsdGeom.Gprim):
                warn(f"{prim.GetPath()}: a {prim.GetTypeName()} is left out")
        # A stage without light is dark.
        lights = lights or [table("[[light]]", {"type": "environment", "radiance": [0, 0, 0]})]
        out = f"name = {text(name)}\n" + self.film() + "".join(cameras + meshes + lights + volumes)
        with open(os.path.join(self.folder, name + ".toml"), "w") as file:
            file.write(out)

    def film(self):
        size = (640, 480)
        for prim in self.stage.Traverse():
            if prim.IsA(UsdRender.Settings):
                size = UsdRender.Settings(prim).GetResolutionAttr().Get(self.time) or size
        self.aspect = size[0] / size[1]
        return table("[film]", {"width": int(size[0]), "height": int(size[1])})

    def world(self, prim):
        return self.cache.GetLocalToWorldTransform(prim) * self.y_up

    def camera(self, prim):
        found = UsdGeom.Camera(prim).GetCamera(self.time)
        if found.projection != Gf.Camera.Perspective:
            warn(f"{prim.GetPath()}: a camera that is not perspective is left out")
            return ""
        place = self.world(prim).RemoveScaleShear()
        fov = found.GetFieldOfView(Gf.Camera.FOVHorizontal)
        keys = {"name": prim.GetName(), "camera_to_world": columns(place), "fov_x_deg": fov}
        return table("[[camera]]", keys)

    # ------------------------------------------------------------------------------------------------ surfaces

    def look(self, prim):
        """Albedo, emission and texture."""
        albedo, emission, texture = [0.5] * 3, None, None
        shown = UsdGeom.Gprim(prim).GetDisplayColorAttr().Get(self.time) if prim.IsA(UsdGeom.Gprim) else None
        if shown:
            if len(shown) > 1:
                warn(f"{prim.GetPath()}: of its colours the first is taken")
            albedo = list(shown[0])
        material = UsdShade.MaterialBindingAPI(prim).ComputeBoundMaterial()[0]
        shader = material.ComputeSurfaceSource()[0] if material else None
        if shader and shader.GetIdAttr().Get() == "UsdPreviewSurface":
            albedo = [0.18] * 3
            value, source = self.input(shader, "diffuseColor")
            if value is not None:
                albedo = list(value)
            if source and source.GetIdAttr().Get() == "UsdUVTexture":
                file = self.input(source, "file")[0]
                if file and file.resolvedPath:
                    texture, albedo = copied(file.resolvedPath, self.folder), [1.0] * 3
            value, source = self.input(shader, "emissiveColor")
            if value is not None and max(value) > 0:
                emission = list(value)
            for key in ("metallic", "opacity"):
                value, source = self.input(shader, key)
                if source or (value is not None and value != (key == "opacity")):
                    warn(f"{material.GetPath()}: `{key}` is left out")
        elif shader:
            warn(f"{material.GetPath()}: a surface that is no UsdPreviewSurface is taken by its displayColor")
        keys = {"albedo": [min(max(c, 0.0), 1.0) for c in albedo]}
        if emission:
            keys["emission"] = emission
        return keys, texture

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

    def builtin(self, prim, file, size):
        place = Gf.Matrix4d().SetScale(size) * self.world(prim)
        keys = {"file": file, "name": prim.GetName(), "transform": columns(place)}
        return table("[[mesh]]", keys | self.look(prim)[0])

    def mesh(self, prim):
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
            look, texture = self.look(owner)
            if owner != prim and not UsdShade.MaterialBindingAPI(owner).ComputeBoundMaterial()[0]:
                look, texture = self.look(prim)
            name = prim.GetPath().pathString.strip("/").replace("/", "_") + (f".{number}" if subsets else "")
            file = self.ply(name, points, [range(starts[f], starts[f + 1]) for f in faces], indices, uvs, turned)
            keys = {"file": file, "name": name, "transform": columns(self.world(prim))} | look
            if texture and uvs:
                keys["texture"] = texture
                del keys["albedo"]
            elif texture:
                warn(f"{prim.GetPath()}: its texture needs coordinates `st`: it is left out")
            out.append(table("[[mesh]]", keys))
        return out

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
        head = f"ply\nformat binary_little_endian 1.0\nelement vertex {len(vertices)}\nproperty float x\nproperty float y\n"
        head += f"property float z\n{more}element face {len(faces)}\nproperty list uint uint vertex_indices\nend_header\n"
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

    def light(self, prim):
        lamp, time = UsdLux.LightAPI(prim), self.time
        strength = lamp.GetIntensityAttr().Get(time) * 2.0 ** lamp.GetExposureAttr().Get(time)
        color = [c * strength for c in lamp.GetColorAttr().Get(time)]
        if lamp.GetEnableColorTemperatureAttr().Get(time):
            warn(f"{prim.GetPath()}: its colour temperature is left out")
        is_normal = lamp.GetNormalizeAttr().Get(time)
        world = self.world(prim)
        if prim.IsA(UsdLux.DistantLight):
            half = math.radians(UsdLux.DistantLight(prim).GetAngleAttr().Get(time)) / 2
            # A radiance, unless it is normalized or has no extent.
            if not is_normal and half > 0:
                color = [c * math.pi * math.sin(half) ** 2 for c in color]
            keys = {"type": "directional", "direction": list(world.TransformDir(Gf.Vec3d(0, 0, -1)))}
            return "light", table("[[light]]", keys | {"irradiance": color, "angular_radius_deg": math.degrees(half)})
        if prim.IsA(UsdLux.DomeLight):
            file = UsdLux.DomeLight(prim).GetTextureFileAttr().Get(time)
            keys = {"type": "environment", "radiance": color}
            if file and file.resolvedPath:
                ahead = world.TransformDir(Gf.Vec3d(0, 0, 1))
                keys |= {"image": copied(file.resolvedPath, self.folder)}
                keys["rotate_deg"] = math.degrees(math.atan2(ahead[0], ahead[2]))
                if UsdGeom.GetStageUpAxis(self.stage) == "Z" or abs(ahead[1]) > 1e-6:
                    warn(f"{prim.GetPath()}: a sky that is turned about another axis than y is not turned so")
            return "light", table("[[light]]", keys)
        scale = [world.TransformDir(Gf.Vec3d(*axis)).GetLength() for axis in ((1, 0, 0), (0, 1, 0), (0, 0, 1))]
        down = Gf.Matrix4d(1, 0, 0, 0, 0, 0, -1, 0, 0, 1, 0, 0, 0, 0, 0, 1)
        if prim.IsA(UsdLux.RectLight):
            rect = UsdLux.RectLight(prim)
            x, y = rect.GetWidthAttr().Get(time), rect.GetHeightAttr().Get(time)
            file, size, area = "builtin:quad", (x, 1, y), x * scale[0] * y * scale[1]
        elif prim.IsA(UsdLux.DiskLight):
            d = 2 * UsdLux.DiskLight(prim).GetRadiusAttr().Get(time)
            file, size, area = self.disk(), (d, 1, d), math.pi / 4 * d * d * scale[0] * scale[1]
        elif prim.IsA(UsdLux.SphereLight):
            d = 2 * UsdLux.SphereLight(prim).GetRadiusAttr().Get(time)
            file, size, area = "builtin:sphere", (d, d, d), math.pi * (d * scale[0]) ** 2
        else:
            warn(f"{prim.GetPath()}: a {prim.GetTypeName()} is left out")
            return "light", ""
        if is_normal:
            color = [c / area for c in color]
        place = Gf.Matrix4d().SetScale(Gf.Vec3d(*size)) * down * world
        keys = {"file": file, "name": prim.GetName(), "transform": columns(place), "albedo": [0, 0, 0]}
        return "mesh", table("[[mesh]]", keys | {"emission": color})

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
            keys = {"file": copied(file.resolvedPath, self.folder), "name": prim.GetName()}
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
