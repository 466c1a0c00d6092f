#!/usr/bin/env python3
"""What tools/usd_export.py makes of a stage, held to the same scene by hand: usd_agrees.py LVOX OUT
makes a z-up stage of meshes, instances, materials, lights of each kind and a camera that moves, exports it, renders it
beside a TOML scene of the same, and compares means of blocks. Needs a Python that has usd-core.
Ends with: N passed, N failed."""
import os
import struct
import subprocess
import sys
import zlib

from pxr import Gf, Sdf, Usd, UsdGeom, UsdLux, UsdRender, UsdShade, UsdUtils

lvox, out = sys.argv[1], sys.argv[2]
here = os.path.dirname(os.path.abspath(__file__))
sys.path.insert(0, os.path.join(here, "../acceptance/references"))
import exr  # noqa: E402

TWIN = """
[film]
width = 64
height = 48
[[camera]]
position = [0.5, 2, 6]
target = [0.5, 2, 0]
fov_x_deg = 53.1301024
aperture = 0.1
focus_distance = 6
[[mesh]]
file = "builtin:quad"
scale = [8, 1, 8]
albedo = [0.6, 0.5, 0.4]
[[mesh]]
file = "builtin:cube"
translate = [-1, 0.5, 0]
albedo = [0.7, 0.2, 0.1]
[[mesh]]
file = "builtin:cube"
translate = [2, 0.5, -1]
albedo = [0.7, 0.2, 0.1]
[[mesh]]
file = "builtin:sphere"
scale = 1.2
translate = [0.8, 0.6, 1]
albedo = [0.2, 0.4, 0.8]
[[mesh]]
file = "builtin:quad"
scale = [2, 1, 1]
rotate_deg = [180, 0, 0]
translate = [0, 4, 0]
albedo = [0, 0, 0]
emission = [4, 3, 2]
[[mesh]]
file = "builtin:sphere"
scale = 0.5
translate = [-2, 2.5, 1]
albedo = [0, 0, 0]
emission = [2, 4, 6]
[[mesh]]
file = "builtin:cube"
scale = 0.3
translate = [-2.5, 0.15, 1.5]
albedo = [0.2, 0.7, 0.1]
[[mesh]]
file = "builtin:cube"
scale = 0.6
rotate_deg = [0, 30, 0]
translate = [1.8, 0.3, 2]
albedo = [0.2, 0.7, 0.1]
[[mesh]]
file = "builtin:quad"
scale = 0.8
rotate_deg = [90, 0, 0]
translate = [-2.4, 1, 0]
albedo = [0.5, 0, 0]
[[mesh]]
file = "builtin:quad"
scale = 0.8
rotate_deg = [90, 0, 0]
translate = [-2.4, 3, 0]
albedo = [0, 0, 1]
[[mesh]]
file = "builtin:quad"
scale = 0.8
rotate_deg = [90, 0, 0]
translate = [3, 1, 0]
albedo = [0, 0, 0]
emission = [2, 0, 0]
[[mesh]]
file = "builtin:quad"
scale = 0.8
rotate_deg = [90, 0, 0]
translate = [3, 3, 0]
albedo = [0.5, 0.5, 0.5]
emission = [0, 3, 0]
[[light]]
type = "spot"
position = [2.2, 3, 1.5]
direction = [0, -1, 0]
intensity = [6.2831853, 6.2831853, 6.2831853]
inner_deg = 15
outer_deg = 30
[[light]]
type = "directional"
direction = [0, -1, 0]
irradiance = [0.5, 0.5, 0.5]
[[light]]
type = "environment"
radiance = [0.1, 0.15, 0.2]
"""


