//! Files that come back, and files that are damaged.

use super::*;

fn sample(region: Region) -> Frame {
    let mut frame = Frame::new(37, 41, region);
    let pixels: Vec<[f32; 3]> = (0..region.pixels())
        .map(|i| [i as f32 / 64.0, 0.25, -1.5])
        .collect();
    frame.layers.push(Layer::rgb("", &pixels));
    frame.layers.push(Layer::single(
        "depth",
        "Z",
        pixels.iter().map(|p| 1e6 + p[0]).collect(),
    ));
    frame.layers.push(Layer::rgb("direct", &pixels));
    frame.layers.push(Layer::xyz("normal", &pixels));
    for name in ["lvox/tree", "lvox/settings", "lvox/version", "lvox/scene"] {
        frame
            .attributes
            .insert(name.into(), format!("{name} \u{3c3}=1"));
    }
    frame.camera = Some(CameraMatrices {
        world_to_camera: std::array::from_fn(|i| i as f32),
        world_to_ndc: std::array::from_fn(|i| -0.1 * i as f32),
    });
    frame
}

#[test]
fn tiles_survive_a_round_trip() {
    let dir = tempfile::tempdir().unwrap();
    let path = dir.path().join("tile.exr");
    for region in [
        Region::full(37, 41),
        Region {
            x0: 5,
            y0: 7,
            x1: 36,
            y1: 40,
        },
        Region {
            x0: 36,
            y0: 40,
            x1: 37,
            y1: 41,
        },
    ] {
        for precision in [Precision::Half, Precision::Float] {
            let frame = sample(region);
            write(&path, &frame, precision).unwrap();
            assert_eq!(read(&path).unwrap(), frame);
            let info = info(&path).unwrap();
            assert_eq!(info.precision(), precision);
            assert_eq!(info.region, region);
        }
    }
}

#[test]
fn bytes_are_the_same_every_time() {
    let frame = sample(Region::full(37, 41));
    let once = encode(&frame, Precision::Half).unwrap();
    for _ in 0..20 {
        assert_eq!(encode(&frame, Precision::Half).unwrap(), once);
    }
}

#[test]
fn bright_pixels_stay_finite_in_half() {
    let dir = tempfile::tempdir().unwrap();
    let path = dir.path().join("bright.exr");
    let mut frame = Frame::new(2, 1, Region::full(2, 1));
    frame.layers.push(Layer::rgb(
        "",
        &[[1e30, -1e30, 0.5], [f32::INFINITY, f32::NAN, 0.0]],
    ));
    frame
        .layers
        .push(Layer::single("variance", "Y", vec![1e30, 1e-30]));
    write(&path, &frame, Precision::Half).unwrap();
    let expected = Clamped {
        samples: 2,
        channels: vec!["R".into(), "G".into()],
    };
    assert_eq!(clamped(&frame, Precision::Half), expected);
    assert_eq!(clamped(&frame, Precision::Float), Clamped::default());
    let back = read(&path).unwrap();
    let beauty = back.layer("").unwrap();
    assert_eq!(beauty.channel("R").unwrap(), [65504.0, f32::INFINITY]);
    assert_eq!(beauty.channel("G").unwrap()[0], -65504.0);
    assert!(beauty.channel("G").unwrap()[1].is_nan());
    assert_eq!(
        back.layer("variance").unwrap().channel("Y").unwrap(),
        [1e30, 1e-30]
    );
}

#[test]
fn overscan_is_dropped_and_the_corner_is_the_origin() {
    let dir = tempfile::tempdir().unwrap();
    let path = dir.path().join("overscan.exr");
    let list = ["B", "G", "R"].map(|name| {
        let samples = (0..6 * 5).map(|i| i as f32).collect();
        AnyChannel::new(name, FlatSamples::F32(samples))
    });
    let attributes = LayerAttributes {
        layer_position: Vec2(-11, 99),
        ..LayerAttributes::default()
    };
    let layer = exr::image::Layer::new(
        (6, 5),
        attributes,
        Encoding::SMALL_FAST_LOSSLESS,
        AnyChannels::sort(list.into_iter().collect()),
    );
    // One column and one row of the data lie outside on the left and on the top.
    let window = IntegerBounds::new((-10, 100), (20, 3));
    let image = Image::new(ImageAttributes::new(window), layer);
    image.write().to_file(&path).unwrap();
    let frame = read(&path).unwrap();
    assert_eq!((frame.width, frame.height), (20, 3));
    assert_eq!(
        frame.region,
        Region {
            x0: 0,
            y0: 0,
            x1: 5,
            y1: 3
        }
    );
    let red = frame.layer("").unwrap().channel("R").unwrap();
    assert_eq!(red[0], 7.0);
    assert_eq!(red[5], 13.0);
}

#[test]
fn damaged_files_are_input_errors() {
    let dir = tempfile::tempdir().unwrap();
    let path = dir.path().join("damaged.exr");
    let whole = encode(&sample(Region::full(37, 41)), Precision::Half).unwrap();
    for length in [0, 3, 8, 100, 400, whole.len() / 2, whole.len() - 1] {
        std::fs::write(&path, &whole[..length]).unwrap();
        let error = read(&path).unwrap_err();
        assert_eq!(error.kind(), crate::Kind::Input, "{length}: {error}");
        assert!(error.to_string().contains("damaged.exr"));
    }
    std::fs::write(&path, b"\x89PNG\r\n\x1a\n and more").unwrap();
    assert_eq!(read(&path).unwrap_err().kind(), crate::Kind::Input);
    assert_eq!(
        read(&dir.path().join("no.exr")).unwrap_err().kind(),
        crate::Kind::Input
    );
}

#[test]
fn a_header_cannot_claim_all_memory() {
    let dir = tempfile::tempdir().unwrap();
    let path = dir.path().join("bomb.exr");
    let mut bytes = encode(&sample(Region::full(37, 41)), Precision::Half).unwrap();
    let name = b"dataWindow\0box2i\0";
    let at = bytes.windows(name.len()).position(|w| w == name).unwrap() + name.len() + 4;
    bytes[at + 8..at + 12].copy_from_slice(&0x00ff_ffff_i32.to_le_bytes());
    bytes[at + 12..at + 16].copy_from_slice(&0x00ff_ffff_i32.to_le_bytes());
    std::fs::write(&path, bytes).unwrap();
    let error = read(&path).unwrap_err();
    assert_eq!(error.kind(), crate::Kind::Input);
    assert!(error.to_string().contains("bomb.exr"), "{error}");
}

#[test]
fn flipped_bits_never_panic() {
    let dir = tempfile::tempdir().unwrap();
    let path = dir.path().join("flipped.exr");
    let whole = encode(&sample(Region::full(37, 41)), Precision::Half).unwrap();
    for at in 0..whole.len().min(900) {
        let mut bytes = whole.clone();
        bytes[at] ^= 1 << (at % 8);
        std::fs::write(&path, &bytes).unwrap();
        let _ = read(&path);
    }
}
