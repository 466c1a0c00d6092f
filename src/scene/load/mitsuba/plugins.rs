//! The names of Mitsuba's plugins: those of version 3, and of 0.6 where these are others.

use super::element::Element;
use crate::Error;
use crate::scene::load::nearest::nearest;

const SHAPES: &[&str] = &[
    "obj",
    "ply",
    "rectangle",
    "cube",
    "sphere",
    "disk",
    "cylinder",
    "shapegroup",
    "instance",
    "merge",
    "serialized",
    "bsplinecurve",
    "linearcurve",
    "ellipsoids",
    "ellipsoidsmesh",
    "sdfgrid",
    "hair",
    "heightfield",
    "deformable",
];
const BSDFS: &[&str] = &[
    "diffuse",
    "twosided",
    "mask",
    "null",
    "dielectric",
    "thindielectric",
    "roughdielectric",
    "conductor",
    "roughconductor",
    "plastic",
    "roughplastic",
    "pplastic",
    "principled",
    "principledthin",
    "bumpmap",
    "normalmap",
    "blendbsdf",
    "hair",
    "measured",
    "measured_polarized",
    "circular",
    "polarizer",
    "retarder",
    "roughdiffuse",
    "phong",
    "ward",
    "coating",
    "roughcoating",
    "mixturebsdf",
    "difftrans",
    "hk",
    "irawan",
];
const EMITTERS: &[&str] = &[
    "area",
    "point",
    "spot",
    "directional",
    "constant",
    "envmap",
    "directionalarea",
    "projector",
    "sunsky",
    "timed_sunsky",
    "sky",
    "sun",
    "collimated",
];
const SENSORS: &[&str] = &[
    "perspective",
    "thinlens",
    "orthographic",
    "batch",
    "distant",
    "irradiancemeter",
    "radiancemeter",
    "fluencemeter",
    "spherical",
    "telecentric",
    "perspective_rdist",
];
const MEDIA: &[&str] = &["homogeneous", "heterogeneous"];
const PHASES: &[&str] = &[
    "isotropic",
    "hg",
    "rayleigh",
    "blendphase",
    "sggx",
    "tabphase",
    "microflake",
    "kkay",
    "mixturephase",
];
const VOLUMES: &[&str] = &["gridvolume", "constvolume", "volcache", "hgridvolume"];
const TEXTURES: &[&str] = &[
    "bitmap",
    "checkerboard",
    "mesh_attribute",
    "volume",
    "scale",
    "vertexcolors",
    "gridtexture",
    "wireframe",
    "curvature",
    "uniform",
    "srgb",
    "d65",
    "rawconstant",
    "blackbody",
    "irregular",
    "regular",
];
const FILMS: &[&str] = &["hdrfilm", "ldrfilm", "tiledhdrfilm", "mfilm", "specfilm"];

/// The plugins that an element of this tag may have; none for tags of which all are fine.
fn names(tag: &str) -> &'static [&'static str] {
    match tag {
        "shape" => SHAPES,
        "bsdf" => BSDFS,
        "emitter" => EMITTERS,
        "sensor" => SENSORS,
        "medium" => MEDIA,
        "phase" => PHASES,
        "volume" => VOLUMES,
        "texture" | "spectrum" => TEXTURES,
        "film" => FILMS,
        _ => &[],
    }
}

/// An error for a plugin that lvox does not take: `None` if it is one of Mitsuba's.
pub(super) fn unknown(element: &Element<'_>) -> Option<Error> {
    let (tag, kind) = (element.tag(), element.kind());
    let names = names(tag);
    if names.contains(&kind) {
        return None;
    }
    let error = match kind {
        "" => element.error(format_args!("<{tag}> has no `type`")),
        _ => element.error(format_args!("unknown {tag} `{kind}`")),
    };
    Some(match nearest(kind, names) {
        Some(near) if !kind.is_empty() => error.hint(format!("did you mean `{near}`?")),
        _ => error.hint(format!("known are {}", names.join(", "))),
    })
}
