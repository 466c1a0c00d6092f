"""Media of Blender: shader nodes of volumes as extinction, albedo and phase function by Cycles' rules.

Cycles adds up what nodes scatter and absorb, by channel and unit of length. With density d and colour c,
Volume Scatter scatters c d and absorbs nothing; Volume Absorption absorbs (1 - c) d; Principled Volume
scatters c d and absorbs (1 - c) (1 - sqrt a) d, with a the colour of its absorption. Extinction is the sum,
albedo what is scattered of it.
"""
import math
import os
import re
from dataclasses import dataclass, field

import bpy
from mathutils import Matrix, Vector

from scene_text import copied, table, warn

# Voxels of an even medium along the longest edge of its box: what light inside is resolved by.
EVEN_VOXELS = 32
MOST_G = 0.99
# Blender is z-up, lvox is y-up.
Y_UP = Matrix(((1, 0, 0, 0), (0, 0, 1, 0), (0, -1, 0, 0), (0, 0, 0, 1)))


@dataclass
class Medium:
    """What scatters, absorbs and emits where its grid is 1, or everywhere without one."""

    grid: str | None
    scattered: list
    absorbed: list
    g: float = 0.0
    color_grid: str | None = None
    emission: dict | None = field(default=None)

    def extinction(self):
        return [s + a for s, a in zip(self.scattered, self.absorbed)]

    def keys(self, size=1.0):
        """As a scene has it; `size` is what lengths are multiplied by."""
        extinction = [max(e, 0.0) for e in self.extinction()]
        albedo = [min(max(s / e, 0.0), 1.0) if e > 0 else 0.0 for s, e in zip(self.scattered, extinction)]
        extinction = [e / size for e in extinction]
        is_grey = max(extinction) - min(extinction) <= 1e-6 * max(extinction)
        keys = {"sigma_t_scale": max(extinction) if is_grey else extinction, "albedo": albedo}
        if self.color_grid:
            keys["albedo_grid"] = self.color_grid
        if self.g:
            keys["g"] = max(-MOST_G, min(MOST_G, self.g))
        if self.emission:
            keys["emission"] = self.emission | {"scale": self.emission["scale"] / size}
        return keys


# -------------------------------------------------------------------------------------------------------- nodes


def feed(socket):
    """The output that a socket is fed from, if any, through reroutes."""
    while socket.is_linked:
        fed = socket.links[0].from_socket
        if fed.node.type != "REROUTE":
            return fed
        socket = fed.node.inputs[0]
    return None


def source(socket):
    """The node that a socket is fed from, if any, through reroutes."""
    fed = feed(socket)
    return fed.node if fed else None


def output(tree, kind="OUTPUT_MATERIAL"):
    nodes = [node for node in tree.nodes if node.type == kind]
    active = [node for node in nodes if node.is_active_output]
    return (active or nodes or [None])[0]


def grid_of(fed):
    """The grid that an output reads, if it does."""
    if fed.node.type == "ATTRIBUTE" and fed.node.attribute_type == "GEOMETRY":
        return fed.node.attribute_name
    return fed.name.lower() if fed.node.type == "VOLUME_INFO" else None


def number(socket):
    """A number, and the grid that it is a factor on or None; nothing where nodes are not followed."""
    fed = feed(socket)
    if fed is None:
        return socket.default_value, None
    if fed.node.type == "VALUE":
        return fed.default_value, None
    if grid_of(fed):
        return 1.0, grid_of(fed)
    if fed.node.type == "MATH" and fed.node.operation == "MULTIPLY" and not fed.node.use_clamp:
        both = [number(socket) for socket in fed.node.inputs[:2]]
        if None not in both and None in (both[0][1], both[1][1]):
            return both[0][0] * both[1][0], both[0][1] or both[1][1]
    return None


def color(socket):
    """A colour, and the grid that it is a factor on or None; nothing where nodes are not followed."""
    fed = feed(socket)
    if fed is None:
        return list(socket.default_value[:3]), None
    if fed.node.type == "RGB":
        return list(fed.default_value[:3]), None
    if grid_of(fed):
        return [1.0] * 3, grid_of(fed)
    return None


