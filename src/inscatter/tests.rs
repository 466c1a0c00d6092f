//! Where light in media is looked for, and how soon that stops on request.

mod lamps;

use super::counts::Counters;
use super::far_field::FarField;
use super::source::{InScatter, MediaLights, RayMemo};
use super::spacing::LeastSpacing;
use super::sweep::{Sweep, SweepScope};
use super::vertices::BORDER_MARGIN_VOXELS;
use crate::Kind;
use crate::gather::{self, ColoredMedia, Gatherer, Geometry, Medium, NoMedia, PatchRadiance};
use crate::image::Region;
use crate::light::{Lights, SceneMedia};
use crate::math::segment::{Composite, Segment};
use crate::math::{Hit, Ray, Rgb, sampling};
use crate::run::{Cancel, Job};
use crate::scene::{Film, Grid, Scene, Volume};
use crate::trace::Tracer;
use crate::tree::{Media, OpenTree};
use crate::view::{View, VisibleMedia};
use glam::{DAffine3, DVec3, Vec3};
use lvox_formats::record::{Lvoxel, VolumeInfo};
use lvox_formats::{Overwrite, Sums, TreeMeta, TreeWriter};
use std::sync::Mutex;
use std::sync::atomic::{AtomicU64, Ordering};

/// Opens a tree without surfels, with the folder that it is in.
fn tree_without_surfels() -> (tempfile::TempDir, OpenTree) {
    let dir = tempfile::tempdir().unwrap();
    let path = dir.path().join("empty.lvt");
    let writer = TreeWriter::create(&path, TreeMeta::default(), Overwrite::Refuse).unwrap();
    writer.finish(None, Sums::default(), vec![]).unwrap();
    let tree = OpenTree::open(&path, None).unwrap();
    (dir, tree)
}

/// Black surfaces at some distance from wherever rays begin, which is noted.
#[derive(Debug)]
struct Shell {
    distance: f32,
    origins: Mutex<Vec<Vec3>>,
    /// Asked to stop by the first ray.
    cancel: Option<Cancel>,
}

impl Shell {
    fn at(distance: f32) -> Self {
        Self {
            distance,
            origins: Mutex::default(),
            cancel: None,
        }
    }

    fn rays(&self) -> usize {
        self.origins.lock().unwrap().len()
    }
}

impl Geometry for Shell {
    fn closest(&self, ray: &Ray) -> Option<Hit> {
        self.origins.lock().unwrap().push(ray.origin);
        self.cancel.as_ref().map(Cancel::request);
        self.distance.is_finite().then_some(Hit {
            t: self.distance,
            triangle: 0,
            uv: [0.3; 2],
            is_back: false,
        })
    }

    fn triangles(&self) -> u32 {
        1
    }

    fn corners(&self, _: u32) -> [Vec3; 3] {
        [Vec3::ZERO, Vec3::X, Vec3::Y]
    }

    fn normal(&self, _: u32) -> Vec3 {
        Vec3::Z
    }

    fn surfel_area_over_mean(&self, _: u32) -> Option<f32> {
        None
    }
}

/// No medium; rays through it are counted, and the first asks for a stop.
#[derive(Clone, Copy)]
struct Counted<'a> {
    rays: &'a AtomicU64,
    cancel: Option<&'a Cancel>,
}

impl Medium for Counted<'_> {
    type Share = f32;

    fn walk(&self, _: &Ray, _: &mut impl FnMut(Segment) -> bool) -> bool {
        self.rays.fetch_add(1, Ordering::Relaxed);
        self.cancel.map(Cancel::request);
        true
    }
}

/// Voxels along each edge of the haze.
const SIDE: usize = 16;

/// Haze before the camera, of this extinction, its lower border in the plane y = -8.
fn haze(sigma_t: f32) -> Scene {
    let mut scene = Scene::without_picture();
    let place = DAffine3::from_translation(DVec3::new(-8.0, -8.0, -20.0));
    let grid = Grid::from_fn([SIDE; 3], |_| sigma_t);
    let volume = Volume::new("haze".into(), grid, [0.9; 3], place);
    scene.volumes.push(volume);
    scene
}

/// Calls `run` with what light in a thin haze is looked for with.
fn with_haze<M: Medium<Share = f32>, T>(
    around: &Shell,
    media: M,
    run: impl FnOnce(&View, &Lights, &Gatherer<M>) -> T,
) -> T {
    with(&haze(0.02), around, media, run)
}

