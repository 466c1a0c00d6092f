//! The arithmetic of the kernels, f32, against the same in f64 by brute force, on a real scene; and
//! long sums.

use super::field::{Blocks, Field};
use super::row::Row;
use super::workbench::{Workbench, gatherer, lvoxels};
use super::{Effort, random};
use crate::Result;
use crate::formats::record::tangent_frame;
use crate::formats::{Lvoxel, Surfel};
use crate::gather::cone::Scratch;
use crate::gather::{Medium, NoMedia};
use crate::math::exp::exp_neg;
use crate::math::sampling::{hash, sphere};
use crate::math::segment::Composite;
use crate::math::{Aabb, Ray};
use crate::scene::Scene;
use crate::tree::AggregateSums;
use crate::tree::{Media, OpenTree};
use glam::{DVec3, Vec3};
use rayon::prelude::*;

pub fn rows(bench: &Workbench, scene: &Scene, effort: Effort) -> Result<Vec<Row>> {
    let mut rows = Vec::new();
    kernels(bench, scene, effort, &mut rows)?;
    sums(effort, &mut rows);
    Ok(rows)
}

/// Where a ray meets a disk.
pub struct DiskHit {
    pub t: f64,
    /// Radiance of the side that it sees.
    pub radiance: [f32; 3],
}

/// The first of all disks that a ray meets, in f64.
pub fn first_disk(surfels: &[Surfel], origin: DVec3, direction: DVec3) -> Option<DiskHit> {
    let mut best: Option<DiskHit> = None;
    for s in surfels {
        let normal = DVec3::from(s.normal.map(f64::from));
        let to_centre = DVec3::from(s.position.map(f64::from)) - origin;
        let (cos, height) = (normal.dot(direction), normal.dot(to_centre));
        let (t, radius) = (height / cos, f64::from(s.radius));
        // As the kernels have it: a ray from just behind a disk leaves through its back.
        let own = cos > 0.0 && height.abs() < 0.1 * radius;
        if own || t.is_nan() || t <= 0.0 || best.as_ref().is_some_and(|b| t >= b.t) {
            continue;
        }
        let offset = direction * t - to_centre;
        if offset.length() > radius {
            continue;
        }
        let (x, y) = tangent_frame(s.normal);
        let (x, y) = (DVec3::from(x.map(f64::from)), DVec3::from(y.map(f64::from)));
        let edges = &s.clips.edges[..usize::from(s.clips.count)];
        let is_left = edges.iter().all(|e| {
            let (sin, cos) = f64::from(e.angle).sin_cos();
            offset.dot(x) * cos + offset.dot(y) * sin <= (f64::from(e.offset) + 0.005) * radius
        });
        if is_left {
            best = Some(DiskHit {
                t,
                radiance: if cos < 0.0 { s.front } else { s.back },
            });
        }
    }
    best
}

/// Rows for median, 95 %, 99.9 % and the largest of some differences.
fn distribution(
    case: &str,
    parameter: &str,
    mut all: Vec<f64>,
    limits: [f64; 4],
    rows: &mut Vec<Row>,
) {
    all.sort_by(f64::total_cmp);
    let Some(last) = all.len().checked_sub(1) else {
        return;
    };
    let shares = [
        ("median", 0.5),
        ("95 %", 0.95),
        ("99.9 %", 0.999),
        ("largest", 1.0),
    ];
    for ((name, share), limit) in shares.into_iter().zip(limits) {
        let at = (share * last as f64).round() as usize;
        let parameter = format!("{name} of {parameter}");
        rows.push(Row::nothing(case, parameter, all[at], limit));
    }
}

fn kernels(bench: &Workbench, scene: &Scene, effort: Effort, rows: &mut Vec<Row>) -> Result<()> {
    let (count, surfels) = match effort {
        Effort::Full => (10_000, 50_000),
        Effort::Brief => (2000, 10_000),
    };
    let store = bench.tree(scene, surfels)?;
    let Aabb { min, max } = scene.bounds();
    let rays: Vec<(Vec3, Vec3)> = (0..count)
        .map(|i| {
            let at = Vec3::from([31, 32, 33].map(|s| 0.02 + 0.96 * random(s, i)));
            (
                min + (max - min) * at,
                sphere([random(34, i), random(35, i)]),
            )
        })
        .collect();
    compare_disks(bench, &store, &rays, rows)?;
    if scene.volumes.is_empty() {
        return Ok(());
    }
    let all = lvoxels(&store)?;
    let length = (max - min).length();
    for index in 0..scene.volumes.len() {
        let lvoxels = LvoxelsOf::new(index, &store, &all);
        compare_lvoxels(bench, scene, &lvoxels, &rays, length, rows)?;
    }
    Ok(())
}

