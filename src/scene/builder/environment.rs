//! Environment images as they are handed to a builder.

use crate::scene::{EnvironmentImage, ImageSun};

/// The image of what comes from every direction in which no surface is, and what is to become of
/// the suns in it.
#[derive(Clone, Debug)]
pub struct EnvironmentInput {
    pub(super) image: EnvironmentImage,
    keeps_suns: bool,
}

/// What a scene has of an image.
pub(super) enum EnvironmentParts {
    /// An environment of one colour.
    Constant([f32; 3]),
    /// The image, and the suns that were in it.
    Image(EnvironmentImage, Vec<ImageSun>),
}

impl EnvironmentInput {
    /// Suns in the image become directional lights: connected texels, no more than 3 degrees
    /// across, over 50 times as bright as the ring around them. What the camera sees stays as it
    /// is.
    #[must_use]
    pub fn new(image: EnvironmentImage) -> Self {
        Self {
            image,
            keeps_suns: false,
        }
    }

    /// Leaves suns in the image.
    #[must_use]
    pub fn keeping_suns(mut self) -> Self {
        self.keeps_suns = true;
        self
    }

    /// Takes the image apart.
    pub(super) fn into_parts(self) -> EnvironmentParts {
        if let Some(radiance) = self.image.only_radiance() {
            return EnvironmentParts::Constant(radiance);
        }
        let (image, suns) = match self.keeps_suns {
            true => (self.image, Vec::new()),
            false => self.image.without_suns(),
        };
        EnvironmentParts::Image(image, suns)
    }
}

/// What to tell of a sun that was taken out of an image.
pub(super) fn note(sun: &ImageSun) -> String {
    let [r, g, b] = sun.irradiance;
    let height_deg = libm::asinf(sun.towards.y.clamp(-1.0, 1.0)).to_degrees();
    format!(
        "the environment image has a sun {height_deg:.1} degrees high, which became a directional \
         light: irradiance [{r:.4}, {g:.4}, {b:.4}], angular radius {:.2} degrees",
        sun.angular_radius_rad.to_degrees()
    )
}
