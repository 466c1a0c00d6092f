use super::*;
use crate::inscatter::far_field::FarField;
use crate::math::{PhaseFunction, sampling};
use crate::scene::Grid;
use glam::DAffine3;
use lvox_formats::record::LightPart;

/// Cells of noise, some of them empty, of a medium of such a colour.
fn noise(dims: [usize; 3], color: [f32; 3]) -> SourceCells {
    let cell = |i: usize| {
        let unit = |c: u64| sampling::unit(sampling::hash(&[i as u64, c]));
        let is_empty = unit(0) < 0.4 || i % dims[0] == 3;
        let sigma_t = if is_empty { 0.0 } else { unit(1) };
        let [r, g, b] = color.map(|c| c * sigma_t);
        f32x4::new([unit(2) * r, g, unit(3) * b, sigma_t])
    };
    SourceCells {
        edge: 2,
        dims,
        cells: (0..dims.iter().product()).map(cell).collect(),
        color: f32x4::new([color[0], color[1], color[2], 0.0]),
        lobes: Vec::new(),
        singles: Vec::new(),
        once: None,
    }
}

/// The same as [`SourceLayers::pass`] for one ray, which has passed all layers.
fn plain<K: Spectrum>(
    cells: &SourceCells,
    rays: &RayLattice,
    ray: [f32; 2],
    end: usize,
) -> Arriving<K> {
    let count = cells.dims[rays.axes[0]];
    let color = cells.color.to_array().map(f64::from);
    let (mut light, mut through) = ([0.0; 3], [1.0; 3]);
    let steps = if rays.upwards { count - end } else { end };
    for step in 0..steps {
        let layer = if rays.upwards { count - 1 - step } else { step };
        let at = rays.across(ray, layer as f32 + 0.5);
        let mut sum = [0.0; 4];
        for (u, w) in (-1..=1).flat_map(|u| (-1..=1).map(move |w| (u, w))) {
            let cell = [at[0].floor() as i32 + u, at[1].floor() as i32 + w];
            let weight = |a: usize| 1.0 - (at[a] - cell[a] as f32 - 0.5).abs();
            let mut place = [0; 3];
            place[rays.axes[0]] = layer as i32;
            place[rays.axes[1]] = cell[0];
            place[rays.axes[2]] = cell[1];
            let inside = (0..3).all(|a| (0..cells.dims[a] as i32).contains(&place[a]));
            if inside && weight(0) > 0.0 && weight(1) > 0.0 {
                let [x, y, z] = place.map(|c| c as usize);
                let i = (z * cells.dims[1] + y) * cells.dims[0] + x;
                for (sum, value) in sum.iter_mut().zip(cells.cells[i].to_array()) {
                    *sum += f64::from(value * weight(0) * weight(1));
                }
            }
        }
        for c in 0..3 {
            let sigma_t = sum[3] * color[c];
            let depth = sigma_t * f64::from(rays.between);
            if depth > 0.0 {
                light[c] = light[c] * (-depth).exp() + sum[c] / sigma_t * -(-depth).exp_m1();
                through[c] *= (-depth).exp();
            }
        }
    }
    Arriving {
        radiance: Rgb(light.map(|v| v as f32)),
        transmittance: K::of_channels(through.map(|v| v as f32)),
    }
}

#[test]
fn layers_bring_what_each_ray_does_by_itself() {
    check_layers::<f32>([1.0; 3]);
    check_layers::<Rgb>([0.3, 1.0, 0.0]);
}

