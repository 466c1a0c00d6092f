//! Lambertian materials, two-sided in reflection, with optional emission, textures of base colour
//! and emission, and mask.

use super::Mask;

/// How a surface reflects and emits.
#[derive(Clone, Debug, PartialEq)]
pub struct Material {
    /// Name, for messages.
    pub name: String,
    /// Diffuse albedo, each channel in `[0,1]`.
    pub albedo: [f32; 3],
    /// Factor on the albedo, index into the scene's textures.
    pub texture: Option<u32>,
    /// Where the surface is there; `None` for everywhere.
    pub mask: Option<Mask>,
    /// Emitted radiance, linear Rec.709; 0 for no light.
    pub emission: [f32; 3],
    /// Factor on the emission, index into the scene's textures.
    pub emission_texture: Option<u32>,
    /// Whether the back emits too.
    pub emits_both_sides: bool,
    /// Whether rays of cameras meet it; all others do.
    pub is_seen: bool,
}

impl Material {
    /// A material that only reflects.
    #[must_use]
    pub fn diffuse(name: &str, albedo: [f32; 3]) -> Self {
        Self {
            name: name.into(),
            albedo,
            texture: None,
            mask: None,
            emission: [0.0; 3],
            emission_texture: None,
            emits_both_sides: false,
            is_seen: true,
        }
    }

    /// Whether it needs texture coordinates.
    pub(in crate::scene) fn has_texture(&self) -> bool {
        self.textures().next().is_some()
    }

    /// Indices of its textures: of its albedo, its emission, its mask.
    pub(in crate::scene) fn textures(&self) -> impl Iterator<Item = u32> {
        let of_mask = self.mask.and_then(|mask| mask.texture);
        let all = [self.texture, self.emission_texture, of_mask];
        all.into_iter().flatten()
    }

    /// Whether light comes from it.
    #[must_use]
    pub fn emits(&self) -> bool {
        self.emission != [0.0; 3]
    }

    /// Counts textures from so many further on.
    pub(in crate::scene) fn move_textures(&mut self, first: u32) {
        self.texture = self.texture.map(|t| t + first);
        self.emission_texture = self.emission_texture.map(|t| t + first);
        if let Some(mask) = &mut self.mask {
            mask.texture = mask.texture.map(|t| t + first);
        }
    }
}
