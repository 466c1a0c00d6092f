//! Trees for tests and benchmarks to shade from.

use lvox::bake::{self, SurfelSampling};
use lvox::build;
use lvox::formats::Overwrite;
use lvox::run::Job;
use lvox::scene::Scene;
use std::path::{Path, PathBuf};

/// Bakes a scene into `NAME.lvc`, builds `NAME.lvt` over it, and names that.
pub fn baked(scene: &Scene, settings: &bake::Settings, dir: &Path, name: &str) -> PathBuf {
    built(scene, settings, &build::Settings::default(), dir, name)
}

/// The same with settings of the build.
pub fn built(
    scene: &Scene,
    settings: &bake::Settings,
    of_build: &build::Settings,
    dir: &Path,
    name: &str,
) -> PathBuf {
    let cloud = dir.join(format!("{name}.lvc"));
    let tree = cloud.with_extension("lvt");
    let job = Job::default();
    bake::run(scene, settings, &cloud, Overwrite::Replace, &job).unwrap();
    build::run(&cloud, &tree, of_build, Overwrite::Replace, &job).unwrap();
    tree
}

/// Settings for so many surfels.
pub fn of_surfels(count: u64) -> bake::Settings {
    bake::Settings {
        surfels: SurfelSampling::Area { count },
        ..bake::Settings::default()
    }
}
