//! The fast kernel against the plain one, and media against a walk over all boxes.

use crate::demo;
use crate::support::random::Random;
use glam::{Affine3A, Quat, Vec3};
use lvox::build;
use lvox::formats::record::{MAX_LEVEL, VolumeInfo};
use lvox::formats::{ClipEdge, Clips, CloudMeta, CloudWriter, Lvoxel, Overwrite, Surfel};
use lvox::internals::gather::{
    Crossing, Gatherer, Medium, NoMedia, PatchRadiance, PatchRequest, RayKernel, RaySettings,
    SampleRange, SurfacePoint,
};
use lvox::internals::tree::{self, Media, SurfelStore};
use lvox::internals::{Composite, Environment, MAX_PACKET, Scratch, Tracer, plain, r2, sphere};
use lvox::run::Job;
use lvox::tree::OpenTree;
use lvox::{Ray, Rgb};
use std::f32::consts::PI;
use std::path::PathBuf;

const OVERLAP: f32 = 1.8;

/// Disks on a box of edge 2 seen from inside, and on thirty balls in it; no two of one plane
/// overlap by chance alone.
fn cloud(n: usize) -> Vec<Surfel> {
    let mut random = Random(7);
    let balls: Vec<([f32; 3], f32)> = (0..30)
        .map(|_| {
            let centre = std::array::from_fn(|_| 0.8 * random.signed());
            (centre, 0.02 + 0.1 * random.unit())
        })
        .collect();
    let ball_area: f32 = balls.iter().map(|(_, r)| 4.0 * PI * r * r).sum();
    let area = (24.0 + ball_area) / n as f32;
    (0..n)
        .map(|_| {
            let mut s = Surfel {
                area,
                radius: OVERLAP * (area / PI).sqrt(),
                ..Surfel::default()
            };
            let mut pick = random.unit() * (24.0 + ball_area) - 24.0;
            if pick < 0.0 {
                let axis = (random.next() % 3) as usize;
                let side = 1.0_f32.copysign(random.signed());
                s.position = std::array::from_fn(|_| random.signed());
                s.position[axis] = side;
                s.normal[axis] = -side;
            } else {
                let ball = balls.iter().find(|(_, r)| {
                    pick -= 4.0 * PI * r * r;
                    pick < 0.0
                });
                let (centre, r) = ball.unwrap_or(&balls[0]);
                s.normal = random.direction();
                s.position = std::array::from_fn(|a| centre[a] + r * s.normal[a]);
            }
            // Smooth over space, so that which of two overlapping disks is met does not matter.
            let p = s.position;
            s.front =
                std::array::from_fn(|c| 1.0 + (2.0 * p[c] + p[(c + 1) % 3]).sin() * s.normal[0]);
            s.back = [0.1, 0.0, 0.0];
            if random.next().is_multiple_of(20) {
                s.clips.count = 1;
                s.clips.edges[0] = ClipEdge {
                    angle: 6.0 * random.unit(),
                    offset: random.unit(),
                };
            }
            s
        })
        .collect()
}

fn store(surfels: &[Surfel]) -> (tempfile::TempDir, OpenTree) {
    let (dir, tree) = tree(surfels);
    let store = OpenTree::open(&tree, None).unwrap();
    (dir, store)
}

fn tree(surfels: &[Surfel]) -> (tempfile::TempDir, PathBuf) {
    let dir = tempfile::tempdir().unwrap();
    let (cloud, tree) = (dir.path().join("a.lvc"), dir.path().join("a.lvt"));
    let meta = CloudMeta {
        disk_overlap: OVERLAP,
        ..CloudMeta::default()
    };
    let mut writer = CloudWriter::create(&cloud, meta, Overwrite::Refuse).unwrap();
    writer.push_surfels(surfels).unwrap();
    writer.finish().unwrap();
    build::run(
        &cloud,
        &tree,
        &build::Settings::default(),
        Overwrite::Refuse,
        &Job::default(),
    )
    .unwrap();
    (dir, tree)
}

/// The surfels of a tree that was opened without a limit.
fn pages(store: &OpenTree) -> &SurfelStore {
    let pages = tree::surfels(store);
    assert!(!pages.are_cached(), "a limit without being asked");
    pages
}

fn settings(kernel: RayKernel, max_solid_angle: f32) -> RaySettings {
    RaySettings {
        samples: 64,
        max_solid_angle,
        max_dist: f32::INFINITY,
        kernel,
        environment: Environment::even(Rgb::splat(0.5)),
        leave_out_bright: false,
    }
}