def png(path, color):
    """An image of one colour."""
    head, rows = struct.pack(">IIBBBBB", 4, 4, 8, 2, 0, 0, 0), (b"\0" + bytes(color) * 4) * 4
    os.makedirs(os.path.dirname(path), exist_ok=True)
    with open(path, "wb") as file:
        file.write(b"\x89PNG\r\n\x1a\n")
        for kind, body in ((b"IHDR", head), (b"IDAT", zlib.compress(rows)), (b"IEND", b"")):
            file.write(struct.pack(">I", len(body)) + kind + body + struct.pack(">I", zlib.crc32(kind + body)))


def material(stage, path, color, **textures):
    """Of a colour; or of a file and a factor for an input."""
    made = UsdShade.Material.Define(stage, path)
    shader = UsdShade.Shader.Define(stage, path + "/surface")
    shader.CreateIdAttr("UsdPreviewSurface")
    shader.CreateInput("diffuseColor", Sdf.ValueTypeNames.Color3f).Set(color)
    for key, (file, factor) in textures.items():
        texture = UsdShade.Shader.Define(stage, f"{path}/{key}")
        texture.CreateIdAttr("UsdUVTexture")
        texture.CreateInput("file", Sdf.ValueTypeNames.Asset).Set(file)
        texture.CreateInput("scale", Sdf.ValueTypeNames.Float4).Set(Gf.Vec4f(factor, factor, factor, 1))
        made_of = texture.CreateOutput("rgb", Sdf.ValueTypeNames.Float3)
        shader.CreateInput(key, Sdf.ValueTypeNames.Color3f).ConnectToSource(made_of)
    made.CreateSurfaceOutput().ConnectToSource(shader.ConnectableAPI(), "surface")
    return made


def upright(stage, path, place, look=None):
    """A square that stands and faces the camera."""
    made = UsdGeom.Mesh.Define(stage, path)
    made.CreatePointsAttr([(x, 0, z) for x, z in ((-0.4, -0.4), (0.4, -0.4), (0.4, 0.4), (-0.4, 0.4))])
    made.CreateFaceVertexCountsAttr([4])
    made.CreateFaceVertexIndicesAttr([0, 1, 2, 3])
    made.AddTranslateOp().Set(Gf.Vec3d(*place))
    st = UsdGeom.PrimvarsAPI(made).CreatePrimvar("st", Sdf.ValueTypeNames.TexCoord2fArray, "vertex")
    st.Set([(0, 0), (1, 0), (1, 1), (0, 1)])
    if look:
        UsdShade.MaterialBindingAPI.Apply(made.GetPrim()).Bind(look)
    return made


def more(stage):
    """A point instancer, textures of one name, a mesh that is a light, a spot, and depth of field."""
    png(os.path.join(out, "red", "tile.png"), (255, 0, 0))
    png(os.path.join(out, "blue", "tile.png"), (0, 0, 255))
    dark = (0, 0, 0)
    red = material(stage, "/red", dark, diffuseColor=("red/tile.png", 0.5))
    upright(stage, "/redtile", (-2.4, 0, 1), red)
    upright(stage, "/bluetile", (-2.4, 0, 3), material(stage, "/bluelook", dark, diffuseColor=("blue/tile.png", 1)))
    upright(stage, "/screen", (3, 0, 1), material(stage, "/screenlook", dark, emissiveColor=("red/tile.png", 2)))
    panel = upright(stage, "/panel", (3, 0, 3))
    light = UsdLux.MeshLightAPI.Apply(panel.GetPrim())
    light = UsdLux.LightAPI(panel.GetPrim())
    light.CreateIntensityAttr(3 * 0.8 * 0.8)
    light.CreateColorAttr((0, 1, 0))
    light.CreateNormalizeAttr(True)

    many = UsdGeom.PointInstancer.Define(stage, "/many")
    many.AddTranslateOp().Set(Gf.Vec3d(0.1, 0, 0))
    seed = UsdGeom.Cube.Define(stage, "/many/seeds/seed")
    seed.CreateSizeAttr(0.3)
    seed.CreateDisplayColorAttr([(0.2, 0.7, 0.1)])
    many.CreatePrototypesRel().AddTarget("/many/seeds/seed")
    many.CreateProtoIndicesAttr([0, 0, 0])
    many.CreatePositionsAttr([(-2.6, -1.5, 0.15), (1.7, -2, 0.3), (0, -3, 1)])
    many.CreateScalesAttr([(1, 1, 1), (2, 2, 2), (3, 3, 3)])
    turn = Gf.Quath(0.9659258, 0, 0, 0.2588190)
    many.CreateOrientationsAttr([Gf.Quath(1, 0, 0, 0), turn, turn])
    many.CreateInvisibleIdsAttr([2])

    spot = UsdLux.SphereLight.Define(stage, "/spot")
    UsdGeom.Xformable(spot).AddTranslateOp().Set(Gf.Vec3d(2.2, -1.5, 3))
    spot.CreateRadiusAttr(0.1)
    spot.CreateIntensityAttr(200)
    shape = UsdLux.ShapingAPI.Apply(spot.GetPrim())
    shape.CreateShapingConeAngleAttr(30)
    shape.CreateShapingConeSoftnessAttr(0.5)
    view = UsdGeom.Camera(stage.GetPrimAtPath("/view"))
    view.CreateFStopAttr(10)
    view.CreateFocusDistanceAttr(6)


