//! What a glTF file has that is not read, for the user to know.

use super::super::surfaces::{LeftOut, Look};
use gltf::{Document, Material};

/// Extensions that are read here or by the crate.
const READ: [&str; 3] = [
    "KHR_lights_punctual",
    "KHR_materials_emissive_strength",
    "KHR_texture_transform",
];

/// Extensions that do not change what the scene looks like at rest: descriptions, variants to
/// choose from, and motion.
const NOT_OF_LOOKS: [&str; 9] = [
    "KHR_animation_pointer",
    "KHR_materials_variants",
    "KHR_mesh_quantization",
    "KHR_physics_rigid_bodies",
    "KHR_xmp",
    "KHR_xmp_json_ld",
    "MSFT_lod",
    "MSFT_packing_normalRoughnessMetallic",
    "MSFT_packing_occlusionRoughnessMetallic",
];

/// A sentence for each kind of thing that would change the picture and is left out.
pub(super) fn told(document: &Document) -> Vec<String> {
    let is_missed = |name: &&str| !READ.contains(name) && !NOT_OF_LOOKS.contains(name);
    let extensions = document.extensions_used().filter(is_missed);
    let extension =
        |name| format!("the extension {name} is left out: what it adds is not in the picture");
    // Files of characters show them as they were made, not as they stand in the first frame.
    let mut primitives = document.meshes().flat_map(|m| m.primitives());
    let motion = [
        ("skins are", document.skins().next().is_some()),
        (
            "morph targets are",
            primitives.any(|p| p.morph_targets().next().is_some()),
        ),
        ("animations are", document.animations().next().is_some()),
    ];
    let motion = motion.into_iter().filter(|(_, is_there)| *is_there);
    let moved = |(what, _)| format!("{what} left out: meshes and nodes are where they are without");
    let surfaces = of_surfaces(document);
    let extensions = extensions.map(extension);
    extensions
        .chain(motion.map(moved))
        .chain(surfaces)
        .collect()
}

/// What materials ask for beyond diffuse reflection, extensions apart.
fn of_surfaces(document: &Document) -> Option<String> {
    let mut left_out = LeftOut::default();
    for (i, material) in document.materials().enumerate() {
        if is_metal(&material) {
            left_out.add(Look::Metal, i);
        }
        if material.normal_texture().is_some() {
            left_out.add(Look::Bump, i);
        }
    }
    left_out.told(document.materials().len())
}

/// Whether it would look like metal. One as rough as can be is nearly diffuse; so is one of which
/// nothing is said, for which the format has full metal, as rough as can be.
fn is_metal(material: &Material<'_>) -> bool {
    let base = material.pbr_metallic_roughness();
    let is_smooth = base.roughness_factor() < 1.0 || base.metallic_roughness_texture().is_some();
    base.metallic_factor() > 0.0 && is_smooth
}
