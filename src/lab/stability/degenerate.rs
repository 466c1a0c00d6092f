//! Needles, nothing, doubles and crowds: geometry and media at their extremes.

use super::row::Row;
use super::transmittance::{brief, emitter_behind};
use super::workbench::{
    Workbench, add_quad, add_room, gatherer, mean, media, pixels, relative_rms, stage, volume,
};
use super::{Effort, random};
use crate::Result;
use crate::formats::record::Below;
use crate::formats::{CloudMeta, Surfel};
use crate::gather::Medium;
use crate::gather::NoMedia;
use crate::gather::cone::Scratch;
use crate::math::Ray;
use crate::math::sampling::sphere;
use crate::scene::{Grid, Light, Scene};
use crate::shade;
use crate::trace::Tracer;
use crate::tree::OpenTree;
use glam::{DAffine3, DVec3, Vec3};
use std::f32::consts::PI;

pub fn rows(bench: &Workbench, effort: Effort) -> Result<Vec<Row>> {
    let mut rows = Vec::new();
    needles(bench, &mut rows)?;
    doubles(bench, &mut rows)?;
    crowd(bench, effort, &mut rows)?;
    radii(bench, &mut rows)?;
    overlaps(bench, &mut rows)?;
    Ok(rows)
}

/// A floor between two walls under an emitter.
pub(super) fn room() -> Scene {
    let mut scene = stage(
        24,
        Vec3::new(0.0, 0.3, 0.8),
        Vec3::new(0.0, -0.3, 0.0),
        70.0,
    );
    add_room(&mut scene, 2.0, 0.5, 0.0);
    let emitter = [Vec3::new(-0.3, 0.95, -0.3), 0.6 * Vec3::X, 0.6 * Vec3::Z];
    add_quad(&mut scene, emitter, 0.0, 5.0);
    scene
}

pub(super) fn settings() -> shade::Settings {
    shade::Settings {
        samples: 64,
        ..shade::Settings::default()
    }
}

/// Exact area of a mesh.
fn area(scene: &Scene) -> f64 {
    (0..scene.mesh.triangles.len())
        .map(|t| {
            let [a, b, c] = scene.mesh.corners(t).map(|p| p.as_dvec3());
            0.5 * (b - a).cross(c - a).length()
        })
        .sum()
}

/// The floor of the room (its third wall) cut into needles: a fan from one corner to points 4e-6
/// apart at one end of the opposite edge, and one triangle for the rest.
fn with_needles() -> Scene {
    const NEEDLES: u32 = 500;
    let mut scene = room();
    let t = scene.mesh.triangles[4];
    let [a, b, c] = t;
    let (pb, pc) = (
        scene.mesh.positions[b as usize],
        scene.mesh.positions[c as usize],
    );
    let mut last = b;
    for i in 1..=NEEDLES {
        let next = scene.mesh.positions.len() as u32;
        scene
            .mesh
            .positions
            .push(pb + (pc - pb) * (i as f32 * 2e-6));
        if i == 1 {
            scene.mesh.triangles[4] = [a, last, next];
        } else {
            scene.mesh.triangles.push([a, last, next]);
            scene.mesh.material.push(scene.mesh.material[4]);
        }
        last = next;
    }
    scene.mesh.triangles.push([a, last, c]);
    scene.mesh.material.push(scene.mesh.material[4]);
    scene
}

fn needles(bench: &Workbench, rows: &mut Vec<Row>) -> Result<()> {
    const SURFELS: u64 = 50_000;
    let (plain, needles) = (room(), with_needles());
    let tracer = Tracer::new(&needles);
    let misses = (0..100_000)
        .filter(|&i| {
            let target = needles.mesh.positions[needles.mesh.triangles[4][0] as usize];
            let end = needles.mesh.positions[needles.mesh.triangles[4][1] as usize];
            // Half of the rays go along the needles.
            let way = if i % 2 == 0 {
                sphere([random(1, i), random(2, i)])
            } else {
                let aside = Vec3::new(random(3, i) - 0.5, 0.0, random(4, i) - 0.5) * 4e-6;
                target + (end - target) * random(5, i) + aside
            };
            let way = way.normalize();
            tracer.closest(&Ray::endless(Vec3::ZERO, way)).is_none()
        })
        .count();
    rows.push(Row::count(
        "needles of aspect 1e6: rays that slip through",
        "100,000 rays",
        misses,
    ));
    let tree = bench.tree(&needles, SURFELS)?;
    rows.push(Row::relative(
        "needles of aspect 1e6: area of the surfels",
        "",
        area(&needles),
        tree.tree().summary().sums.area,
        1e-5,
    ));
    let (a, b) = (
        pixels(&bench.shade(&needles, &tree, &settings())?, "")?,
        bench.render(&plain, SURFELS, &settings())?,
    );
    rows.push(Row::relative(
        "needles of aspect 1e6: mean of the picture",
        "",
        mean(&b),
        mean(&a),
        2e-3,
    ));
    rows.push(Row::nothing(
        "needles of aspect 1e6: RMS of pixels over the mean",
        "",
        relative_rms(&a, &b),
        0.02,
    ));
    Ok(())
}

