//! Cameras with a lens or an open shutter: circles of confusion in closed form, the light that the
//! path tracer has, and the same picture in tiles.

use crate::{Work, beauty, mean, relative_rms, shade, traced, with_threads};
use glam::{DAffine3, DVec3};
use lvox::image::Region;
use lvox::run::Job;
use lvox::scene::{
    CameraInput, CameraKey, Film, Grid, LightInput, MeshInput, Scene, SceneBuilder, VolumeInput,
};
use lvox::shade::{self as shading, Aov, Settings};
use lvox::tree::OpenTree;

const FOV: f64 = 0.7;

/// Pixels at a distance of 1.
fn pixels_per_tangent(film: Film) -> f64 {
    f64::from(film.width) / (2.0 * (0.5 * FOV).tan())
}

fn film(width: u32, height: u32) -> Film {
    Film {
        width,
        height,
        exposure: 1.0,
    }
}

/// A disk that shines at the camera, `distance` away and `radius` wide, before nothing.
fn disk(distance: f64, radius: f64, camera: CameraInput) -> Scene {
    const CORNERS: u32 = 48;
    let rim = (0..CORNERS).map(|i| {
        let (sin, cos) = (std::f64::consts::TAU * f64::from(i) / f64::from(CORNERS)).sin_cos();
        DVec3::new(radius * cos, radius * sin, -distance).to_array()
    });
    let corners: Vec<[f64; 3]> = [[0.0, 0.0, -distance]].into_iter().chain(rim).collect();
    let triangles = (0..CORNERS).map(|i| [0, 1 + i, 1 + (i + 1) % CORNERS]);
    let disk = MeshInput::new("disk", corners, triangles.collect());
    SceneBuilder::new("disk")
        .film(film(72, 72))
        .camera(camera)
        .mesh(disk.albedo([0.0; 3]).emission([50.0; 3]))
        .build()
        .unwrap()
}

fn ahead() -> CameraInput {
    CameraInput::look_at("front", [0.0; 3], [0.0, 0.0, -1.0], DVec3::Y, FOV).unwrap()
}

#[test]
fn a_small_disk_out_of_focus_is_spread_over_its_circle_of_confusion() {
    let (distance, radius, aperture) = (4.0, 0.04, 0.2);
    for focus in [2.0, 12.0] {
        let scene = disk(distance, radius, ahead().lens(aperture, focus));
        let work = Work::new("");
        let tree = work.bake(&scene, 1000);
        let scale = pixels_per_tangent(scene.film);
        let confusion =
            f64::from(aperture) * (1.0 / f64::from(focus) - 1.0 / distance).abs() * scale;
        let seen = radius / distance * scale;
        let even = 50.0 * (seen / confusion).powi(2);
        let found = beauty(&shade(&scene, &tree, &Settings::default()));
        for (what, picture) in [("shade", &found), ("reference", &traced(&scene, 3, 2048))] {
            let (mut light, mut most) = (0.0, 0.0_f64);
            let (mut inside, mut count) = (0.0, 0);
            for (i, pixel) in picture.iter().enumerate() {
                let [x, y] = [i % 72, i / 72].map(|c| c as f64 + 0.5 - 36.0);
                let away = x.hypot(y);
                light += f64::from(pixel[1]);
                if away > confusion + seen + 0.8 {
                    assert!(pixel[1] == 0.0, "{what} {focus}: {x} {y}");
                }
                if away < confusion - seen - 0.8 {
                    inside += f64::from(pixel[1]);
                    count += 1;
                    most = most.max((f64::from(pixel[1]) / even - 1.0).abs());
                }
            }
            // None is lost, and the circle is even.
            let all = 50.0 * std::f64::consts::PI * seen * seen * 0.997;
            assert!(
                (light / all - 1.0).abs() < 0.03,
                "{what} {focus}: {light} of {all}"
            );
            let inside = inside / f64::from(count);
            assert!(
                (inside / even - 1.0).abs() < 0.04,
                "{what} {focus}: {inside} of {even}"
            );
            assert!(what == "reference" || most < 0.05, "{what} {focus}: {most}");
        }
    }
}