/// The same in any scene.
fn with<M: Medium, T>(
    scene: &Scene,
    around: &Shell,
    media: M,
    run: impl for<'a> FnOnce(&View, &Lights<'a, SceneMedia<'a, M::Share>>, &Gatherer<M>) -> T,
) -> T {
    let tracer = Tracer::new(scene);
    let view = View::new(&tracer, scene.camera(None).unwrap(), scene.film, 5);
    let outgoing = PatchRadiance::new(around, 0.0, 0).unwrap();
    let (_dir, tree) = tree_without_surfels();
    let gatherer = Gatherer {
        pages: &tree.surfels,
        media,
        settings: gather::RaySettings {
            samples: 8,
            max_solid_angle: 0.01,
            max_dist: f32::INFINITY,
            kernel: gather::RayKernel::Traced(&outgoing),
            environment: crate::math::Environment::even(Rgb::BLACK),
            leave_out_bright: false,
        },
    };
    run(&view, &Lights::new(&tracer), &gatherer)
}

fn in_scatter<'a, M: Medium<Share = f32>>(
    view: &View<'a>,
    regions: &[Region],
    lights: &'a Lights<'a>,
    gatherer: &'a Gatherer<'a, M>,
    job: &Job,
) -> crate::Result<InScatter<'a, Gatherer<'a, M>>> {
    let light = MediaLights {
        lights,
        gatherer: Some(gatherer),
        scattered: None,
        incident: None,
    };
    InScatter::new(view, VisibleMedia::ThroughRegions(regions), &light, job)
}

/// Sweeps the haze on one thread.
fn sweep<M: Medium<Share = f32>>(around: &Shell, media: M, cancel: &Cancel) -> crate::Result<()> {
    let job = Job {
        cancel: cancel.clone(),
        ..Job::default()
    };
    let pool = rayon::ThreadPoolBuilder::new().num_threads(1).build();
    with_haze(around, media, |view, lights, gatherer| {
        let regions = [Region::full(1, 1)];
        let in_scatter = pool
            .unwrap()
            .install(|| in_scatter(view, &regions, lights, gatherer, &job));
        in_scatter.map(drop)
    })
}

/// Whether all rays began inside the haze, away from the planes of its borders.
fn assert_inside(around: &Shell) {
    let origins = around.origins.lock().unwrap();
    assert!(!origins.is_empty());
    for &origin in origins.iter() {
        let at = origin + Vec3::new(8.0, 8.0, 20.0);
        let (least, most) = (at.min_element(), at.max_element());
        assert!(
            least > 0.9 * BORDER_MARGIN_VOXELS && most < SIDE as f32 - 0.9 * BORDER_MARGIN_VOXELS,
            "{at}"
        );
    }
}

#[test]
fn probes_and_vertices_keep_off_the_planes_of_a_volumes_borders() {
    let far = Shell::at(f32::INFINITY);
    with_haze(&far, NoMedia, |view, _, gatherer| {
        let volume = &view.tracer.scene.volumes[0];
        let field = FarField::new(volume, 8, 1);
        for corner in [[0.0; 3], [16.0; 3], [8.0, 0.0, 8.0], [0.0, 16.0, 3.0]] {
            assert!(field.around(volume, gatherer, corner.into()).is_some());
        }
    });
    assert_inside(&far);
    // Too near for probes: vertices gather for themselves.
    let near = Shell::at(0.5);
    with_haze(&near, NoMedia, |view, lights, gatherer| {
        let (regions, job) = ([Region::full(1, 1)], Job::default());
        let in_scatter = in_scatter(view, &regions, lights, gatherer, &job).unwrap();
        let probes = near.rays();
        let floor = |x: f32| Vec3::new(x, -7.9, -12.0);
        let _ = in_scatter.source(
            0,
            [floor(0.0), floor(0.1)],
            0.002,
            1.0,
            &mut RayMemo::default(),
        );
        assert!(near.rays() > probes);
    });
    assert_inside(&near);
}

