//! Presets of 3D Slicer's volume rendering (`.vp.json`): opacity and colour of values, as media.
//!
//! An opacity a over the unit distance d is an extinction of -ln(1 - a) / d. Colours, which are
//! encoded as on screens, become albedos such that a thick layer looks so. Each colour of the
//! preset is a medium; from one point to the next its share of the extinction goes over to the
//! next. Alike ones are joined until there are few. Shading, lighting and opacity by gradients are
//! left out.

use super::colors::linear_from_srgb;
use super::files::Files;
use super::scale::{Density, Scale};
use crate::{Error, Result};
use serde_json::Value;
use std::path::Path;

/// Media that a preset becomes, at most.
const MAX_BANDS: usize = 5;
/// Points of a function, at most.
const MAX_POINTS: usize = 1024;
/// Opacities above this are taken as this: no light gets through.
const OPAQUE: f64 = 0.999;
/// Pieces of each line between two points: what is straight in opacity is none in extinction.
const PIECES: usize = 16;

/// What the schema's address has in it.
const SCHEMA: &str = "volume-property-schema-v1.";

/// A preset: the media that values become.
#[derive(Debug, PartialEq)]
pub(super) struct Transfer {
    bands: Vec<Band>,
}

/// One medium of a preset.
#[derive(Debug, PartialEq)]
struct Band {
    albedo: [f64; 3],
    /// Points of value and extinction per unit of the file.
    curve: Vec<[f64; 2]>,
}

/// A function of values: points, with lines between them.
type Points<const N: usize> = Vec<(f64, [f64; N])>;

impl Transfer {
    /// Reads a preset, and notes how far the media are from its colours.
    pub(super) fn read(content: &[u8], path: &Path, files: &mut Files) -> Result<Self> {
        let document: Value = serde_json::from_slice(content).map_err(|e| {
            Error::input(format!("expected a preset in JSON, found none: {e}")).hint(
                "3D Slicer 5.10 and later save volume properties as .vp.json; open older ones \
                 there and save them anew",
            )
        })?;
        let schema = document.get("@schema").and_then(Value::as_str);
        if !schema.is_some_and(|s| s.contains(SCHEMA)) {
            let found: String = schema.unwrap_or("none").chars().take(200).collect();
            return Err(Error::input(format!(
                "expected the schema {SCHEMA}0.0.json of 3D Slicer in `@schema`, found {found}"
            )));
        }
        let components = &document["volumeProperties"][0]["components"];
        let component = &components[0];
        let unit = match component.get("scalarOpacityUnitDistance") {
            None => 1.0,
            Some(unit) => unit
                .as_f64()
                .filter(|d| (1e-15..=1e15).contains(d))
                .ok_or_else(|| {
                    Error::input(format!(
                        "expected a distance above 0 in `scalarOpacityUnitDistance`, found {unit}"
                    ))
                })?,
        };
        let mut odd = Vec::new();
        let opacity = points::<1>(component, "scalarOpacity", &mut odd)?;
        let colors = points::<3>(component, "rgbTransferFunction", &mut odd)?;
        let has_gradients = component["disableGradientOpacity"] != Value::Bool(true)
            && points::<1>(component, "gradientOpacity", &mut odd)
                .is_ok_and(|g| g.iter().any(|(_, [y])| *y != 1.0));
        if has_gradients {
            odd.push("opacity by gradients is left out".into());
        }
        if components.as_array().is_some_and(|all| all.len() > 1) {
            odd.push("all components but the first are left out".into());
        }
        for what in odd {
            files.warn(format!("{}: {what}", path.display()));
        }
        let (transfer, error) = Self::of(&opacity, &colors, unit);
        if transfer.bands.is_empty() {
            return Err(Error::input(
                "no value has an opacity above 0: there is nothing to render",
            ));
        }
        files.note(format!(
            "{}: a preset of {} colours as {} media; albedos are off by at most {error:.3}",
            path.display(),
            colors.len(),
            transfer.bands.len()
        ));
        Ok(transfer)
    }

