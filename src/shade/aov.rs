//! Layers of the image.

use super::pixels::Pixel;
use crate::image::{Frame, Layer, Region};
use crate::math::Rgb;
use crate::scene::Scene;

/// Extra layers of the image beside the beauty.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Aov {
    /// Directly lit and emitted light, as it comes through media.
    Direct,
    /// Light from other surfaces and media.
    Indirect,
    /// Light scattered by media towards the camera.
    Volume,
    /// Mean distance along the camera rays, scene units.
    Depth,
    /// Mean shading normal, scene space.
    Normal,
}

impl Aov {
    /// All of them, by the name of their layer.
    pub const ALL: [(&'static str, Self); 5] = [
        ("direct", Self::Direct),
        ("indirect", Self::Indirect),
        ("volume", Self::Volume),
        ("depth", Self::Depth),
        ("normal", Self::Normal),
    ];
}

/// The image of shaded pixels, with the layers asked for.
pub(super) fn to_frame(scene: &Scene, region: Region, pixels: &[Pixel], aovs: &[Aov]) -> Frame {
    let mut frame = Frame::new(scene.film.width, scene.film.height, region);
    let rgb = |name: &str, f: &dyn Fn(&Pixel) -> Rgb| {
        Layer::rgb(name, &pixels.iter().map(|p| f(p).0).collect::<Vec<_>>())
    };
    frame.layers.push(rgb("", &Pixel::radiance));
    for (name, aov) in Aov::ALL {
        if aovs.contains(&aov) {
            frame.layers.push(match aov {
                Aov::Direct => rgb(name, &|p| p.direct),
                Aov::Indirect => rgb(name, &|p| p.indirect),
                Aov::Volume => rgb(name, &|p| p.volume),
                Aov::Depth => Layer::single(name, "Z", pixels.iter().map(|p| p.depth).collect()),
                Aov::Normal => Layer::xyz(
                    name,
                    &pixels
                        .iter()
                        .map(|p| p.normal.to_array())
                        .collect::<Vec<_>>(),
                ),
            });
        }
    }
    frame
}
