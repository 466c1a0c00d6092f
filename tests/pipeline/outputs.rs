//! Outputs that name an input or another output are refused, and everything stays as it was.

use crate::messages::lvox;
use crate::{ROOM, Work};
use std::fs;

/// Every file of the folder with its content.
fn contents(work: &Work) -> Vec<(String, Vec<u8>)> {
    let read = |name: String| {
        let bytes = fs::read(work.path(&name)).unwrap();
        (name, bytes)
    };
    work.names().into_iter().map(read).collect()
}

#[test]
fn no_output_takes_the_place_of_an_input_or_another_output() {
    let work = Work::new(ROOM);
    work.bake(&work.scene(), 500);
    let small = ["--resolution", "4x4", "--progress", "none"];
    let shade = ["shade", "scene.toml", "-t", "scene.lvt"];
    let run = lvox(&work, &[&shade[..], &small, &["-o", "p.exr"]].concat());
    assert_eq!(run.code, 0, "{}", run.stderr);
    fs::copy(work.path("p.exr"), work.path("q.exr")).unwrap();
    let before = contents(&work);
    let inputs: [(&str, &str); 16] = [
        ("bake scene.toml -o scene.toml --force", "scene"),
        (
            "bake scene.toml -o ./smoke.raw --force",
            "file of the scene",
        ),
        (
            "bake scene.toml -o new.lvc --report smoke.raw",
            "file of the scene",
        ),
        ("build scene.lvc -o scene.lvc --force", "cloud"),
        (
            "render scene.toml -o a.exr --keep-tree scene.toml --force",
            "scene",
        ),
        ("render scene.toml -o a.exr --keep-tree a.exr", "--output"),
        ("render scene.toml -o a.exr --report a.exr", "--output"),
        (
            "shade scene.toml -t scene.lvt -o a.exr --report scene.lvt",
            "tree",
        ),
        ("shade scene.toml -t p.exr -o p.exr", "tree"),
        ("compare p.exr q.exr --heatmap p.exr", "image"),
        ("compare p.exr q.exr --report q.exr", "reference"),
        ("merge p.exr -o p.exr", "tile"),
        ("inspect scene.lvc --export scene.lvc --force", "file"),
        ("verify scene.lvc --report scene.lvc", "file"),
        ("reference scene.toml -o r.exr --report r.exr.sums", "sums"),
        (
            "study scene.toml -o out --report out/study.json",
            "--output",
        ),
    ];
    for (line, part) in inputs {
        fs::create_dir(work.path("out")).unwrap();
        let args: Vec<&str> = line.split(' ').collect();
        lvox(&work, &args).refused(2, &["would replace", part, "hint: "]);
        fs::remove_dir(work.path("out")).unwrap();
        assert!(contents(&work) == before, "{line} has changed a file");
    }
}