fn doubles(bench: &Workbench, rows: &mut Vec<Row>) -> Result<()> {
    const SURFELS: u64 = 50_000;
    // Triangles without area come in by a file, which says how many were dropped.
    let file = |extra: &str| {
        format!("v 0 0 0\nv 1 0 0\nv 1 1 0\nv 0 1 0\nv 0.5 0 0\nf 1 2 3\nf 1 3 4\n{extra}")
    };
    let text = "[film]\nwidth = 8\nheight = 8\n[[camera]]\nposition = [0.5, 0.5, 2]\n\
                target = [0.5, 0.5, 0]\nfov_x_deg = 20\n\
                [[light]]\ntype = \"point\"\nposition = [0.2, 0.3, 1]\nintensity = [3, 2, 1]\n\
                [[mesh]]\nfile = \"a.obj\"\nalbedo = [0.5, 0.5, 0.5]\n";
    let load = |extra: &str| bench.load(text, &[("a.obj", file(extra).as_bytes())]);
    let (plain, flat) = (load("")?, load("f 1 5 2\nf 3 3 4\nf 2 2 2\n")?);
    let render = |scene: &Scene| bench.render(scene, 1000, &brief());
    let (a, b) = (render(&flat)?, render(&plain)?);
    rows.push(Row::relative(
        "triangles without area: dropped and counted",
        "3 of 5",
        3.0,
        flat.mesh.degenerate as f64,
        0.0,
    ));
    rows.push(Row::nothing(
        "triangles without area: RMS of the picture",
        "",
        relative_rms(&a, &b),
        0.0,
    ));

    let plain = room();
    let reference = bench.render(&plain, SURFELS, &settings())?;
    let mut doubled = room();
    let (triangles, material) = (
        doubled.mesh.triangles.clone(),
        doubled.mesh.material.clone(),
    );
    // All but the emitter, whose light would double.
    doubled.mesh.triangles.extend(&triangles[..12]);
    doubled.mesh.material.extend(&material[..12]);
    let mut turned = room();
    let backs = triangles[..12].iter().map(|&[a, b, c]| [a, c, b]);
    turned.mesh.triangles.extend(backs);
    turned.mesh.material.extend(&material[..12]);
    for (name, scene) in [
        ("every wall twice", doubled),
        ("every wall with a coincident opposite face", turned),
    ] {
        let picture = bench.render(&scene, 2 * SURFELS, &settings())?;
        rows.push(Row::relative(
            format!("{name}: mean of the picture"),
            "",
            mean(&reference),
            mean(&picture),
            0.01,
        ));
        rows.push(Row::nothing(
            format!("{name}: RMS of pixels over the mean"),
            "",
            relative_rms(&picture, &reference),
            0.03,
        ));
    }
    Ok(())
}