fn check_layers<K: Spectrum>(color: [f32; 3]) {
    let cells = noise([12, 9, 10], color);
    for direction in [
        Vec3::new(0.9, 0.3, -0.2),
        Vec3::new(0.5, -2.0, 0.7),
        Vec3::new(-0.1, 0.4, -3.0),
        Vec3::new(0.0, 0.0, 1.0),
    ] {
        let rays = cells.lattice(direction);
        let layers = cells.layers(rays.axes, Towards::default());
        for (step, every) in [(2, 1), (4, 1), (2, 7)] {
            let count = cells.dims.map(|n| n / (step / 2) + 1);
            let set = SparseLattice::new(count, |choose| {
                let all = (0..count.iter().product()).map(|i| unflatten(i, count));
                let chosen = |v: &[usize; 3]| (v[0] * 5 + v[1] + v[2]).is_multiple_of(every);
                all.filter(chosen).for_each(choose);
            });
            let vertices = VertexLayers::new(&set, step, &cells, rays.axes);
            let (arriving, passed) = layers.pass::<K>(&rays, &[vertices]);
            assert!(passed > 0);
            for (v, found) in set.vertices().zip(&arriving[0]) {
                let place = rays.axes.map(|a| v[a] * step / 2);
                let taps = Taps::new(&rays, place[0]);
                let first = taps.first_rays([place[1] as i32, place[2] as i32]);
                let ray = |k: usize, i: usize| {
                    let ray = [first[0] + i as i32, first[1] + k as i32].map(|c| c as f32);
                    plain::<K>(&cells, &rays, ray, place[0]).lanes()
                };
                let rows: [[K::Lanes; TAPS]; TAPS] =
                    std::array::from_fn(|k| std::array::from_fn(|i| ray(k, i)));
                let expected: Arriving<K> = taps.between([0, 1, 2, 3].map(|k| &rows[k][..]));
                let numbers = |a: &Arriving<K>| [a.radiance.0, a.transmittance.channels()];
                let found_and_expected = numbers(found).into_iter().zip(numbers(&expected));
                let off = found_and_expected
                    .flat_map(|(a, b)| (0..3).map(move |c| (a[c] - b[c]).abs()))
                    .fold(0.0, f32::max);
                assert!(off < 2e-5, "{direction} {v:?} {found:?} {expected:?}");
            }
        }
    }
}

#[test]
fn what_arrives_at_a_vertex_does_not_depend_on_others() {
    let cells = noise([60, 37, 41], [1.0; 3]);
    let count = cells.dims.map(|n| n + 1);
    // All vertices, and those in a corner that is far from the first.
    let sets = [[0; 3], [43, 21, 29]].map(|least| {
        SparseLattice::new(count, |choose| {
            let all = (0..count.iter().product()).map(|i| unflatten(i, count));
            let chosen = |v: &[usize; 3]| (0..3).all(|a| v[a] >= least[a]);
            all.filter(chosen).for_each(choose);
        })
    });
    for direction in [[0.9, 0.3, -0.2], [0.5, -2.0, 0.7], [-0.1, 0.41, -3.0]].map(Vec3::from) {
        let rays = cells.lattice(direction);
        let layers = cells.layers(rays.axes, Towards::default());
        let [all, few] = sets.each_ref().map(|set| {
            let vertices = VertexLayers::new(set, 2, &cells, rays.axes);
            let (mut arriving, _) = layers.pass::<f32>(&rays, &[vertices]);
            let bits = |a: Arriving| (a.radiance.0.map(f32::to_bits), a.transmittance.to_bits());
            let arriving = arriving.remove(0).into_iter().map(bits);
            set.vertices().zip(arriving).collect::<Vec<_>>()
        });
        let all: std::collections::BTreeMap<_, _> = all.into_iter().collect();
        assert!(few.iter().all(|(v, bits)| all[v] == *bits), "{direction}");
    }
}

/// Tells lvoxels, and nothing else.
struct Lvoxels {
    dims: [usize; 3],
    blocks: Vec<LvoxelBlock>,
}

impl GatherInMedia for Lvoxels {
    type Share = f32;

    fn settings(&self) -> &crate::gather::RaySettings<'_> {
        unreachable!()
    }

    fn scattered(
        &self,
        _: Vec3,
        _: crate::gather::SampleRange,
        _: Option<crate::math::SeenPhase>,
    ) -> crate::gather::Gathered {
        unreachable!()
    }

    fn incident_from_surfaces(
        &self,
        _: &crate::math::Ray,
        _: &mut crate::gather::cone::Scratch,
    ) -> crate::gather::Incident {
        unreachable!()
    }

    fn walk(
        &self,
        _: &crate::math::Ray,
        _: &mut impl FnMut(crate::math::segment::Segment) -> bool,
    ) -> bool {
        unreachable!()
    }

    fn pass(&self, _: &crate::math::Ray, _: &mut crate::math::segment::Composite) -> u64 {
        unreachable!()
    }

    fn lvoxel_dims(&self, _: usize) -> Option<[usize; 3]> {
        Some(self.dims)
    }

    fn each_lvoxel(&self, _: usize, take: &mut impl FnMut(LvoxelBlock)) {
        self.blocks.iter().for_each(|b| take(*b));
    }
}

