//! What must hold whatever the input, tried on many inputs from a fixed seed.

use super::row::Row;
use super::workbench::{Workbench, gatherer, media, volume};
use super::{Effort, random};
use crate::Result;
use crate::formats::record::{Below, Node, SurfelPage};
use crate::formats::{CloudMeta, Surfel};
use crate::gather::NoMedia;
use crate::gather::cone::Scratch;
use crate::math::exp::exp_neg;
use crate::math::sampling::{cosine_hemisphere, disk, sobol2, sphere, tangents};
use crate::math::segment::Composite;
use crate::math::{Aabb, Ray, Rgb};
use crate::scene::{Grid, Scene};
use crate::trace::Cells;
use crate::tree::OpenTree;
use glam::{DAffine3, DQuat, DVec3, Vec3};
use std::f32::consts::PI;

pub fn rows(bench: &Workbench, scene: &Scene, effort: Effort) -> Result<Vec<Row>> {
    let mut rows = Vec::new();
    let surfels = if effort == Effort::Full {
        100_000
    } else {
        20_000
    };
    let store = bench.tree(scene, surfels)?;
    radiance(scene, &store, &mut rows)?;
    halves(&mut rows);
    along_rays(&mut rows);
    aggregates(&store, &mut rows)?;
    reciprocity(bench, &mut rows)?;
    Ok(rows)
}

/// Light from a tree is finite and not negative, and no more than its brightest record.
fn radiance(scene: &Scene, store: &OpenTree, rows: &mut Vec<Row>) -> Result<()> {
    const RAYS: u64 = 20_000;
    let Aabb { min, max } = scene.bounds();
    let tree = store.tree();
    let mut brightest = 0.0_f32;
    for page in 0..tree.surfel_pages() {
        let surfels = tree.surfel_page(page)?.surfels;
        let sides = surfels
            .iter()
            .flat_map(|s| s.front.into_iter().chain(s.back));
        brightest = sides.fold(brightest, f32::max);
    }
    for l in super::workbench::lvoxels(store)? {
        brightest = l.source.into_iter().fold(brightest, f32::max);
    }
    let media = media(store)?;
    for cut in [0.0, 0.01, 0.5] {
        let gatherer = gatherer(store, &media, 1, cut);
        let mut scratch = Scratch::default();
        let (mut wrong, mut most) = (0, 0.0_f32);
        for i in 0..RAYS {
            let at = Vec3::from([41, 42, 43].map(|s| random(s, i) * 1.2 - 0.1));
            let direction = match i % 16 {
                0 => Vec3::X,
                1 => -Vec3::Y,
                _ => sphere([random(44, i), random(45, i)]),
            };
            let seen = gatherer.incident(
                &Ray::endless(min + (max - min) * at, direction),
                &mut scratch,
            );
            wrong += usize::from(!seen.radiance.0.iter().all(|v| v.is_finite() && *v >= 0.0));
            most = most.max(seen.radiance.max());
        }
        let at = format!("{RAYS} rays, nodes below {cut} sr whole");
        rows.push(Row::count(
            "radiance that is not finite, or negative",
            at.clone(),
            wrong,
        ));
        let over = f64::from(most / brightest) - 1.0;
        rows.push(Row::nothing(
            "radiance above the brightest record",
            at,
            over.max(0.0),
            0.01,
        ));
    }
    Ok(())
}

/// A stretch of medium in two parts is that medium.
fn halves(rows: &mut Vec<Row>) {
    let (mut light, mut through) = (0.0_f64, 0.0_f64);
    for i in 0..100_000 {
        let tau = libm::powf(10.0, 10.0 * random(51, i) - 8.0).min(60.0);
        let (cut, source) = (random(52, i), random(53, i));
        let mut whole = Composite::default();
        whole.medium(tau, Rgb::splat(source));
        let mut parts = Composite::default();
        parts.medium(tau * cut, Rgb::splat(source));
        parts.medium(tau - tau * cut, Rgb::splat(source));
        let off = |a: f32, b: f32| f64::from((a - b).abs() / b.max(f32::MIN_POSITIVE));
        light = light.max(off(parts.radiance.0[0], whole.radiance.0[0]));
        through = through.max(off(parts.transmittance, whole.transmittance));
    }
    let at = "worst of 100,000, tau to 60";
    rows.push(Row::nothing(
        "segment in two parts: radiance",
        at,
        light,
        1e-6,
    ));
    // A depth of 60 is known to 4e-6 in f32, and so is its exponential.
    rows.push(Row::nothing(
        "segment in two parts: transmittance",
        at,
        through,
        1e-5,
    ));
}

