//! Colours of files: numbers that are brought to linear factors in [0,1].

use super::left_out::LeftOut;

/// The largest value that stands for 1 where colours are written as 0 to 255.
const BYTE: f32 = 255.0;
/// Values above this are no rounding of 1.
const ABOVE_ONE: f32 = 1.5;

/// How numbers of a file stand for colours.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Hash)]
pub(super) enum ColorEncoding {
    /// By the sRGB curve, as on screens.
    #[default]
    Srgb,
    /// In proportion to light.
    Linear,
}

impl ColorEncoding {
    /// Names in scene files, in the order of [`Self::ALL`].
    pub(super) const NAMES: [&str; 2] = ["srgb", "linear"];
    pub(super) const ALL: [Self; 2] = [Self::Srgb, Self::Linear];

    /// The linear value of an encoded one, both in [0,1].
    pub(super) fn linear(self, encoded: f32) -> f32 {
        match self {
            Self::Srgb => linear_from_srgb(encoded),
            Self::Linear => encoded,
        }
    }

    /// Brings colours of a file into [0,1] and makes them linear. Numbers up to 255 are taken as
    /// bytes; a colour that has no number in it becomes white.
    pub(super) fn decode(self, colors: &mut [[f32; 3]], left_out: &mut LeftOut) {
        let numbers = || {
            colors
                .as_flattened()
                .iter()
                .copied()
                .filter(|c| c.is_finite())
        };
        let highest = numbers().fold(0.0, f32::max);
        let lowest = numbers().fold(0.0, f32::min);
        let one = match highest {
            h if h > ABOVE_ONE && h <= BYTE => BYTE,
            _ => 1.0,
        };
        if one == BYTE {
            left_out.note(
                "colours are taken as bytes",
                format_args!("up to {highest}"),
            );
        } else if highest > 1.0 {
            left_out.note(
                "colours above 1 are taken as 1",
                format_args!("up to {highest}"),
            );
        }
        if lowest < 0.0 {
            left_out.note(
                "colours below 0 are taken as 0",
                format_args!("down to {lowest}"),
            );
        }
        for color in colors {
            *color = match color.iter().all(|c| c.is_finite()) {
                true => color.map(|c| self.linear((c / one).clamp(0.0, 1.0))),
                false => [1.0; 3],
            };
        }
    }
}

/// Linear value of an sRGB-encoded one, both in [0,1].
pub(crate) fn linear_from_srgb(encoded: f32) -> f32 {
    if encoded <= 0.04045 {
        encoded / 12.92
    } else {
        libm::powf((encoded + 0.055) / 1.055, 2.4)
    }
}

#[cfg(test)]
mod tests {
    use super::super::files::Files;
    use super::*;
    use std::path::Path;

    #[test]
    fn srgb_is_decoded() {
        assert_eq!(linear_from_srgb(0.0), 0.0);
        assert_eq!(linear_from_srgb(1.0), 1.0);
        assert!((linear_from_srgb(0.5) - 0.214_041).abs() < 1e-6);
    }

    #[test]
    fn colours_of_all_ranges_come_into_one() {
        let decoded = |encoding: ColorEncoding, mut colors: Vec<[f32; 3]>| {
            let mut left_out = LeftOut::default();
            encoding.decode(&mut colors, &mut left_out);
            let mut files = Files::default();
            left_out.tell(Path::new("x"), 0, &mut files);
            (colors, files.warnings.len())
        };
        let half = linear_from_srgb(0.5);
        let plain = vec![[0.5, 1.0, 0.0]];
        assert_eq!(
            decoded(ColorEncoding::Srgb, plain.clone()),
            (vec![[half, 1.0, 0.0]], 0)
        );
        assert_eq!(decoded(ColorEncoding::Linear, plain.clone()), (plain, 0));
        let bytes = vec![[127.5, 255.0, 0.0], [f32::NAN; 3]];
        assert_eq!(
            decoded(ColorEncoding::Srgb, bytes),
            (vec![[half, 1.0, 0.0], [1.0; 3]], 1)
        );
        let over = vec![[1.0001, -0.5, 1.0]];
        assert_eq!(
            decoded(ColorEncoding::Srgb, over),
            (vec![[1.0, 0.0, 1.0]], 2)
        );
        assert_eq!(
            decoded(ColorEncoding::Linear, vec![[1e9, 1.0, 0.0]]).0,
            [[1.0, 1.0, 0.0]]
        );
    }
}