/// Adds rows about the disks that rays meet first.
fn compare_disks(
    bench: &Workbench,
    store: &OpenTree,
    rays: &[(Vec3, Vec3)],
    rows: &mut Vec<Row>,
) -> Result<()> {
    let parameter = format!("{} rays", rays.len());
    let tree = store.tree();
    let mut all = Vec::new();
    for page in 0..tree.surfel_pages() {
        all.extend(tree.surfel_page(page)?.surfels);
    }
    let gatherer = gatherer(store, NoMedia, 1, 0.0);
    // Difference of distance, and whether the same disk was met.
    let met: Vec<(f64, bool)> = rays
        .par_iter()
        .map(|&(origin, direction)| {
            let seen = gatherer.incident(&Ray::endless(origin, direction), &mut Scratch::default());
            match first_disk(&all, origin.as_dvec3(), direction.as_dvec3()) {
                None if seen.distance.is_infinite() => (0.0, true),
                None => (f64::INFINITY, false),
                Some(hit) => (
                    (f64::from(seen.distance) - hit.t).abs() / hit.t,
                    seen.radiance.0 == hit.radiance,
                ),
            }
        })
        .collect();
    bench.cancel().check()?;
    // A ray through the rim of a disk, or from just behind one, may meet another.
    let is_near = |m: &&(f64, bool)| m.0 < 0.01;
    let agree: Vec<f64> = met.iter().filter(is_near).map(|m| m.0).collect();
    let share = |count: usize| count as f64 / met.len() as f64;
    rows.push(Row::nothing(
        "disks: rays that end elsewhere in f64",
        format!("share of {parameter}"),
        share(met.len() - agree.len()),
        1e-3,
    ));
    // Of disks of one plane that overlap, rounding decides which is first.
    let other = met.iter().filter(is_near).filter(|m| !m.1).count();
    rows.push(Row::nothing(
        "disks: rays that end there on another disk in f64",
        format!("share of {parameter}"),
        share(other),
        0.1,
    ));
    distribution(
        "disks: distance, f32 against f64",
        &parameter,
        agree,
        [1e-6, 1e-5, 1e-4, 1e-2],
        rows,
    );
    Ok(())
}

/// The lvoxels of one volume, as the kernels take them and one by one in f64. One volume at a time:
/// where several overlap, order decides.
struct LvoxelsOf<'a> {
    index: usize,
    media: Media,
    blocks: Blocks<'a>,
}

impl<'a> LvoxelsOf<'a> {
    fn new(index: usize, store: &'a OpenTree, all: &'a [Lvoxel]) -> Self {
        let volumes = &store.tree().meta().cloud.volumes;
        let own = all.iter().filter(|l| usize::from(l.volume) == index);
        Self {
            index,
            media: Media::new(volumes, own.copied()),
            blocks: Blocks::of(index, &volumes[index], all),
        }
    }
}