/// Points in the box that are off all surfaces, and unit vectors.
fn receivers(n: usize) -> Vec<(Vec3, Vec3)> {
    let mut random = Random(11);
    (0..n)
        .map(|_| {
            let p: [f32; 3] = std::array::from_fn(|_| 0.95 * random.signed());
            (p.into(), random.direction().into())
        })
        .collect()
}

#[test]
fn the_fast_kernel_without_aggregates_sees_what_the_plain_one_sees() {
    let (_dir, store) = store(&cloud(40_000));
    let pages = pages(&store);
    let gatherer = |kernel| Gatherer {
        pages,
        media: NoMedia,
        settings: settings(kernel, 0.0),
    };
    let (fast, plain) = (gatherer(RayKernel::Cone), gatherer(RayKernel::Plain));
    let (mut other_distance, mut other_light) = (0, 0);
    let rays = receivers(40_000);
    let mut scratch = Scratch::default();
    for &(origin, direction) in &rays {
        let a = fast.incident(&Ray::endless(origin, direction), &mut scratch);
        let b = plain.incident(&Ray::endless(origin, direction), &mut scratch);
        let same = (a.distance - b.distance).abs() <= 1e-4 * (1.0 + b.distance);
        other_distance += usize::from(!same && a.distance != b.distance);
        let difference = (a.radiance.luminance() - b.radiance.luminance()).abs();
        other_light += usize::from(difference > 0.1);
    }
    // Rays through the rim of a disk.
    assert!(other_distance <= 8, "{other_distance} of {}", rays.len());
    assert!(other_light <= 16, "{other_light} of {}", rays.len());
}

#[test]
fn the_plain_kernel_sees_the_same_in_any_order() {
    let (_dir, store) = store(&cloud(10_000));
    let pages = pages(&store);
    let mut scratch = Scratch::default();
    let (mut other, mut met) = (0, 0);
    for (origin, direction) in receivers(10_000) {
        let far = f32::INFINITY;
        let near_first = plain::cast(pages, &Ray::new(origin, direction, far), &mut scratch);
        let as_stored =
            plain::cast_in_order::<false>(pages, &Ray::new(origin, direction, far), &mut scratch);
        other += usize::from(near_first.map(|c| c.t) != as_stored.map(|c| c.t));
        met += usize::from(near_first.is_some());
    }
    // A disk in the wall of a box can be met a rounding error before the box.
    assert!(met > 9000 && other <= 2, "{other} of {met}");
}

#[test]
fn aggregates_change_irradiance_by_a_few_percent() {
    let (_dir, store) = store(&cloud(200_000));
    let pages = pages(&store);
    let irradiance = |kernel, solid_angle| -> Vec<f32> {
        let gatherer = Gatherer {
            pages,
            media: NoMedia,
            settings: settings(kernel, solid_angle),
        };
        let all = receivers(1000);
        let light = all.iter().enumerate().map(|(i, (p, n))| {
            let gathered = gatherer.irradiance(*p, *n, *n, SampleRange::first(i as u64));
            gathered.light.luminance()
        });
        light.collect()
    };
    let plain = irradiance(RayKernel::Plain, 0.0);
    let mean: f32 = plain.iter().sum::<f32>() / plain.len() as f32;
    for (solid_angle, limit) in [(0.0, 0.002), (0.001, 0.02), (0.01, 0.03), (0.05, 0.06)] {
        let fast = irradiance(RayKernel::Cone, solid_angle);
        let pairs = fast.iter().zip(&plain);
        let square: f32 = pairs.map(|(a, b)| (a - b) * (a - b)).sum();
        let rms = (square / plain.len() as f32).sqrt() / mean;
        assert!(rms < limit, "{solid_angle} sr: {rms}");
    }
}

