//! Light beside lamps that stand in a medium.

use super::*;
use crate::light::ShadowRays;
use crate::scene::Material;

/// The haze with lamps in it that shine on both sides, each a square with corners that far from its
/// middle along x and z, or y.
fn haze_with_lamps(lamps: &[(Vec3, f32, bool)]) -> Scene {
    let mut scene = haze(0.02);
    scene.film = LARGE;
    scene.materials.push(Material {
        emission: [5.0; 3],
        emits_both_sides: true,
        ..Material::diffuse("lamp", [0.0; 3])
    });
    for &(middle, half, is_upright) in lamps {
        let along = if is_upright { Vec3::Y } else { Vec3::Z };
        let first = scene.mesh.positions.len() as u32;
        for [u, v] in [[-1.0, -1.0], [1.0, -1.0], [1.0, 1.0], [-1.0, 1.0]] {
            let corner = middle + half * (u * Vec3::X + v * along);
            scene.mesh.positions.push(corner);
        }
        for [b, c] in [[1, 2], [2, 3]] {
            scene.mesh.triangles.push([first, first + b, first + c]);
            scene.mesh.material.push(0);
        }
    }
    scene
}

#[test]
fn light_of_lamps_in_a_haze_is_where_it_belongs() {
    let middle = Vec3::new(0.0, 0.0, -12.0);
    let far = Shell::at(f32::INFINITY);
    for (name, lamps) in [
        // Vertices of the coarsest lattice stand in its plane, where it sends nothing; just beside
        // that; and half way to the next.
        ("flat", vec![(middle, 3.0, false)]),
        ("beside", vec![(middle + 0.03 * Vec3::Y, 3.0, false)]),
        ("between", vec![(middle + 1.9 * Vec3::Y, 3.0, false)]),
        // One that vertices surround, and one that is near to one of them.
        (
            "small",
            vec![
                (middle + Vec3::new(-5.9, 2.0, 2.1), 0.5, true),
                (middle + Vec3::new(4.1, 4.0, 0.0), 0.5, true),
            ],
        ),
    ] {
        let scene = haze_with_lamps(&lamps);
        with(&scene, &far, NoMedia, |view, lights, gatherer| {
            let (regions, job) = ([Region::full(LARGE.width, LARGE.height)], Job::default());
            let in_scatter = in_scatter(view, &regions, lights, gatherer, &job).unwrap();
            let (mut squares, mut sums) = (0.0, [0.0; 2]);
            for i in 0..400 {
                let [x, y] = sampling::r2(i, [0.5; 2]).map(|u| 15.0 * u - 7.5);
                let z = 15.0 * (0.37 * i as f32).fract() - 7.5;
                let point = middle + Vec3::new(x, y, z);
                let ends = [point, point + 0.1 * Vec3::X];
                let found = in_scatter.source(0, ends, 0.002, 1.0, &mut RayMemo::default());
                let rays = ShadowRays::Sequence {
                    per_light: 16,
                    first: 0,
                    seed: i,
                };
                let light = lights.in_medium(point + 0.05 * Vec3::X, rays, None, None);
                let [found, exact] = [found.0[0], 0.9 * light.rest.0[0]];
                sums[0] += found;
                sums[1] += exact;
                squares += (found - exact).powi(2);
            }
            let [bias, rms] = [sums[0] / sums[1] - 1.0, (400.0 * squares).sqrt() / sums[1]];
            assert!(bias.abs() < 0.02 && rms < 0.08, "{name}: {bias} {rms}");
        });
    }
}

#[test]
fn what_is_lit_beforehand_is_finer_near_lamps() {
    let far = Shell::at(f32::INFINITY);
    // Two voxels from three borders.
    let lamp = (Vec3::new(-6.0, -6.0, -18.0), 0.5, false);
    let lit = with(
        &haze_with_lamps(&[lamp]),
        &far,
        NoMedia,
        |view, lights, gatherer| {
            let light = MediaLights {
                lights,
                gatherer: Some(gatherer),
                scattered: None,
                incident: None,
            };
            let job = Job::default();
            InScatter::new(view, VisibleMedia::All, &light, &job)?.light_all(&job)
        },
    );
    let lit = lit.unwrap().remove(0);
    let is_lit = |level: usize, v| lit.direct[level].as_ref().unwrap().get(v).is_some();
    assert!(is_lit(2, [4; 3]) && is_lit(1, [5, 0, 0]) && is_lit(0, [7, 2, 1]));
    assert!(!is_lit(1, [8; 3]) && !is_lit(0, [16; 3]));
}
