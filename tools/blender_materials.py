"""Materials of Blender, brought into a form that glTF has: one Principled node for each."""
import bpy

from blender_media import feed, output, source
from scene_text import warn

# Sockets that hold what others of the nodes say, to be read anew at each frame.
followers = []


def prepare_materials():
    """Lets a Principled node stand for others, of which glTF has none or not all."""
    for material in bpy.data.materials:
        tree = material.node_tree
        out = output(tree) if tree else None
        node = source(out.inputs["Surface"]) if out else None
        if node is None:
            continue
        if node.type != "BSDF_PRINCIPLED":
            node = Standing(material, tree).of(node)
            if node is None:
                continue
            tree.links.new(node.outputs["BSDF"], out.inputs["Surface"])


def refresh_materials():
    """Takes over values that change from frame to frame."""
    for socket, value_of in followers:
        socket.default_value = value_of()


class Standing:
    """Makes the Principled node of a material whose surface is of other nodes."""

    def __init__(self, material, tree):
        self.material, self.tree = material, tree

    def of(self, node):
        if node.type not in ("BSDF_DIFFUSE", "EMISSION"):
            warn(f"material {self.material.name}: {node.bl_label} is exported as glTF can")
            return None
        plain = self.tree.nodes.new("ShaderNodeBsdfPrincipled")
        plain.inputs["Roughness"].default_value = 1
        plain.inputs["Specular IOR Level"].default_value = 0
        if node.type == "EMISSION":
            plain.inputs["Base Color"].default_value = (0, 0, 0, 1)
            if node.inputs["Strength"].is_linked:
                warn(f"material {self.material.name}: the strength of its emission comes from a node: left out")
            self.follow(node.inputs["Strength"], plain.inputs["Emission Strength"])
            self.follow(node.inputs["Color"], plain.inputs["Emission Color"])
        else:
            self.follow(node.inputs["Color"], plain.inputs["Base Color"])
        return plain

    def follow(self, socket, follower):
        """Feeds a socket of the Principled node as another is fed."""
        fed = feed(socket)
        if fed:
            self.tree.links.new(fed, follower)
        follower.default_value = socket.default_value
        followers.append((follower, lambda: socket.default_value))
