//! What ends a run before its work begins: a frame that no memory holds, and warnings where they
//! are errors.

use crate::support::program::Run;
use crate::{ROOM, Work, messages::lvox};
use std::fs;

const SMALL: &str = "--resolution 8x8 --samples 4 --volume-samples 2 --progress none";

fn run(work: &Work, line: &str) -> Run {
    let args: Vec<&str> = line.split_whitespace().collect();
    lvox(work, &args)
}

#[cfg(target_os = "linux")]
#[test]
fn a_frame_that_does_not_fit_is_refused_before_the_bake() {
    use crate::support::program;
    use std::process::Command;

    let work = Work::new(ROOM);
    // Whatever the machine has.
    let limited = |line: &str| {
        let program = program::command(work.0.path(), &[]);
        let program = program.get_program().to_string_lossy().into_owned();
        let script = format!("ulimit -v 4000000; exec {program} {line}");
        let mut command = Command::new("bash");
        command.args(["-c", &script]).current_dir(work.0.path());
        Run::of(&mut command)
    };
    let whole =
        "render scene.toml -o a.exr --surfels 500 --threads 2 --progress plain --resolution";
    let refused = limited(&format!("{whole} 60000x60000"));
    refused.refused(
        1,
        &[
            "shading 3600000000 pixels needs ",
            " of memory, the machine has ",
            "--tile I/N",
            "--resolution",
            "--memory-limit",
        ],
    );
    assert_eq!(work.names(), ["scene.toml", "smoke.raw"]);
    let one = "reference scene.toml -o a.exr --spp 1 --resolution 60000x60000";
    limited(one).refused(
        1,
        &["summing samples of 3600000000 pixels needs ", "--region"],
    );
    // A tile of it fits.
    let tile = format!("{whole} 60000x60000 --region 0 0 8 8 --lattice 64 --samples 4");
    assert_eq!(limited(&tile).code, 0);
}

#[test]
fn strict_verbs_end_at_a_warning_before_they_write() {
    let work = Work::new(ROOM);
    work.bake(&work.scene(), 500);
    let dark = ROOM.replace("emission = [10, 9, 7]", "");
    fs::write(work.path("dark.toml"), &dark).unwrap();
    let before = work.names();
    let refused = [
        (
            "bake dark.toml -o a.lvc",
            "a warning with --strict: the scene has no light",
        ),
        (
            "render dark.toml -o a.exr --keep-tree a.lvt",
            "the scene has no light",
        ),
        (
            "reference dark.toml -o a.exr --spp 1",
            "the scene has no light",
        ),
        ("study dark.toml -o a --quick", "the scene has no light"),
        (
            "shade scene.toml -t scene.lvt -o a.exr --target-error 1e-9",
            "out of reach",
        ),
        (
            "study scene.toml -o a --quick --max-depth 2",
            "--max-depth 3",
        ),
    ];
    for (line, part) in refused {
        run(&work, &format!("{line} --strict --progress none")).refused(2, &["error: ", part]);
        assert_eq!(work.names(), before, "{line}");
    }
    // All that is to be said is said at once.
    let line = format!("shade dark.toml -t scene.lvt -o a.exr {SMALL}");
    let two = run(&work, &format!("{line} --strict"));
    two.refused(
        2,
        &[
            "error: 2 warnings with --strict: the scene has no light",
            "; scene.lvt: baked from",
        ],
    );
    assert_eq!(work.names(), before);
    run(&work, &line).done();
    run(
        &work,
        &format!("shade scene.toml -t scene.lvt -o b.exr --strict {SMALL}"),
    )
    .done();
    let compared = run(&work, "compare a.exr b.exr --strict --heatmap h.png");
    compared.refused(2, &["do not show the same"]);
    assert!(!work.path("h.png").exists());
}

#[test]
fn strict_frames_are_not_written_where_the_work_warns() {
    let bright = ROOM.replace("emission = [10, 9, 7]", "emission = [1e9, 1e9, 1e9]");
    let work = Work::new(&bright);
    work.bake(&work.scene(), 500);
    let line = format!("shade scene.toml -t scene.lvt -o a.exr {SMALL}");
    run(&work, &format!("{line} --strict")).refused(2, &["the largest 16-bit float", "--float"]);
    assert!(!work.path("a.exr").exists());
    run(&work, &format!("{line} --strict --float")).done();
}
