//! Quantities of pixels, and the layers of the image that are made of them.

use crate::image::{Frame, Layer, Region};
use crate::scene::Scene;

/// A number of each pixel of a region, row by row, in each plane.
pub type Planes = Vec<Vec<f32>>;

/// Extra layers of the image beside the beauty.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Aov {
    /// Light of lights on what they reach, and emitted light, as it comes through media.
    Direct,
    /// Light that comes straight from the environment, on what it reaches and where it is seen.
    Environment,
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
    pub const ALL: [(&'static str, Self); 6] = [
        ("direct", Self::Direct),
        ("environment", Self::Environment),
        ("indirect", Self::Indirect),
        ("volume", Self::Volume),
        ("depth", Self::Depth),
        ("normal", Self::Normal),
    ];
}

/// A quantity of pixels that is kept.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Quantity {
    /// All light of the pixel.
    Radiance,
    /// A layer of its own.
    Aov(Aov),
    /// 1 where the border of an emissive triangle runs through the pixel, else 0.
    EmitterBorder,
}

impl Quantity {
    /// Planes that it takes.
    #[must_use]
    pub fn planes(self) -> usize {
        match self {
            Self::Aov(Aov::Depth) | Self::EmitterBorder => 1,
            _ => 3,
        }
    }
}

/// What is needed of pixels for an image with these layers, in the image's order.
pub fn quantities(aovs: &[Aov]) -> Vec<Quantity> {
    let layers = Aov::ALL.map(|(_, aov)| aov).into_iter();
    let asked = layers.filter(|aov| aovs.contains(aov)).map(Quantity::Aov);
    std::iter::once(Quantity::Radiance).chain(asked).collect()
}

/// The image of shaded pixels with these layers, of their [`quantities`].
pub fn to_frame(scene: &Scene, region: Region, aovs: &[Aov], planes: Planes) -> Frame {
    let mut frame = Frame::new(scene.film.width, scene.film.height, region);
    let mut planes = planes.into_iter();
    let mut add = |name: &str, channels: &[&str]| {
        let named = channels.iter().map(|&c| c.to_owned()).zip(&mut planes);
        frame.layers.push(Layer {
            name: name.into(),
            channels: named.collect(),
        });
    };
    add("", &["R", "G", "B"]);
    for (name, aov) in Aov::ALL {
        if aovs.contains(&aov) {
            match aov {
                Aov::Direct | Aov::Environment | Aov::Indirect | Aov::Volume => {
                    add(name, &["R", "G", "B"]);
                }
                Aov::Depth => add(name, &["Z"]),
                Aov::Normal => add(name, &["X", "Y", "Z"]),
            }
        }
    }
    frame
}
