//! The diffuse colour of a material, by either of the models that glTF has.

use gltf::Material;
use gltf::texture::Info;

/// A colour, and the texture that it is a factor on.
pub(super) struct BaseColor<'a> {
    /// Linear red, green and blue, and opacity.
    pub(super) factor: [f32; 4],
    pub(super) texture: Option<Info<'a>>,
}

/// That of metal and roughness, or, in older files, of what scatters beside highlights.
pub(super) fn base_color<'a>(material: &Material<'a>) -> BaseColor<'a> {
    if let Some(diffuse) = material.pbr_specular_glossiness() {
        return BaseColor {
            factor: diffuse.diffuse_factor(),
            texture: diffuse.diffuse_texture(),
        };
    }
    let base = material.pbr_metallic_roughness();
    BaseColor {
        factor: base.base_color_factor(),
        texture: base.base_color_texture(),
    }
}
