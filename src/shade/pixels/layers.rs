//! Quantities of pixels, and the layers of the image that are made of them.

use crate::image::{COLOR_SPACE, Frame, Layer, Region};
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
    /// Least distance along the camera's axis to what the pixel shows, scene units;
    /// [`crate::image::BACKGROUND_DEPTH`] where it shows no surface.
    Depth,
    /// Mean distance along the camera rays that end on surfaces, scene units; the same where none
    /// does.
    Distance,
    /// Mean shading normal, scene space.
    Normal,
    /// The point, in world space, that [`Self::Depth`] is of; 0 where there is none.
    Position,
    /// Mean albedo as denoisers want it: of surfaces, whose emission counts as far as it is below
    /// 1, and of media before them; 0 of the environment.
    Albedo,
    /// Share of the light from behind the scene that it keeps from the camera; a channel of the
    /// beauty, and no layer of its own.
    Alpha,
}

impl Aov {
    /// All that are layers, by name.
    pub const ALL: [(&'static str, Self); 9] = [
        ("direct", Self::Direct),
        ("environment", Self::Environment),
        ("indirect", Self::Indirect),
        ("volume", Self::Volume),
        ("depth", Self::Depth),
        ("distance", Self::Distance),
        ("normal", Self::Normal),
        ("position", Self::Position),
        ("albedo", Self::Albedo),
    ];

    /// Whether it is of where samples end, not of light.
    fn is_of_ends(self) -> bool {
        matches!(
            self,
            Self::Depth | Self::Position | Self::Albedo | Self::Alpha
        )
    }
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
            Self::Aov(Aov::Depth | Aov::Distance | Aov::Alpha) | Self::EmitterBorder => 1,
            _ => 3,
        }
    }

    /// Whether it is of where samples end, not of light.
    #[must_use]
    pub fn is_of_ends(self) -> bool {
        matches!(self, Self::Aov(aov) if aov.is_of_ends())
    }
}

/// What is needed of pixels for an image with these layers, in the image's order.
pub fn quantities(aovs: &[Aov]) -> Vec<Quantity> {
    let alpha = std::iter::once(Aov::Alpha);
    let layers = alpha.chain(Aov::ALL.map(|(_, aov)| aov));
    let asked = layers.filter(|aov| aovs.contains(aov)).map(Quantity::Aov);
    std::iter::once(Quantity::Radiance).chain(asked).collect()
}

/// The image of shaded pixels with these layers, of their [`quantities`].
pub fn to_frame(scene: &Scene, region: Region, aovs: &[Aov], planes: Planes) -> Frame {
    let mut frame = Frame::new(scene.film.width, scene.film.height, region);
    let [name, value] = COLOR_SPACE.map(str::to_owned);
    frame.attributes.insert(name, value);
    let mut planes = planes.into_iter();
    let mut add = |name: &str, channels: &[&str]| {
        let named = channels.iter().map(|&c| c.to_owned()).zip(&mut planes);
        frame.layers.push(Layer {
            name: name.into(),
            channels: named.collect(),
        });
    };
    match aovs.contains(&Aov::Alpha) {
        true => add("", &["R", "G", "B", "A"]),
        false => add("", &["R", "G", "B"]),
    }
    for (name, aov) in Aov::ALL {
        if aovs.contains(&aov) {
            match aov {
                Aov::Depth | Aov::Distance => add(name, &["Z"]),
                Aov::Normal | Aov::Position => add(name, &["X", "Y", "Z"]),
                _ => add(name, &["R", "G", "B"]),
            }
        }
    }
    frame
}