def stage(path):
    """z is up: what is (x, y, z) in the twin is (x, -z, y) here."""
    made = Usd.Stage.CreateNew(path)
    UsdGeom.SetStageUpAxis(made, "Z")
    made.SetStartTimeCode(1)
    settings = UsdRender.Settings.Define(made, "/render")
    settings.CreateResolutionAttr(Gf.Vec2i(64, 48))

    view = UsdGeom.Camera.Define(made, "/view")
    place = UsdGeom.Xformable(view).AddTranslateOp()
    place.Set(Gf.Vec3d(0.5, -6, 2), 1)
    place.Set(Gf.Vec3d(1.5, -6, 2), 3)
    UsdGeom.Xformable(view).AddRotateXOp().Set(90)
    view.CreateHorizontalApertureAttr(20)
    view.CreateFocalLengthAttr(20)

    floor = UsdGeom.Mesh.Define(made, "/floor")
    # Left-handed corners that face upwards.
    floor.CreatePointsAttr([(-4, -4, 0), (-4, 4, 0), (4, 4, 0), (4, -4, 0)])
    floor.CreateFaceVertexCountsAttr([4])
    floor.CreateFaceVertexIndicesAttr([0, 1, 2, 3])
    floor.CreateOrientationAttr("leftHanded")
    floor.CreateDisplayColorAttr([(0.6, 0.5, 0.4)])

    block = made.CreateClassPrim("/block")
    cube = UsdGeom.Cube.Define(made, "/block/cube")
    cube.CreateSizeAttr(1)
    cube.CreateDisplayColorAttr([(0.7, 0.2, 0.1)])
    for name, at in (("a", (-1, 0, 0.5)), ("b", (2, 1, 0.5))):
        copy = UsdGeom.Xform.Define(made, "/" + name)
        copy.GetPrim().GetReferences().AddInternalReference(block.GetPath())
        copy.GetPrim().SetInstanceable(True)
        copy.AddTranslateOp().Set(Gf.Vec3d(*at))

    ball = UsdGeom.Sphere.Define(made, "/ball")
    ball.CreateRadiusAttr(0.6)
    UsdGeom.Xformable(ball).AddTranslateOp().Set(Gf.Vec3d(0.8, -1, 0.6))
    UsdShade.MaterialBindingAPI.Apply(ball.GetPrim()).Bind(material(made, "/blue", (0.2, 0.4, 0.8)))
    hidden = UsdGeom.Cube.Define(made, "/hidden")
    hidden.MakeInvisible()

    # Rectangles emit along -z, which is downwards here.
    rect = UsdLux.RectLight.Define(made, "/rect")
    UsdGeom.Xformable(rect).AddTranslateOp().Set(Gf.Vec3d(0, 0, 4))
    rect.CreateWidthAttr(2)
    rect.CreateHeightAttr(1)
    rect.CreateNormalizeAttr(True)
    rect.CreateIntensityAttr(4)
    rect.CreateExposureAttr(1)
    rect.CreateColorAttr((1, 0.75, 0.5))
    lamp = UsdLux.SphereLight.Define(made, "/lamp")
    UsdGeom.Xformable(lamp).AddTranslateOp().Set(Gf.Vec3d(-2, -1, 2.5))
    lamp.CreateRadiusAttr(0.25)
    lamp.CreateIntensityAttr(2)
    lamp.CreateColorAttr((1, 2, 3))
    sun = UsdLux.DistantLight.Define(made, "/sun")
    sun.CreateIntensityAttr(0.5)
    sun.CreateAngleAttr(0)
    sky = UsdLux.DomeLight.Define(made, "/sky")
    sky.CreateIntensityAttr(1)
    sky.CreateColorAttr((0.1, 0.15, 0.2))
    more(made)
    made.Save()


