//! Indirect light where surfaces come close to each other.

use crate::{layer, relative_rms, render};
use lvox::shade::Settings;

/// Cubes stand just above a floor, their sides a few steps of the lattice apart, and light changes
/// within less than a step between them. The difference from a gather at each pixel was 0.24 of the
/// mean with none between those of whole steps, and is 0.20.
#[test]
fn gathers_stand_closer_where_surfaces_do() {
    let mut text = String::from(
        "[film]\nwidth = 96\nheight = 72\n[[camera]]\nposition = [0, 1.6, 3.2]\n\
         target = [0, 0.2, 0]\nfov_x_deg = 45\n\
         [[mesh]]\nfile = \"builtin:quad\"\nscale = [6, 1, 6]\nalbedo = [0.8, 0.8, 0.8]\n\
         [[light]]\ntype = \"point\"\nposition = [1.5, 3, 2]\nintensity = [20, 20, 20]\n",
    );
    for (i, j) in (-2..=2).flat_map(|i| (-2..=1).map(move |j| (i, j))) {
        let (x, z) = (0.45 * f64::from(i), 0.5 * f64::from(j));
        text += &format!(
            "[[mesh]]\nfile = \"builtin:cube\"\nscale = [0.2, 0.2, 0.2]\n\
             translate = [{x}, 0.12, {z}]\nalbedo = [0.8, 0.3, 0.2]\n"
        );
    }
    let [few, all] = [4, 1].map(|lattice| {
        let settings = Settings {
            lattice,
            samples: 256,
            ..Settings::default()
        };
        layer(&render(&text, 60_000, &settings), "indirect")
    });
    let difference = relative_rms(&few, &all);
    assert!(difference < 0.22, "{difference}");
}