#[test]
fn sweeps_stop_soon_on_request() {
    let (far, none) = (Shell::at(f32::INFINITY), Cancel::default());
    let rays = AtomicU64::new(0);
    let counted = Counted {
        rays: &rays,
        cancel: None,
    };
    sweep(&far, counted, &none).unwrap();
    let (probed, swept) = (far.rays(), rays.swap(0, Ordering::Relaxed));
    assert!(probed > 0 && swept > 100, "{probed} {swept}");

    let asked_before = Cancel::default();
    asked_before.request();
    let far = Shell::at(f32::INFINITY);
    let error = sweep(&far, counted, &asked_before).unwrap_err();
    assert_eq!((error.kind(), far.rays()), (Kind::Cancelled, 0));

    // By the first ray of a probe: those of one vertex, of 8 at most, are looked from.
    let cancel = Cancel::default();
    let far = Shell {
        cancel: Some(cancel.clone()),
        ..Shell::at(f32::INFINITY)
    };
    let error = sweep(&far, counted, &cancel).unwrap_err();
    assert_eq!(
        (error.kind(), rays.load(Ordering::Relaxed)),
        (Kind::Cancelled, 0)
    );
    assert!(2 * far.rays() < probed, "{} of {probed}", far.rays());

    // By the first ray of the sweep.
    let cancel = Cancel::default();
    let counted = Counted {
        cancel: Some(&cancel),
        ..counted
    };
    let error = sweep(&Shell::at(f32::INFINITY), counted, &cancel).unwrap_err();
    assert_eq!(
        (error.kind(), rays.load(Ordering::Relaxed)),
        (Kind::Cancelled, 1)
    );
}

#[test]
fn sweeps_beyond_the_memory_limit_are_refused_before_they_begin() {
    // A vertex at each voxel: 17^3 of some hundred bytes.
    let mut scene = haze(1.0);
    scene.film = LARGE;
    for (memory_limit, is_held) in [
        (None, true),
        (Some(4 << 20), true),
        (Some(1 << 20), false),
        (Some(1), false),
    ] {
        let far = Shell::at(f32::INFINITY);
        let job = Job {
            memory_limit,
            ..Job::default()
        };
        let made = with(&scene, &far, NoMedia, |view, lights, gatherer| {
            in_scatter(
                view,
                &[Region::full(LARGE.width, LARGE.height)],
                lights,
                gatherer,
                &job,
            )
            .map(drop)
        });
        assert_eq!(far.rays() > 0, is_held);
        if is_held {
            made.unwrap();
            continue;
        }
        let error = made.unwrap_err();
        assert_eq!(error.kind(), Kind::Input);
        assert!(error.to_string().contains("4661 vertices"), "{error}");
        assert!(error.to_string().contains("\"haze\""), "{error}");
        assert!(error.hint_text().unwrap().contains("`max_dist`"));
    }
    // What looks past the volume has no sweep.
    let far = Shell::at(f32::INFINITY);
    let job = Job {
        memory_limit: Some(1),
        ..Job::default()
    };
    with(&scene, &far, NoMedia, |view, lights, gatherer| {
        in_scatter(view, &[], lights, gatherer, &job).map(drop)
    })
    .unwrap();
}

#[test]
fn what_a_sweep_takes_is_also_that_of_its_rays() {
    // Two specks at opposite corners: few vertices, but four rows of rays are held in 257 layers,
    // in eight directions.
    const FAR: usize = 256;
    let mut scene = haze(1.0);
    scene.film = LARGE;
    let is_speck = |v: [usize; 3]| v == [0; 3] || v == [FAR - 1; 3];
    let volume = &mut scene.volumes[0];
    volume.sigma_t = Grid::from_fn([FAR; 3], |v| f32::from(is_speck(v))).into();
    volume.place(DAffine3::from_translation(DVec3::new(
        -128.0, -128.0, -600.0,
    )));
    let far = Shell::at(f32::INFINITY);
    for (memory_limit, is_held) in [(10 << 20, false), (100 << 20, true)] {
        let job = Job {
            memory_limit: Some(memory_limit),
            ..Job::default()
        };
        let made = with(&scene, &far, NoMedia, |view, lights, gatherer| {
            in_scatter(
                view,
                &[Region::full(LARGE.width, LARGE.height)],
                lights,
                gatherer,
                &job,
            )
            .map(drop)
        });
        match made {
            Ok(()) => assert!(is_held),
            Err(error) => {
                assert!(error.to_string().contains("54 vertices"), "{error}");
                assert!(!is_held, "{error}");
            }
        }
    }
}

/// A film of so many pixels that each voxel covers some.
const LARGE: Film = Film {
    width: 4096,
    height: 4096,
    exposure: 1.0,
};

/// Extinction of a haze whose left face is lit, and light in it fades to the right.
const SIGMA_T: f32 = 0.3;

