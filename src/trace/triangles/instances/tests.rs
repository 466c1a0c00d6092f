//! Instances held to the same triangles that lie flat.

use super::super::tests::sphere;
use super::*;
use crate::math::sampling::{self, hash, unit};
use crate::scene::{CameraInput, Mask, Material, MeshInput, Scene, SceneBuilder, Texture};
use crate::trace::{Surface, Tracer, offset};
use glam::{DMat3, Vec2};

fn number(i: u64, k: u64) -> f64 {
    f64::from(unit(hash(&[i, k]))) - 0.5
}

/// A bumpy ball with normals and texture coordinates, of two materials, of which one has a mask if
/// the scene has any.
fn ball(is_masked: bool) -> MeshInput {
    let mesh = sphere(17, 23);
    let bump = |i: u64| 1.0 + 0.3 * unit(hash(&[i, 5]));
    let positions = (0..).zip(&mesh.positions[..]).map(|(i, p)| *p * bump(i));
    let positions: Vec<DVec3> = positions.map(|p| p.as_dvec3()).collect();
    let mut materials = vec![
        Material::diffuse("a", [0.5; 3]),
        Material::diffuse("b", [0.3, 0.6, 0.2]),
    ];
    let texels = (0..64).map(|i| [unit(hash(&[i])); 3]).collect();
    if is_masked {
        materials[1].mask = Some(Mask {
            opacity: 0.9,
            texture: Some(0),
            cutoff: Some(0.4),
        });
    }
    let uvs = (0..mesh.positions.len() as u64).map(|i| {
        let [u, v] = [11, 12].map(|k| unit(hash(&[i, k])));
        Vec2::new(u, v)
    });
    let triangles = mesh.triangles.to_vec();
    let of = (0..triangles.len() as u32).map(|i| i % 2);
    MeshInput::new("ball", positions, triangles.clone())
        .materials(materials, of.collect(), vec![Texture::new(8, 8, texels)])
        .normals(mesh.positions.to_vec())
        .uvs(uvs.collect())
}

/// Places of all kinds: turned, of all sizes, sheared, mirrored, and far away.
fn places(count: u64, offset: f64) -> Vec<DAffine3> {
    let place = |i: u64| {
        let axes = [0, 1, 2].map(|k| {
            let column = [0, 1, 2].map(|a| number(i, 3 * k + a) * 2.0);
            DVec3::from(column) + DVec3::AXES[k as usize] * 1.5
        });
        let mut turned = DMat3::from_cols(axes[0], axes[1], axes[2]);
        if i.is_multiple_of(3) {
            turned.y_axis = -turned.y_axis;
        }
        let size = libm::exp2(6.0 * number(i, 20) - 1.0);
        let middle = [10, 11, 12].map(|k| number(i, k));
        DAffine3 {
            matrix3: turned * size,
            translation: DVec3::from(middle) * 30.0 + offset,
        }
    };
    (0..count).map(place).collect()
}

fn floor(offset: f64) -> MeshInput {
    let corners = [
        [-40.0, -5.0, -40.0],
        [-40.0, -5.0, 40.0],
        [40.0, -5.0, 40.0],
        [40.0, -5.0, -40.0],
    ];
    let corners = corners.map(|c| DVec3::from(c) + offset);
    MeshInput::new("floor", corners, vec![[0, 1, 2], [0, 2, 3]])
}

/// One scene with instances, and the same with each place flat.
fn scenes(is_masked: bool, offset: f64) -> [Scene; 2] {
    let builder = || {
        let from = [offset, offset, offset + 60.0];
        let camera = CameraInput::look_at("", from, [offset; 3], [0.0, 1.0, 0.0], 1.0);
        let builder = SceneBuilder::new("balls").camera(camera.unwrap());
        builder.mesh(floor(offset))
    };
    let places = places(60, offset);
    let instances = builder().instances(ball(is_masked), places.clone());
    let flat = places.iter().fold(builder(), |builder, place| {
        builder.mesh(ball(is_masked).transform(place))
    });
    [instances, flat].map(|builder| builder.build().unwrap())
}

fn rays(count: u64) -> Vec<Ray> {
    let ray = |i| {
        let origin = 25.0 * sampling::sphere(sampling::r2(i / 8, [0.3; 2]));
        let origin = if i / 8 % 4 == 0 { 0.3 * origin } else { origin };
        let to = 12.0 * sampling::sphere(sampling::r2(i, [0.7; 2]));
        let to = if i % 16 < 8 {
            to
        } else {
            to * 0.02 - 0.5 * origin
        };
        let t_max = if i % 5 == 0 { 22.0 } else { f32::INFINITY };
        Ray::new(origin, (to - origin).normalize(), t_max)
    };
    (0..count).map(ray).collect()
}