#[test]
fn cells_hold_what_their_lvoxels_do_on_whatever_level_the_volume_is() {
    let block = |first: [usize; 3], edge: usize, sigma_t: f32| LvoxelBlock {
        first,
        edge,
        sigma_t,
        source: Rgb([2.0, 1.0, 0.5]),
        lobe: [0; 3],
        single: LightPart::default(),
    };
    let lvoxels = Lvoxels {
        dims: [256, 200, 170],
        blocks: vec![
            block([0; 3], 1, 8.0),
            block([1, 0, 0], 1, 8.0),
            block([8, 16, 24], 8, 3.0),
            block([252, 196, 168], 2, 16.0),
        ],
    };
    let volume = Volume::new(
        "cloud".into(),
        Grid::from_fn(lvoxels.dims, |_| 1.0),
        [0.9; 3],
        DAffine3::IDENTITY,
    );
    let depth = |cells: &SourceCells, at: [usize; 3]| {
        let i = (at[2] * cells.dims[1] + at[1]) * cells.dims[0] + at[0];
        cells.cells[i].to_array()
    };
    // Cells of two voxels an edge, which are four of the finest on the other level.
    let finest = SourceCells::new(&lvoxels, 1, &volume, 8).unwrap();
    assert_eq!((finest.edge, finest.dims), (2, [128, 100, 88]));
    assert_eq!(depth(&finest, [0; 3]), [4.0, 2.0, 1.0, 2.0]);
    assert_eq!(depth(&finest, [4, 8, 12]), [6.0, 3.0, 1.5, 3.0]);
    assert_eq!(depth(&finest, [7, 11, 15]), [6.0, 3.0, 1.5, 3.0]);
    assert_eq!(depth(&finest, [8, 11, 15]), [0.0; 4]);
    assert_eq!(depth(&finest, [126, 98, 84])[3], 16.0);
    let coarser = SourceCells::new(&lvoxels, 1, &volume.at_level(1), 2).unwrap();
    assert_eq!((coarser.edge, coarser.dims), (1, [128, 100, 86]));
    assert_eq!(depth(&coarser, [0; 3])[3], 2.0);
    // The lvoxels of another volume on the same grid count as well.
    let both = SourceCells::new(&lvoxels, 2, &volume, 8).unwrap();
    assert_eq!(depth(&both, [4, 8, 12]), [12.0, 6.0, 3.0, 6.0]);
    let other = Lvoxels {
        dims: [100; 3],
        ..lvoxels
    };
    assert!(SourceCells::new(&other, 1, &volume, 8).is_none());
}

/// Volume of a phase function, one lvoxel of which sends light of three kinds.
fn lobed(single: LightPart) -> (SourceCells, FarField) {
    let mut volume = Volume::new(
        "cloud".into(),
        Grid::from_fn([64; 3], |_| 1.0),
        [0.9; 3],
        DAffine3::IDENTITY,
    );
    volume.phase = PhaseFunction::henyey_greenstein(0.8);
    let lvoxels = Lvoxels {
        dims: [64; 3],
        blocks: vec![LvoxelBlock {
            first: [0; 3],
            edge: 1,
            sigma_t: 1.0,
            source: Rgb([3.0, 2.0, 1.0]),
            lobe: [20, -30, 60],
            single,
        }],
    };
    let field = FarField::new(&volume, 6, 0);
    let cells = SourceCells::new(&lvoxels, 1, &volume, 1).unwrap();
    let once = ScatteringWeights::unsharpened(volume.phase, &field).unwrap();
    (cells.seen_in(once), field)
}

#[test]
fn cells_send_in_lobes_what_they_would_send_evenly() {
    let [none, half] = [0, 127].map(|share| LightPart {
        share,
        lobe: [0, 98, -10],
    });
    for single in [none, half] {
        let (cells, field) = lobed(single);
        let (mut sum, mut way) = (0.0, Vec3::ZERO);
        for q in 0..field.quarters() {
            let towards = Towards {
                travel: -field.direction(q),
                row_and_column: field.row_and_column(q),
            };
            let sent = cells.along(0, towards);
            assert!(sent >= 0.0);
            sum += sent;
            way += towards.travel * sent;
        }
        let count = field.quarters() as f32;
        assert!((sum / count - 1.0).abs() < 0.05, "{}", sum / count);
        // Quarters widen lobes.
        let once = cells.singles.first().copied().unwrap_or_default();
        let expected = cells.lobes[0] * (1.0 - once.share) + once.lobe * once.share;
        assert!((way / count).distance(expected) < 0.1, "{way} {expected}");
    }
    assert!(!lobed(none).0.tell_single() && lobed(half).0.tell_single());
}
