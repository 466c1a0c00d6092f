//! What a tree over many lights promises.

use super::cut::Cut;
use super::emitters::{Emitter, Emitters};
use super::receiver::Receiver;
use super::{Lights, ShadowRays};
use crate::math::{Rgb, sampling};
use crate::scene::{Camera, Film, Material, Mesh, Scene};
use crate::trace::Tracer;
use glam::{Affine3A, DVec3, Vec3};

/// Numbers in [0,1) that a key tells.
struct Numbers {
    key: u64,
    next: u64,
}

impl Numbers {
    fn new(key: u64) -> Self {
        Self { key, next: 0 }
    }

    fn unit(&mut self) -> f32 {
        self.next += 1;
        sampling::unit(sampling::hash(&[self.key, self.next]))
    }

    fn direction(&mut self) -> Vec3 {
        sampling::sphere([self.unit(), self.unit()])
    }

    /// In a box of 10 x 4 x 6 around the origin.
    fn place(&mut self) -> Vec3 {
        Vec3::new(
            10.0 * self.unit() - 5.0,
            4.0 * self.unit() - 2.0,
            6.0 * self.unit() - 3.0,
        )
    }

    fn receiver(&mut self) -> Receiver {
        if self.unit() < 0.25 {
            return Receiver::Medium;
        }
        let normal = self.direction();
        let face_normal = normal;
        Receiver::Surface {
            normal,
            face_normal,
        }
    }
}

fn empty() -> Scene {
    Scene {
        name: String::new(),
        world_from_scene: DVec3::ZERO,
        cameras: vec![Camera {
            name: String::new(),
            scene_from_camera: Affine3A::IDENTITY,
            fov_x_rad: 1.0,
        }],
        film: Film {
            width: 4,
            height: 4,
            exposure: 1.0,
        },
        mesh: Mesh::default(),
        materials: Vec::new(),
        textures: Vec::new(),
        lights: Vec::new(),
        volumes: Vec::new(),
        hash: [0; 32],
        warnings: Vec::new(),
    }
}

/// Lamps of power over a range of 36 and of different colours: half of them anywhere, half on a ceiling.
fn lamps(count: usize, key: u64) -> Scene {
    let mut numbers = Numbers::new(key);
    let mut scene = empty();
    let size = 0.5 / (count as f32).sqrt();
    for i in 0..count {
        let (mut middle, mut normal) = (numbers.place(), numbers.direction());
        if i % 2 == 0 {
            (middle.y, normal) = (2.0, -Vec3::Y);
        }
        let (x, y) = sampling::tangents(normal);
        let first = scene.mesh.positions.len() as u32;
        let side = size * (0.3 + numbers.unit());
        for corner in [x, -0.5 * x + 0.8 * y, -0.5 * x - 0.8 * y] {
            scene.mesh.positions.push(middle + corner * side);
        }
        scene.mesh.triangles.push([first, first + 1, first + 2]);
        scene.mesh.material.push(i as u32);
        let radiance = 30.0 * 6.0_f32.powf(2.0 * numbers.unit() - 1.0);
        scene.materials.push(Material {
            emission: std::array::from_fn(|_| radiance * (0.2 + numbers.unit())),
            emits_both_sides: i % 5 == 0,
            name: String::new(),
            albedo: [0.0; 3],
            texture: None,
        });
    }
    scene
}

fn sends(e: &Emitter, origin: Vec3, receiver: Receiver) -> Rgb {
    let in_front = (origin - e.corners[0]).dot(e.normal) > 0.0;
    if in_front || e.both_sides {
        e.radiance * receiver.of_triangle(e.corners.map(|c| c - origin))
    } else {
        Rgb::BLACK
    }
}