    /// The media of two functions, and the largest difference between what they scatter and what
    /// they should, as an albedo.
    fn of(opacity: &Points<1>, colors: &Points<3>, unit: f64) -> (Self, f64) {
        let values = values(opacity, colors);
        let sigma_t = |value: f64| {
            let [a] = at(opacity, value);
            -libm::log1p(-a.clamp(0.0, OPAQUE)) / unit
        };
        // How much of each colour there is.
        let share = |i: usize, value: f64| share(colors, i, value);
        let weight = |i: usize| {
            let pieces = values.windows(2);
            let piece = |v: &[f64]| {
                let middle = 0.5 * (v[0] + v[1]);
                sigma_t(middle) * share(i, middle) * (v[1] - v[0])
            };
            // What is beyond the ends counts, too, if little.
            pieces.map(piece).sum::<f64>()
                + [values[0], values[values.len() - 1]]
                    .map(|v| 1e-6 * sigma_t(v) * share(i, v))
                    .iter()
                    .sum::<f64>()
        };
        let mut groups: Vec<Group> = (0..colors.len())
            .map(|i| Group {
                colors: vec![i],
                albedo: colors[i].1.map(albedo),
                weight: weight(i),
            })
            .filter(|group| group.weight > 0.0)
            .collect();
        join(&mut groups);
        let bands = groups.iter().map(|group| Band {
            albedo: group.albedo,
            curve: values
                .iter()
                .map(|&v| {
                    let share: f64 = group.colors.iter().map(|&i| share(i, v)).sum();
                    [v, sigma_t(v) * share]
                })
                .collect(),
        });
        let bands: Vec<Band> = bands.collect();
        let mut error = 0.0_f64;
        for (i, &value) in values.iter().enumerate() {
            let total = sigma_t(value);
            if total <= 0.0 {
                continue;
            }
            let wanted = at(colors, value).map(albedo);
            for (c, wanted) in wanted.into_iter().enumerate() {
                let scattered = bands.iter().map(|b| b.curve[i][1] * b.albedo[c]);
                error = error.max((scattered.sum::<f64>() / total - wanted).abs());
            }
        }
        (Self { bands }, error)
    }

    /// The media, with a factor on all extinctions.
    pub(super) fn bands(&self, factor: f64) -> Vec<(Scale, [f32; 3])> {
        let band = |band: &Band| {
            let scale = Scale {
                sigma_t: factor,
                density: Density::Curve(band.curve.clone()),
            };
            (scale, band.albedo.map(|a| a as f32))
        };
        self.bands.iter().map(band).collect()
    }
}

/// Colours that are one medium.
struct Group {
    colors: Vec<usize>,
    albedo: [f64; 3],
    weight: f64,
}

/// Joins those that are the same, and then the two that cost least until there are few.
fn join(groups: &mut Vec<Group>) {
    loop {
        let mut best: Option<(f64, usize, usize)> = None;
        for j in 1..groups.len() {
            for i in 0..j {
                let (a, b) = (&groups[i], &groups[j]);
                let difference = (0..3).map(|c| a.albedo[c] - b.albedo[c]);
                let difference = difference.map(|d| d * d).sum::<f64>();
                let cost = difference * a.weight * b.weight / (a.weight + b.weight);
                if best.is_none_or(|(least, ..)| cost < least) {
                    best = Some((cost, i, j));
                }
            }
        }
        let Some((cost, i, j)) = best.filter(|(cost, ..)| *cost == 0.0 || groups.len() > MAX_BANDS)
        else {
            return;
        };
        let other = groups.remove(j);
        let group = &mut groups[i];
        let weight = group.weight + other.weight;
        if cost > 0.0 {
            group.albedo = std::array::from_fn(|c| {
                (group.albedo[c] * group.weight + other.albedo[c] * other.weight) / weight
            });
        }
        group.weight = weight;
        group.colors.extend(other.colors);
    }
}

/// The single-scattering albedo of a thick medium that reflects so much of the light of one
/// channel, which is encoded as on screens (Chiang, Kutz and Burley 2016, after van de Hulst).
fn albedo(encoded: f64) -> f64 {
    let r = f64::from(linear_from_srgb(encoded.clamp(0.0, 1.0) as f32));
    let s = 4.09712 + 4.20863 * r - (9.59217 + 41.6808 * r + 17.7126 * r * r).sqrt();
    (1.0 - s * s).clamp(0.0, 1.0)
}

/// The values at which the curves of bands have points.
fn values(opacity: &Points<1>, colors: &Points<3>) -> Vec<f64> {
    let knees = opacity
        .iter()
        .map(|p| p.0)
        .chain(colors.iter().map(|p| p.0));
    let mut knees: Vec<f64> = knees.collect();
    knees.sort_by(f64::total_cmp);
    knees.dedup();
    let mut values = Vec::new();
    for pair in knees.windows(2) {
        let piece = |i: usize| pair[0] + (pair[1] - pair[0]) * i as f64 / PIECES as f64;
        values.extend((0..PIECES).map(piece));
    }
    values.extend(knees.last());
    values
}