class Reader:
    """Reads the nodes of a material that fills an object with these grids."""

    def __init__(self, material, grids):
        self.material, self.grids = material, grids

    def told(self, what):
        warn(f"material {self.material.name}: {what}")

    def number(self, node, key):
        """As `number`, but what is not followed is told, and has the value of the socket."""
        return self.followed(number, node, key)

    def color(self, node, key):
        """As `color`, but what is not followed is told, and has the value of the socket."""
        value, grid = self.followed(color, node, key)
        return [max(c, 0.0) for c in value], grid

    def followed(self, follow, node, key):
        found = follow(node.inputs[key])
        if found is not None:
            return found
        self.told(f"the nodes of the {key.lower()} of its {node.bl_label} are left out")
        plain = node.inputs[key].default_value
        return (plain if isinstance(plain, float) else list(plain[:3])), None

    def even_color(self, node, key):
        value, grid = self.color(node, key)
        if grid:
            self.told(f"the grid of the {key.lower()} of its {node.bl_label} is left out")
        return value

    def even_number(self, node, key):
        value, grid = self.number(node, key)
        if grid:
            self.told(f"the grid of the {key.lower()} of its {node.bl_label} is left out")
        return value

    def media(self):
        """The media that are to be added up."""
        out = output(self.material.node_tree) if self.material.node_tree else None
        fed = feed(out.inputs["Volume"]) if out else None
        if fed is None:
            self.told("it has no volume")
            return []
        return merged(self.parts(fed.node, 1.0))

    def parts(self, node, weight):
        if node.type in ("ADD_SHADER", "MIX_SHADER"):
            return self.sum(node, weight)
        read = {
            "VOLUME_SCATTER": self.scatter,
            "VOLUME_ABSORPTION": self.absorption,
            "PRINCIPLED_VOLUME": self.principled,
            "VOLUME_COEFFICIENTS": self.coefficients,
            "EMISSION": self.emissive,
        }.get(node.type)
        if read is None:
            self.told(f"a {node.bl_label} in its volume is left out")
            return []
        return [part for part in read(node, weight) if self.is_there(part)]

    def sum(self, node, weight):
        weights = [weight, weight]
        if node.type == "MIX_SHADER":
            share = number(node.inputs[0])
            if share is None or share[1]:
                self.told("a Mix Shader that nodes weigh is left out of its volume")
                return []
            share = min(max(share[0], 0.0), 1.0)
            weights = [weight * (1.0 - share), weight * share]
        out = []
        for socket, weight in zip(node.inputs[-2:], weights):
            fed = feed(socket)
            out += self.parts(fed.node, weight) if fed and weight > 0 else []
        return out

    def is_there(self, part):
        """Whether Cycles draws it: in a grid of the file, or of no grid in a box."""
        if part.grid is None and self.grids:
            self.told("a density that no grid feeds is left out of a volume that has grids")
            return False
        if part.grid is not None and part.grid not in self.grids:
            self.told(f"what is as dense as the grid `{part.grid}` is left out: there is none")
            return False
        return True

    def density(self, node, weight):
        density, grid = self.number(node, "Density")
        return max(density, 0.0) * weight, grid

    def phase(self, node):
        kind = getattr(node, "phase", "HENYEY_GREENSTEIN")
        if kind != "HENYEY_GREENSTEIN":
            self.told("its phase function is taken as one of Henyey and Greenstein")
        # Of the others only Draine's has the socket.
        if kind not in ("HENYEY_GREENSTEIN", "DRAINE"):
            return 0.0
        return self.even_number(node, "Anisotropy")

    def scatter(self, node, weight):
        density, grid = self.density(node, weight)
        scattered = [c * density for c in self.even_color(node, "Color")]
        return [Medium(grid, scattered, [0.0] * 3, self.phase(node))]

    def absorption(self, node, weight):
        density, grid = self.density(node, weight)
        absorbed = [max(1.0 - c, 0.0) * density for c in self.even_color(node, "Color")]
        return [Medium(grid, [0.0] * 3, absorbed)]

    def coefficients(self, node, weight):
        scattered, absorbed, emitted = (
            [max(c, 0.0) * weight for c in self.even_color(node, key + " Coefficients")]
            for key in ("Scatter", "Absorption", "Emission")
        )
        medium = Medium(None, scattered, absorbed, self.phase(node))
        if max(emitted) > 0:
            medium.emission = {"scale": 1.0, "color": emitted}
        return [medium]

    def principled(self, node, weight):
        density, grid = self.density(node, weight)
        named = node.inputs["Density Attribute"].default_value
        if grid and named in self.grids:
            self.told("its density is fed by nodes, and the grid of its density attribute is left out")
        elif named in self.grids:
            grid = named
        tint, color_grid = self.color(node, "Color")
        named = node.inputs["Color Attribute"].default_value
        if color_grid and named in self.grids:
            self.told("its colour is fed by nodes, and the grid of its colour attribute is left out")
        elif named in self.grids:
            color_grid = named
        shadow = self.even_color(node, "Absorption Color")
        if color_grid and color_grid not in self.grids:
            self.told(f"the grid `{color_grid}` of its colour is left out: there is none")
            color_grid = None
        if color_grid:
            tint = [min(c, 1.0) for c in tint]
            if max(shadow) > 0:
                self.told("the colour of its absorption is left out, as its colour is a grid")
                shadow = [0.0] * 3
        absorbed = [max(1.0 - c, 0.0) * max(1.0 - math.sqrt(s), 0.0) for c, s in zip(tint, shadow)]
        absorbed = [c * density for c in absorbed]
        scattered = [c * density for c in tint]
        g = self.even_number(node, "Anisotropy")
        medium = Medium(grid, scattered, absorbed, g, color_grid, self.emission(node, weight))
        if medium.emission and medium.grid is None and max(medium.extinction()) <= 0:
            medium.grid = medium.emission.get("grid")
        return [medium]

    def emission(self, node, weight):
        """What a Principled Volume sends out: that of a black body, or of a grid that its strength comes from."""
        inputs = node.inputs
        if inputs["Blackbody Intensity"].default_value > 0:
            if list(inputs["Blackbody Tint"].default_value[:3]) != [1.0] * 3:
                self.told("the tint of its black body is left out")
            named = inputs["Temperature Attribute"].default_value
            if self.grids and named not in self.grids:
                self.told(f"its black body is left out: there is no grid `{named}`")
                return None
            grid = {"grid": named} if self.grids else {}
            scale = inputs["Blackbody Intensity"].default_value * weight
            return grid | {"kelvin": inputs["Temperature"].default_value, "scale": scale}
        return self.glow(node, "Emission Strength", "Emission Color", weight)

    def emissive(self, node, weight):
        glow = self.glow(node, "Strength", "Color", weight)
        return [Medium(glow.get("grid"), [0.0] * 3, [0.0] * 3, emission=glow)] if glow else []

    def glow(self, node, strength, tint, weight):
        """The light of a grid, or in a box of its own even one."""
        found = number(node.inputs[strength])
        if found is None or (found[1] is None and found[0] > 0 and self.grids):
            self.told("an emission that no grid feeds is left out")
            return None
        scale, grid = found
        if grid is not None and grid not in self.grids:
            self.told(f"an emission by the grid `{grid}` is left out: there is none")
            return None
        if scale <= 0 and grid is None:
            return None
        keys = {"grid": grid} if grid else {}
        return keys | {"scale": scale * weight, "color": self.even_color(node, tint)}