#[test]
fn neighbours_gather_together_what_they_gather_one_by_one() {
    let (_dir, store) = store(&cloud(40_000));
    let few = settings(RayKernel::Cone, 0.01);
    // More than are put in order.
    let many = RaySettings {
        samples: 5000,
        ..few
    };
    for (seed, neighbours) in receivers(96).chunks(12).enumerate() {
        let gatherer = Gatherer {
            pages: pages(&store),
            media: NoMedia,
            settings: if seed == 0 { many } else { few },
        };
        let order = gatherer.order(16);
        // Some of the stretches, in no order, and facets that are not quite where normals say.
        let point = |(k, &(position, normal)): (usize, &(Vec3, Vec3))| SurfacePoint {
            position,
            normal,
            face_normal: (normal + 0.3 * Vec3::Y).normalize(),
            range: (5 * k + 3) as u32 % 16,
        };
        let points: Vec<_> = neighbours.iter().enumerate().map(point).collect();
        let together = gatherer.irradiance_at_neighbours(&points, seed as u64, &order);
        for (p, got) in points.iter().zip(&together) {
            let stretch = SampleRange {
                index: p.range,
                seed: seed as u64,
            };
            let alone = gatherer.irradiance(p.position, p.normal, p.face_normal, stretch);
            assert_eq!(*got, alone);
        }
        assert!(together.iter().all(|g| g.light.luminance() > 0.0));
        // Sums in another order; some of the points look along the same range.
        let point = |p: &SurfacePoint| SurfacePoint {
            range: p.range / 3,
            ..*p
        };
        let points: Vec<_> = points.iter().map(point).collect();
        let around = gatherer.around_neighbours(&points, seed as u64, &order);
        for (p, got) in points.iter().zip(&around) {
            let stretch = SampleRange {
                index: p.range,
                seed: seed as u64,
            };
            let alone = gatherer.irradiance(p.position, p.normal, p.face_normal, stretch);
            let difference = got.gathered.light.luminance() - alone.light.luminance();
            assert!(difference.abs() < 1e-4 * alone.light.luminance());
            assert!((0.0..1.001).contains(&got.covered));
            let lone = gatherer.around_neighbours(&[*p], seed as u64, &order);
            assert_eq!(*got, lone[0]);
        }
    }
}

/// Whatever was asked before, and of whom.
#[test]
fn rays_that_are_looked_up_together_find_what_each_finds_alone() {
    let (_dir, scene, store) = demo(20_000);
    let tracer = Tracer::new(&scene);
    let corners = &scene.mesh.positions;
    let from = corners.iter().sum::<Vec3>() / corners.len() as f32;
    let ray = |i| Ray::new(from, sphere(r2(i, [0.5; 2])), 1e3);
    let rays: Vec<Ray> = (0..2000).map(ray).collect();
    let wanted = PatchRequest {
        max_solid_angle: 0.01,
        leave_out_bright: false,
    };
    let outgoing = || PatchRadiance::new(&tracer, store.area_per_surfel(), rays.len()).unwrap();
    let alone = outgoing();
    let mut stack = Default::default();
    let cast = |ray: &Ray| alone.cast(pages(&store), ray, wanted, &mut stack);
    let expected: Vec<_> = rays.iter().map(cast).collect();
    assert!(expected.iter().flatten().count() > 500);
    for size in [1, 5, MAX_PACKET] {
        let together = outgoing();
        let mut ends = [None; MAX_PACKET];
        for (rays, expected) in rays.chunks(size).zip(expected.chunks(size)) {
            together.cast_packet(pages(&store), rays, wanted, &mut stack, &mut ends);
            assert_eq!(&ends[..rays.len()], expected);
        }
        assert_eq!(alone.stats(), together.stats());
    }
}

#[test]
fn nothing_behind_the_facet_of_a_smooth_mesh_reaches_it() {
    let face = Vec3::Y;
    // A box that sends light from below its receiver alone.
    let mut below = cloud(20_000);
    for s in &mut below {
        let sent = if s.position[1] < -0.2 { 1.0 } else { 0.0 };
        (s.front, s.back) = ([sent; 3], [sent; 3]);
    }
    // A disk too small to be seen, so that there is a tree.
    let mut speck = below[0];
    (speck.position, speck.radius) = ([0.0, 100.0, 0.0], 1e-3);
    let (_dirs, stores): (Vec<_>, Vec<_>) = [store(&[speck]), store(&below)].into_iter().unzip();
    for kernel in [RayKernel::Cone, RayKernel::Plain] {
        let of = |store, environment, normal, face| {
            let gatherer = Gatherer {
                pages: pages(store),
                media: NoMedia,
                settings: RaySettings {
                    samples: 4096,
                    environment: Environment::even(Rgb::splat(environment)),
                    leave_out_bright: false,
                    ..settings(kernel, 0.0)
                },
            };
            let gathered = gatherer.irradiance(Vec3::ZERO, normal, face, SampleRange::first(3));
            gathered.light.luminance()
        };
        for degrees in [0.0_f32, 30.0, 60.0, 85.0] {
            let normal = Quat::from_rotation_z(degrees.to_radians()) * face;
            // Half of the disk that directions project to, and half of the ellipse that the facet's
            // rim does.
            let expected = 0.5 * PI * (1.0 + normal.dot(face));
            let open = of(&stores[0], 1.0, normal, face);
            assert!(
                (open - expected).abs() < 0.01 * expected,
                "{degrees}: {open}"
            );
            assert_eq!(of(&stores[1], 0.0, normal, face), 0.0, "{degrees}");
            // It is the facet that hides it.
            let lit = of(&stores[1], 0.0, normal, normal);
            assert!(degrees < 30.0 || lit > 0.05, "{degrees}: {lit}");
        }
    }
}

