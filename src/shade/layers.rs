//! Layers of the image.

use super::aov::{Aov, Part};
use super::pixels::Planes;
use crate::image::{Frame, Layer, Region};
use crate::scene::Scene;

/// What is needed of pixels for an image with these layers, in the image's order.
pub(super) fn parts(aovs: &[Aov]) -> Vec<Part> {
    let layers = Aov::ALL.map(|(_, aov)| aov).into_iter();
    let asked = layers.filter(|aov| aovs.contains(aov)).map(Part::Aov);
    std::iter::once(Part::Radiance).chain(asked).collect()
}

/// The image of shaded pixels with these layers, of their [`parts`].
pub(super) fn to_frame(scene: &Scene, region: Region, aovs: &[Aov], planes: Planes) -> Frame {
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
                Aov::Direct | Aov::Indirect | Aov::Volume => add(name, &["R", "G", "B"]),
                Aov::Depth => add(name, &["Z"]),
                Aov::Normal => add(name, &["X", "Y", "Z"]),
            }
        }
    }
    frame
}
