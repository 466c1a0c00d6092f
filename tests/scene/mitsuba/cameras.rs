//! What cameras of Mitsuba scenes say beyond where they are.

use super::*;

#[test]
fn clip_planes_are_told_where_they_cut() {
    // A floor from 3 in front of the camera to 7, and beside what it sees a wall that is nearer.
    let told = |keys: &str| {
        let scene = format!(
            "<scene version=\"3.0.0\"><sensor type=\"perspective\">\
             <float name=\"fov\" value=\"60\"/>\
             <transform name=\"to_world\">\
             <lookat origin=\"0,0.5,5\" target=\"0,0.5,0\" up=\"0,1,0\"/></transform>\n\
             {keys}</sensor><emitter type=\"constant\"/>\
             <shape type=\"rectangle\"><transform name=\"to_world\"><scale value=\"2\"/>\
             <rotate x=\"1\" angle=\"-90\"/></transform></shape>\
             <shape type=\"rectangle\"><transform name=\"to_world\"><rotate y=\"1\" angle=\"90\"/>\
             <translate x=\"3\" z=\"4\"/></transform></shape></scene>"
        );
        load(&scene).unwrap().warnings
    };
    let plane = |name: &str, value: &str| format!("<float name=\"{name}\" value=\"{value}\"/>");
    for keys in [
        String::new(),
        plane("near_clip", "0.01"),
        plane("near_clip", "2.9"),
        plane("far_clip", "7.1"),
        plane("near_clip", "0.1") + &plane("far_clip", "1000"),
    ] {
        assert_eq!(told(&keys), [] as [String; 0], "{keys}");
    }
    for keys in [plane("near_clip", "3.1"), plane("far_clip", "6.9")] {
        let told = told(&keys);
        let [line] = &told[..] else {
            panic!("{keys}: {told:?}");
        };
        assert!(
            line.contains("`near_clip` and `far_clip` are left out"),
            "{line}"
        );
        assert!(line.ends_with(": line 1"), "{line}");
    }
}
