//! Media of Mitsuba whose extinction has a colour.

use crate::Folder;
use glam::Vec3;
use lvox::Result;
use lvox::scene::{Scene, Volume};

/// A file of two voxels beside each other.
fn vol(values: &[f32], channels: i32) -> Vec<u8> {
    let mut bytes = b"VOL\x03\x01\0\0\0".to_vec();
    let sizes = [2, 1, 1, channels];
    bytes.extend(sizes.into_iter().flat_map(i32::to_le_bytes));
    let bounds = [0.0_f32, 0.0, 0.0, 2.0, 1.0, 1.0];
    let numbers = bounds.iter().chain(values);
    bytes.extend(numbers.flat_map(|v| v.to_le_bytes()));
    bytes
}

/// A scene of a cube of this medium, beside a file `a.vol`.
fn load(kind: &str, content: &str, vol: &[u8]) -> Result<Scene> {
    let scene = format!(
        "<scene version=\"3.0.0\"><sensor type=\"perspective\"/><emitter type=\"constant\"/>\n\
         <shape type=\"cube\"><transform name=\"to_world\"><translate value=\"1\"/>\
         <scale value=\"0.5\"/></transform><bsdf type=\"null\"/>\n\
         <medium name=\"interior\" type=\"{kind}\">\n\
         {content}\n</medium></shape></scene>"
    );
    let folder = Folder::new(&[("a.xml", scene.as_bytes()), ("a.vol", vol)]);
    Scene::load(&folder.path("a.xml"))
}

const GRID: &str = "<float name=\"scale\" value=\"10\"/>\
                    <volume name=\"sigma_t\" type=\"gridvolume\">\
                    <string name=\"filename\" value=\"a.vol\"/></volume>";

/// Extinction of all channels at a place of the grid.
fn at(volume: &Volume, place: Vec3) -> [f32; 3] {
    volume
        .extinction_color
        .map(|c| c * volume.sigma_t.sample(place))
}

#[track_caller]
fn near(found: [f32; 3], expected: [f32; 3]) {
    let is_near = |(a, b): (f32, f32)| (a - b).abs() <= 1e-5 * b.abs();
    assert!(
        found.into_iter().zip(expected).all(is_near),
        "{found:?} against {expected:?}"
    );
}

#[test]
fn colors_of_homogeneous_media_are_taken_by_channel() {
    let of = |content: &str| {
        let scene = load("homogeneous", content, &[]).unwrap();
        assert_eq!(scene.warnings, [""; 0]);
        let [volume] = <[Volume; 1]>::try_from(scene.volumes).expect("one medium");
        volume
    };
    let volume = of(
        "<rgb name=\"sigma_t\" value=\"1 2 0.5\"/><float name=\"scale\" value=\"3\"/>\
         <rgb name=\"albedo\" value=\"0.9 0.5 0.1\"/>",
    );
    assert_eq!(volume.extinction_color, [0.5, 1.0, 0.25]);
    assert_eq!(
        (volume.sigma_t.max(), volume.albedo),
        (6.0, [0.9, 0.5, 0.1])
    );
    let volume = of(
        "<rgb name=\"sigma_s\" value=\"1 3 0\"/><rgb name=\"sigma_a\" value=\"1 1 0\"/>\
         <float name=\"scale\" value=\"2\"/>",
    );
    assert_eq!(volume.extinction_color, [0.5, 1.0, 0.0]);
    assert_eq!(
        (volume.sigma_t.max(), volume.albedo),
        (8.0, [0.5, 0.75, 0.0])
    );
    let volume = of("<volume name=\"sigma_t\" type=\"constvolume\">\
         <rgb name=\"value\" value=\"4 2 1\"/></volume>");
    assert_eq!(
        (volume.sigma_t.max(), volume.extinction_color),
        (4.0, [1.0, 0.5, 0.25])
    );
    // Grey is grey, and none is none.
    let volume = of("<rgb name=\"sigma_t\" value=\"0.3 0.3 0.3\"/>");
    assert!(volume.is_grey() && volume.sigma_t.max() == 0.3);
    assert!(of("<rgb name=\"sigma_t\" value=\"0\"/>").is_grey());
}

#[test]
fn channels_of_grids_are_taken_as_far_as_they_have_one_color() {
    let of = |values: &[f32], channels: i32| {
        let scene = load("heterogeneous", GRID, &vol(values, channels)).unwrap();
        let warnings = scene.warnings.join("\n");
        let [volume] = <[Volume; 1]>::try_from(scene.volumes).expect("one medium");
        (volume, warnings)
    };
    let places = [Vec3::splat(0.5), Vec3::new(1.5, 0.5, 0.5)];
    let (volume, told) = of(&[1.0, 4.0, 2.0, 0.5, 2.0, 1.0], 3);
    assert_eq!(told, "");
    assert_eq!(volume.extinction_color, [0.25, 1.0, 0.5]);
    near(at(&volume, places[0]), [10.0, 40.0, 20.0]);
    near(at(&volume, places[1]), [5.0, 20.0, 10.0]);
    // Means by voxel, and by channel.
    let (volume, told) = of(&[3.0, 0.0, 0.0, 0.0, 6.0, 0.0], 3);
    assert!(
        told.contains("extinctions that change their colour take that of their mean: line 3"),
        "{told}"
    );
    near(at(&volume, places[0]), [10.0, 20.0, 0.0]);
    near(at(&volume, places[1]), [20.0, 40.0, 0.0]);
    let (volume, told) = of(&[1.0, 3.0, 2.0, 6.0], 2);
    assert!(told.contains("are taken as their mean"), "{told}");
    near(at(&volume, places[0]), [20.0; 3]);
    let (volume, told) = of(&[0.0; 6], 3);
    assert!(volume.is_grey() && told.is_empty(), "{told}");
}