/// The lvoxels of a volume of the haze's size.
fn lvoxels(volume: u16, source: impl Fn([u16; 3]) -> f32) -> Vec<Lvoxel> {
    let side = 0..SIDE as u16;
    let blocks = side.clone().flat_map(|z| {
        let rows = side.clone().flat_map(|y| side.clone().map(move |x| [x, y]));
        rows.map(move |[x, y]| [x, y, z])
    });
    let lvoxel = |block| Lvoxel {
        block,
        level: 0,
        volume,
        sigma_t: SIGMA_T,
        source: [source(block); 3],
        ..Lvoxel::default()
    };
    blocks.map(lvoxel).collect()
}

fn lit([x, ..]: [u16; 3]) -> f32 {
    (-SIGMA_T * (f32::from(x) + 0.5)).exp()
}

/// Swept light from the lit face of the haze inwards, along the middle, and the same by many rays.
fn swept_and_exact(scene: &Scene, lvoxels: Vec<Lvoxel>) -> Vec<[f32; 2]> {
    let media = media_of(scene, lvoxels);
    let found = swept_and_exact_in(scene, &media).into_iter();
    found.map(|light| light.map(|l| l.0[0])).collect()
}

fn media_of(scene: &Scene, lvoxels: Vec<Lvoxel>) -> Media {
    let infos: Vec<VolumeInfo> = scene
        .volumes
        .iter()
        .map(|volume| VolumeInfo {
            name: volume.name.clone(),
            dims: volume.sigma_t.dims().map(|n| n as u32),
            index_from_scene: volume.index_from_scene_f64.to_cols_array_2d(),
            albedo: volume.albedo,
            extinction_color: volume.extinction_color,
        })
        .collect();
    Media::new(&infos, lvoxels)
}

/// The same in all channels.
fn swept_and_exact_in<M: Medium>(scene: &Scene, media: M) -> Vec<[Rgb; 2]> {
    let volume = &scene.volumes[0];
    let (far, job) = (Shell::at(f32::INFINITY), Job::default());
    with(scene, &far, media, |view, _, gatherer| {
        let far_field = FarField::new(volume, 64, 1);
        let scope = SweepScope {
            view,
            visible: VisibleMedia::ThroughRegions(&[Region::full(1, 1)]),
            gatherer,
            volume,
            far_field: &far_field,
            job: &job,
            counters: &Counters::default(),
        };
        let sweep = Sweep::new(&scope, &LeastSpacing::none(), |_, own| own).unwrap();
        let level = sweep.level_at(Vec3::splat(8.0)).unwrap();
        assert_eq!(level, 2);
        let along = |x: usize| {
            let p =
                Vec3::new(4.0 * x as f32, 8.0, 8.0).clamp(Vec3::splat(0.01), Vec3::splat(15.99));
            let origin = volume.scene_from_index.transform_point3(p.as_dvec3());
            let mut exact = Rgb::BLACK;
            for i in 0..4000 {
                let direction = sampling::sphere(sampling::r2(i, [0.5; 2]));
                let mut light = Composite::default();
                media.pass(
                    &Ray::endless(origin.as_vec3(), direction),
                    0.0,
                    &[],
                    &mut light,
                );
                exact += light.radiance * (1.0 / 4000.0);
            }
            [sweep.get(level, [x, 2, 2]).unwrap(), exact]
        };
        (0..=4).map(along).collect()
    })
}

#[test]
fn a_sweep_finds_the_crest_of_light_in_a_medium_that_is_lit_from_one_side() {
    // Straight lines between rays would be 8 % too dark at the face, and 11 % off on the whole.
    let mut squares = 0.0;
    let found = swept_and_exact(&haze(SIGMA_T), lvoxels(0, lit));
    for (x, [swept, exact]) in found.into_iter().enumerate() {
        let error = swept / exact - 1.0;
        assert!(x > 0 || error.abs() < 0.04, "{error}");
        squares += error * error / 5.0;
    }
    assert!(squares.sqrt() < 0.07, "{}", squares.sqrt());
}

#[test]
fn a_huge_volume_around_another_moves_no_light_in_it() {
    let alone = swept_and_exact(&haze(SIGMA_T), lvoxels(0, lit));
    let mut scene = haze(SIGMA_T);
    let mut huge = haze(1e-12).volumes.remove(0);
    huge.place(
        DAffine3::from_translation(DVec3::splat(-5e7))
            * DAffine3::from_scale(DVec3::splat(1e8 / SIDE as f64)),
    );
    scene.volumes.push(huge);
    let beside = swept_and_exact(&scene, lvoxels(0, lit));
    for ([alone, _], [beside, _]) in alone.into_iter().zip(beside) {
        assert!((beside / alone - 1.0).abs() < 1e-4, "{beside} {alone}");
    }
}

