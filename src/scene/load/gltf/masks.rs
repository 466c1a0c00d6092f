//! Where the surfaces of a glTF file are there: alpha modes, cut-offs, and the alpha of factors,
//! textures and vertices.

use super::super::colors::ColorEncoding;
use super::super::texture::{self, Decoding};
use super::base_color::base_color;
use super::{Reader, wrap};
use crate::Result;
use crate::scene::{Mask, Wrap};
use ::gltf::material::AlphaMode;
use ::gltf::{Accessor, Material};

/// Alpha is no colour.
const LINEAR: Decoding = Decoding {
    encoding: ColorEncoding::Linear,
    base: 0.0,
    gain: 1.0,
};

impl Reader<'_> {
    /// Where a material is there: what blends with what is behind it is taken as a share.
    pub(super) fn mask(&mut self, material: &Material<'_>, name: &str) -> Result<Option<Mask>> {
        let cutoff = match material.alpha_mode() {
            AlphaMode::Opaque => return Ok(None),
            AlphaMode::Mask => Some(material.alpha_cutoff().unwrap_or(0.5)),
            AlphaMode::Blend => None,
        };
        let base = base_color(material);
        let mut within = |value: f32, what: &str| {
            if !(0.0..=1.0).contains(&value) {
                self.left_out.note(what, format_args!("`{name}`"));
            }
            if value.is_nan() {
                0.0
            } else {
                value.clamp(0.0, 1.0)
            }
        };
        let [_, _, _, opacity] = base.factor;
        let opacity = within(opacity, "opacities outside of [0,1] are brought into it");
        let what = "`alphaCutoff` outside of [0,1] is brought into it";
        let cutoff = cutoff.map(|cutoff| within(cutoff, what));
        let mut texture = None;
        if let Some(info) = base.texture {
            texture = self.alpha(info.texture().source().index(), wrap(&info))?;
            if texture.is_none() && opacity == 1.0 {
                let what = "masks of textures without alpha leave all";
                self.left_out.note(what, format_args!("`{name}`"));
            }
        }
        if cutoff.is_none() && (texture.is_some() || opacity < 1.0) {
            let what = "materials that blend are there in part: by their alpha they reflect light \
                        or let it through";
            self.left_out.note(what, format_args!("`{name}`"));
        }
        Ok(Some(Mask {
            opacity,
            texture,
            cutoff,
        }))
    }

    /// The opacities of vertices; what is no number is 1.
    pub(super) fn opacities(&self, accessor: &Accessor<'_>) -> Result<Vec<f32>> {
        let mut opacities: Vec<f32> = (self.buffers).floats(accessor, |[_, _, _, a]| a)?;
        for opacity in &mut opacities {
            *opacity = if opacity.is_nan() {
                1.0
            } else {
                opacity.clamp(0.0, 1.0)
            };
        }
        if opacities.iter().all(|o| *o == 1.0) {
            opacities = Vec::new();
        }
        Ok(opacities)
    }

    /// The alpha of an image of the file, if it has one and can be read.
    fn alpha(&mut self, image: usize, wrap: [Wrap; 2]) -> Result<Option<u32>> {
        if let Some(&index) = self.alphas.get(&(image, wrap)) {
            return Ok(index);
        }
        let texture = self.image_by(image, |content, name, files| {
            texture::decode_alpha(content, name, LINEAR, files)
        })?;
        let index = texture.flatten().map(|mut texture| {
            texture.wrap = wrap;
            self.list.textures.push(texture);
            self.list.textures.len() as u32 - 1
        });
        self.alphas.insert((image, wrap), index);
        Ok(index)
    }
}