def merged(parts):
    """Parts that are one medium as one; what only absorbs or emits goes with another if it can."""
    out = []
    for part in sorted(parts, key=lambda part: not any(part.scattered)):
        with_it = next((other for other in out if is_joined(other, part)), None)
        if with_it is None:
            out.append(part)
            continue
        with_it.scattered = [a + b for a, b in zip(with_it.scattered, part.scattered)]
        with_it.absorbed = [a + b for a, b in zip(with_it.absorbed, part.absorbed)]
        with_it.emission = with_it.emission or part.emission
    return [part for part in out if max(part.extinction()) > 0 or part.emission]


def is_joined(other, part):
    if other.emission and part.emission:
        return False
    if max(part.extinction()) <= 0:
        return True
    if any(part.scattered):
        return (other.grid, other.g, other.color_grid) == (part.grid, part.g, part.color_grid)
    return other.grid == part.grid and other.color_grid is None


# ------------------------------------------------------------------------------------------------------ objects


def volume(obj, folder, to_world):
    """The tables of a volume object."""
    data = obj.data
    data.grids.load()
    path = bpy.path.abspath(data.grids.frame_filepath or data.filepath)
    if not os.path.exists(path):
        warn(f"volume {obj.name}: {path} is not there: it is left out")
        return ""
    grids = {grid.name for grid in data.grids}
    slots = [slot.material for slot in obj.material_slots if slot.material]
    plain = [Medium("density", [0.5] * 3, [0.5] * 3)]
    media = Reader(slots[0], grids).media() if slots else plain
    if not media:
        return ""
    name = copied(path, folder)
    # A volume that is larger is as opaque, unless it is said to be in the world.
    size = 1.0
    if data.render.space == "OBJECT":
        size = (to_world.to_3x3() @ Vector((1, 1, 1)).normalized()).length
    place = {"transform": rows(to_world)}
    return "".join(
        table("[[volume]]", {"file": name, "name": obj.name, "grid": medium.grid} | medium.keys(size) | place)
        for medium in media
    )