def blocks(path):
    rows = exr.read(path)[1]
    means = []
    for channel in "RGB":
        for y in range(0, 48, 8):
            for x in range(0, 64, 8):
                means.append(sum(sum(row[x : x + 8]) for row in rows[channel][y : y + 8]) / 64)
    return means


def render(scene, image):
    words = [lvox, "reference", scene, "-o", image, "--spp", "256", "--max-depth", "3", "--force", "--progress", "none"]
    subprocess.run(words, check=True)
    return blocks(image)


def export(folder, *more, file="stage.usda"):
    script = os.path.join(here, "../../tools/usd_export.py")
    subprocess.run([sys.executable, script, os.path.join(out, file), "-o", folder, *more], check=True)


if os.path.exists(os.path.join(out, "stage.usda")):
    os.remove(os.path.join(out, "stage.usda"))
stage(os.path.join(out, "stage.usda"))
twin, folder = os.path.join(out, "twin.toml"), os.path.join(out, "stage")
with open(twin, "w") as file:
    file.write(TWIN)
export(folder)
theirs = render(twin, os.path.join(out, "twin.exr"))
mine = render(os.path.join(folder, "stage.toml"), os.path.join(out, "stage.exr"))
mean = sum(theirs) / len(theirs)
apart = (sum(((a - b) / max(b, mean)) ** 2 for a, b in zip(mine, theirs)) / len(mine)) ** 0.5
is_near = apart < 0.01
print(f"{'' if is_near else 'FAILED: '}stage: blocks differ by {apart:.4f}, means by {sum(mine) / sum(theirs) - 1:+.4f}")

moving = os.path.join(out, "moving")
export(moving, "--frames", "1-3x2")
files = sorted(os.listdir(moving))
words = ["inspect", os.path.join(moving, "stage.####.toml"), "--frames", "1-3x2"]
done = subprocess.run([lvox, *words], capture_output=True, text=True)
meshes = ["floor.ply", "redtile.ply", "tile.2.png", "tile.png"]
are_right = files == sorted(meshes + ["stage.0001.toml", "stage.0003.toml"]) and done.returncode == 0
print(f"{'' if are_right else 'FAILED: '}frames: {', '.join(files)}")
packed = os.path.join(out, "packed")
UsdUtils.CreateNewUsdzPackage(os.path.join(out, "stage.usda"), os.path.join(out, "stage.usdz"))
export(packed, file="stage.usdz")
names = sorted(os.listdir(folder))
same = [open(os.path.join(folder, name), "rb").read() == open(os.path.join(packed, name), "rb").read() for name in names]
is_same = names == sorted(os.listdir(packed)) and all(same)
print(f"{'' if is_same else 'FAILED: '}a package: {', '.join(names)}")
results = [is_near, are_right, is_same]
print(f"\n{sum(results)} passed, {len(results) - sum(results)} failed")
sys.exit(not all(results))