#[test]
fn nothing_beyond_the_largest_distance_sends_light_or_lets_it_through() {
    let (_dir, store) = store(&cloud(20_000));
    let pages = pages(&store);
    for kernel in [RayKernel::Cone, RayKernel::Plain] {
        let gatherer = Gatherer {
            pages,
            media: NoMedia,
            settings: RaySettings {
                max_dist: 1e-3,
                ..settings(kernel, 0.01)
            },
        };
        let gathered = gatherer.irradiance(
            Vec3::new(0.0, 0.9, 0.0),
            Vec3::Z,
            Vec3::Z,
            SampleRange::first(1),
        );
        // All rays end at the box's walls, which are too far away to send light and hide the
        // environment, but for the gaps that disks at random leave.
        let gaps = (-OVERLAP * OVERLAP).exp();
        let light = gathered.light.luminance();
        assert!(light < 2.0 * gaps * 0.5 * PI, "{light}");
    }
}

/// Two overlapping volumes, one of them turned, with blocks of all sizes.
fn media() -> (Vec<VolumeInfo>, Vec<Lvoxel>) {
    let mut random = Random(3);
    let maps = [
        Affine3A::from_scale(Vec3::splat(20.0)) * Affine3A::from_translation(Vec3::splat(0.6)),
        Affine3A::from_scale(Vec3::new(15.0, 25.0, 18.0))
            * Affine3A::from_translation(Vec3::splat(0.5))
            * Affine3A::from_quat(Quat::from_rotation_y(0.7)),
    ];
    let dims = [[26, 24, 21], [17, 24, 19]];
    let volumes = maps.iter().zip(dims).map(|(map, dims)| VolumeInfo {
        name: String::new(),
        dims,
        index_from_scene: map.to_cols_array_2d().map(|column| column.map(f64::from)),
        albedo: [0.5; 3],
        extinction_color: [1.0; 3],
    });
    let mut lvoxels = Vec::new();
    for (volume, dims) in dims.iter().enumerate() {
        let bricks = dims.map(|n| n.div_ceil(1 << MAX_LEVEL));
        for b in 0..bricks[0] * bricks[1] * bricks[2] {
            let brick = [
                b % bricks[0],
                b / bricks[0] % bricks[1],
                b / (bricks[0] * bricks[1]),
            ];
            let level = (random.next() % 4) as u8;
            let per_axis = 1 << (MAX_LEVEL - level);
            for k in 0..per_axis * per_axis * per_axis {
                let local = [
                    k % per_axis,
                    k / per_axis % per_axis,
                    k / (per_axis * per_axis),
                ];
                let block = std::array::from_fn(|a| (brick[a] * per_axis + local[a]) as u16);
                let is_inside = (0..3).all(|a| u32::from(block[a]) << level < dims[a]);
                if is_inside && !random.next().is_multiple_of(3) {
                    lvoxels.push(Lvoxel {
                        volume: volume as u16,
                        level,
                        block,
                        sigma_t: 3.0 * random.unit(),
                        source: std::array::from_fn(|_| random.unit()),
                        ..Lvoxel::default()
                    });
                }
            }
        }
    }
    (volumes.collect(), lvoxels)
}

/// Where a ray is inside a block: the block's box, cut by that of its volume.
fn within(volume: &VolumeInfo, l: &Lvoxel, origin: Vec3, direction: Vec3) -> Option<(f64, f64)> {
    let m = volume.index_from_scene;
    let map = |v: Vec3, w: f64| -> [f64; 3] {
        std::array::from_fn(|r| {
            (0..3).map(|c| m[c][r] * f64::from(v[c])).sum::<f64>() + w * m[3][r]
        })
    };
    let (o, d) = (map(origin, 1.0), map(direction, 0.0));
    let (mut near, mut far) = (0.0_f64, f64::INFINITY);
    for a in 0..3 {
        let low = f64::from(u32::from(l.block[a]) << l.level);
        let high = (low + f64::from(1 << l.level)).min(f64::from(volume.dims[a]));
        let (t0, t1) = ((low - o[a]) / d[a], (high - o[a]) / d[a]);
        near = near.max(t0.min(t1));
        far = far.min(t0.max(t1));
    }
    (near < far).then_some((near, far))
}

