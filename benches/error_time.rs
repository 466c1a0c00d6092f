//! Error against run time in one table: the acceptance scenes at every quality, beside their
//! references; for scenes that other renderers were measured on, those come after. Scenes that need
//! `../shared` are skipped where it is not there; all that goes wrong otherwise is a failure.
//!
//! CPU seconds of all threads. `cargo bench --bench error_time -- A thin` measures these scenes
//! only.

#![allow(clippy::print_stdout)] // The table is the product.

use lvox::formats::Overwrite;
use lvox::image::{Picture, Region, load, metrics};
use lvox::internals::usage;
use lvox::run::Job;
use lvox::scene::Scene;
use lvox::shade::{self, Quality};
use lvox::{Error, Result, bake, build, tree::OpenTree};
use std::path::{Path, PathBuf};
use std::process::ExitCode;

/// Scenes whose references an independent renderer made.
const SHARED: [&str; 4] = ["A", "B", "C", "C_novol"];

/// Scenes whose references lvox made itself.
const OWN: [&str; 5] = ["curved", "lights100", "volumes", "thin", "outdoor"];

const QUALITIES: [(&str, Quality); 3] = [
    ("draft", Quality::Draft),
    ("good", Quality::Good),
    ("best", Quality::Best),
];

struct Paths {
    scene: PathBuf,
    reference: PathBuf,
}

fn main() -> ExitCode {
    let is_trial = std::env::args().any(|a| a == "--test");
    let wanted: Vec<String> = std::env::args()
        .skip(1)
        .filter(|a| !a.starts_with('-'))
        .collect();
    let is_wanted = |name: &&&str| match (is_trial, wanted.is_empty()) {
        // Enough to see that it runs.
        (true, _) => **name == "thin",
        (false, true) => true,
        (false, false) => wanted.iter().any(|w| w == **name),
    };
    println!(
        "{:<10} {:<30} {:>9} {:>14} {:>8} {:>8} {:>8} {:>11} {:>11}",
        "scene",
        "",
        "relMSE",
        "relMSE trimmed",
        "pdiff %",
        "bias %",
        "FLIP",
        "shade CPU s",
        "all CPU s"
    );
    let qualities = if is_trial {
        &QUALITIES[..1]
    } else {
        &QUALITIES
    };
    let mut code = ExitCode::SUCCESS;
    for name in SHARED.iter().chain(&OWN).filter(is_wanted) {
        if SHARED.contains(name) && !shared("refs").exists() {
            println!("SKIPPED: benches/error_time.rs, {name}: needs ../shared/refs");
            continue;
        }
        if let Err(e) = measure(name, qualities).and_then(|()| peers(name)) {
            eprintln!("error: {name}: {e}");
            code = ExitCode::FAILURE;
        }
    }
    code
}

fn shared(path: &str) -> PathBuf {
    let folder = Path::new(env!("CARGO_MANIFEST_DIR")).join("../shared");
    folder.join(path)
}

fn paths(name: &str) -> Paths {
    let tests = Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/acceptance");
    if SHARED.contains(&name) {
        Paths {
            scene: tests.join(format!("scenes/{name}.toml")),
            reference: shared(&format!("refs/{name}_d3.exr")),
        }
    } else {
        Paths {
            scene: tests.join(format!("scenes/general/{name}.toml")),
            reference: tests.join(format!("references/{name}_d3.exr")),
        }
    }
}

fn measure(name: &str, qualities: &[(&str, Quality)]) -> Result<()> {
    let paths = paths(name);
    let scene = Scene::load(&paths.scene)?;
    let exposure = load::exposure_of(&paths.reference)?.unwrap_or(scene.film.exposure);
    let reference = load::picture(&paths.reference, "", exposure, None)?;
    let folder = tempfile::tempdir().expect("a folder for the tree");
    let (cloud, tree) = (folder.path().join("t.lvc"), folder.path().join("t.lvt"));
    let job = Job::default();
    let before = usage::cpu_secs();
    bake::run(
        &scene,
        &bake::Settings::default(),
        &cloud,
        Overwrite::Replace,
        &job,
    )?;
    build::run(
        &cloud,
        &tree,
        &build::Settings::default(),
        Overwrite::Replace,
        &job,
    )?;
    let prepare = usage::cpu_secs() - before;
    for &(quality_name, quality) in qualities {
        let before = usage::cpu_secs();
        let picture = shade(&scene, &tree, quality, &job)?;
        let shading = usage::cpu_secs() - before;
        let s = metrics::compare(&picture, &reference, exposure)?.scores;
        println!(
            "{name:<10} {quality_name:<26} {:>9.2e} {:>14.2e} {:>8.2} {:>+8.2} {:>8.4} \
             {shading:>11.2} {:>11.2}",
            s.relmse,
            s.relmse_trimmed,
            100.0 * s.pdiff,
            100.0 * s.bias,
            s.flip,
            prepare + shading
        );
    }
    Ok(())
}

fn shade(scene: &Scene, tree: &Path, quality: Quality, job: &Job) -> Result<Picture> {
    let store = OpenTree::open(tree, None)?;
    let region = Region::full(scene.film.width, scene.film.height);
    let settings = shade::Settings::of(quality);
    let frame = shade::run(scene, &store, &settings, region, &[], job)?;
    frame.picture("", &region)
}

/// Prints what other renderers took for the same image at one indirect bounce, as `../shared/peers`
/// has it, if it is there.
fn peers(name: &str) -> Result<()> {
    let file = shared("peers/results.csv");
    if !SHARED.contains(&name) || !file.exists() {
        return Ok(());
    }
    let text = std::fs::read_to_string(&file).map_err(|e| Error::io("read", &file, &e))?;
    let mut lines = text.lines();
    let header: Vec<&str> = lines.next().unwrap_or_default().split(',').collect();
    let column = |key: &str| {
        let found = header.iter().position(|&h| h == key);
        found.ok_or_else(|| Error::input(format!("{} has no column {key}", file.display())))
    };
    let [scene, depth, peer, variant, spp, oidn] = [
        column("scene")?,
        column("depth")?,
        column("peer")?,
        column("variant")?,
        column("spp")?,
        column("oidn")?,
    ];
    let errors = [
        column("relMSE")?,
        column("relMSE_t")?,
        column("pdiff_rgb_pct")?,
        column("bias_pct")?,
        column("FLIP")?,
    ];
    let cpu = column("cpu_s")?;
    for line in lines {
        let field: Vec<&str> = line.split(',').collect();
        if field.len() != header.len() || field[scene] != name || field[depth] != "3" {
            continue;
        }
        let denoised = if field[oidn] == "none" { "" } else { " + OIDN" };
        let short = |s: &str| s.split_whitespace().next().unwrap_or_default().to_owned();
        let label = format!(
            "{} {} {} spp{denoised}",
            short(field[peer]),
            field[variant].trim_end_matches("_rgb"),
            field[spp]
        );
        let e = errors.map(|c| field[c].parse::<f64>().unwrap_or(f64::NAN));
        let secs: f64 = field[cpu].parse().unwrap_or(f64::NAN);
        println!(
            "{name:<10} {label:<26} {:>9.2e} {:>14.2e} {:>8.2} {:>+8.2} {:>8.4} \
             {secs:>11.2} {secs:>11.2}",
            e[0], e[1], e[2], e[3], e[4]
        );
    }
    Ok(())
}
