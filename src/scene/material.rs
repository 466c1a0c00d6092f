//! Lambertian materials, two-sided in reflection, with optional emission and base-colour texture.

use crate::{Error, Result};
use glam::Vec2;

/// How a surface reflects and emits.
#[derive(Clone, Debug, PartialEq)]
pub struct Material {
    /// Name, for messages.
    pub name: String,
    /// Diffuse albedo, each channel in `[0,1]`.
    pub albedo: [f32; 3],
    /// Factor on the albedo, index into the scene's textures.
    pub texture: Option<u32>,
    /// Emitted radiance, linear Rec.709; 0 for no light.
    pub emission: [f32; 3],
    /// Whether the back emits too.
    pub emits_both_sides: bool,
}

impl Material {
    /// A material that only reflects.
    #[must_use]
    pub fn diffuse(name: &str, albedo: [f32; 3]) -> Self {
        Self {
            name: name.into(),
            albedo,
            texture: None,
            emission: [0.0; 3],
            emits_both_sides: false,
        }
    }
}

/// What a texture is beyond its border.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Hash)]
pub enum Wrap {
    /// The image again.
    #[default]
    Repeat,
    /// The texel at the border.
    Clamp,
    /// The image turned round, and so on.
    Mirror,
}

impl Wrap {
    /// The texel of `0..n` that stands at `i`.
    fn texel(self, i: i64, n: i64) -> usize {
        let at = match self {
            Self::Repeat => i.rem_euclid(n),
            Self::Clamp => i.clamp(0, n - 1),
            Self::Mirror => {
                let twice = i.rem_euclid(2 * n);
                twice.min(2 * n - 1 - twice)
            }
        };
        at as usize
    }

    /// Texture coordinates brought to where few digits are lost, without a change of what they
    /// show.
    fn near(self, t: f32) -> f32 {
        match self {
            Self::Repeat => t - t.floor(),
            // From the width of the image on beyond it there is but the texel at its border.
            Self::Clamp => t.clamp(-1.0, 2.0),
            Self::Mirror => t - 2.0 * (0.5 * t).floor(),
        }
    }
}

/// An image in linear RGB, filtered bilinearly.
#[derive(Clone, Debug)]
pub struct Texture {
    /// Texels in a row.
    pub width: u32,
    /// Rows of texels.
    pub height: u32,
    /// Linear RGB, row by row from the top.
    pub texels: Vec<[f32; 3]>,
    /// What is beyond the left and right border, and beyond the upper and lower.
    pub wrap: [Wrap; 2],
}

impl Texture {
    /// Refuses an image without texels, or of a size that is not theirs.
    pub(super) fn check(&self) -> Result<()> {
        let count = self.width as usize * self.height as usize;
        if count == 0 || count != self.texels.len() {
            return Err(Error::input(format!(
                "expected {} x {} texels and at least one, found {}",
                self.width,
                self.height,
                self.texels.len()
            )));
        }
        let in_range = |t: &[f32; 3]| t.iter().all(|x| (0.0..=1.0).contains(x));
        match self.texels.iter().find(|t| !in_range(t)) {
            Some(texel) => Err(Error::input(format!("the texel {texel:?} is not in [0,1]"))),
            None => Ok(()),
        }
    }

    /// Bits of each channel of a texel in memory.
    #[must_use]
    pub fn bits(&self) -> u32 {
        8 * size_of::<f32>() as u32
    }

    /// Bytes of memory that its texels take.
    #[must_use]
    pub fn bytes(&self) -> u64 {
        size_of_val(&self.texels[..]) as u64
    }

    /// Bilinear sample at (u, v); (0,0) is the corner of the first texel, (1,1) that of the last.
    #[must_use]
    pub fn sample(&self, uv: Vec2) -> [f32; 3] {
        let at = |t: f32, n: u32, wrap: Wrap| {
            let x = wrap.near(t) * n as f32 - 0.5;
            let lower = x.floor();
            let texel = |i: i64| wrap.texel(i, n.into());
            (texel(lower as i64), texel(lower as i64 + 1), x - lower)
        };
        let (x0, x1, fx) = at(uv.x, self.width, self.wrap[0]);
        let (y0, y1, fy) = at(uv.y, self.height, self.wrap[1]);
        let texel = |x: usize, y: usize| self.texels[y * self.width as usize + x];
        let (a, b, c, d) = (texel(x0, y0), texel(x1, y0), texel(x0, y1), texel(x1, y1));
        std::array::from_fn(|i| {
            let top = a[i] + (b[i] - a[i]) * fx;
            let bottom = c[i] + (d[i] - c[i]) * fx;
            top + (bottom - top) * fy
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn borders_repeat_clamp_and_mirror() {
        let row = |wrap: Wrap| Texture {
            width: 4,
            height: 1,
            texels: (0..4).map(|i| [i as f32, 0.0, 0.0]).collect(),
            wrap: [wrap, Wrap::Clamp],
        };
        // At the centres of texels from -5 to 8.
        let seen = |wrap: Wrap| -> Vec<f32> {
            let texture = row(wrap);
            let at = |i: i32| Vec2::new((i as f32 + 0.5) / 4.0, 0.3);
            (-5..9).map(|i| texture.sample(at(i))[0]).collect()
        };
        assert_eq!(
            seen(Wrap::Repeat),
            [3, 0, 1, 2, 3, 0, 1, 2, 3, 0, 1, 2, 3, 0].map(|v| v as f32)
        );
        assert_eq!(
            seen(Wrap::Clamp),
            [0, 0, 0, 0, 0, 0, 1, 2, 3, 3, 3, 3, 3, 3].map(|v| v as f32)
        );
        assert_eq!(
            seen(Wrap::Mirror),
            [3, 3, 2, 1, 0, 0, 1, 2, 3, 3, 2, 1, 0, 0].map(|v| v as f32)
        );
        // Between the last texel and what follows.
        assert_eq!(row(Wrap::Repeat).sample(Vec2::X)[0], 1.5);
        assert_eq!(row(Wrap::Clamp).sample(Vec2::X)[0], 3.0);
        assert_eq!(row(Wrap::Mirror).sample(Vec2::X)[0], 3.0);
        assert_eq!(row(Wrap::Clamp).sample(Vec2::new(-1e30, 1e30))[0], 0.0);
    }
}
