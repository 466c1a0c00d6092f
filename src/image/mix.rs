//! Images of groups of lights added up: light is a sum, so that a frame is lit anew by factors on
//! what each group sends, without another ray.

use super::{Frame, Layer};
use crate::{Error, Result};
use serde_json::Value;
use std::collections::BTreeMap;
use std::path::PathBuf;
use std::str::FromStr;

/// The attribute that names the group of lights which alone lit an image.
pub const GROUP: &str = "lvox/group";
/// The attribute that has the number of the frame.
const FRAME: &str = "lvox/frame";
/// The attribute that has the settings of an image, the name of its camera among them.
const SETTINGS: &str = "lvox/settings";
/// Names of layers of the light of a group begin so.
pub const LIGHT: &str = "light.";
/// Layers of light of all groups: sums, as the beauty is.
const SUMS: [&str; 4] = ["direct", "environment", "indirect", "volume"];
/// A layer in which lights show as white, and other surfaces as they reflect: the largest is meant.
const ALBEDO: &str = "albedo";
/// A layer that cannot be added up as light is.
const VARIANCE: &str = "variance";

/// A factor on the light of a group.
#[derive(Clone, Debug, PartialEq)]
pub struct GroupScale {
    /// Name of the group.
    pub group: String,
    /// By channel.
    pub factor: [f32; 3],
}

impl FromStr for GroupScale {
    type Err = Error;

    /// Reads `KEY=FACTOR` or `KEY=R,G,B`.
    fn from_str(text: &str) -> Result<Self> {
        let wrong = || {
            Error::input(format!(
                "expected a group and a factor, as key=2 or key=2,1,1, found {text}"
            ))
        };
        let (group, factors) = text.split_once('=').ok_or_else(wrong)?;
        let factors: Vec<f32> = factors
            .split(',')
            .map(|f| f.trim().parse().ok())
            .collect::<Option<_>>()
            .ok_or_else(wrong)?;
        let factor = match factors[..] {
            [all] => [all; 3],
            [r, g, b] => [r, g, b],
            _ => return Err(wrong()),
        };
        let is_allowed = |f: &f32| (0.0..=1e30).contains(f);
        match factor.iter().all(is_allowed) && !group.is_empty() {
            true => Ok(Self {
                group: group.into(),
                factor,
            }),
            false => Err(wrong()),
        }
    }
}

/// An image that is to be added, and where it is from.
#[derive(Debug)]
pub struct Part {
    /// For messages.
    pub path: PathBuf,
    /// The group that alone lit it; `None` if it has a layer for each of its groups.
    pub group: Option<String>,
    /// The image.
    pub frame: Frame,
}

/// What images add up to.
#[derive(Debug)]
pub struct Mixed {
    /// The beauty, a layer `light.NAME` for each group, and the layers that all images have.
    pub frame: Frame,
    /// Names of the layers that could not be kept.
    pub left_out: Vec<String>,
}

/// Adds images up, with factors on the light of groups.
///
/// # Errors
/// [`crate::Kind::Input`] for images of different pixels, frames or cameras, a group that is there
/// twice, an image without groups, or a factor on a group that is not there.
pub fn mix(parts: Vec<Part>, scales: &[GroupScale]) -> Result<Mixed> {
    let Some(first) = parts.first() else {
        return Err(Error::input("there are no images to add up"));
    };
    let mut mixed = Frame::new(first.frame.width, first.frame.height, first.frame.region);
    mixed.attributes = shared_attributes(&parts);
    mixed.camera =
        (first.frame.camera).filter(|c| parts.iter().all(|p| p.frame.camera == Some(*c)));
    let lights = lights(&parts)?;
    check_scales(&lights, scales)?;
    let factor = |group: &str| {
        let scale = scales.iter().find(|s| s.group == group);
        scale.map_or([1.0; 3], |s| s.factor)
    };
    let mut beauty = Layer {
        name: String::new(),
        channels: zeros(&mixed),
    };
    let mut groups = Vec::new();
    for light in &lights {
        let mut layer = Layer {
            name: format!("{LIGHT}{}", light.group),
            channels: zeros(&mixed),
        };
        add(&mut layer, light.layer, factor(light.group), light.part)?;
        add(&mut beauty, &layer, [1.0; 3], light.part)?;
        groups.push(layer);
    }
    if let Some(alpha) = first.frame.layer("").and_then(|l| l.channel("A")) {
        beauty.channels.push(("A".into(), alpha.to_vec()));
    }
    mixed.layers.push(beauty);
    mixed.layers.extend(groups);
    let left_out = add_others(&mut mixed, &parts, &lights, factor)?;
    mixed.check()?;
    Ok(Mixed {
        frame: mixed,
        left_out,
    })
}