fn crowd(bench: &Workbench, effort: Effort, rows: &mut Vec<Row>) -> Result<()> {
    let count: u32 = if effort == Effort::Full {
        10_000_000
    } else {
        200_000
    };
    let one = Surfel {
        position: [0.25, -0.5, 0.125],
        normal: [0.0, 1.0, 0.0],
        radius: 1.0,
        area: PI,
        front: [1.0, 0.5, 0.25],
        ..Surfel::default()
    };
    let meta = CloudMeta {
        disk_overlap: 1.0,
        ..CloudMeta::default()
    };
    let store = bench.tree_of(meta, (0..count).map(|_| one), &[])?;
    let at = format!("{count} surfels");
    let tree = store.tree();
    rows.push(Row::relative(
        "surfels on one spot: how many",
        at.clone(),
        f64::from(count),
        tree.summary().sums.surfels as f64,
        0.0,
    ));
    rows.push(Row::relative(
        "surfels on one spot: area",
        at.clone(),
        f64::from(count) * f64::from(PI),
        tree.summary().sums.area,
        1e-6,
    ));
    let root = root_area(&store)?;
    rows.push(Row::relative(
        "surfels on one spot: area of the root",
        at.clone(),
        f64::from(count) * f64::from(PI),
        root,
        1e-6,
    ));
    // Near by, one ray looks at every disk; far away none of them is looked at.
    for (cut, d) in [(0.0, 1.0_f32), (0.01, 1.0), (0.01, 100.0)] {
        let origin = Vec3::from(one.position) + Vec3::Y * d;
        let seen = gatherer(&store, NoMedia, 1, cut)
            .incident(&Ray::endless(origin, -Vec3::Y), &mut Scratch::default());
        let at = format!("{at}, d / R {d}, nodes below {cut} sr whole");
        let case = "surfels on one spot: distance to them";
        rows.push(Row::relative(
            case,
            at.clone(),
            d.into(),
            seen.distance.into(),
            1e-5,
        ));
        let case = "surfels on one spot: radiance";
        rows.push(Row::relative(
            case,
            at,
            1.0,
            seen.radiance.0[0].into(),
            2e-3,
        ));
    }
    Ok(())
}

/// Area of the root's aggregate.
fn root_area(store: &OpenTree) -> Result<f64> {
    let Some(root) = store.surfels.root() else {
        return Ok(0.0);
    };
    let page = store.tree().surfel_page(root as usize)?;
    Ok(page
        .nodes
        .first()
        .map_or(0.0, |n| f64::from(n.aggregate.area)))
}

/// Surfels of a unit cube with radii from 1e-6 to 1e6.
fn surfels_of_all_sizes(count: u64) -> Vec<Surfel> {
    (0..count)
        .map(|i| {
            let n = sphere([random(11, i), random(12, i)]);
            // Few are larger than their distance, else those alone would be seen.
            let large = i % 1000 == 0;
            let decade = if large { 6.0 } else { -6.0 } * random(13, i);
            let radius = libm::powf(10.0, decade);
            let away = if large { 3.0 * radius } else { 0.0 };
            let p = Vec3::from([14, 15, 16].map(|s| random(s, i))) - n * away;
            Surfel {
                position: p.to_array(),
                normal: n.to_array(),
                radius,
                area: PI * radius * radius,
                front: [1.0 + random(17, i); 3],
                ..Surfel::default()
            }
        })
        .collect()
}

/// Disks whose radii span twelve decades, in one cloud.
fn radii(bench: &Workbench, rows: &mut Vec<Row>) -> Result<()> {
    const COUNT: u64 = 20_000;
    let surfels = surfels_of_all_sizes(COUNT);
    let meta = CloudMeta {
        disk_overlap: 1.0,
        ..CloudMeta::default()
    };
    let store = bench.tree_of(meta, surfels.iter().copied(), &[])?;
    let at = "radii from 1e-6 to 1e6";
    let (mut decoded, mut outside) = (Vec::new(), 0);
    let tree = store.tree();
    for id in 0..tree.surfel_pages() {
        let page = tree.surfel_page(id)?;
        for node in &page.nodes {
            let Below::Surfels { first, count } = node.below else {
                continue;
            };
            for s in &page.surfels[first as usize..first as usize + usize::from(count)] {
                let b = crate::formats::Bounds::of_surfel(s);
                outside += usize::from((0..3).any(|a| {
                    let slack = 1e-6 * (b.max[a].abs().max(b.min[a].abs()));
                    b.min[a] < node.bounds.min[a] - slack || b.max[a] > node.bounds.max[a] + slack
                }));
            }
        }
        decoded.extend(page.surfels);
    }
    rows.push(Row::count(
        "disks that stick out of their node",
        at,
        outside,
    ));
    let total: f64 = surfels.iter().map(|s| f64::from(s.area)).sum();
    rows.push(Row::relative(
        "area of the tree",
        at,
        total,
        tree.summary().sums.area,
        1e-3,
    ));
    let log_sum = |all: &[Surfel]| all.iter().map(|s| f64::from(s.radius.ln())).sum::<f64>();
    rows.push(Row::with_error(
        "mean of ln(radius)",
        at,
        (
            log_sum(&surfels) / COUNT as f64,
            log_sum(&decoded) / COUNT as f64,
        ),
        (log_sum(&surfels) - log_sum(&decoded)).abs() / COUNT as f64,
        5e-4,
    ));
    let gatherer = gatherer(&store, NoMedia, 1, 0.0);
    let mut scratch = Scratch::default();
    let mut off = 0;
    for i in 0..500 {
        let origin = Vec3::from([21, 22, 23].map(|s| random(s, i)));
        let direction = sphere([random(24, i), random(25, i)]);
        let seen = gatherer
            .incident(&Ray::endless(origin, direction), &mut scratch)
            .distance;
        let exact = super::precision::first_disk(&decoded, origin.as_dvec3(), direction.as_dvec3());
        let exact = exact.map_or(f64::INFINITY, |hit| hit.t);
        let same = f64::from(seen) == exact || (f64::from(seen) - exact).abs() <= 1e-4 * exact;
        off += usize::from(!same);
    }
    rows.push(Row::nothing(
        "rays that see another disk first than a scan of all in f64",
        at,
        off as f64 / 500.0,
        0.01,
    ));
    Ok(())
}