/// A floor with a ball of triangles near the camera and one far away, and smoke if that is asked
/// for.
fn still_life(camera: CameraInput, smoke: bool) -> Scene {
    let corners = [
        [-3.0, 0.0, 3.0],
        [3.0, 0.0, 3.0],
        [3.0, 0.0, -4.0],
        [-3.0, 0.0, -4.0],
    ];
    let floor = MeshInput::new("floor", corners, vec![[0, 1, 2], [0, 2, 3]]);
    let post = |x: f64, z: f64, albedo: [f32; 3]| {
        let corners = [
            [x - 0.1, 0.0, z],
            [x + 0.1, 0.0, z],
            [x + 0.1, 0.9, z],
            [x - 0.1, 0.9, z],
        ];
        MeshInput::new("post", corners, vec![[0, 1, 2], [0, 2, 3]]).albedo(albedo)
    };
    let builder = SceneBuilder::new("still life")
        .film(film(64, 48))
        .camera(camera)
        .mesh(floor.albedo([0.6, 0.5, 0.4]))
        .mesh(post(-0.25, 1.6, [0.2, 0.3, 0.7]))
        .mesh(post(0.1, 0.0, [0.7, 0.6, 0.2]))
        .mesh(post(0.7, -2.5, [0.7, 0.2, 0.2]))
        .light(LightInput::sun([0.4, -1.0, -0.6], [2.0, 1.9, 1.7], 0.02).unwrap())
        .light(LightInput::environment([0.4, 0.5, 0.7]));
    let builder = match smoke {
        true => {
            let ball = Grid::from_fn([24; 3], move |v| {
                let squares: f32 = v.iter().map(|i| ((*i as f32 - 11.5) / 12.0).powi(2)).sum();
                3.0 * (1.5 - 1.5 * squares).clamp(0.0, 1.0)
            });
            let place = DAffine3::from_translation(DVec3::new(-0.9, 0.1, -1.2))
                * DAffine3::from_scale(DVec3::splat(0.9 / 24.0));
            builder.volume(VolumeInput::new("smoke", ball, [0.8; 3], place))
        }
        false => builder,
    };
    builder.build().unwrap()
}

fn before_still_life() -> CameraInput {
    CameraInput::look_at("front", [0.0, 0.8, 3.2], [0.0, 0.4, 0.0], DVec3::Y, FOV).unwrap()
}

/// A camera that goes to the right from frame 0 to 1.
fn moving() -> CameraInput {
    let key = |frame: i32, x: f64| CameraKey {
        frame,
        position: DVec3::new(x, 0.8, 3.2),
        target: DVec3::new(x, 0.4, 0.0),
        up: DVec3::Y,
        fov_x_rad: FOV,
        lens: None,
    };
    CameraInput::moving("front", vec![key(0, -0.2), key(1, 0.2)]).unwrap()
}

#[test]
fn lenses_and_shutters_agree_with_the_path_tracer() {
    for (name, camera, smoke) in [
        ("lens", before_still_life().lens(0.06, 3.2), false),
        ("lens and smoke", before_still_life().lens(0.06, 3.2), true),
        ("shutter", moving().shutter(0.0, 1.0), false),
        (
            "lens and shutter",
            moving().lens(0.04, 3.0).shutter(0.2, 0.6),
            false,
        ),
    ] {
        let scene = still_life(camera, smoke);
        let work = Work::new("");
        let tree = work.bake(&scene, 20_000);
        let found = beauty(&shade(&scene, &tree, &Settings::default()));
        let expected = traced(&scene, 3, 256);
        let bias = mean(&found) / mean(&expected) - 1.0;
        assert!(bias.abs() < 0.004, "{name}: {bias}");
        let rms = relative_rms(&found, &expected);
        assert!(rms < 0.035, "{name}: {rms}");
    }
}