/// The light of a group.
struct GroupLight<'a> {
    group: &'a str,
    layer: &'a Layer,
    part: &'a Part,
}

/// The groups of all images, in their order.
fn lights(parts: &[Part]) -> Result<Vec<GroupLight<'_>>> {
    let mut lights: Vec<GroupLight> = Vec::new();
    for part in parts {
        let (frame, path) = (&part.frame, part.path.display());
        let first = &parts[0].frame;
        let pixels = |f: &Frame| (f.width, f.height, f.region);
        if pixels(frame) != pixels(first) {
            return Err(Error::input(format!(
                "{path}: expected the pixels of {}, {} of {}x{}, found {} of {}x{}",
                parts[0].path.display(),
                first.region,
                first.width,
                first.height,
                frame.region,
                frame.width,
                frame.height
            ))
            .hint("merge the tiles of each group first"));
        }
        check_view(&parts[0], part)?;
        let of_group = part.group.as_deref().zip(frame.layer(""));
        let layers = frame.layers.iter().filter_map(|layer| {
            let group = layer.name.strip_prefix(LIGHT)?;
            Some((group, layer))
        });
        let own: Vec<_> = match of_group {
            Some(light) => vec![light],
            None => layers.collect(),
        };
        if own.is_empty() {
            return Err(Error::input(format!(
                "{path}: expected the image of a group of lights, or one with layers {LIGHT}NAME, \
                 found neither"
            ))
            .hint("name its group as NAME=FILE"));
        }
        for (group, layer) in own {
            if let Some(other) = lights.iter().find(|l| l.group == group) {
                let other = other.part.path.display();
                return Err(Error::input(format!(
                    "the light of the group {group} is there twice: in {other} and in {path}"
                )));
            }
            lights.push(GroupLight { group, layer, part });
        }
    }
    Ok(lights)
}

/// Refuses an image that shows another frame than the first one, or shows it through another
/// camera: the sum would show both. What only one of them tells is no difference, as images may
/// have come through other programs.
fn check_view(first: &Part, part: &Part) -> Result<()> {
    let differ = |what: &str, told: [Option<String>; 2]| {
        let [Some(here), Some(there)] = told else {
            return Ok(());
        };
        if here == there {
            return Ok(());
        }
        Err(Error::input(format!(
            "{} does not belong to the frame of {}: {what} is {here}, there {there}",
            part.path.display(),
            first.path.display()
        ))
        .hint("add up groups of one frame only, seen by one camera"))
    };
    let both = [part, first];
    differ(FRAME, both.map(|p| p.frame.attributes.get(FRAME).cloned()))?;
    differ("the camera", both.map(camera_name))?;
    let (Some(here), Some(there)) = (part.frame.camera, first.frame.camera) else {
        return Ok(());
    };
    let [here, there] = [here, there].map(|c| [c.world_to_camera, c.world_to_ndc]);
    let names = ["worldToCamera", "worldToNDC"].into_iter();
    for (name, (here, there)) in names.zip(here.iter().zip(&there)) {
        if let Some(i) = first_difference(here, there) {
            let told = [here, there].map(|matrix| Some(matrix[i].to_string()));
            differ(&format!("{name}[{i}]"), told)?;
        }
    }
    Ok(())
}

/// The first place where matrices differ by more than rounding.
fn first_difference(a: &[f32; 16], b: &[f32; 16]) -> Option<usize> {
    const ROUNDING: f32 = 1e-4;
    let largest = a.iter().chain(b).fold(0.0_f32, |most, x| most.max(x.abs()));
    let are_close = |(a, b): (&f32, &f32)| (a - b).abs() <= ROUNDING * largest;
    a.iter().zip(b).position(|pair| !are_close(pair))
}

/// The camera by the name that the scene gives it.
fn camera_name(part: &Part) -> Option<String> {
    let settings: Value = serde_json::from_str(part.frame.attributes.get(SETTINGS)?).ok()?;
    settings["camera"].as_str().map(Into::into)
}

