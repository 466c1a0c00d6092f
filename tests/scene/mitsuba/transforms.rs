//! Maps of Mitsuba scenes.

use super::*;

fn rotated(version: &str, rotate: &str) -> Scene {
    let scene = format!(
        "<scene version=\"{version}\"><sensor type=\"perspective\"/><emitter type=\"constant\"/>\
         <shape type=\"cube\"><transform name=\"to_world\">\n\
         {rotate}</transform></shape></scene>"
    );
    load(&scene).unwrap()
}

#[test]
fn axes_of_rotations_are_taken_at_their_length() {
    // The matrix that Mitsuba 3.9 makes of it.
    let (c, s) = (40_f32.to_radians().cos(), 40_f32.to_radians().sin());
    let map = glam::Mat3::from_cols(
        Vec3::new(1.0, 1.0 - c, -s),
        Vec3::new(1.0 - c, 1.0, s),
        Vec3::new(s, -s, c),
    );
    let rotate = "<rotate x=\"1\" y=\"1\" angle=\"40\"/>";
    let scene = rotated("3.0.0", rotate);
    let corner = map * Vec3::new(1.0, -1.0, 1.0);
    let is_there = |p: &Vec3| (*p - corner).length() < 1e-5;
    assert!(scene.mesh.positions.iter().any(is_there), "{corner}");
    let [told] = &scene.warnings[..] else {
        panic!("{:?}", scene.warnings);
    };
    assert!(
        told.contains("not of length 1") && told.ends_with(": line 2"),
        "{told}"
    );
    // Mitsuba 0.6 makes it one of length 1.
    for (version, rotate) in [
        ("0.6.0", rotate),
        ("3.0.0", "<rotate x=\"0.707\" y=\"0.707\" angle=\"40\"/>"),
        ("3.0.0", "<rotate x=\"1\" y=\"1\" angle=\"0\"/>"),
    ] {
        let scene = rotated(version, rotate);
        let radius = |p: &Vec3| (p.length() - 3_f32.sqrt()).abs() < 1e-5;
        assert!(scene.mesh.positions.iter().all(radius), "{rotate}");
        assert_eq!(scene.warnings, [] as [String; 0], "{rotate}");
    }
}
