//! Points that are none are refused, and nothing is written.

use super::*;

const POSITION: [&str; 3] = ["float x", "float y", "float z"];
const PLACE: [&str; 6] = [
    "float x", "float y", "float z", "float nx", "float ny", "float nz",
];

/// Points of these properties as PLY, with these rows of numbers.
fn ply(count: u32, properties: &[&str], rows: &str) -> Vec<u8> {
    let mut text = format!("ply\nformat ascii 1.0\nelement vertex {count}\n");
    for property in properties {
        text += &format!("property {property}\n");
    }
    (text + "end_header\n" + rows).into_bytes()
}

/// Gathers by these words, of which nothing but an error may come.
#[track_caller]
fn refused(work: &Work, args: &[&str], says: &[&str]) {
    let before = work.names();
    lvox(work.0.path(), &[&["gather"], args].concat()).refused(2, says);
    assert_eq!(work.names(), before, "{args:?}");
}

/// Name and content of a file, more options, and what is said.
type Case<'a> = (&'a str, Vec<u8>, &'a [&'a str], &'a [&'a str]);

#[track_caller]
fn are_refused(cases: Vec<Case>) {
    let (work, ..) = closed_room();
    for (name, content, more, says) in cases {
        let name = format!("in.{name}");
        fs::write(work.path(&name), content).unwrap();
        let args = [&["scene.lvt", &name, "-o", "out.ply"], more].concat();
        refused(&work, &args, says);
    }
}

#[test]
fn files_that_are_damaged_or_of_something_else_are_refused() {
    let mut cut = npy(&[(DVec3::ZERO, Some(Vec3::X)), (DVec3::X, Some(Vec3::X))]);
    cut.truncate(cut.len() - 1);
    let five = String::from_utf8_lossy(&npy(&[(DVec3::ZERO, None)])).replace(", 3)", ", 5)");
    let five = [b"\x93", five.trim_start_matches('\u{fffd}').as_bytes()].concat();
    are_refused(vec![
        (
            "nan.ply",
            ply(2, &PLACE, "0 0 0 1 0 0\n0 nan 0 1 0 0\n"),
            &[],
            &["vertex 1", "position", "NaN"],
        ),
        (
            "flat.ply",
            ply(2, &PLACE, "0 0 0 1 0 0\n0 0 0 0 0 0\n"),
            &[],
            &["vertex 1", "normal of a length"],
        ),
        (
            "word.ply",
            ply(1, &PLACE, "0 0 x 1 0 0\n"),
            &[],
            &["vertex 0", "expected a number", "\"x\""],
        ),
        (
            "short.ply",
            ply(2, &PLACE, "0 0 0 1 0 0\n0 0 0 1 0       \n"),
            &[],
            &["vertex 1", "truncated"],
        ),
        (
            "many.ply",
            ply(4_000_000, &PLACE, "0 0 0 1 0 0\n"),
            &[],
            &["promises 4000000 points"],
        ),
        (
            "half.ply",
            ply(1, &["float x", "float y"], "0 0\n"),
            &[],
            &["`z`"],
        ),
        (
            "twice.ply",
            ply(1, &["float x", "float x"], "0 0\n"),
            &[],
            &["`x` twice"],
        ),
        (
            "list.ply",
            ply(1, &["list uchar int x"], "1 0\n"),
            &[],
            &["list `x`"],
        ),
        ("cut.npy", cut, &[], &["truncated or damaged"]),
        ("five.npy", five, &[], &["N x 5"]),
        (
            "scene.toml",
            b"[film]\n".to_vec(),
            &[],
            &["expected a file of points"],
        ),
    ]);
}

#[test]
fn points_that_do_not_suit_what_is_asked_are_refused() {
    let origin = ply(1, &POSITION, "0 0 0\n");
    are_refused(vec![
        (
            "bare.ply",
            origin.clone(),
            &["--over", "hemisphere"],
            &["expected points with normals"],
        ),
        (
            "traced.ply",
            origin,
            &["--kernel", "traced"],
            &["needs triangles"],
        ),
        (
            "name.ply",
            ply(
                1,
                &[&POSITION[..], &["float mean_radiance_g"]].concat(),
                "0 0 0 1\n",
            ),
            &[],
            &["`mean_radiance_g` already"],
        ),
    ]);
}

#[test]
fn options_and_outputs_that_cannot_be_are_refused() {
    let (work, ..) = closed_room();
    fs::write(work.path("in.ply"), ply(1, &POSITION, "0 0 0\n")).unwrap();
    let with =
        |more: [&'static str; 2]| [&["scene.lvt", "in.ply", "-o", "out.ply"], &more[..]].concat();
    for (args, says) in [
        (
            vec!["scene.lvt", "in.ply", "-o", "out.exr"],
            &[".ply or .npy"][..],
        ),
        (
            vec!["scene.lvt", "none.ply", "-o", "out.ply"],
            &["none.ply", "No such file"],
        ),
        (
            vec!["scene.lvt", "in.ply", "-o", "in.ply", "--force"],
            &["would replace the points"],
        ),
        (with(["--samples", "0"]), &["--samples"]),
        (with(["--memory-limit", "8M"]), &["8.00 MiB"]),
    ] {
        refused(&work, &args, says);
    }
}

#[test]
fn an_empty_file_has_no_points_which_is_no_fault() {
    let (work, ..) = closed_room();
    fs::write(work.path("no.ply"), ply(0, &PLACE, "")).unwrap();
    lvox(
        work.0.path(),
        &["gather", "scene.lvt", "no.ply", "-o", "no.npy"],
    )
    .done();
    assert!(rows(&work.path("no.npy"), 3).is_empty());
}
