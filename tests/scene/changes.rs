//! Values of a scene file that are changed as it is read, by the library and by `--set`.

use crate::Folder;
use crate::support::program::lvox;
use lvox::run::Job;
use lvox::scene::load::{Change, Settings};
use lvox::scene::{Light, Scene};
use lvox::{Kind, Result};
use std::fs;

const SCENE: &str = "[[camera]]\nname = \"main\"\nposition = [0, 0, 5]\ntarget = [0, 0, 0]\n\
    [[camera]]\nname = \"side\"\nposition = [5, 0, 0]\ntarget = [0, 0, 0]\n\
    [[mesh]]\nfile = \"builtin:cube\"\nalbedo = [0.1, 0.2, 0.3]\n\
    [[light]]\ntype = \"point\"\nposition = [0, 2, 2]\nintensity = [1, 1, 1]\n";

fn changed(changes: &[&str]) -> Result<Scene> {
    let folder = Folder::new(&[("scene.toml", SCENE.as_bytes())]);
    let changes = changes.iter().map(|text| text.parse::<Change>());
    let settings = Settings {
        changes: changes.collect::<Result<_>>()?,
        ..Settings::default()
    };
    Scene::load_with(&folder.path("scene.toml"), &settings, &Job::default())
}

#[test]
fn values_take_the_place_of_those_of_the_file() {
    let plain = changed(&[]).unwrap();
    let scene = changed(&[
        "light.0.intensity=[3, 2, 1]",
        "camera.side.fov_x_deg = 90",
        "camera.0.position.2=7",
        "film={width=32, height=16}",
        "film.exposure=2",
        "mesh.0.file=builtin:quad",
        "name=other",
    ])
    .unwrap();
    let Light::Point { intensity, .. } = scene.lights[0] else {
        panic!("{:?}", scene.lights);
    };
    assert_eq!(intensity, [3.0, 2.0, 1.0]);
    assert!((scene.cameras[1].fov_x_rad - 90_f32.to_radians()).abs() < 1e-6);
    assert!((scene.cameras[0].origin().z - 7.0).abs() < 1e-6);
    assert_eq!((scene.film.width, scene.film.exposure), (32, 2.0));
    assert_eq!((scene.mesh.triangles.len(), &*scene.name), (2, "other"));
    assert_ne!(scene.hash, plain.hash);
    // The same changes give the same scene, others another.
    let hash = |change: &str| changed(&[change]).unwrap().hash;
    assert_eq!(
        hash("light.0.intensity=[3,3,3]"),
        hash("light.0.intensity=[3,3,3]")
    );
    assert_ne!(
        hash("light.0.intensity=[3,3,3]"),
        hash("light.0.intensity=[3,3,4]")
    );
    assert_eq!(
        changed(&["film.width=9", "film.height=8"])
            .unwrap()
            .film
            .height,
        8
    );
}

#[test]
fn what_is_not_there_is_told_with_the_nearest() {
    for (change, says, hints) in [
        (
            "light.0.intensiti=[1,1,1]",
            "unknown key `intensiti` in [[light]] by `set` light.0.intensiti",
            "`intensity`",
        ),
        (
            "light.0.intensity=[1,1]",
            "`intensity` in [[light]] by `set` light.0.intensity: expected 3 numbers",
            "",
        ),
        ("light.0.intensity=much", "found the string much", ""),
        (
            "light.1.intensity=[1,1,1]",
            "`light` has no `1`",
            "it has 0",
        ),
        (
            "camera.mian.fov_x_deg=9",
            "`camera` has no `mian`",
            "did you mean `main`?",
        ),
        (
            "camera.fov_x_deg=40",
            "`camera` has no `fov_x_deg`",
            "name one of main, side, as in camera.main.fov_x_deg",
        ),
        (
            "lihgt.0.intensity=[1,1,1]",
            "the scene has no `lihgt`",
            "did you mean `light`?",
        ),
        (
            "filn=3",
            "unknown key `filn` in the scene by `set` filn",
            "`film`",
        ),
        (
            "mesh.0.albedo.0.x=1",
            "nothing below `mesh.0.albedo.0`, which is of type float",
            "",
        ),
        ("light.0.intensity=[1,1,1", "is not valid TOML", ""),
        (
            "camera.main.fov_x_deg=200",
            "by `set` camera.main.fov_x_deg: expected a number from 0.01 to 179",
            "",
        ),
        ("light", "expected a key and a value", ""),
        ("light..x=1", "expected a key and a value", ""),
    ] {
        let error = changed(&[change]).unwrap_err();
        assert_eq!(error.kind(), Kind::Input);
        assert!(error.to_string().contains(says), "{change}: {error}");
        let hint = error.hint_text().unwrap_or_default();
        assert!(hint.contains(hints), "{change}: {hint}");
    }
}

#[test]
fn verbs_jobs_and_resumed_runs_have_them() {
    let folder = Folder::new(&[("scene.toml", SCENE.as_bytes()), ("a.gltf", b"{}")]);
    let dir = folder.path("");
    let args = |line: &str| line.split(' ').map(str::to_owned).collect::<Vec<_>>();
    let run = |line: &str| {
        let words = args(line);
        lvox(&dir, &words.iter().map(String::as_str).collect::<Vec<_>>())
    };
    let bake = "bake scene.toml --surfels 500 -o a.lvc --resume";
    run(bake).done();
    let first = fs::read(folder.path("a.lvc")).unwrap();
    let other = format!("{bake} --set light.0.intensity=[2,2,2]");
    for (line, is_made) in [(bake, true), (&*other, false), (&*other, true)] {
        let told = run(line);
        told.done();
        let says = "made of the same scene and settings";
        assert_eq!(told.stderr.contains(says), is_made, "{}", told.stderr);
    }
    assert_ne!(fs::read(folder.path("a.lvc")).unwrap(), first);
    let job = run("farm commands scene.toml --set light.0.intensity=[2,2,2] --set name=x -o a.exr");
    assert_eq!(job.code, 0, "{}", job.stderr);
    let lines = job
        .stdout
        .lines()
        .filter(|line| line.contains("scene.toml"));
    let words = ["--set 'light.0.intensity=[2,2,2]'", "--set 'name=x'"];
    let has = |line: &str| {
        words
            .iter()
            .all(|w| line.contains(w) || line.contains(&w.replace('\'', "")))
    };
    assert!(
        lines.clone().count() > 0 && lines.clone().all(has),
        "{}",
        job.stdout
    );
    let told = run("inspect scene.toml --set mesh.0.file=builtin:quad --json");
    assert!(told.stdout.contains("\"triangles\": 2"), "{}", told.stdout);
    run("bake --demo -o b.lvc --set filn.width=3").refused(2, &["--set filn.width"]);
    run("inspect a.gltf --set film.width=3").refused(2, &["--set film.width", ".toml"]);
}
