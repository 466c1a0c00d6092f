//! Pictures from files of either kind, and the exposure that a reference is looked at with.

use super::frame::EXPOSURE;
use super::{ImageKind, Picture, Region, exr, npy, png, tone};
use crate::{Error, Result};
use serde_json::Value;
use std::path::Path;

/// Reads linear RGB from an OpenEXR, a PNG or a NumPy file; which it is, its first bytes say.
/// Eight-bit values are taken through the inverse of the tone map at `exposure`. The layer `""` is
/// the beauty, the only one that a PNG file has. `None` for the region means the whole frame.
///
/// # Errors
/// [`crate::Kind::Input`] if the file cannot be read, has no colour in that layer, or does not
/// cover the region.
pub fn picture(path: &Path, layer: &str, exposure: f32, region: Option<Region>) -> Result<Picture> {
    match ImageKind::of(path)? {
        Some(ImageKind::Exr) => {
            let frame = exr::read(path)?;
            let region = region.unwrap_or(Region::full(frame.width, frame.height));
            let picture = frame.picture(layer, &region);
            picture.map_err(|e| e.at(path.display()))
        }
        Some(ImageKind::Png) if !layer.is_empty() => Err(Error::input(format!(
            "{} is a PNG file, which has no layer {layer}",
            path.display()
        ))),
        Some(ImageKind::Png) => {
            let whole = tone::unmap(&png::read(path)?, exposure);
            let Some(region) = region else {
                return Ok(whole);
            };
            whole.crop(&region).map_err(|e| e.at(path.display()))
        }
        Some(ImageKind::Npy) if !layer.is_empty() => Err(Error::input(format!(
            "{} is a NumPy file, which names no layer {layer}",
            path.display()
        ))),
        Some(ImageKind::Npy) => npy::read(path, region),
        None => Err(Error::input(format!(
            "{} is neither OpenEXR nor PNG nor NumPy",
            path.display()
        ))
        .hint("convert it: oiiotool in -o out.exr")),
    }
}

/// Finds the exposure that belongs to a reference image: beside `NAME.exr` a side-car `NAME.json`
/// names, under `scene`, the scene's JSON file in the same folder, whose `tonemap.exposure` it is;
/// else what the image [notes](noted_exposure). `None` if neither tells. A side-car that names a
/// scene of another format tells none.
///
/// # Errors
/// [`crate::Kind::Input`] if a file of that chain is damaged or not there.
pub fn exposure_of(reference: &Path) -> Result<Option<f32>> {
    match side_car_exposure(reference)? {
        Some(exposure) => Ok(Some(exposure)),
        None => noted_exposure(reference),
    }
}

/// Reads the exposure of the scene's film from the header of an OpenEXR file that lvox wrote;
/// `None` for other files.
///
/// # Errors
/// [`crate::Kind::Input`] if the file cannot be read, or what it notes is not a positive number.
pub fn noted_exposure(image: &Path) -> Result<Option<f32>> {
    let Some(info) = header(image)? else {
        return Ok(None);
    };
    let Some(text) = info.attributes.get(EXPOSURE) else {
        return Ok(None);
    };
    match text.parse::<f32>() {
        Ok(e) if e > 0.0 && e.is_finite() => Ok(Some(e)),
        _ => Err(Error::input(format!(
            "{}: {EXPOSURE} is {text}, not a positive number",
            image.display()
        ))
        .hint("give the exposure: `exposure` E")),
    }
}

/// Reads the header of an OpenEXR file; `None` for other files.
///
/// # Errors
/// [`crate::Kind::Input`] if the file cannot be read or is damaged.
pub fn header(image: &Path) -> Result<Option<exr::Info>> {
    match ImageKind::of(image)? {
        Some(ImageKind::Exr) => exr::info(image).map(Some),
        _ => Ok(None),
    }
}