/// Adds rows about what rays collect in the lvoxels and in the cells of one volume.
fn compare_lvoxels(
    bench: &Workbench,
    scene: &Scene,
    lvoxels: &LvoxelsOf<'_>,
    rays: &[(Vec3, Vec3)],
    length: f32,
    rows: &mut Vec<Row>,
) -> Result<()> {
    let LvoxelsOf {
        index,
        ref media,
        ref blocks,
    } = *lvoxels;
    let reach = f64::from(length);
    let volume = &scene.volumes[index];
    let field = Field::of(volume);
    let differences: Vec<Option<[f64; 3]>> = rays
        .par_iter()
        .enumerate()
        .map(|(i, &(origin, _))| {
            // From anywhere in the scene to a point of the volume's box.
            let at = [36, 37, 38].map(|s| f64::from(random(s, i as u64)));
            let target = DVec3::from(at) * DVec3::from(volume.sigma_t.dims().map(|n| n as f64));
            let target = volume.scene_from_index.transform_point3(target).as_vec3();
            let direction = (target - origin).normalize();
            let (o, d) = (origin.as_dvec3(), direction.as_dvec3());
            let mut light = Composite::default();
            media.pass(&Ray::new(origin, direction, length), 0.0, &[], &mut light);
            let (radiance, through) = blocks.pass(o, d, reach);
            let tau = field.optical_depth(o, d, reach);
            (through < 1.0 || tau > 0.0).then(|| {
                let cells = cells_of(scene, index, origin, direction, length);
                [
                    if through > 1e-30 {
                        relative(light.transmittance, through)
                    } else {
                        0.0
                    },
                    relative(light.radiance.0[1], radiance[1]),
                    if tau < 69.0 {
                        relative(exp_neg(cells), (-tau).exp())
                    } else {
                        0.0
                    },
                ]
            })
        })
        .collect();
    bench.cancel().check()?;
    let met: Vec<[f64; 3]> = differences.into_iter().flatten().collect();
    let parameter = format!("{} rays that meet volume {index}", met.len());
    let column = |k: usize| met.iter().map(|m| m[k]).collect::<Vec<_>>();
    let limits = [5e-6, 1e-4, 1e-3, 1e-2];
    distribution(
        "lvoxels: transmittance, f32 against f64",
        &parameter,
        column(0),
        limits,
        rows,
    );
    distribution(
        "lvoxels: radiance, f32 against f64",
        &parameter,
        column(1),
        limits,
        rows,
    );
    distribution(
        "cells: transmittance, f32 against f64",
        &parameter,
        column(2),
        limits,
        rows,
    );
    Ok(())
}

/// The difference from an exact value, relative to that where it is not 0.
fn relative(got: f32, exact: f64) -> f64 {
    if exact == 0.0 {
        f64::from(got).abs()
    } else {
        (f64::from(got) - exact).abs() / exact
    }
}

fn cells_of(scene: &Scene, index: usize, origin: Vec3, direction: Vec3, length: f32) -> f32 {
    let mut tau = 0.0_f64;
    if let Some(mut cells) =
        crate::trace::Cells::new(&scene.volumes[index], &Ray::new(origin, direction, length))
    {
        while let Some(cell) = cells.next_cell() {
            tau += f64::from(cell.tau);
        }
    }
    tau as f32
}

/// Aggregates over very many surfels whose sums are known as integers.
fn sums(effort: Effort, rows: &mut Vec<Row>) {
    let count: u64 = if effort == Effort::Full {
        100_000_000
    } else {
        4_000_000
    };
    const UNIT: f32 = 1.0 / 1024.0;
    let chunks = 4;
    let parts: Vec<(AggregateSums, u64, u64)> = (0..chunks)
        .into_par_iter()
        .map(|chunk| {
            let mut sums = AggregateSums::NOTHING;
            let (mut area, mut power) = (0, 0);
            for i in chunk * count / chunks..(chunk + 1) * count / chunks {
                let bits = hash(&[i]);
                // Areas over three decades, light over three.
                let (a, l) = (1 + (bits & 1023), 1 + (bits >> 10 & 1023));
                area += a;
                power += a * l;
                let surfel = Surfel {
                    position: [0.5; 3],
                    normal: [0.0, 1.0, 0.0],
                    radius: 0.01,
                    area: a as f32 * UNIT,
                    front: [l as f32 * UNIT; 3],
                    ..Surfel::default()
                };
                sums.add_surfel(&surfel);
            }
            (sums, area, power)
        })
        .collect();
    let mut all = AggregateSums::NOTHING;
    let (mut area, mut power) = (0, 0);
    for (sums, a, p) in &parts {
        all.add(sums);
        area += a;
        power += p;
    }
    let got = all.aggregate();
    let unit = f64::from(UNIT);
    let at = format!("{count} surfels");
    rows.push(Row::relative(
        "sum of areas",
        at.clone(),
        area as f64 * unit,
        got.area.into(),
        1e-6,
    ));
    rows.push(Row::relative(
        "mean radiance, weighted by area",
        at.clone(),
        power as f64 / area as f64 * unit,
        got.axis_radiance[2][1].into(),
        1e-6,
    ));
    rows.push(Row::relative(
        "mean position, weighted by area",
        at,
        0.5,
        got.centre[0].into(),
        1e-6,
    ));
}
