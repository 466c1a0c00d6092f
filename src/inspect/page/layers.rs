//! The layers of an image as a view holds them: the very values of the file.

use super::data::Data;
use crate::image::exr::{Info, Precision};
use crate::image::{EXPOSURE, Frame};
use half::f16;
use serde_json::{Value, json};

/// Pixels of a layer, at most; of a larger image each k-th along both sides is kept.
pub const MAX_PIXELS: usize = 1 << 20;
/// Values of all channels, at most.
pub const MAX_VALUES: usize = 12 << 20;

/// How many pixels along each side one that is kept stands for.
fn stride(width: usize, height: usize, channels: usize) -> usize {
    let kept = |k: usize| width.div_ceil(k) * height.div_ceil(k);
    let fits = |k: usize| kept(k) <= MAX_PIXELS && kept(k) * channels <= MAX_VALUES;
    let mut k = 1;
    while !fits(k) && k < width.max(height) {
        k += 1;
    }
    k
}

/// Describes the layers for the script, and adds their values to the data: 16-bit floats where the
/// file has no more, else 32 bits, low bytes first, each byte of all values together.
pub fn layers(frame: &Frame, info: &Info, data: &mut Data) -> Value {
    let (width, height) = (
        frame.region.width() as usize,
        frame.region.height() as usize,
    );
    let channels = frame.layers.iter().map(|l| l.channels.len()).sum();
    let k = stride(width, height, channels);
    let columns = (0..width).step_by(k);
    let kept: Vec<usize> = (0..height)
        .step_by(k)
        .flat_map(|y| columns.clone().map(move |x| y * width + x))
        .collect();
    let mut layers = Vec::new();
    for layer in &frame.layers {
        let mut channels = Vec::new();
        for (name, samples) in &layer.channels {
            let full_name = match layer.name.as_str() {
                "" => name.clone(),
                layer => format!("{layer}.{name}"),
            };
            let bits = match info.channels.get(&full_name) {
                Some(Precision::Half) => 16,
                _ => 32,
            };
            let mut planes = vec![Vec::with_capacity(kept.len()); bits / 8];
            for &at in &kept {
                let v = samples[at];
                let bytes = match bits {
                    16 => u32::from(f16::from_f32(v).to_bits()),
                    _ => v.to_bits(),
                }
                .to_le_bytes();
                for (plane, byte) in planes.iter_mut().zip(bytes) {
                    plane.push(byte);
                }
            }
            channels.push(json!({
                "name": name,
                "bits": bits,
                "data": data.add_deflated(&planes.concat()),
            }));
        }
        layers.push(json!({"name": layer.name, "channels": channels}));
    }
    let exposure = info.attributes.get(EXPOSURE);
    let exposure = exposure.and_then(|e| e.parse::<f32>().ok());
    json!({
        "width": width.div_ceil(k),
        "height": height.div_ceil(k),
        "stride": k,
        "x0": frame.region.x0,
        "y0": frame.region.y0,
        "frame": [frame.width, frame.height],
        "exposure": exposure.filter(|e| e.is_finite() && *e > 0.0).unwrap_or(1.0),
        "layers": layers,
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_is_kept_has_room() {
        for (width, height, channels) in [
            (1024, 1024, 3),
            (1025, 1024, 3),
            (1024, 1024, 40),
            (1 << 20, 3, 3),
            (1, 1, 1),
            (10, 1, 99_000_000),
        ] {
            let k = stride(width, height, channels);
            let kept = width.div_ceil(k) * height.div_ceil(k);
            assert!(kept <= MAX_PIXELS && (kept * channels <= MAX_VALUES || kept == 1));
        }
        assert_eq!(stride(1024, 1024, 12), 1);
        assert_eq!(stride(1025, 1024, 12), 2);
    }
}
