//! What a bake says beforehand that it will make and write, beside what it then does.

use crate::{ROOM, Work};
use glam::{DAffine3, DVec3};
use lvox::bake::{self, Part, Settings, SurfelSampling};
use lvox::formats::Overwrite;
use lvox::run::Job;
use lvox::scene::{Grid, LightInput, MeshInput, Scene, SceneBuilder, VolumeInput};
use std::fs;

/// Whether what was told is off by a fifth at most, counted from what is there.
fn is_near(told: u64, found: u64) -> bool {
    told.abs_diff(found) * 5 <= found
}

/// Plans a bake, and bakes.
fn holds(scene: &Scene, settings: &Settings) {
    let work = Work::new("");
    let (cloud, job) = (work.path("scene.lvc"), Job::default());
    let plan = bake::plan(scene, settings, &job).unwrap();
    assert!(!cloud.exists());
    let found = bake::run(scene, settings, &cloud, Overwrite::Refuse, &job).unwrap();
    let (surfels, lvoxels) = (found.sums.surfels, found.sums.lvoxels());
    let bytes = fs::metadata(&cloud).unwrap().len();
    for (told, found) in [
        (plan.surfels, surfels),
        (plan.lvoxels, lvoxels),
        (plan.cloud_bytes, bytes),
    ] {
        let all = format!("{plan:?}: {surfels} surfels, {lvoxels} lvoxels, {bytes} bytes");
        assert!(is_near(told, found), "{all}");
    }
    assert!(plan.cpu_secs > 0.0 && plan.memory_bytes > 0, "{plan:?}");
}

fn of_surfels(count: u64) -> Settings {
    Settings {
        surfels: SurfelSampling::Area { count },
        ..Settings::default()
    }
}

/// Slats of a third of the light above a floor, one in two of them coloured.
fn slats() -> Scene {
    let rect = |name: String, [x0, x1]: [f64; 2], y: f64| {
        let corners = [[x0, y, -9.0], [x0, y, 9.0], [x1, y, 9.0], [x1, y, -9.0]];
        MeshInput::new(&name, corners, vec![[0, 1, 2], [0, 2, 3]])
    };
    let slats = (0..60_usize).map(|i| {
        let x = 0.3 * i as f64 - 9.0;
        let albedo = [[0.5; 3], [0.8, 0.3, 0.1]][i % 2];
        rect(format!("slat {i}"), [x, x + 0.1], 0.5).albedo(albedo)
    });
    let floor = rect("floor".into(), [-9.0, 9.0], 0.0);
    let sun = LightInput::sun([0.1, -1.0, 0.2], [3.0; 3], 0.5).unwrap();
    let scene = SceneBuilder::new("slats").light(sun).mesh(floor);
    slats.fold(scene, SceneBuilder::mesh).build().unwrap()
}

#[test]
fn a_plan_holds_where_there_are_surfaces() {
    let scene = slats();
    for count in [700, 60_000, 400_000] {
        holds(&scene, &of_surfels(count));
    }
    let part = Settings {
        part: Part::new(1, 3).unwrap(),
        ..of_surfels(400_000)
    };
    holds(&scene, &part);
}

#[test]
fn a_plan_holds_where_rays_of_a_camera_miss() {
    let work = Work::new(ROOM);
    let from_camera = Settings {
        surfels: SurfelSampling::Camera {
            name: None,
            rate: 4.0,
            overscan: 2.0,
        },
        ..Settings::default()
    };
    holds(&work.scene(), &from_camera);
}

/// A cloud that is dense at its middle, with a hole, beside a floor that cuts it.
#[test]
fn a_plan_holds_where_there_are_media() {
    const EDGE: usize = 96;
    let place = DAffine3::from_translation(DVec3::splat(-1.0))
        * DAffine3::from_scale(DVec3::splat(2.0 / EDGE as f64));
    let density = |v: [usize; 3]| {
        let at = v.map(|i| (i as f32 + 0.5) / (EDGE / 2) as f32 - 1.0);
        let from = |x: f32| (at[0] - x).hypot(at[1]).hypot(at[2]);
        let is_hole = from(0.6) < 0.3;
        if is_hole {
            0.0
        } else {
            40.0 * (0.9 - from(0.0)).max(0.0).powi(2)
        }
    };
    let grid = Grid::from_fn([EDGE; 3], density);
    let corners = [[-9.0, -0.6, -9.0], [0.0, -0.5, 9.0], [9.0, -0.5, -9.0]];
    let scene = SceneBuilder::new("cloud")
        .light(LightInput::sun([0.5, -0.7, -0.5], [5.0; 3], 0.0).unwrap())
        .volume(VolumeInput::new("cloud", grid, [0.9; 3], place))
        .mesh(MeshInput::new("floor", corners, vec![[0, 1, 2]]))
        .build()
        .unwrap();
    holds(&scene, &of_surfels(3000));
    let blocks = bake::BlockSize::Fixed {
        level: 1,
        samples: 4,
    };
    holds(
        &scene,
        &Settings {
            blocks,
            ..of_surfels(3000)
        },
    );
}