#[test]
fn light_of_a_volume_beside_another_is_swept_into_it() {
    let mut scene = haze(SIGMA_T);
    let mut bright = haze(SIGMA_T).volumes.remove(0);
    bright.place(DAffine3::from_translation(DVec3::new(-24.5, -8.0, -20.0)));
    scene.volumes.push(bright);
    let both = [lvoxels(0, |_| 0.0), lvoxels(1, |_| 1.0)].concat();
    // Where little of it is left, a few directions tell it roughly.
    let sums = |found: Vec<[Rgb; 2]>| {
        let sum = |i: usize| found.iter().fold(Rgb::BLACK, |sum, light| sum + light[i]);
        [sum(0), sum(1)]
    };
    let grey = sums(swept_and_exact_in(&scene, &media_of(&scene, both.clone())));
    for (volume, color) in (scene.volumes.iter_mut()).zip([[1.0, 0.5, 0.2], [0.3, 1.0, 1.0]]) {
        volume.extinction_color = color;
    }
    let media = media_of(&scene, both);
    let colored = sums(swept_and_exact_in(&scene, ColoredMedia(&media)));
    for [swept, exact] in [grey, colored] {
        for (swept, exact) in swept.0.into_iter().zip(exact.0) {
            assert!((swept / exact - 1.0).abs() < 0.1, "{swept} {exact}");
        }
    }
    // The channels that the dark medium lets through are brighter in it.
    let [_, exact] = colored;
    assert!(
        exact.0[1] > 1.2 * exact.0[0] && exact.0[2] > 1.1 * exact.0[1],
        "{exact:?}"
    );
}

/// Lights all of the haze beforehand.
fn light_all(around: &Shell, job: &Job) -> crate::Result<Vec<super::VolumeLight>> {
    with_haze(around, NoMedia, |view, lights, gatherer| {
        let light = MediaLights {
            lights,
            gatherer: Some(gatherer),
            scattered: None,
            incident: None,
        };
        InScatter::new(view, VisibleMedia::All, &light, job)?.light_all(job)
    })
}

#[test]
fn what_is_lit_beforehand_is_what_any_ray_asks_for() {
    // Near surfaces let no probe stand for them: vertices gather for themselves then, before any
    // ray does.
    for distance in [f32::INFINITY, 0.5] {
        let around = Shell::at(distance);
        let lit = light_all(&around, &Job::default()).unwrap().remove(0);
        let swept: Vec<_> = lit.indirect.iter().flatten().collect();
        assert!(!swept.is_empty());
        assert!(swept.iter().all(|l| l.values.iter().all(Option::is_some)));
        let step = lit.direct.iter().rposition(Option::is_some).unwrap();
        // The haze fills its box: all vertices are lit.
        let along = SIDE.div_ceil(1 << step) + 1;
        let direct = lit.direct[step].as_ref().unwrap();
        assert_eq!(direct.values.len(), along.pow(3));
    }
}

#[test]
fn lighting_all_is_refused_or_stops_before_it_takes_more_than_it_may() {
    let around = Shell::at(f32::INFINITY);
    let small = Job {
        memory_limit: Some(1),
        ..Job::default()
    };
    let error = light_all(&around, &small).unwrap_err();
    assert_eq!(error.kind(), Kind::Input);
    assert_eq!(error.hint_text(), Some("raise `memory_limit`"));
    let stopped = Job::default();
    stopped.cancel.request();
    assert!(light_all(&around, &stopped).is_err());
}

#[test]
fn what_is_passed_unseen_is_not_lit() {
    let around = Shell::at(f32::INFINITY);
    with(&haze(3.0), &around, NoMedia, |view, lights, gatherer| {
        let regions = [Region::full(1, 1)];
        let job = Job::default();
        let in_scatter = in_scatter(view, &regions, lights, gatherer, &job).unwrap();
        let ray = Ray::endless(Vec3::ZERO, -Vec3::Z);
        let (passed, took) = in_scatter.march_counted(&ray);
        assert!(passed.transmittance < 1e-15, "{took:?}");
        assert!(took.segments >= 1 && took.segments < took.cells, "{took:?}");
    });
}