/// Transmittance through random media stays in [0,1], falls along a ray, and composes.
fn along_rays(rows: &mut Vec<Row>) {
    const FIELDS: u64 = 20;
    const RAYS: u64 = 100;
    let (mut outside, mut rising, mut worst) = (0, 0, 0.0_f64);
    for f in 0..FIELDS {
        let dims = [61, 62, 63].map(|s| 1 + (20.0 * random(s, f)) as usize);
        let dense = libm::powf(10.0, 8.0 * random(64, f) - 4.0);
        let grid = Grid::from_fn(dims, |v| {
            let at = (f << 48) + ((v[2] * 64 + v[1]) * 64 + v[0]) as u64;
            let value = random(65, at);
            if value < 0.4 { 0.0 } else { dense * value }
        });
        let placed = DAffine3::from_scale_rotation_translation(
            DVec3::from(dims.map(|n| 1.0 / n as f64)),
            DQuat::from_rotation_y(f64::from(random(66, f))),
            DVec3::splat(-0.5),
        );
        let medium = volume(grid, 0.5, placed);
        let depth = |origin: Vec3, direction: Vec3, t: f32| {
            let mut tau = 0.0_f64;
            if let Some(mut cells) = Cells::new(&medium, &Ray::new(origin, direction, t)) {
                while let Some(cell) = cells.next_cell() {
                    tau += f64::from(cell.tau);
                }
            }
            tau
        };
        for (i, (origin, direction)) in super::rays(RAYS, 2.0, 0.6).enumerate() {
            let mut last = 1.0_f32;
            for k in 0..=40 {
                let t = exp_neg(depth(origin, direction, 0.1 * k as f32) as f32);
                outside += usize::from(!(0.0..=1.0).contains(&t));
                rising += usize::from(t > last * (1.0 + 1e-5));
                last = t;
            }
            let split = 4.0 * random(67, i as u64);
            let whole = depth(origin, direction, 4.0);
            let parts = depth(origin, direction, split)
                + depth(origin + direction * split, direction, 4.0 - split);
            if whole > 0.0 {
                worst = worst.max((parts - whole).abs() / whole.max(1e-3 * f64::from(dense)));
            }
        }
    }
    let at = format!("{} rays", FIELDS * RAYS);
    rows.push(Row::count(
        "transmittance outside [0,1]",
        at.clone(),
        outside,
    ));
    rows.push(Row::count(
        "transmittance that rises along a ray",
        at.clone(),
        rising,
    ));
    rows.push(Row::nothing(
        "optical depth of a ray in two parts",
        at,
        worst,
        2e-3,
    ));
}

/// Boxes hold boxes, centres lie in boxes, and a node is no brighter than what is below it.
fn aggregates(store: &OpenTree, rows: &mut Vec<Row>) -> Result<()> {
    let tree = store.tree();
    let (mut nodes, mut boxes, mut centres, mut areas, mut bright) = (0, 0, 0, 0, 0);
    for id in 0..tree.surfel_pages() {
        let page = tree.surfel_page(id)?;
        for node in &page.nodes {
            let below = Children::of(&page, node);
            let Some(below) = below else { continue };
            nodes += 1;
            let (low, high) = (node.bounds.min, node.bounds.max);
            let slack: [f32; 3] =
                std::array::from_fn(|a| 1e-5 * (high[a] - low[a]) + 1e-6 * high[a].abs());
            let sticks = (0..3)
                .any(|a| below.low[a] < low[a] - slack[a] || below.high[a] > high[a] + slack[a]);
            boxes += usize::from(sticks);
            let c = node.aggregate.centre;
            let away = (0..3).any(|a| c[a] < low[a] - slack[a] || c[a] > high[a] + slack[a]);
            centres += usize::from(away);
            areas += usize::from((f64::from(node.aggregate.area) / below.area - 1.0).abs() > 2e-3);
            let a = &node.aggregate;
            let mean = (a.axis_radiance.iter().chain(&a.back_radiance)).flatten();
            let most = mean.fold(0.0_f32, |a, &b| a.max(b));
            bright += usize::from(most > below.brightest * 1.01 + f32::MIN_POSITIVE);
        }
    }
    let at = format!("{nodes} nodes");
    rows.push(Row::count(
        "boxes that stick out of their parent's",
        at.clone(),
        boxes,
    ));
    rows.push(Row::count("centres outside the box", at.clone(), centres));
    rows.push(Row::count(
        "areas that are not the children's",
        at.clone(),
        areas,
    ));
    rows.push(Row::count(
        "nodes brighter than all that is below",
        at,
        bright,
    ));
    Ok(())
}