/// Radiance and transmittance along a ray to `t_max`, by looking at every block and surface for
/// every stretch.
fn by_force(
    volumes: &[VolumeInfo],
    lvoxels: &[Lvoxel],
    (origin, direction): (Vec3, Vec3),
    t_max: f64,
    crossings: &[Crossing],
) -> ([f64; 3], f64) {
    let spans: Vec<(f64, f64, &Lvoxel)> = lvoxels
        .iter()
        .filter_map(|l| {
            let volume = &volumes[usize::from(l.volume)];
            let (near, far) = within(volume, l, origin, direction)?;
            (near < t_max).then_some((near, far.min(t_max), l))
        })
        .collect();
    let mut cuts: Vec<f64> = spans.iter().flat_map(|s| [s.0, s.1]).collect();
    cuts.extend(crossings.iter().map(|c| f64::from(c.t)));
    cuts.sort_by(f64::total_cmp);
    let (mut light, mut through) = ([0.0; 3], 1.0);
    let mut met = crossings.iter().peekable();
    let mut start = 0.0;
    for end in cuts {
        let middle = 0.5 * (start + end);
        let inside = || spans.iter().filter(|s| s.0 < middle && middle < s.1);
        let sigma: f64 = inside().map(|s| f64::from(s.2.sigma_t)).sum();
        let share = 1.0 - (-sigma * (end - start)).exp();
        if sigma > 0.0 {
            for (c, out) in light.iter_mut().enumerate() {
                let source: f64 = inside()
                    .map(|s| f64::from(s.2.sigma_t) * f64::from(s.2.source[c]))
                    .sum();
                *out += through * share * source / sigma;
            }
        }
        through *= 1.0 - share;
        while let Some(c) = met.next_if(|c| f64::from(c.t) <= end) {
            for (k, out) in light.iter_mut().enumerate() {
                *out += through * f64::from(c.opacity) * f64::from(c.radiance.0[k]);
            }
            through *= 1.0 - f64::from(c.opacity);
        }
        start = end;
    }
    (light, through)
}

#[test]
fn passing_media_is_passing_every_block() {
    let (volumes, lvoxels) = media();
    let all = &Media::new(&volumes, lvoxels.iter().copied());
    let mut random = Random(5);
    let mut passed = 0;
    for i in 0..2000 {
        let origin = Vec3::from(std::array::from_fn(|_| 1.5 * random.signed()));
        let mut direction = Vec3::from(random.direction());
        if i % 10 == 0 {
            // Along an axis of the first volume.
            direction = [Vec3::X, -Vec3::Y, Vec3::Z][i / 10 % 3];
        }
        let t_max = if i % 3 == 0 { 0.8 } else { f32::INFINITY };
        let mut crossings: Vec<Crossing> = (0..i % 4)
            .map(|_| Crossing {
                t: 0.7 * random.unit(),
                opacity: 0.8 * random.unit(),
                radiance: Rgb::splat(random.unit()),
            })
            .collect();
        crossings.sort_by(|a, b| a.t.total_cmp(&b.t));
        let mut light = Composite::default();
        all.pass(
            &Ray::new(origin, direction, t_max),
            0.0,
            &crossings,
            &mut light,
        );
        let (radiance, through) = by_force(
            &volumes,
            &lvoxels,
            (origin, direction),
            f64::from(t_max),
            &crossings,
        );
        passed += usize::from(through < 0.9);
        let error = (f64::from(light.transmittance) - through).abs();
        assert!(error < 2e-4, "ray {i}: {light:?}, {through}");
        for c in 0..3 {
            let error = (f64::from(light.radiance.0[c]) - radiance[c]).abs();
            assert!(error < 3e-4, "ray {i}: {light:?}, {radiance:?}");
        }
    }
    assert!(passed > 1000, "{passed} rays met anything");
}

#[test]
fn trees_are_held_whole_only_if_the_memory_limit_allows_it() {
    let clipped = cloud(20_000);
    let grey = cloud(20_000).into_iter().map(|s| Surfel {
        front: [0.5; 3],
        back: [0.0; 3],
        clips: Clips::default(),
        ..s
    });
    let one = &clipped[..1];
    for surfels in [&clipped, &grey.collect::<Vec<_>>(), one] {
        let (_dir, path) = tree(surfels);
        let store = OpenTree::open(&path, None).unwrap();
        let held: usize = (0..store.tree().surfel_pages() as u32)
            .map(|id| {
                let page = pages(&store).page(id);
                page.nodes().bytes() + page.leaves().bytes()
            })
            .sum();
        let is_kept = |limit: usize| match OpenTree::open(&path, Some(limit as u64)) {
            Ok(store) => !tree::surfels(&store).are_cached(),
            Err(_) => false,
        };
        assert!(!is_kept(held - 1), "{held}");
        assert!(is_kept(held + held / 2 + 1000), "{held}");
    }
}
