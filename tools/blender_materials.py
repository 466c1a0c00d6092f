"""Materials of Blender, brought into a form that glTF has: one Principled node for each."""
import bpy

from blender_media import color, feed, number, output, source
from scene_text import warn

# Sockets that hold what others of the nodes say, to be read anew at each frame.
followers = []
# What glTF has before a colour, and what it has an image through.
COLORS = ("TEX_IMAGE", "VERTEX_COLOR", "ATTRIBUTE")
CHANGES = ("HUE_SAT", "BRIGHTCONTRAST", "GAMMA", "CURVE_RGB", "INVERT", "MIX", "MIX_RGB")


def prepare_materials():
    """Lets a Principled node stand for others, of which glTF has none or not all."""
    for material in bpy.data.materials:
        tree = material.node_tree
        out = output(tree) if tree else None
        node = source(out.inputs["Surface"]) if out else None
        if node is None or not material.users:
            continue
        surface = Surface(material, tree)
        if out.inputs["Displacement"].is_linked:
            surface.told("its displacement is left out")
        if node.type != "BSDF_PRINCIPLED":
            node = surface.of(node)
            if node is None:
                continue
            tree.links.new(node.outputs["BSDF"], out.inputs["Surface"])
        surface.settle(node)


def refresh_materials():
    """Takes over values that change from frame to frame."""
    for socket, value_of in followers:
        socket.default_value = value_of()


def is_multiplied(node):
    """Whether glTF has what a mix makes of its colours, by a factor."""
    if node.type not in ("MIX", "MIX_RGB") or node.blend_type != "MULTIPLY":
        return False
    mixed = color_inputs(node)
    fed = [source(socket) for socket in mixed]
    known = all(other is None or other.type in (*COLORS, "RGB") for other in fed)
    known = known and sum(other is not None and other.type == "TEX_IMAGE" for other in fed) < 2
    return known and not node.inputs[0].is_linked and node.inputs[0].default_value == 1


def color_inputs(node):
    return [socket for socket in node.inputs if socket.enabled and socket.type == "RGBA"]


class Surface:
    """Makes the Principled node of a material whose surface is of other nodes, and what feeds it readable."""

    def __init__(self, material, tree):
        self.material, self.tree = material, tree

    def told(self, what):
        warn(f"material {self.material.name}: {what}")

    def of(self, node):
        """A Principled node of its own that looks as a node does, or none."""
        if node.type == "ADD_SHADER":
            return self.sum(node)
        if node.type == "MIX_SHADER":
            return self.mix(node)
        if node.type == "EMISSION":
            plain = self.plain()
            plain.inputs["Base Color"].default_value = (0, 0, 0, 1)
            return self.emitting(plain, node)
        if node.type == "BSDF_PRINCIPLED":
            return node
        socket = node.inputs.get("Color") or node.inputs.get("Base Color")
        if socket is None or node.type in ("BSDF_TRANSPARENT", "HOLDOUT", "GROUP"):
            self.told(f"{node.bl_label} is exported as glTF can")
            return None
        if node.type != "BSDF_DIFFUSE":
            self.told(f"{node.bl_label} is taken as diffuse")
        plain = self.plain()
        self.follow(socket, plain.inputs["Base Color"])
        return plain

    def plain(self):
        plain = self.tree.nodes.new("ShaderNodeBsdfPrincipled")
        plain.inputs["Roughness"].default_value = 1
        plain.inputs["Specular IOR Level"].default_value = 0
        return plain

    def emitting(self, plain, node):
        self.follow(node.inputs["Strength"], plain.inputs["Emission Strength"])
        self.follow(node.inputs["Color"], plain.inputs["Emission Color"])
        return plain

    def sum(self, node):
        """What reflects, with the light of an Emission node."""
        both = [source(socket) for socket in node.inputs]
        emits = [other for other in both if other and other.type == "EMISSION"]
        rest = [other for other in both if other and other.type != "EMISSION"]
        if len(emits) == 2 or len(rest) == 2:
            self.told(f"of an Add Shader its {both[0].bl_label} alone is taken")
            return self.of(both[0])
        plain = self.of((rest + emits)[0]) if rest or emits else None
        if rest and emits and plain:
            if plain.inputs["Emission Strength"].default_value and rest[0].type != "BSDF_DIFFUSE":
                self.told("of an Add Shader one emission alone is taken")
            self.emitting(plain, emits[0])
        return plain

    def mix(self, node):
        """What is there in part, where one of two nodes is transparent; else what has the larger share."""
        both = [source(socket) for socket in node.inputs[1:3]]
        clear = [other is not None and other.type == "BSDF_TRANSPARENT" for other in both]
        share, fed = number(node.inputs[0]), feed(node.inputs[0])
        if None in both or all(clear):
            self.told("Mix Shader is exported as glTF can")
            return None
        if not any(clear):
            heavy = both[share is not None and share[0] > 0.5]
            self.told(f"of a Mix Shader its {heavy.bl_label} alone is taken")
            return self.of(heavy)
        solid = self.of(both[clear[0]])
        if solid is None:
            return None
        alpha = solid.inputs["Alpha"]
        if share is not None and share[1] is None:
            followers.append((alpha, lambda: abs(clear[1] - number(node.inputs[0])[0])))
            alpha.default_value = followers[-1][1]()
        elif clear[0] and fed.node.type == "TEX_IMAGE" and fed.name == "Alpha":
            self.tree.links.new(fed, alpha)
        else:
            self.told(f"the {fed.node.bl_label} that weighs its Mix Shader is left out: it is opaque")
        return solid

    def follow(self, socket, follower):
        """Feeds a socket of the Principled node as another is fed."""
        fed = feed(socket)
        follower.default_value = socket.default_value
        if fed:
            self.tree.links.new(fed, follower)
        else:
            followers.append((follower, lambda: socket.default_value))

    def settle(self, node):
        """Leaves before its sockets what glTF has; of other nodes the image that they change, or the socket's value."""
        for key, name in (("Base Color", "base colour"), ("Emission Color", "colour of its emission")):
            self.settle_color(node.inputs[key], name)
        for key, name in (("Emission Strength", "strength of its emission"), ("Alpha", "alpha")):
            socket = node.inputs[key]
            fed = feed(socket)
            if fed is None or (key == "Alpha" and fed.node.type in (*COLORS, "MATH")):
                continue
            self.constant(socket, number, name)

    def settle_color(self, socket, name):
        fed = feed(socket)
        if fed is None or fed.node.type in COLORS or is_multiplied(fed.node):
            return
        if fed.node.type not in CHANGES:
            self.constant(socket, color, name)
            return
        self.told(f"the {fed.node.bl_label} before its {name} is left out")
        below = [feed(other) for other in color_inputs(fed.node)]
        found = next((other for other in below if other), None)
        if found:
            self.tree.links.new(found, socket)
            self.settle_color(socket, name)
            return
        own = color_inputs(fed.node)
        self.unlink(socket, own[0].default_value if own else socket.default_value)

    def constant(self, socket, value_of, name):
        """A value in place of nodes that say none but one."""
        fed = feed(socket)
        found = value_of(socket)
        if found is None or found[1] is not None:
            self.told(f"the {fed.node.bl_label} before its {name} is left out: its plain value is taken")
            self.unlink(socket, socket.default_value)
            return
        if fed.node.type in ("VALUE", "RGB"):
            followers.append((socket, lambda: fed.default_value))
        value = found[0]
        self.unlink(socket, [*value, 1.0] if isinstance(value, list) else value)

    def unlink(self, socket, value):
        for link in list(socket.links):
            self.tree.links.remove(link)
        socket.default_value = value