def filling(materials):
    """The one of a mesh's materials that has nothing but a volume."""
    for material in materials:
        tree = material.node_tree if material else None
        out = output(tree) if tree else None
        if out is None or not out.inputs["Volume"].is_linked:
            continue
        surface = feed(out.inputs["Surface"])
        if surface is None or surface.node.type == "BSDF_TRANSPARENT":
            return material
        warn(f"material {material.name}: the volume within its surface is left out")
    return None


def box(name, mesh, material, folder, to_world):
    """The tables of an object whose mesh is filled with an even medium, if it is a box."""
    corners = {tuple(vertex.co) for vertex in mesh.vertices}
    low, high = ([pick(axis) for axis in zip(*corners)] for pick in (min, max)) if corners else ([], [])
    is_box = len(corners) == 8 and all(c in pair for corner in corners for c, pair in zip(corner, zip(low, high)))
    if not is_box:
        warn(f"object {name}: a medium in a mesh that is not a box is left out")
        return ""
    size = Vector(high) - Vector(low)
    world_from_unitcube = to_world @ Matrix.Translation(Vector(low)) @ Matrix.Diagonal((*size, 1))
    edges = [world_from_unitcube.col[i].to_3d().length for i in range(3)]
    if min(edges) <= 0:
        return ""
    dims = [max(2, math.ceil(EVEN_VOXELS * edge / max(edges) - 1e-4)) for edge in edges]
    brick = "even-" + "x".join(map(str, dims)) + ".raw"
    with open(os.path.join(folder, brick), "wb") as file:
        file.write(bytes([1]) * math.prod(dims))
    keys = {"file": brick, "name": name, "dims": dims, "dtype": "u8"}
    place = {"unitcube_to_world": rows(world_from_unitcube)}
    media = Reader(material, frozenset()).media()
    return "".join(table("[[volume]]", keys | medium.keys() | place) for medium in media)


def rows(matrix):
    return [[matrix[i][j] for j in range(4)] for i in range(3)] + [[0, 0, 0, 1]]


def grouped(obj, keys):
    """With the light group that an object or a world is in."""
    name = re.sub("[^A-Za-z0-9_-]", "_", getattr(obj, "lightgroup", ""))
    return keys | {"group": name} if name else keys