/// The share of a point in the function at a value: 1 there, and 0 from the next on.
fn share<const N: usize>(points: &Points<N>, i: usize, value: f64) -> f64 {
    let x = |i: usize| points[i].0;
    let after = points.partition_point(|p| p.0 <= value);
    match after.checked_sub(1) {
        None => f64::from(u8::from(i == 0)),
        Some(before) if after == points.len() => f64::from(u8::from(i == before)),
        Some(before) => {
            let t = (value - x(before)) / (x(after) - x(before));
            match i {
                _ if i == before => 1.0 - t,
                _ if i == after => t,
                _ => 0.0,
            }
        }
    }
}

/// The function at a value.
fn at<const N: usize>(points: &Points<N>, value: f64) -> [f64; N] {
    let after = points.partition_point(|p| p.0 <= value);
    let near = [after.saturating_sub(1), after.min(points.len() - 1)];
    let mut sum = [0.0; N];
    for (n, &i) in near.iter().enumerate() {
        if n == 1 && near[0] == near[1] {
            break;
        }
        let share = share(points, i, value);
        (0..N).for_each(|c| sum[c] += share * points[i].1[c]);
    }
    sum
}

/// The points of a function of a component, whose values rise.
fn points<const N: usize>(
    component: &Value,
    name: &str,
    odd: &mut Vec<String>,
) -> Result<Points<N>> {
    let list = component[name]["points"].as_array();
    let list = list.filter(|list| (1..=MAX_POINTS).contains(&list.len()));
    let list = list.ok_or_else(|| {
        Error::input(format!(
            "expected 1 to {MAX_POINTS} points in \
             `volumeProperties[0].components[0].{name}.points`, found none, or more"
        ))
    })?;
    let mut points = Points::<N>::new();
    for (i, point) in list.iter().enumerate() {
        let wrong = |what: &str| {
            let found: String = point.to_string().chars().take(120).collect();
            Error::input(format!(
                "point {} of `{name}`: expected {what}, found {found}",
                i + 1
            ))
        };
        let x = point["x"].as_f64().ok_or_else(|| wrong("a number `x`"))?;
        let share = |v: &Value| v.as_f64().filter(|v| (0.0..=1.0).contains(v));
        let mut y = [0.0; N];
        if N == 1 {
            y[0] = share(&point["y"]).ok_or_else(|| wrong("`y` from 0 to 1"))?;
        } else {
            for (c, y) in y.iter_mut().enumerate() {
                *y = share(&point["color"][c])
                    .ok_or_else(|| wrong("`color`, three numbers from 0 to 1"))?;
            }
        }
        if points.last().is_some_and(|(before, _)| *before > x) {
            return Err(wrong("values `x` that rise"));
        }
        let is_plain = |key: &str, plain: f64| {
            point.get(key).and_then(Value::as_f64).unwrap_or(plain) == plain
        };
        if !(is_plain("midpoint", 0.5) && is_plain("sharpness", 0.0)) {
            let what = format!("lines between the points of `{name}` are taken as straight");
            if !odd.contains(&what) {
                odd.push(what);
            }
        }
        points.push((x, y));
    }
    Ok(points)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn preset(points: &str, colors: &str) -> String {
        format!(
            r#"{{"@schema": "https://raw.githubusercontent.com/slicer/slicer/main/Modules/Loadable/VolumeRendering/Resources/Schema/volume-property-schema-v1.0.0.json#",
            "volumeProperties": [{{"components": [{{"scalarOpacityUnitDistance": 2.0,
            "scalarOpacity": {{"type": "piecewiseLinearFunction", "points": [{points}]}},
            "rgbTransferFunction": {{"type": "colorTransferFunction", "points": [{colors}]}}}}]}}]}}"#
        )
    }

    const OPACITY: &str = r#"{"x": 0, "y": 0}, {"x": 100, "y": 0.5}, {"x": 200, "y": 1}"#;
    const COLORS: &str = r#"{"x": 0, "color": [0, 0, 0]}, {"x": 100, "color": [1, 0.5, 0.25]},
        {"x": 150, "color": [1, 0.5, 0.25]}, {"x": 200, "color": [1, 1, 1]}"#;

    fn read(text: &str) -> Result<(Transfer, Files)> {
        let mut files = Files::default();
        let transfer = Transfer::read(text.as_bytes(), Path::new("a.vp.json"), &mut files)?;
        Ok((transfer, files))
    }

    #[test]
    fn media_have_the_extinction_and_the_colours_of_the_preset() {
        let (transfer, files) = read(&preset(OPACITY, COLORS)).unwrap();
        assert!(files.warnings.is_empty(), "{:?}", files.warnings);
        let bands = transfer.bands(1.0);
        assert_eq!(bands.len(), 3, "the colour that is there twice is one");
        let sum = |value: f32| bands.iter().map(|(s, _)| s.apply(value)).sum::<f32>();
        let expected = |a: f64| (-(1.0 - a).ln() / 2.0) as f32;
        for (value, a) in [
            (0.0, 0.0),
            (50.0, 0.25),
            (100.0, 0.5),
            (125.0, 0.625),
            (999.0, 0.999),
        ] {
            let (found, expected) = (sum(value), expected(a));
            assert!(
                (found - expected).abs() < 1e-5 * (1.0 + expected),
                "{value}: {found} {expected}"
            );
        }
        let [_, middle, white] = &bands[..] else {
            unreachable!()
        };
        assert_eq!(white.1, [1.0; 3]);
        assert_eq!(middle.0.apply(125.0), sum(125.0), "one colour alone");
        assert!((middle.0.apply(175.0) - 0.5 * sum(175.0)).abs() < 1e-6);
        // What a thick layer of the albedo reflects.
        let reflected = |albedo: f64| {
            let s = (1.0 - albedo).sqrt();
            (1.0 - 0.139 * s) * (1.0 - s) / (1.0 + 1.17 * s)
        };
        for c in 0..3 {
            let color = f64::from(linear_from_srgb([1.0, 0.5, 0.25][c]));
            let found = reflected(middle.1[c].into());
            assert!((found - color).abs() < 0.02, "{found} {color}");
        }
        assert!(
            files.notes[0].contains("4 colours as 3 media"),
            "{:?}",
            files.notes
        );
    }

    #[test]
    fn alike_colours_are_joined_until_there_are_few() {
        let colors: Vec<String> = (0..20)
            .map(|i| {
                format!(
                    r#"{{"x": {}, "color": [{}, 0.5, 0.5]}}"#,
                    10 * i,
                    f64::from(i) / 19.0
                )
            })
            .collect();
        let (transfer, files) = read(&preset(OPACITY, &colors.join(","))).unwrap();
        assert_eq!(transfer.bands.len(), MAX_BANDS);
        let sum = |value: f32| {
            transfer
                .bands(3.0)
                .iter()
                .map(|(s, _)| s.apply(value))
                .sum::<f32>()
        };
        assert!((sum(100.0) - 3.0 * 0.5 * 2.0_f32.ln()).abs() < 1e-4);
        let error: f64 = files.notes[0].rsplit(' ').next().unwrap().parse().unwrap();
        assert!(error > 0.0 && error < 0.3, "{error}");
    }

    #[test]
    fn what_is_no_preset_is_refused_in_a_line() {
        let good = preset(OPACITY, COLORS);
        for (text, says) in [
            ("x".into(), "expected a preset in JSON"),
            (good.replace("-v1.0.0", "-v2.0.0"), "expected the schema"),
            ("{}".into(), "found none"),
            (
                good.replace("scalarOpacity\"", "opacity\""),
                "components[0].scalarOpacity.points",
            ),
            (
                good.replace("\"y\": 0.5", "\"y\": 1.5"),
                "point 2 of `scalarOpacity`: expected `y` from 0 to 1",
            ),
            (
                good.replace("\"x\": 150", "\"x\": 50"),
                "point 3 of `rgbTransferFunction`: expected values `x` that rise",
            ),
            (
                good.replace("Distance\": 2.0", "Distance\": 0"),
                "a distance above 0",
            ),
            (preset(r#"{"x": 0, "y": 0}"#, COLORS), "nothing to render"),
        ] {
            let message = read(&text).err().unwrap().to_string();
            assert!(
                message.contains(says) && !message.contains('\n'),
                "{message}"
            );
        }
        let bent = good.replace("\"y\": 0.5", "\"y\": 0.5, \"midpoint\": 0.3");
        let (_, files) = read(&bent).unwrap();
        assert!(files.warnings[0].contains("taken as straight"));
    }
}
