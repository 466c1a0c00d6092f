//! How to shade, and the presets.

use crate::gather::check_max_solid_angle;
use crate::{Error, Result};

/// How to shade.
#[derive(Clone, Debug, PartialEq, serde::Serialize)]
pub struct Settings {
    /// Name of the camera; the scene's first if `None`.
    pub camera: Option<String>,
    /// Gather rays at each lattice pixel.
    pub samples: u32,
    /// A node seen under less than this, steradians, may stand for all below it; under half of that
    /// where there are bright patches.
    pub max_solid_angle: f32,
    /// How finely gather rays tell apart what is near: in parts of triangles of which the square
    /// over the longest edge has the area of so many surfels at most, in frames of few gathers
    /// ([`Self::surfels_per_patch`]). From 32 on nodes of the tree answer for all of them, and its
    /// leaves are not decoded.
    pub patch_surfels: u32,
    /// Nothing further than this, in scene units, sends indirect light; it hides the environment as
    /// ever.
    pub max_dist: Option<f32>,
    /// What ends gather rays.
    pub kernel: Kernel,
    /// What takes part in indirect light.
    pub method: Method,
    /// Whether gathers ask the few places that send most of a frame's light, if there are such, as
    /// they ask emitters.
    pub bright_patches: bool,
    /// Pixels between gathers on surfaces, where others stand between those if light may change
    /// within that; 1 gathers at every pixel.
    pub lattice: u32,
    /// Gather rays at each vertex inside media.
    pub volume_samples: u32,
    /// Primary rays a pixel; 1 for rays through the corners of pixels, which neighbours share.
    pub pixel_samples: u32,
    /// Corners of pixels from one primary ray to the next where those around end on one triangle, 1
    /// or 2; elsewhere, and where pixels have samples of their own, it does not matter.
    pub corner_spacing: u32,
    /// Primary rays inside a pixel whose corners disagree, beside those through the corners; up to
    /// 64 lie in a pattern made for edges. Three times as many where masks cut surfaces out. Where
    /// pixels have samples of their own: all rays of a pixel whose first ones disagree.
    pub edge_samples: u32,
    /// Shadow rays to lights with an extent from the end of each primary ray inside a pixel; shared
    /// corners take one, and four in penumbrae.
    pub shadow_rays: u32,
    /// Whether the environment is seen where no surface is; it lights the scene in any case.
    #[serde(skip_serializing_if = "is_true")]
    pub background: bool,
    /// Key of all random choices.
    pub seed: u64,
}

/// What images are made with unless asked otherwise is not told.
#[allow(clippy::trivially_copy_pass_by_ref)]
fn is_true(value: &bool) -> bool {
    *value
}

/// The way in which the surface that ends a gather ray is found.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, serde::Serialize)]
#[serde(rename_all = "lowercase")]
pub enum Kernel {
    /// The scene's triangles, which send what the tree says.
    #[default]
    Traced,
    /// Surfels and nodes of the tree alone.
    Cone,
    /// Surfels alone, as in the paper.
    Plain,
}

impl Kernel {
    /// All of them, by name.
    pub const ALL: [(&'static str, Self); 3] = [
        ("traced", Self::Traced),
        ("cone", Self::Cone),
        ("plain", Self::Plain),
    ];
}

/// What takes part in indirect light: the two point-based rows of the paper's Table 1 (Gibson &
/// Wood 2011).
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, serde::Serialize)]
#[serde(rename_all = "lowercase")]
pub enum Method {
    /// Surfels and lvoxels: media take from gathers and add to them, and are lit by gathers
    /// themselves.
    #[default]
    Extended,
    /// Surfels alone, as Christensen 2008: gathers on surfaces pass media unseen, and media get
    /// direct light only. Camera and shadow rays see media as ever, so that the two differ in their
    /// indirect light and in nothing else.
    Traditional,
}

impl Method {
    /// All of them, by name.
    pub const ALL: [(&'static str, Self); 2] = [
        ("extended", Self::Extended),
        ("traditional", Self::Traditional),
    ];
}

/// Settings that go together; the same for all scenes.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Quality {
    /// For layout and light placement: grain in corners and penumbrae.
    Draft,
    /// Close to the converged image.
    #[default]
    Good,
    /// Where only a metric can tell.
    Best,
}