fn side_car_exposure(reference: &Path) -> Result<Option<f32>> {
    let side_car = reference.with_extension("json");
    if side_car == reference || !side_car.is_file() {
        return Ok(None);
    }
    let value = json(&side_car)?;
    let Some(scene) = value.get("scene").and_then(Value::as_str) else {
        return Ok(None);
    };
    let scene = side_car.with_file_name(scene);
    if !scene
        .extension()
        .is_some_and(|e| e.eq_ignore_ascii_case("json"))
    {
        return Ok(None);
    }
    let value = json(&scene).map_err(|e| {
        e.at(format!("the scene of {}", side_car.display()))
            .hint("give the exposure: `exposure` E")
    })?;
    let Some(exposure) = value.pointer("/tonemap/exposure") else {
        return Ok(None);
    };
    match exposure.as_f64() {
        Some(e) if e > 0.0 && (e as f32).is_finite() => Ok(Some(e as f32)),
        _ => Err(Error::input(format!(
            "{}: tonemap.exposure is {exposure}, not a positive number",
            scene.display()
        ))
        .hint("give the exposure: `exposure` E")),
    }
}

fn json(path: &Path) -> Result<Value> {
    let text = std::fs::read_to_string(path).map_err(|e| Error::io("read", path, &e))?;
    serde_json::from_str(&text)
        .map_err(|e| Error::input(format!("{} is not valid JSON: {e}", path.display())))
}

#[cfg(test)]
mod tests {
    use super::super::{Frame, Layer};
    use super::*;
    use std::fs::write;

    #[test]
    fn the_side_car_leads_to_the_exposure() {
        let dir = tempfile::tempdir().unwrap();
        let image = dir.path().join("S_d3.exr");
        let mut frame = Frame::new(1, 1, Region::full(1, 1));
        frame.layers.push(Layer::rgb("", &[[1.0; 3]]));
        let mut put = |exposure: &str| {
            let name = EXPOSURE.to_owned();
            frame.attributes.insert(name, exposure.into());
            exr::write(&image, &frame, exr::Precision::Half).unwrap();
        };
        put("-1");
        let error = exposure_of(&image).unwrap_err();
        assert!(error.hint_text().unwrap().contains("`exposure`"));
        put("0.35");
        assert_eq!(exposure_of(&image).unwrap(), Some(0.35));
        write(dir.path().join("S_d3.json"), r#"{"scene": "S.toml"}"#).unwrap();
        assert_eq!(exposure_of(&image).unwrap(), Some(0.35));
        write(dir.path().join("S_d3.json"), r#"{"scene": "S.json"}"#).unwrap();
        let error = exposure_of(&image).unwrap_err();
        assert!(error.to_string().contains("S_d3.json") && error.to_string().contains("S.json"));
        write(
            dir.path().join("S.json"),
            r#"{"tonemap": {"exposure": 2.5}}"#,
        )
        .unwrap();
        assert_eq!(exposure_of(&image).unwrap(), Some(2.5));
        write(
            dir.path().join("S.json"),
            r#"{"tonemap": {"exposure": -1}}"#,
        )
        .unwrap();
        assert!(
            exposure_of(&image)
                .unwrap_err()
                .hint_text()
                .unwrap()
                .contains("`exposure`")
        );
        write(dir.path().join("S.json"), "{}").unwrap();
        assert_eq!(exposure_of(&image).unwrap(), Some(0.35));
        write(dir.path().join("S_d3.json"), "{").unwrap();
        assert!(exposure_of(&image).is_err());
    }

    #[test]
    fn both_kinds_are_known_by_their_bytes() {
        let dir = tempfile::tempdir().unwrap();
        let (exr_path, png_path) = (dir.path().join("a"), dir.path().join("b"));
        let mut frame = Frame::new(3, 2, Region::full(3, 2));
        frame.layers.push(Layer::rgb("", &[[0.25, 0.5, 0.0]; 6]));
        exr::write(&exr_path, &frame, exr::Precision::Half).unwrap();
        let linear = picture(&exr_path, "", 1.0, None).unwrap();
        png::write(&png_path, &tone::map(&linear, 2.0)).unwrap();
        let display = picture(&png_path, "", 2.0, None).unwrap();
        assert_eq!(tone::map(&display, 2.0), tone::map(&linear, 2.0));
        let region = Region {
            x0: 1,
            y0: 1,
            x1: 3,
            y1: 2,
        };
        for path in [&exr_path, &png_path] {
            let part = picture(path, "", 2.0, Some(region)).unwrap();
            assert_eq!((part.width, part.height, part.pixels.len()), (2, 1, 2));
            assert!(picture(path, "", 2.0, Some(Region::full(4, 4))).is_err());
        }
        write(&exr_path, "P6").unwrap();
        assert!(
            picture(&exr_path, "", 1.0, None)
                .unwrap_err()
                .to_string()
                .contains("neither")
        );
    }
}
