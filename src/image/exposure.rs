//! The exposure of pictures of eight bits: given, or found in what they show.

use super::Picture;

/// The factor on radiance before the tone map.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Exposure {
    /// This one.
    Fixed(f32),
    /// One that is found from the picture.
    Automatic,
}

impl Exposure {
    /// For a picture; `None` if it is black and there is nothing to find.
    #[must_use]
    pub fn of(self, picture: &Picture) -> Option<f32> {
        match self {
            Self::Fixed(exposure) => Some(exposure),
            Self::Automatic => automatic(picture),
        }
    }
}

/// Pixels of which one may be brighter than white.
const ONE_IN: usize = 50;

/// The exposure at which one in fifty of the pixels that are not black is brighter than white, by
/// their luminance: the same for the same pixels, in any order. `None` if all are black.
#[must_use]
pub fn automatic(picture: &Picture) -> Option<f32> {
    let luminance = |[r, g, b]: &[f32; 3]| 0.2126 * r + 0.7152 * g + 0.0722 * b;
    let lit = picture.pixels.iter().map(luminance);
    let mut lit: Vec<f32> = lit.filter(|l| *l > 0.0 && l.is_finite()).collect();
    let white = lit.len().checked_sub(1 + lit.len() / ONE_IN)?;
    let (_, white, _) = lit.select_nth_unstable_by(white, f32::total_cmp);
    // Within what a film may have.
    Some((1.0 / *white).clamp(1e-30, 1e30))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn one_lit_pixel_in_fifty_is_white() {
        let picture = |pixels: Vec<[f32; 3]>| Picture {
            width: pixels.len(),
            height: 1,
            pixels,
        };
        assert_eq!(automatic(&picture(vec![[0.0; 3], [f32::NAN; 3]])), None);
        assert_eq!(automatic(&picture(vec![[0.0; 3], [0.5; 3]])), Some(2.0));
        // 1 to 100, and as many black ones and broken ones: 99 and 100 are brighter than 98.
        let mut pixels: Vec<[f32; 3]> = (1..=100_u8).map(|i| [f32::from(i); 3]).collect();
        pixels.extend(vec![[0.0; 3]; 100]);
        pixels.extend(vec![[f32::INFINITY; 3]; 50]);
        let exposure = automatic(&picture(pixels.clone())).unwrap();
        assert!((exposure * 98.0 - 1.0).abs() < 1e-6, "{exposure}");
        pixels.reverse();
        assert_eq!(automatic(&picture(pixels.clone())), Some(exposure));
        let fixed = Exposure::Fixed(3.0).of(&picture(pixels));
        assert_eq!(fixed, Some(3.0));
    }
}
