//! What a glTF file has that is not read, for the user to know.

use super::super::left_out::{LeftOut, SurfaceFeature};
use crate::{Error, Result};
use gltf::{Document, Material};
use serde_json::Value;

/// Extensions that are read here or by the crate.
const READ: [&str; 7] = [
    "EXT_mesh_gpu_instancing",
    "EXT_texture_webp",
    "KHR_lights_punctual",
    "KHR_materials_emissive_strength",
    "KHR_materials_pbrSpecularGlossiness",
    "KHR_node_visibility",
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

/// Beginnings of the names of extensions without which a file can be drawn: what they add is left
/// out, or is none of looks.
const KNOWN: [&str; 16] = [
    "ADOBE_materials_",
    "EXT_lights_",
    "EXT_materials_",
    "EXT_mesh_gpu_instancing",
    "EXT_texture_",
    "KHR_animation",
    "KHR_lights_",
    "KHR_materials_",
    "KHR_mesh_quantization",
    "KHR_node_",
    "KHR_physics",
    "KHR_texture_",
    "KHR_xmp",
    "MSFT_lod",
    "MSFT_packing_",
    "MSFT_texture_",
];

/// Extensions without which there are no meshes, and the cure.
const NEEDED: [(&str, &str); 3] = [
    (
        "KHR_draco_mesh_compression",
        "write it without, for example with `gltf-transform copy` or Blender's export",
    ),
    (
        "EXT_meshopt_compression",
        "write it without, for example with `gltf-transform copy`",
    ),
    (
        "KHR_meshopt_compression",
        "write it without, for example with `gltf-transform copy`",
    ),
];

/// Refuses a file that requires an extension without which nothing right can be drawn.
pub(super) fn check_required(document: &Value) -> Result<()> {
    let required = document.get("extensionsRequired").and_then(Value::as_array);
    let names = required.into_iter().flatten().filter_map(Value::as_str);
    for name in names {
        let error = || {
            let short: String = name.chars().take(60).collect();
            Error::input(format!(
                "the file requires the extension {}, which is not read",
                short.escape_debug()
            ))
        };
        if let Some((_, cure)) = NEEDED.iter().find(|(n, _)| *n == name) {
            return Err(error().hint(*cure));
        }
        if !KNOWN.iter().any(|known| name.starts_with(known)) {
            return Err(error().hint("write the file without it"));
        }
    }
    Ok(())
}

/// Extensions of materials with a factor that is 0 wherever they are: they add nothing.
pub(super) fn idle(document: &Value) -> Vec<&'static str> {
    /// Name, factor, and the factor of which nothing is said.
    const FACTORS: [(&str, &str, f64); 5] = [
        ("KHR_materials_clearcoat", "clearcoatFactor", 0.0),
        ("KHR_materials_iridescence", "iridescenceFactor", 0.0),
        ("KHR_materials_specular", "specularFactor", 1.0),
        ("KHR_materials_transmission", "transmissionFactor", 0.0),
        (
            "KHR_materials_diffuse_transmission",
            "diffuseTransmissionFactor",
            0.0,
        ),
    ];
    let materials = document.get("materials").and_then(Value::as_array);
    let is_idle = |(name, factor, plain): &(&str, &str, f64)| {
        let all = materials.into_iter().flatten();
        let mut all = all
            .filter_map(|m| m.get("extensions")?.get(name))
            .peekable();
        let is_zero = |e: &Value| e.get(factor).map_or(Some(*plain), Value::as_f64) == Some(0.0);
        all.peek().is_some() && all.all(is_zero)
    };
    let idle = FACTORS.iter().filter(|factor| is_idle(factor));
    idle.map(|(name, ..)| *name).collect()
}

/// Notes each kind of thing that would change the picture and is left out; what is `idle` does not.
pub(super) fn note(document: &Document, idle: &[&str], left_out: &mut LeftOut) {
    let is_missed =
        |name: &&str| !READ.contains(name) && !NOT_OF_LOOKS.contains(name) && !idle.contains(name);
    for name in document.extensions_used().filter(is_missed) {
        let what = "extensions are left out, with what they add to the picture";
        left_out.note(what, name);
    }
    // Files of characters show them as they were made, not as they stand in the first frame.
    let mut primitives = document.meshes().flat_map(|m| m.primitives());
    let motion = [
        ("skins", document.skins().next().is_some()),
        (
            "morph targets",
            primitives.any(|p| p.morph_targets().next().is_some()),
        ),
        ("animations", document.animations().next().is_some()),
    ];
    for (name, _) in motion.into_iter().filter(|(_, is_there)| *is_there) {
        let what = "motion is left out, meshes and nodes are where they are without";
        left_out.note(what, name);
    }
    for (i, material) in document.materials().enumerate() {
        if is_metal(&material) {
            left_out.feature(SurfaceFeature::Metal, i);
        }
        if material.normal_texture().is_some() {
            left_out.feature(SurfaceFeature::Bump, i);
        }
    }
}

/// Whether it would look like metal. One as rough as can be is nearly diffuse; so is one of which
/// nothing is said, for which the format has full metal, as rough as can be.
fn is_metal(material: &Material<'_>) -> bool {
    let base = material.pbr_metallic_roughness();
    let is_smooth = base.roughness_factor() < 1.0 || base.metallic_roughness_texture().is_some();
    base.metallic_factor() > 0.0 && is_smooth
}