#[test]
fn what_is_out_of_focus_differs_from_what_a_pinhole_sees() {
    let of = |camera: CameraInput| {
        let scene = still_life(camera, false);
        let work = Work::new("");
        let tree = work.bake(&scene, 5000);
        beauty(&shade(&scene, &tree, &Settings::default()))
    };
    let pinhole = of(before_still_life());
    assert!(of(before_still_life().lens(0.0, 3.2)) == pinhole);
    assert!(of(before_still_life().shutter(0.0, 1.0)) == pinhole);
    let lens = of(before_still_life().lens(0.06, 3.2));
    assert!(relative_rms(&lens, &pinhole) > 0.02);
    let moved = of(moving().shutter(0.0, 1.0));
    assert!(relative_rms(&moved, &pinhole) > 0.02);
}

#[test]
fn tiles_and_threads_make_the_same_picture_through_a_lens() {
    for (camera, smoke) in [
        (before_still_life().lens(0.06, 3.2), true),
        (moving().lens(0.04, 3.0).shutter(0.2, 0.6), false),
    ] {
        let scene = still_life(camera, smoke);
        let work = Work::new("");
        let tree = work.bake(&scene, 5000);
        let whole = shade(&scene, &tree, &Settings::default());
        let picture = beauty(&whole);
        let again = with_threads(1, || shade(&scene, &tree, &Settings::default()));
        assert!(picture == beauty(&again));
        let store = OpenTree::open(&tree, None).unwrap();
        let aovs = Aov::ALL.map(|(_, aov)| aov);
        for region in [[13, 7, 31, 29], [40, 30, 64, 48], [20, 20, 21, 21]] {
            let [x0, y0, x1, y1] = region;
            let region = Region { x0, y0, x1, y1 };
            let job = Job::default();
            let tile = shading::run(&scene, &store, &Settings::default(), region, &aovs, &job);
            let tile = tile.unwrap();
            for name in ["", "direct", "environment", "indirect", "volume", "albedo"] {
                let part = tile.picture(name, &region).unwrap().pixels;
                let all = whole.picture(name, &whole.region).unwrap().pixels;
                for (pixel, (x, y)) in part.iter().zip(region.coordinates()) {
                    let same = all[(y * scene.film.width + x) as usize];
                    assert!(*pixel == same, "{name} {x} {y}: {pixel:?} {same:?}");
                }
            }
        }
    }
}

/// A floor before a wall, half of which is in the penumbra of that under a wide sun.
fn in_penumbra(camera: CameraInput) -> Scene {
    let square = |name: &str, corners: [[f64; 3]; 4]| {
        let mesh = MeshInput::new(name, corners.to_vec(), vec![[0, 1, 2], [0, 2, 3]]);
        mesh.albedo([0.5; 3])
    };
    let floor = [[-4.0, 4.0], [4.0, 4.0], [4.0, -4.0], [-4.0, -4.0]].map(|[x, z]| [x, 0.0, z]);
    let wall = [[-4.0, -4.0], [4.0, -4.0], [4.0, 4.0], [-4.0, 4.0]].map(|[x, y]| [x, y, -1.2]);
    let sun = LightInput::sun([-0.77, -0.52, 0.84], [3.4; 3], 0.1).unwrap();
    SceneBuilder::new("penumbra")
        .film(film(160, 120))
        .camera(camera)
        .mesh(square("floor", floor))
        .mesh(square("wall", wall))
        .light(sun)
        .build()
        .unwrap()
}

#[test]
fn shadows_are_where_a_pinhole_sees_them() {
    let light = |up: DVec3, aperture: f32| {
        let (from, to) = ([0.04, 1.0, 2.0], [0.0, 0.5, 0.0]);
        let camera = CameraInput::look_at("front", from, to, up, 1.92).unwrap();
        let camera = match aperture > 0.0 {
            true => camera.lens(aperture, 3.6),
            false => camera,
        };
        let scene = in_penumbra(camera);
        let work = Work::new("");
        let tree = work.bake(&scene, 5_000);
        mean(&beauty(&shade(&scene, &tree, &Settings::default())))
    };
    for up in [DVec3::Y, -DVec3::Y] {
        let off = light(up, 0.026) / light(up, 0.0) - 1.0;
        assert!(off.abs() < 0.004, "{up}: {off}");
    }
}