/// Holds rays among instances to those among the same triangles without, and returns how many
/// met an instance.
fn met_as_flat([instanced, flat]: &[Scene; 2]) -> usize {
    let meshes = [&instanced.mesh, &flat.mesh];
    assert_eq!(meshes[0].triangle_count(), meshes[1].triangle_count());
    assert!(10 * meshes[0].triangles.len() < meshes[1].triangles.len());
    let tracers = [Tracer::new(instanced), Tracer::new(flat)];
    let rays = rays(40_000);
    let mut hits = vec![None; rays.len()];
    tracers[0].closest_of_packet(&rays, &mut hits);
    let (mut met, mut others) = (0, 0);
    for (ray, &hit) in rays.iter().zip(&hits) {
        assert_eq!(hit, tracers[0].closest(ray));
        assert_eq!(hit.is_some(), tracers[0].is_occluded(ray));
        assert_eq!(hit, tracers[0].closest_seen(ray));
        assert_eq!(hit, tracers[0].closest_seen_and_masked(ray).0);
        let expected = tracers[1].closest(ray);
        let is_same = match (hit, expected) {
            (Some(a), Some(b)) => {
                let is_near = |x: f32, y: f32| (x - y).abs() < 3e-4;
                (a.t / b.t - 1.0).abs() < 1e-5
                    && (a.triangle, a.is_back) == (b.triangle, b.is_back)
                    && is_near(a.uv[0], b.uv[0])
                    && is_near(a.uv[1], b.uv[1])
            }
            (a, b) => a == b,
        };
        others += usize::from(!is_same);
        met += usize::from(hit.is_some_and(|h| h.triangle > 1));
        let masked = tracers.each_ref().map(|t| t.closest_seen_and_masked(ray).1);
        assert!(!is_same || masked[0] == masked[1]);
        if is_same && let Some(hit) = hit {
            let [a, b] = [instanced, flat].map(|s| Surface::new(s, hit.triangle, hit.uv));
            assert!(a.position.distance(b.position) < 1e-5 * 40.0);
            assert!(a.face_normal.dot(b.face_normal) > 0.9999);
            assert!(a.normal.dot(b.normal) > 0.999);
            assert_eq!((a.albedo, a.material % 2), (b.albedo, b.material % 2));
            assert!(!tracers[0].is_clear(hit.triangle, hit.uv));
        }
    }
    // Rays along silhouettes and edges pass by rounding.
    assert!(others * 1000 < rays.len(), "{others}");
    met
}

#[test]
fn instances_are_met_as_the_same_triangles_that_lie_flat() {
    assert!(met_as_flat(&scenes(false, 0.0)) > 10_000);
    // So far away that the scene moves to the origin.
    assert!(met_as_flat(&scenes(false, 1e7)) > 10_000);
}

#[test]
fn masks_of_instances_are_those_of_their_mesh() {
    let scenes = scenes(true, 0.0);
    assert!(met_as_flat(&scenes) > 10_000);
    let tracers = scenes.each_ref().map(Tracer::new);
    let through = rays(4000).into_iter().map(|ray| {
        let [a, b] = tracers.each_ref().map(|t| t.let_through(&ray));
        usize::from(a != b)
    });
    assert!(through.sum::<usize>() < 4);
}

#[test]
fn nothing_escapes_from_an_instance_nor_meets_where_it_leaves() {
    let closed = sphere(40, 64);
    let positions = closed.positions.iter().map(|p| p.as_dvec3());
    let mesh = MeshInput::new("ball", positions, closed.triangles.to_vec());
    let places = places(30, 0.0);
    let builder = SceneBuilder::new("balls").instances(mesh, places.clone());
    let scene = builder.build().unwrap();
    let tracer = Tracer::new(&scene);
    let count = closed.triangles.len();
    for (k, place) in places.iter().enumerate() {
        let first = k * count;
        let inside = place
            .transform_point3(DVec3::new(0.1, 0.03, -0.2))
            .as_vec3();
        for t in (0..count).step_by(7) {
            let [a, b, c] = scene.mesh.corners(first + t);
            for to in [
                a,
                b,
                c,
                0.5 * (a + b),
                0.5 * (b + c),
                0.3 * a + 0.4 * b + 0.3 * c,
            ] {
                let ray = Ray::endless(inside, (to - inside).normalize());
                assert!(tracer.closest(&ray).is_some(), "instance {k}, triangle {t}");
                assert!(tracer.is_occluded(&ray));
            }
            let surface = Surface::new(&scene, (first + t) as u32, [0.3, 0.3]);
            let up = offset(surface.position);
            let out = Ray::endless(
                surface.position + surface.face_normal * up,
                surface.face_normal,
            );
            let hit = tracer.closest(&out);
            assert!(hit.is_none_or(|h| h.triangle as usize != first + t));
        }
    }
}

#[test]
fn areas_and_materials_are_those_of_all_places() {
    let [instanced, flat] = scenes(false, 0.0);
    let [a, b] = [&instanced, &flat].map(|s| s.mesh.areas(s.materials.len()));
    let sum = |areas: &[f64]| areas.iter().sum::<f64>();
    assert!((sum(&a) / sum(&b) - 1.0).abs() < 1e-6);
    for t in (0..flat.mesh.triangles.len()).step_by(11) {
        let [x, y] = [&instanced, &flat].map(|s| {
            let material = s.mesh.material_of(t) as usize;
            (s.materials[material].name.clone(), s.mesh.area(t))
        });
        assert_eq!(x.0, y.0);
        assert!((x.1 / y.1 - 1.0).abs() < 1e-3, "{x:?} {y:?}");
    }
    let [a, b] = [&instanced, &flat].map(Scene::bounds);
    assert!((a.min - b.min).abs().max_element() < 1e-4);
    assert!((a.max - b.max).abs().max_element() < 1e-4);
}

#[test]
fn instances_at_one_place_are_all_kept() {
    let places = vec![DAffine3::IDENTITY; 100];
    let builder = SceneBuilder::new("balls").instances(ball(false), places);
    let scene = builder.build().unwrap();
    let bvh = TriangleBvh::new(&scene.mesh);
    let ray = Ray::endless(Vec3::new(0.1, 0.2, 5.0), -Vec3::Z);
    let mut met = 0;
    bvh.instances.as_ref().unwrap().visit(&ray, |_, _| {
        met += 1;
        true
    });
    assert_eq!(met, 100);
    // The first of triangles as far away, as ever.
    let first = scene.mesh.triangles.len();
    assert!((bvh.closest(&ray).unwrap().triangle as usize) < first);
}