impl Quality {
    /// All of them, by name.
    pub const ALL: [(&'static str, Self); 3] = [
        ("draft", Self::Draft),
        ("good", Self::Good),
        ("best", Self::Best),
    ];
}

impl Settings {
    /// The settings of a preset.
    #[must_use]
    pub fn of(quality: Quality) -> Self {
        let good = Self {
            camera: None,
            samples: 40,
            max_solid_angle: 0.02,
            patch_surfels: 1,
            max_dist: None,
            kernel: Kernel::Traced,
            method: Method::Extended,
            bright_patches: true,
            lattice: 4,
            volume_samples: 6,
            pixel_samples: 1,
            corner_spacing: 1,
            edge_samples: 16,
            shadow_rays: 1,
            background: true,
            seed: 0,
        };
        match quality {
            Quality::Draft => Self {
                samples: 24,
                patch_surfels: 32,
                lattice: 6,
                volume_samples: 3,
                corner_spacing: 2,
                edge_samples: 6,
                ..good
            },
            Quality::Good => good,
            Quality::Best => Self {
                samples: 64,
                max_solid_angle: 0.01,
                lattice: 3,
                volume_samples: 16,
                edge_samples: 48,
                ..good
            },
        }
    }
}

impl Default for Settings {
    fn default() -> Self {
        Self::of(Quality::default())
    }
}

impl Settings {
    /// Most pixels between gathers.
    pub const COARSEST_LATTICE: u32 = 64;

    /// Gather rays of a surface that the lattice missed: few pixels see it, and the lattice, which
    /// most see, is worth more.
    #[must_use]
    pub fn own_samples(&self) -> u32 {
        self.samples.div_ceil(2)
    }

    /// Rays of the gathers of a lattice over so many pixels.
    #[must_use]
    pub fn lattice_rays(&self, pixels: usize) -> usize {
        pixels / (self.lattice * self.lattice) as usize * self.samples as usize
    }

    /// Surfels of a near patch in a frame of so many pixels: `patch_surfels` up to 8192 gathers,
    /// and fewer by the square of how many more there are. What near patches cost is the same for
    /// all frames, and more gathers see more of what they blur.
    #[must_use]
    pub fn surfels_per_patch(&self, pixels: usize) -> f32 {
        const FEW: f32 = 8192.0;
        let gathers = pixels as f32 / (self.lattice * self.lattice) as f32;
        (self.patch_surfels as f32 * (FEW / gathers).min(1.0).powi(2)).max(1.0)
    }

    /// Refuses settings that make no sense.
    ///
    /// # Errors
    /// Names the setting, what it may be and what it was.
    pub fn check(&self) -> Result<()> {
        let count = |name: &str, value: u32, most: u32| {
            if (1..=most).contains(&value) {
                Ok(())
            } else {
                Err(Error::input(format!(
                    "{name} must be 1 to {most}, found {value}"
                )))
            }
        };
        count("`samples`", self.samples, 65_536)?;
        count("`patch_surfels`", self.patch_surfels, 65_536)?;
        count("`volume_samples`", self.volume_samples, 65_536)?;
        count("`pixel_samples`", self.pixel_samples, 65_536)?;
        count("`corner_spacing`", self.corner_spacing, 2)?;
        count("`edge_samples`", self.edge_samples, 65_536)?;
        count("`shadow_rays`", self.shadow_rays, 4096)?;
        count("`lattice`", self.lattice, Self::COARSEST_LATTICE)?;
        check_max_solid_angle(self.max_solid_angle)?;
        if let Some(d) = self.max_dist.filter(|d| d.is_nan() || *d <= 0.0) {
            return Err(Error::input(format!(
                "`max_dist` must be more than 0, found {d}"
            )));
        }
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn near_patches_are_large_where_gathers_are_few() {
        let draft = Settings::of(Quality::Draft);
        let surfels = |width: usize, height: usize| draft.surfels_per_patch(width * height);
        assert_eq!(surfels(64, 48), 32.0);
        assert_eq!(surfels(512, 512), 32.0);
        let medium = surfels(1024, 768);
        assert!((4.0..5.0).contains(&medium), "{medium}");
        assert_eq!(surfels(1920, 1080), 1.0);
        let good = Settings::of(Quality::Good);
        assert_eq!(good.surfels_per_patch(64 * 48), 1.0);
    }
}
