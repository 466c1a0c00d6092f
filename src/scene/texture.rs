//! Textures: texels as their files have them, in 8 or 16 bits, and the linear light that they stand
//! for.

use crate::column::Column;
use crate::math::Rgb;
use crate::{Error, Result};
use glam::Vec2;
use std::sync::Arc;

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
    #[inline]
    fn texel(self, i: i64, n: i64) -> usize {
        // Nearly all: a division takes longer than all else.
        if (0..n).contains(&i) {
            return i as usize;
        }
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

/// An image in linear RGB, filtered bilinearly. Its texels are shared by all that are cloned of it.
#[derive(Clone, Debug)]
pub struct Texture {
    /// Texels in a row.
    pub width: u32,
    /// Rows of texels.
    pub height: u32,
    /// What is beyond the left and right border, and beyond the upper and lower.
    pub wrap: [Wrap; 2],
    pub(in crate::scene) texels: Texels,
}

/// Row by row from the top.
#[derive(Clone, Debug)]
pub(in crate::scene) enum Texels {
    /// Linear RGB.
    Linear(Arc<Column<[f32; 3]>>),
    /// What files have, and the linear value of each code.
    Coded(Arc<Codes>, Arc<[f32]>),
}

/// Texels as a file has them.
#[derive(Debug)]
pub(in crate::scene) struct Codes {
    /// Codes of a texel: 1 for grey, or 3.
    pub(in crate::scene) channels: usize,
    pub(in crate::scene) values: CodeValues,
}

/// Codes of all channels of all texels.
#[derive(Debug)]
pub(in crate::scene) enum CodeValues {
    Bytes(Column<u8>),
    Words(Column<u16>),
}

impl Codes {
    /// Codes in all.
    fn len(&self) -> usize {
        match &self.values {
            CodeValues::Bytes(values) => values.len(),
            CodeValues::Words(values) => values.len(),
        }
    }

    /// Codes that there may be, each of which has a linear value.
    pub(in crate::scene) fn colors(&self) -> usize {
        1 << self.bits()
    }

    fn bits(&self) -> u32 {
        match &self.values {
            CodeValues::Bytes(_) => u8::BITS,
            CodeValues::Words(_) => u16::BITS,
        }
    }

    /// Bytes of memory that they take.
    pub(in crate::scene) fn bytes(&self) -> u64 {
        self.len() as u64 * u64::from(self.bits() / 8)
    }

    /// The value of a texel of one channel.
    #[inline]
    fn grey(&self, at: usize, linear: &[f32]) -> f32 {
        match &self.values {
            CodeValues::Bytes(values) => linear[usize::from(values[at])],
            CodeValues::Words(values) => linear[usize::from(values[at])],
        }
    }

    /// The texel at a place in the rows.
    #[inline]
    fn texel(&self, at: usize, linear: &[f32]) -> [f32; 3] {
        match &self.values {
            CodeValues::Bytes(values) => texel(values, self.channels, at, linear),
            CodeValues::Words(values) => texel(values, self.channels, at, linear),
        }
    }
}

#[inline]
fn texel<T: Copy + Into<usize>>(
    values: &[T],
    channels: usize,
    at: usize,
    linear: &[f32],
) -> [f32; 3] {
    let value = |i: usize| linear[values[i].into()];
    match channels {
        1 => [value(at); 3],
        _ => [value(3 * at), value(3 * at + 1), value(3 * at + 2)],
    }
}

impl Texture {
    /// A texture that repeats, of linear RGB in `[0,1]`, row by row from the top.
    #[must_use]
    pub fn new(width: u32, height: u32, texels: Vec<[f32; 3]>) -> Self {
        Self {
            width,
            height,
            wrap: Default::default(),
            texels: Texels::Linear(Arc::new(texels.into())),
        }
    }

    /// A texture that repeats, of codes; `linear` has the value of each.
    pub(in crate::scene) fn coded(
        width: u32,
        height: u32,
        codes: Arc<Codes>,
        linear: Vec<f32>,
    ) -> Self {
        Self {
            width,
            height,
            wrap: Default::default(),
            texels: Texels::Coded(codes, linear.into()),
        }
    }

    /// Refuses an image without texels, or of a size that is not theirs.
    pub(super) fn check(&self) -> Result<()> {
        let count = self.width as usize * self.height as usize;
        let (found, values) = match &self.texels {
            Texels::Linear(texels) => (texels.len(), texels.as_flattened()),
            Texels::Coded(codes, linear) => (codes.len() / codes.channels, &linear[..]),
        };
        if count == 0 || count != found {
            return Err(Error::input(format!(
                "expected {} x {} texels and at least one, found {found}",
                self.width, self.height,
            )));
        }
        match values.iter().find(|v| !(0.0..=1.0).contains(*v)) {
            Some(value) => Err(Error::input(format!(
                "a texel has the value {value}, which is not in [0,1]"
            ))),
            None => Ok(()),
        }
    }

    /// Bits of each channel of a texel in memory.
    #[must_use]
    pub fn bits(&self) -> u32 {
        match &self.texels {
            Texels::Linear(_) => 8 * size_of::<f32>() as u32,
            Texels::Coded(codes, _) => codes.bits(),
        }
    }

    /// Bytes of memory that its texels take, and what says how bright they are.
    #[must_use]
    pub fn bytes(&self) -> u64 {
        match &self.texels {
            Texels::Linear(texels) => size_of_val(&texels[..]) as u64,
            Texels::Coded(codes, linear) => codes.bytes() + size_of_val(&linear[..]) as u64,
        }
    }

    /// Whether the texels of both are the same memory.
    #[must_use]
    pub fn shares_texels(&self, other: &Self) -> bool {
        match (&self.texels, &other.texels) {
            (Texels::Linear(a), Texels::Linear(b)) => Arc::ptr_eq(a, b),
            (Texels::Coded(a, _), Texels::Coded(b, _)) => Arc::ptr_eq(a, b),
            _ => false,
        }
    }

    /// All texels as linear RGB, row by row from the top.
    pub fn texels(&self) -> impl ExactSizeIterator<Item = [f32; 3]> {
        let count = match &self.texels {
            Texels::Linear(texels) => texels.len(),
            Texels::Coded(codes, _) => codes.len() / codes.channels,
        };
        (0..count).map(|at| match &self.texels {
            Texels::Linear(texels) => texels[at],
            Texels::Coded(codes, linear) => codes.texel(at, linear),
        })
    }

    /// Linear RGB of a texel by its number among all, row by row from the top.
    #[inline]
    pub(in crate::scene) fn texel(&self, at: usize) -> [f32; 3] {
        match &self.texels {
            Texels::Linear(texels) => texels[at],
            Texels::Coded(codes, linear) => codes.texel(at, linear),
        }
    }

    /// Luminance of a texel by its number among all, row by row from the top.
    #[inline]
    pub(in crate::scene) fn luminance_of(&self, at: usize) -> f32 {
        match &self.texels {
            Texels::Coded(codes, linear) if codes.channels == 1 => codes.grey(at, linear),
            Texels::Coded(codes, linear) => Rgb(codes.texel(at, linear)).luminance(),
            Texels::Linear(texels) => Rgb(texels[at]).luminance(),
        }
    }

    /// The number of the texel that stands in a column and a row, beyond the borders, too.
    pub(in crate::scene) fn place(&self, [column, row]: [i64; 2]) -> usize {
        let x = self.wrap[0].texel(column, self.width.into());
        let y = self.wrap[1].texel(row, self.height.into());
        y * self.width as usize + x
    }

    /// Luminance of the bilinear sample at (u, v).
    #[must_use]
    pub fn luminance(&self, uv: Vec2) -> f32 {
        let [grey] = self.filtered(uv, |at| [self.luminance_of(at)]);
        grey
    }

    /// Bilinear sample at (u, v); (0,0) is the corner of the first texel, (1,1) that of the last.
    #[must_use]
    pub fn sample(&self, uv: Vec2) -> [f32; 3] {
        match &self.texels {
            Texels::Linear(texels) => self.filtered(uv, |at| texels[at]),
            Texels::Coded(codes, linear) => self.filtered(uv, |at| codes.texel(at, linear)),
        }
    }

    /// The mean of the four texels around a place, by how near they are.
    #[inline]
    fn filtered<const N: usize>(&self, uv: Vec2, texel: impl Fn(usize) -> [f32; N]) -> [f32; N] {
        let at = |t: f32, n: u32, wrap: Wrap| {
            let x = wrap.near(t) * n as f32 - 0.5;
            let lower = x.floor();
            let texel = |i: i64| wrap.texel(i, n.into());
            (texel(lower as i64), texel(lower as i64 + 1), x - lower)
        };
        let (x0, x1, fx) = at(uv.x, self.width, self.wrap[0]);
        let (y0, y1, fy) = at(uv.y, self.height, self.wrap[1]);
        let texel = |x: usize, y: usize| texel(y * self.width as usize + x);
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
        let row = |wrap: Wrap| {
            let texels = (0..4).map(|i| [i as f32, 0.0, 0.0]).collect();
            let mut texture = Texture::new(4, 1, texels);
            texture.wrap = [wrap, Wrap::Clamp];
            texture
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

    /// Codes of one channel and of three, with a curve, against their texels as floats.
    #[test]
    fn codes_are_sampled_as_the_texels_that_they_stand_for() {
        let (width, height) = (5, 3);
        let curve = |n: usize| -> Vec<f32> {
            let code = |i: usize| i as f32 / (n - 1) as f32;
            (0..n).map(|i| code(i) * code(i) * 0.7 + 0.1).collect()
        };
        let noise = |i: u32| i.wrapping_mul(0x9e37_79b9) >> 7;
        for channels in [1, 3] {
            let count = width * height * channels;
            let bytes = (0..count).map(|i| noise(i) as u8).collect();
            let words = (0..count).map(|i| noise(i) as u16).collect();
            for (values, colors) in [
                (CodeValues::Bytes(bytes), 256),
                (CodeValues::Words(words), 65536),
            ] {
                let codes = Arc::new(Codes {
                    channels: channels as usize,
                    values,
                });
                let coded = Texture::coded(width, height, codes.clone(), curve(colors));
                coded.check().unwrap();
                let plain = Texture::new(width, height, coded.texels().collect());
                assert_eq!(plain.texels().len(), (width * height) as usize);
                let table = curve(colors);
                let code = |i: u32| match &codes.values {
                    CodeValues::Bytes(v) => table[v[i as usize] as usize],
                    CodeValues::Words(v) => table[v[i as usize] as usize],
                };
                let second = std::array::from_fn(|c| code(channels + c as u32 % channels));
                assert_eq!(coded.texels().nth(1), Some(second));
                for i in 0..500 {
                    let uv = Vec2::new(noise(i) as f32, noise(i + 7) as f32) * 1e-7 - 1.0;
                    let bits = |t: &Texture| t.sample(uv).map(f32::to_bits);
                    assert_eq!(bits(&coded), bits(&plain));
                }
                assert!(coded.clone().shares_texels(&coded));
                assert!(!coded.shares_texels(&plain) && plain.bits() == 32);
                let size = coded.bits() as usize / 8;
                let bytes = size * count as usize + 4 * colors;
                assert_eq!(coded.bytes(), bytes as u64);
            }
        }
        let codes = |values| {
            Arc::new(Codes {
                channels: 1,
                values,
            })
        };
        let wrong = Texture::coded(
            2,
            2,
            codes(CodeValues::Bytes(vec![0; 3].into())),
            curve(256),
        );
        wrong.check().unwrap_err();
        let dark = Texture::coded(
            1,
            1,
            codes(CodeValues::Bytes(vec![0].into())),
            vec![-0.1; 256],
        );
        dark.check().unwrap_err();
    }
}