/// Three media on one place against one with the sum of their extinctions, and against parts that
/// overlap.
fn overlaps(bench: &Workbench, rows: &mut Vec<Row>) -> Result<()> {
    let parts = [0.5_f32, 1.5, 3.0];
    for (name, albedo, limit) in [("absorbing", 0.0, 1e-5), ("scattering", 0.8, 0.03)] {
        let picture = |densities: &[f32]| -> Result<Vec<[f32; 3]>> {
            let mut scene = emitter_behind(Grid::from_fn([16; 3], |_| densities[0]), albedo);
            for &sigma in &densities[1..] {
                let grid = Grid::from_fn([16; 3], |_| sigma);
                let placed = scene.volumes[0].scene_from_index;
                scene.volumes.push(volume(grid, albedo, placed));
            }
            scene.lights.push(Light::Point {
                position: Vec3::new(1.0, 0.4, 0.2),
                intensity: [3.0; 3],
            });
            bench.render(&scene, 16, &settings())
        };
        let (several, one) = (picture(&parts)?, picture(&[parts.iter().sum()])?);
        rows.push(Row::relative(
            format!("three {name} volumes on one place, against one"),
            "depths 0.5 + 1.5 + 3",
            mean(&one),
            mean(&several),
            limit,
        ));
    }
    // A long box in two halves that overlap by half: 1, 2, 1 times the extinction.
    let long = |values: &'static [f32]| Grid::from_fn([values.len(), 4, 4], move |v| values[v[0]]);
    let placed = |from: f64| {
        DAffine3::from_translation(DVec3::new(from, -0.5, -0.5))
            * DAffine3::from_scale(DVec3::splat(0.25))
    };
    let mut scene = stage(
        1,
        Vec3::new(3.0, 0.03, 0.02),
        Vec3::new(0.0, 0.03, 0.02),
        1e-4,
    );
    scene
        .volumes
        .push(volume(long(&[2.0; 8]), 0.0, placed(-1.0)));
    scene
        .volumes
        .push(volume(long(&[2.0; 8]), 0.0, placed(-2.0)));
    scene
        .volumes
        .push(volume(long(&[0.5; 4]), 0.0, placed(-1.25)));
    let tracer = Tracer::new(&scene);
    let store = bench.tree(&scene, 1)?;
    let (origin, way) = (Vec3::new(3.0, 0.03, 0.02), -Vec3::X);
    let mut light = crate::math::segment::Composite::default();
    (&media(&store)?).pass(&Ray::new(origin, way, 10.0), 0.0, &[], &mut light);
    let tau: f64 = 4.0 + 4.0 + 0.5;
    for (name, got) in [
        ("cells", tracer.transmittance(&Ray::new(origin, way, 10.0))),
        ("lvoxels of a tree", light.transmittance),
    ] {
        rows.push(Row::relative(
            format!("three volumes that overlap in parts, {name}"),
            "depth 8.5",
            (-tau).exp(),
            got.into(),
            1e-5,
        ));
    }
    Ok(())
}