/// What the children of a node come to.
struct Children {
    low: [f32; 3],
    high: [f32; 3],
    area: f64,
    brightest: f32,
}

impl Children {
    /// `None` for a node whose children are in another page.
    fn of(page: &SurfelPage, node: &Node) -> Option<Self> {
        let mut out = Self {
            low: [f32::INFINITY; 3],
            high: [f32::NEG_INFINITY; 3],
            area: 0.0,
            brightest: 0.0,
        };
        let mut add =
            |low: [f32; 3], high: [f32; 3], area: f32, light: &mut dyn Iterator<Item = f32>| {
                out.low = std::array::from_fn(|a| out.low[a].min(low[a]));
                out.high = std::array::from_fn(|a| out.high[a].max(high[a]));
                out.area += f64::from(area);
                out.brightest = light.fold(out.brightest, f32::max);
            };
        match node.below {
            Below::Nodes { first, count } => {
                for n in &page.nodes[first as usize..first as usize + usize::from(count)] {
                    let a = &n.aggregate;
                    let sides = a.axis_radiance.iter().chain(&a.back_radiance);
                    let mut light = sides.flatten().copied();
                    add(n.bounds.min, n.bounds.max, n.aggregate.area, &mut light);
                }
            }
            Below::Surfels { first, count } => {
                for s in &page.surfels[first as usize..first as usize + usize::from(count)] {
                    let b = crate::formats::Bounds::of_surfel(s);
                    let mut light = s.front.into_iter().chain(s.back);
                    add(b.min, b.max, s.area, &mut light);
                }
            }
            Below::Page(_) | Below::EvenPage(_) => return None,
        }
        Some(out)
    }
}

/// Area times form factor is the same both ways between two disks.
fn reciprocity(bench: &Workbench, rows: &mut Vec<Row>) -> Result<()> {
    const POINTS: u32 = 4096;
    for pair in 0..4_u64 {
        let make = |k: u64| {
            let seed = 2 * pair + k;
            let n = if k == 0 { Vec3::Y } else { -Vec3::Y };
            let tilt = 0.6 * sphere([random(71, seed), random(72, seed)]);
            let radius = 0.3 + 0.7 * random(73, seed);
            Surfel {
                position: [
                    random(74, seed) - 0.5,
                    k as f32 * (0.8 + random(75, seed)),
                    random(76, seed) - 0.5,
                ],
                normal: (n + tilt).normalize().to_array(),
                radius,
                area: PI * radius * radius,
                front: [1.0; 3],
                ..Surfel::default()
            }
        };
        let (a, b) = (make(0), make(1));
        let exchange = |from: &Surfel, to: &Surfel| -> Result<f64> {
            let meta = CloudMeta {
                disk_overlap: 1.0,
                ..CloudMeta::default()
            };
            let store = bench.tree_of(meta, [*to], &[])?;
            let gatherer = gatherer(&store, NoMedia, 1, 0.0);
            let n = Vec3::from(from.normal);
            let (x, y) = tangents(n);
            let mut scratch = Scratch::default();
            let mut sum = 0.0;
            for i in 0..POINTS {
                let [u, v] = disk(sobol2(i, 0, 9)).map(|c| c * from.radius);
                let d = cosine_hemisphere(sobol2(i, 1, 9));
                let way = (x * d.x + y * d.y + n * d.z).normalize();
                let point = Vec3::from(from.position) + x * u + y * v;
                sum += f64::from(
                    gatherer
                        .incident(&Ray::endless(point, way), &mut scratch)
                        .radiance
                        .0[0],
                );
            }
            Ok(sum / f64::from(POINTS) * f64::from(from.area))
        };
        let (there, back) = (exchange(&a, &b)?, exchange(&b, &a)?);
        // So many of the points see the other disk.
        let hits = f64::from(POINTS) * there / f64::from(a.area.max(b.area));
        rows.push(Row::relative(
            "form factors of two disks, there and back",
            format!("pair {pair}, {POINTS} rays"),
            there,
            back,
            3.0 / hits.sqrt(),
        ));
    }
    Ok(())
}
