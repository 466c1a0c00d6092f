"""What Blender makes of an .exr of lvox: python blender.py IMAGE.exr ARRAY.npy TOLERANCE.

Exits with 1 where passes, colour space or values, by a relative tolerance, are not those of the
array, whose channels are R G B A and then the layers in lvox's order.
"""

import os
import sys
import tempfile

import bpy
import numpy

# Passes as Blender names them, its kinds of sockets, and the first channel and their number in the array.
PASSES = {
    "Combined": ("RGBA", 0, 4),
    "Alpha": ("VALUE", 3, 1),
    "direct": ("RGBA", 4, 3),
    "environment": ("RGBA", 7, 3),
    "indirect": ("RGBA", 10, 3),
    "volume": ("RGBA", 13, 3),
    "depth": ("VALUE", 16, 1),
    "distance": ("VALUE", 17, 1),
    "normal": ("VECTOR", 18, 3),
    "position": ("VECTOR", 21, 3),
    "albedo": ("RGBA", 24, 3),
}


def told(what, found, expected):
    if found != expected:
        sys.exit(f"{what}: expected {expected}, found {found}")


def scene_of(shape, folder):
    """A scene whose picture is what the compositor makes: 32-bit floats in a file."""
    scene = bpy.context.scene
    for thing in [o for o in bpy.data.objects if o.type != "CAMERA"]:
        bpy.data.objects.remove(thing)
    render = scene.render
    render.resolution_y, render.resolution_x = shape[:2]
    render.resolution_percentage = 100
    render.engine = "CYCLES"
    scene.cycles.device = "CPU"
    scene.cycles.samples = 1
    render.compositor_device = "CPU"
    settings = render.image_settings
    settings.file_format, settings.color_depth, settings.color_mode = "OPEN_EXR", "32", "RGBA"
    render.filepath = os.path.join(folder, "pass.exr")
    scene.compositing_node_group = bpy.data.node_groups.new("passes", "CompositorNodeTree")
    return scene


def pixels_of(scene, image, name, shape):
    """The pixels of a pass, top row first, as the compositor has them."""
    tree = scene.compositing_node_group
    tree.nodes.clear()
    tree.interface.clear()
    source = tree.nodes.new("CompositorNodeImage")
    source.image = image
    tree.interface.new_socket("Image", in_out="OUTPUT", socket_type="NodeSocketColor")
    tree.links.new(source.outputs[name], tree.nodes.new("NodeGroupOutput").inputs[0])
    bpy.ops.render.render(write_still=True)
    made = bpy.data.images.load(scene.render.filepath)
    values = numpy.empty(len(made.pixels), dtype=numpy.float32)
    made.pixels.foreach_get(values)
    bpy.data.images.remove(made)
    return values.reshape(shape[0], shape[1], 4)[::-1]


def main():
    path, array, tolerance = sys.argv[1], numpy.load(sys.argv[2]), float(sys.argv[3])
    told("numbers of the array", (str(array.dtype), array.shape[2]), ("float32", 27))
    image = bpy.data.images.load(os.path.abspath(path))
    # Blender opens the file when it is first asked for what is in it.
    told("whether there are pixels of their own", tuple(image.size), (0, 0))
    told("kind of image", image.type, "MULTILAYER")
    told("colour space", image.colorspace_settings.name, "Linear Rec.709")
    told("alpha", image.alpha_mode, "PREMUL")
    with tempfile.TemporaryDirectory() as folder:
        scene = scene_of(array.shape, folder)
        node = scene.compositing_node_group.nodes.new("CompositorNodeImage")
        node.image = image
        found = {o.name: o.type for o in node.outputs if o.enabled}
        told("passes", found, {name: kind for name, (kind, *_) in PASSES.items()})
        for name, (_, first, count) in PASSES.items():
            values = pixels_of(scene, image, name, array.shape)[:, :, :count]
            expected = array[:, :, first : first + count]
            off = numpy.abs(values - expected) - tolerance * (1e-3 + numpy.abs(expected))
            if not (off <= 0).all():
                sys.exit(f"{name}: off by {off.max()} at {numpy.argwhere(off > 0)[0]}")


main()
