//! Mistakes in Mitsuba scenes, each told in one line that names its own.

use super::*;
use lvox::Kind;

/// What is in the scene, and what the message and the hint say.
type Mistake<'a> = (&'a str, &'a str, &'a str);

#[track_caller]
fn are_told(mistakes: &[Mistake]) {
    for (content, says, hints) in mistakes {
        let error = match with(content) {
            Ok(_) => panic!("loaded: {says}"),
            Err(error) => error,
        };
        assert_eq!(error.kind(), Kind::Input);
        let told = error.to_string();
        assert!(
            told.contains(says) && !told.contains('\n'),
            "{says}: {told}"
        );
        assert!(
            error.hint_text().unwrap_or_default().contains(hints),
            "{hints}: {:?}",
            error.hint_text()
        );
    }
}

const NAMES: &[Mistake] = &[
    (
        "<shape type=\"spher\"/>",
        "line 3: unknown shape `spher`",
        "`sphere`",
    ),
    (
        "<bsdf type=\"difuse\" id=\"a\"/><shape type=\"cube\"><ref id=\"a\"/></shape>",
        "line 3: unknown bsdf `difuse`",
        "`diffuse`",
    ),
    (
        "<emitter type=\"pointt\"/>",
        "line 3: unknown emitter `pointt`",
        "`point`",
    ),
    (
        "<sensor type=\"perspektive\"/>",
        "unknown sensor `perspektive`",
        "`perspective`",
    ),
    (
        "<shpae type=\"cube\"/>",
        "line 3: unknown element <shpae>",
        "<shape>",
    ),
    (
        "\n\n<shape type=\"cube\"><ref id=\"grean\"/></shape>\
         <bsdf id=\"green\" type=\"diffuse\"/>",
        "line 5: there is no element with the id `grean`",
        "`green`",
    ),
    (
        "<shape type=\"cube\"><transform name=\"to_world\"><rotatt/></transform></shape>",
        "unknown <rotatt>",
        "<rotate>",
    ),
    (
        "<shape type=\"cube\" id=\"a\"/><shape type=\"cube\" id=\"a\"/>",
        "another element has the id `a`",
        "",
    ),
];

#[test]
fn names_that_mean_nothing_or_two_things_are_told() {
    are_told(NAMES);
}

const VALUES: &[Mistake] = &[
    (
        "<shape type=\"cube\"><transform name=\"to_world\"><scale value=\"0\"/></transform>\
         </shape>",
        "`to_world` flattens space",
        "",
    ),
    (
        "<shape type=\"cube\"><transform name=\"to_world\"><matrix value=\"1 2\"/></transform>\
         </shape>",
        "9 or 16 numbers, found 2",
        "",
    ),
    (
        "<shape type=\"sphere\"><float name=\"radius\" value=\"big\"/></shape>",
        "`radius`: expected a number, found \"big\"",
        "",
    ),
    (
        "<emitter type=\"point\"><rgb name=\"intensity\" value=\"1 2\"/></emitter>",
        "expected one number or three",
        "",
    ),
    (
        "<emitter type=\"point\"><rgb name=\"intensity\" value=\"-1\"/></emitter>",
        "expected numbers from 0",
        "",
    ),
    (
        "<shape type=\"cube\"><float name=\"a\" value=\"$b\"/></shape>",
        "line 3: the parameter $b has no value",
        "`set` b=VALUE",
    ),
];

#[test]
fn values_that_cannot_be_are_told() {
    are_told(VALUES);
}

const FILES: &[Mistake] = &[
    ("<shape type=\"obj\"/>", "`filename` of obj is missing", ""),
    (
        "<shape type=\"obj\"><string name=\"filename\" value=\"b.obj\"/></shape>",
        "b.obj is not there",
        "",
    ),
    (
        "<include filename=\"a.xml\"/>",
        "at most 15 files",
        "include itself",
    ),
    (
        "<include filename=\"b.xml\"/>",
        "line 3: included file ",
        "",
    ),
];

#[test]
fn files_that_cannot_be_read_are_told() {
    are_told(FILES);
}

#[test]
fn what_never_ends_is_told() {
    let nested = |n: usize| {
        format!(
            "{}{}",
            "<shape type=\"merge\">".repeat(n),
            "</shape>".repeat(n)
        )
    };
    let deep = nested(100_000);
    let looping = "<bsdf type=\"twosided\" id=\"a\"><ref id=\"a\"/></bsdf>\
                   <shape type=\"cube\"><ref id=\"a\"/></shape>";
    let group = "<shape type=\"shapegroup\" id=\"g\"><shape type=\"instance\"><ref id=\"g\"/>\
                 </shape></shape>\
                 <shape type=\"instance\"><ref id=\"g\"/></shape>";
    let mut laughs = String::from("<default name=\"x0\" value=\"ha ha ha ha ha ha\"/>");
    for i in 1..30 {
        laughs += &format!(
            "<default name=\"x{i}\" value=\"{}\"/>",
            format!("$x{} ", i - 1).repeat(10)
        );
    }
    are_told(&[
        (
            looping,
            "at most 16 objects in each other",
            "refer to itself",
        ),
        (group, "at most 16 objects in each other", "refer to itself"),
        (&deep, "elements in each other", ""),
        (&laughs, "MiB of scene descriptions", ""),
    ]);
}

const MARKUP: &[Mistake] = &[
    ("<shape type=\"cube\">", "not valid XML", ""),
    ("words", "expected elements alone, found the text words", ""),
];

#[test]
fn text_that_is_no_scene_is_told() {
    are_told(MARKUP);
    let entities = "<!DOCTYPE x [<!ENTITY a \"b\">]><scene version=\"3.0.0\">&a;</scene>";
    for (scene, says) in [
        (entities, "not valid XML"),
        ("<shape/>", "expected <scene>"),
        ("", "not valid XML"),
    ] {
        let error = load(scene).unwrap_err().to_string();
        assert!(error.contains(says), "{error}");
    }
}