fn check_scales(lights: &[GroupLight<'_>], scales: &[GroupScale]) -> Result<()> {
    for (i, scale) in scales.iter().enumerate() {
        let group = &scale.group;
        if scales[..i].iter().any(|s| s.group == *group) {
            return Err(Error::input(format!("two factors on the group {group}")));
        }
        if lights.iter().all(|l| l.group != group) {
            let groups: Vec<&str> = lights.iter().map(|l| l.group).collect();
            return Err(Error::input(format!(
                "a factor on the group {group}: expected one of {}",
                groups.join(", ")
            )));
        }
    }
    Ok(())
}

const CHANNELS: [&str; 3] = ["R", "G", "B"];

fn zeros(frame: &Frame) -> Vec<(String, Vec<f32>)> {
    let channel = |name: &str| (name.to_owned(), vec![0.0; frame.region.pixels()]);
    CHANNELS.map(channel).into()
}

/// Adds light times a factor.
fn add(sum: &mut Layer, light: &Layer, factor: [f32; 3], part: &Part) -> Result<()> {
    for ((name, sum), factor) in sum.channels.iter_mut().zip(factor) {
        let Some(samples) = light.channel(name) else {
            let (path, layer) = (part.path.display(), &light.name);
            return Err(Error::input(format!(
                "{path}: expected channels R, G, B of the layer \"{layer}\", found no {name}"
            )));
        };
        for (sum, sample) in sum.iter_mut().zip(samples) {
            *sum += factor * sample;
        }
    }
    Ok(())
}

/// Adds the layers that are not of single groups; returns the names of those that cannot be told.
fn add_others(
    mixed: &mut Frame,
    parts: &[Part],
    lights: &[GroupLight<'_>],
    factor: impl Fn(&str) -> [f32; 3],
) -> Result<Vec<String>> {
    // The factor on all that an image shows, if there is one.
    let of_part = |part: &Part| {
        let own = lights.iter().filter(|l| std::ptr::eq(l.part, part));
        let mut factors = own.map(|l| factor(l.group));
        let first = factors.next()?;
        factors.all(|f| f == first).then_some(first)
    };
    let factors: Option<Vec<[f32; 3]>> = parts.iter().map(of_part).collect();
    let mut left_out = Vec::new();
    let is_other = |l: &&Layer| !l.name.is_empty() && !l.name.starts_with(LIGHT);
    for layer in parts.iter().flat_map(|p| &p.frame.layers).filter(is_other) {
        let name = &layer.name;
        if mixed.layer(name).is_some() || left_out.contains(name) {
            continue;
        }
        if !SUMS.contains(&&**name) && name != VARIANCE {
            let mut layer = layer.clone();
            if name == ALBEDO {
                let others = parts.iter().filter_map(|p| p.frame.layer(ALBEDO));
                others.for_each(|other| lighten(&mut layer, other));
            }
            mixed.layers.push(layer);
            continue;
        }
        let all: Option<Vec<&Layer>> = parts.iter().map(|p| p.frame.layer(name)).collect();
        let Some((all, factors)) = all.zip(factors.as_ref()).filter(|_| name != VARIANCE) else {
            left_out.push(name.clone());
            continue;
        };
        let mut sum = Layer {
            name: name.clone(),
            channels: zeros(mixed),
        };
        for ((layer, factor), part) in all.into_iter().zip(factors).zip(parts) {
            add(&mut sum, layer, *factor, part)?;
        }
        mixed.layers.push(sum);
    }
    Ok(left_out)
}

/// Takes the larger samples of two layers.
fn lighten(layer: &mut Layer, other: &Layer) {
    for (name, samples) in &mut layer.channels {
        let others = other.channel(name).unwrap_or_default();
        samples
            .iter_mut()
            .zip(others)
            .for_each(|(a, b)| *a = a.max(*b));
    }
}

/// What all images say of their origin.
fn shared_attributes(parts: &[Part]) -> BTreeMap<String, String> {
    let mut shared = parts[0].frame.attributes.clone();
    shared.remove(GROUP);
    shared.retain(|name, value| {
        let of = |p: &Part| p.frame.attributes.get(name) == Some(value);
        parts.iter().all(of)
    });
    shared
}

#[cfg(test)]
mod tests {
    use super::super::Region;
    use super::*;
    use crate::image::CameraMatrices;

    fn part(group: &str, value: f32) -> Part {
        let mut frame = Frame::new(2, 1, Region::full(2, 1));
        let light = [[value, 2.0 * value, 0.0], [0.0, value, 4.0]];
        frame.layers.push(Layer::rgb("", &light));
        frame.layers[0].channels.push(("A".into(), vec![1.0, 0.5]));
        frame.layers.push(Layer::rgb("direct", &light));
        let depth = vec![value, 1.0];
        frame.layers.push(Layer::single("depth", "Z", depth));
        frame.attributes.insert("lvox/scene".into(), group.into());
        frame.attributes.insert("lvox/version".into(), "1".into());
        Part {
            path: PathBuf::from(group),
            group: Some(group.into()),
            frame,
        }
    }

    fn scales(texts: &[&str]) -> Vec<GroupScale> {
        texts.iter().map(|t| t.parse().unwrap()).collect()
    }

    #[test]
    fn groups_add_up_to_the_beauty_and_again_with_factors() {
        let mixed = mix(vec![part("key", 1.0), part("fill", 2.0)], &[]).unwrap();
        let frame = mixed.frame;
        let names: Vec<&str> = frame.layers.iter().map(|l| &*l.name).collect();
        assert_eq!(names, ["", "light.key", "light.fill", "direct", "depth"]);
        assert_eq!(frame.layers[0].channel("R").unwrap(), [3.0, 0.0]);
        assert_eq!(frame.layers[0].channel("A").unwrap(), [1.0, 0.5]);
        assert_eq!(frame.layers[3].channel("B").unwrap(), [0.0, 8.0]);
        assert_eq!(frame.layers[4].channel("Z").unwrap(), [1.0, 1.0]);
        assert_eq!(Vec::from_iter(frame.attributes.keys()), ["lvox/version"]);

        // The image that came out is lit anew; what all groups sent together cannot be.
        let part = |group| Part {
            path: PathBuf::from("mixed"),
            group,
            frame: frame.clone(),
        };
        let lit = mix(vec![part(None)], &scales(&["key=2,1,0"])).unwrap();
        assert_eq!(lit.frame.layers[0].channel("R").unwrap(), [4.0, 0.0]);
        assert_eq!(lit.frame.layers[0].channel("B").unwrap(), [0.0, 4.0]);
        assert_eq!(lit.left_out, ["direct"]);
        let even = mix(vec![part(None)], &scales(&["key=2", "fill=2"])).unwrap();
        assert_eq!(
            even.frame.layer("direct").unwrap().channel("R").unwrap(),
            [6.0, 0.0]
        );
        assert!(even.left_out.is_empty());
    }

    #[test]
    fn what_does_not_belong_together_is_named() {
        let refused = |parts, texts: &[&str], words: &[&str]| {
            let error = mix(parts, &scales(texts)).unwrap_err().to_string();
            for word in words {
                assert!(error.contains(word), "{error}");
            }
        };
        refused(vec![], &[], &["no images"]);
        refused(
            vec![part("key", 1.0), part("key", 2.0)],
            &[],
            &["key", "twice"],
        );
        refused(vec![part("key", 1.0)], &["fil=2"], &["fil", "one of key"]);
        refused(
            vec![part("key", 1.0)],
            &["key=2", "key=1"],
            &["two factors"],
        );
        let mut other = part("fill", 1.0);
        other.frame.width = 3;
        refused(vec![part("key", 1.0), other], &[], &["fill", "3x1"]);
        let mut none = part("fill", 1.0);
        none.group = None;
        refused(vec![none], &[], &["fill", "light.NAME"]);
        let mut grey = part("fill", 1.0);
        grey.frame.layers[0].channels.remove(1);
        refused(vec![grey], &[], &["fill", "no G"]);
        let seen = |group, frame: &str, camera: &str, x: f32| {
            let mut part = part(group, 1.0);
            let told = [
                (FRAME, frame.to_owned()),
                (SETTINGS, format!(r#"{{"camera":"{camera}","samples":4}}"#)),
            ];
            let told = told.map(|(name, value)| (name.to_owned(), value));
            part.frame.attributes.extend(told);
            part.frame.camera = Some(CameraMatrices {
                world_to_camera: [x; 16],
                world_to_ndc: [0.5; 16],
            });
            part
        };
        let first = || seen("key", "2", "fly", 1.0);
        for (other, words) in [
            (
                seen("fill", "4", "fly", 1.0),
                ["fill", "frame of key", "lvox/frame is 4, there 2"],
            ),
            (
                seen("fill", "2", "front", 1.0),
                ["fill", "frame of key", "the camera is front, there fly"],
            ),
            (
                seen("fill", "2", "fly", 2.0),
                ["fill", "frame of key", "worldToCamera[0] is 2, there 1"],
            ),
        ] {
            refused(vec![first(), other], &[], &words);
        }
        mix(vec![first(), seen("fill", "2", "fly", 1.000_01)], &[]).unwrap();
        mix(vec![first(), part("fill", 1.0)], &[]).unwrap();
        for wrong in ["key", "key=", "key=1,2", "key=-1", "key=nan", "=2"] {
            assert!(wrong.parse::<GroupScale>().is_err(), "{wrong}");
        }
    }
}
