//! All that shines in a scene, as a path asks for it: emissive triangles, lights without size, the
//! environment.

use super::sample::Sample;
use super::sky::Sky;
use crate::math::{Rgb, sampling};
use crate::scene::{Light, Material, Scene};
use crate::trace::{Hit, Surface, unit_normal};
use glam::Vec3;

/// An emissive triangle, or a cell of one that has a texture.
#[derive(Clone, Copy, Debug)]
struct Emitter {
    corners: [Vec3; 3],
    normal: Vec3,
    material: u32,
    triangle: u32,
    /// Weights of the second and third corner of the triangle at those of the cell.
    uvs: [[f32; 2]; 3],
    /// Power per area, over pi.
    strength: f64,
}

/// The lights of a scene.
#[derive(Debug)]
pub struct Sources<'a> {
    scene: &'a Scene,
    /// Cells along an edge of a textured triangle.
    cells: u32,
    /// In the order of triangles, those of each row by row.
    emitters: Vec<Emitter>,
    /// Running sum of the emitters' powers, over pi.
    running_power: Vec<f64>,
    environment: Rgb,
    sky: Option<Sky<'a>>,
}

/// Cells along an edge of a textured triangle.
const CELLS: u32 = 32;
/// Triangles of a scene that are cut into cells, at most.
const MAX_CUT: usize = 512;
/// Points of a cell at which its texture is looked at.
const POINTS: u32 = 16;

/// Luminance times the number of sides that emit: an emitter's power per area, over pi.
fn strength(material: &Material) -> f64 {
    let sides = if material.emits_both_sides { 2.0 } else { 1.0 };
    sides * f64::from(Rgb(material.emission).luminance())
}

impl Emitter {
    /// Emitted radiance at a point of it, by the weights of its corners.
    fn emission(&self, scene: &Scene, weights: [f32; 3]) -> Rgb {
        let uv = [0, 1].map(|i| (0..3).map(|k| self.uvs[k][i] * weights[k]).sum());
        Surface::emission_at(scene, self.triangle, uv)
    }

    /// Cells of equal area, so many along each edge. Each is as strong as its texture is at some
    /// points of it, and a little more, so that no light is never asked for.
    fn cells(&self, scene: &Scene, count: u32) -> Vec<Self> {
        const LITTLE: f64 = 0.05;
        let mut cells = Vec::with_capacity((count * count) as usize);
        let [a, b, c] = self.corners.map(|p| p.as_dvec3());
        let step = 1.0 / f64::from(count);
        for j in 0..count {
            for i in 0..count - j {
                let corner = |x: u32, y: u32| [f64::from(i + x) * step, f64::from(j + y) * step];
                let lower = [corner(0, 0), corner(1, 0), corner(0, 1)];
                let upper = [corner(1, 1), corner(0, 1), corner(1, 0)];
                let whole = 1 + usize::from(i + j + 1 < count);
                for uvs in [lower, upper].into_iter().take(whole) {
                    let at = |[u, v]: [f64; 2]| (a * (1.0 - u - v) + b * u + c * v).as_vec3();
                    cells.push(Self {
                        corners: uvs.map(at),
                        uvs: uvs.map(|uv| uv.map(|w| w as f32)),
                        ..*self
                    });
                }
            }
        }
        for (seed, cell) in (0..).zip(&mut cells) {
            let light = |i| {
                let w = sampling::triangle(sampling::sobol2(i, 0, seed));
                f64::from(cell.emission(scene, w).luminance())
            };
            cell.strength = (0..POINTS).map(light).sum::<f64>() / f64::from(POINTS);
        }
        let sides = match scene.materials[self.material as usize].emits_both_sides {
            true => 2.0,
            false => 1.0,
        };
        let mean = cells.iter().map(|c| c.strength).sum::<f64>() / cells.len() as f64;
        // Where no point is bright, it may still be so between them.
        let more = LITTLE * mean + 1e-4 * self.strength / sides;
        for cell in &mut cells {
            cell.strength = sides * (cell.strength + more);
        }
        cells
    }
}

/// Which of the cells of a triangle, `count` along an edge, a point lies in.
fn cell_of(uv: [f32; 2], count: u32) -> usize {
    let [x, y] = uv.map(|w| w.clamp(0.0, 1.0) * count as f32);
    let j = (y as u32).min(count - 1);
    let i = (x as u32).min(count - 1 - j);
    let is_upper = (x - i as f32) + (y - j as f32) > 1.0 && i + j + 1 < count;
    // Of the rows before, and of this one.
    (j * (2 * count - j) + 2 * i + u32::from(is_upper)) as usize
}

impl<'a> Sources<'a> {
    /// Finds them.
    #[must_use]
    pub fn new(scene: &'a Scene) -> Self {
        let mut emitters = Vec::new();
        let mut running_power = Vec::new();
        let mut sum = 0.0;
        let has_texture = |m: u32| scene.materials[m as usize].emission_texture.is_some();
        let textured = scene.mesh.material.iter().filter(|m| has_texture(**m));
        let cells = if textured.count() > MAX_CUT { 1 } else { CELLS };
        for (t, &material) in scene.mesh.material.iter().enumerate() {
            let strength = strength(&scene.materials[material as usize]);
            if strength > 0.0 {
                let corners = scene.mesh.corners(t);
                let area = f64::from(scene.mesh.area(t));
                let whole = Emitter {
                    corners,
                    normal: unit_normal(corners),
                    material,
                    triangle: t as u32,
                    uvs: [[0.0, 0.0], [1.0, 0.0], [0.0, 1.0]],
                    strength,
                };
                if !has_texture(material) {
                    emitters.push(whole);
                    sum += strength * area;
                    running_power.push(sum);
                    continue;
                }
                for cell in whole.cells(scene, cells) {
                    emitters.push(cell);
                    sum += cell.strength * area / f64::from(cells * cells);
                    running_power.push(sum);
                }
            }
        }
        Self {
            scene,
            cells,
            emitters,
            running_power,
            environment: scene.environment(),
            sky: scene.environment_image.as_ref().and_then(Sky::new),
        }
    }

    /// Radiance that a camera sees in a direction in which no surface is.
    #[must_use]
    pub fn seen_environment(&self, direction: Vec3) -> Rgb {
        if !self.scene.is_environment_seen {
            return Rgb::BLACK;
        }
        let sky = self.sky.as_ref();
        self.environment + sky.map_or(Rgb::BLACK, |sky| sky.seen(direction))
    }

    /// The environment of one colour, for which the lobes of surfaces and media are the best
    /// distribution there is: only paths look for it.
    #[must_use]
    pub fn even_environment(&self) -> Rgb {
        self.environment
    }

    /// The environment image.
    #[must_use]
    pub fn sky(&self) -> Option<&Sky<'a>> {
        self.sky.as_ref()
    }

    /// Whether a ray can run into light: without emitters and environment only shadow rays find
    /// any.
    #[must_use]
    pub fn can_be_hit(&self) -> bool {
        !self.emitters.is_empty() || !self.environment.is_black() || self.sky.is_some()
    }

    fn total_power(&self) -> f64 {
        self.running_power.last().copied().unwrap_or(0.0)
    }

    /// Density per steradian with which [`Sources::emitter`] finds the point that a ray meets under
    /// `cos` to the normal of an emissive triangle.
    #[must_use]
    pub fn emitter_pdf(&self, hit: &Hit, cos: f32) -> f32 {
        let material = self.scene.mesh.material_of(hit.triangle as usize);
        let material = &self.scene.materials[material as usize];
        let strength = match material.emission_texture {
            None => strength(material),
            Some(_) => {
                let first = (self.emitters).partition_point(|e| e.triangle < hit.triangle);
                let cell = first + cell_of(hit.uv, self.cells);
                self.emitters.get(cell).map_or(0.0, |e| e.strength)
            }
        };
        self.pdf(strength, hit.t, cos)
    }

    /// The same of a point `distance` away, by the strength there.
    fn pdf(&self, strength: f64, distance: f32, cos: f32) -> f32 {
        let per_area = strength / self.total_power();
        per_area as f32 * distance * distance / cos.abs()
    }

    /// A point on an emissive triangle, by power: `choice` picks the triangle, `u` the point.
    /// `None` if that point does not shine this way.
    #[must_use]
    pub fn emitter(&self, origin: Vec3, choice: f32, u: [f32; 2]) -> Option<Sample> {
        if self.emitters.is_empty() {
            return None;
        }
        let target = f64::from(choice) * self.total_power();
        let index = self.running_power.partition_point(|&p| p <= target);
        let emitter = &self.emitters[index.min(self.emitters.len() - 1)];
        let material = &self.scene.materials[emitter.material as usize];
        let w = sampling::triangle(u);
        let [a, b, c] = emitter.corners.map(|p| p - origin);
        let to_light = a * w[0] + b * w[1] + c * w[2];
        let distance = to_light.length();
        let direction = to_light / distance;
        let cos = -direction.dot(emitter.normal);
        if !(cos > 0.0 || (material.emits_both_sides && cos < 0.0)) {
            return None;
        }
        let pdf = self.pdf(emitter.strength, distance, cos);
        (pdf > 0.0 && pdf.is_finite()).then(|| Sample {
            direction,
            distance,
            light: emitter.emission(self.scene, w) * (1.0 / pdf),
            pdf,
        })
    }

    /// One of the lights that rays cannot run into (points, spots, suns), chosen by what each would
    /// send to a receiver of this `response` if nothing were between. `disk` picks the point of a
    /// sun.
    #[must_use]
    pub fn delta_light(
        &self,
        origin: Vec3,
        response: impl Fn(Vec3) -> f32,
        choice: f32,
        disk: [f32; 2],
    ) -> Option<Sample> {
        let power = |s: &Sample| s.light.luminance() * response(s.direction);
        let ways = || {
            self.scene
                .lights
                .iter()
                .filter_map(|light| way_to(light, origin, disk))
        };
        let total: f32 = ways().map(|s| power(&s)).sum();
        if total.is_nan() || total <= 0.0 {
            return None;
        }
        let mut left = choice * total;
        let mut chosen: Option<(Sample, f32)> = None;
        for way in ways() {
            let p = power(&way);
            if p > 0.0 {
                chosen = Some((way, p));
                if left < p {
                    break;
                }
                left -= p;
            }
        }
        chosen.map(|(mut way, p)| {
            way.light *= total / p;
            way
        })
    }
}

/// The way to a light that has no size or is infinitely far, with the irradiance that it sends to a
/// plane facing it.
fn way_to(light: &Light, origin: Vec3, disk: [f32; 2]) -> Option<Sample> {
    let near = |position: Vec3, intensity: Rgb| {
        let to_light = position - origin;
        let distance = to_light.length();
        (distance > 0.0).then(|| Sample {
            direction: to_light / distance,
            distance,
            light: intensity * (1.0 / (distance * distance)),
            pdf: f32::INFINITY,
        })
    };
    match *light {
        Light::Environment { .. } => None,
        Light::Point {
            position,
            intensity,
        } => near(position, Rgb(intensity)),
        Light::Spot {
            position,
            intensity,
            ..
        } => {
            let mut way = near(position, Rgb(intensity))?;
            let falloff = light.falloff(-way.direction);
            way.light *= falloff;
            (falloff > 0.0).then_some(way)
        }
        Light::Directional {
            direction,
            irradiance,
            angular_radius_rad,
        } => {
            let mut way = Sample {
                direction: -direction,
                distance: f32::INFINITY,
                light: Rgb(irradiance),
                pdf: f32::INFINITY,
            };
            if angular_radius_rad > 0.0 {
                // Uniform in the projection on a plane that faces the light, where every part sends
                // the same irradiance.
                let (x, y) = sampling::tangents(-direction);
                let radius = libm::sinf(angular_radius_rad);
                let [u, v] = sampling::disk(disk).map(|c| c * radius);
                let cos = (1.0 - u * u - v * v).max(0.0).sqrt();
                if cos <= 0.0 {
                    return None;
                }
                way.direction = (x * u + y * v - direction * cos).normalize();
                way.light *= 1.0 / cos;
            }
            Some(way)
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::scene::Texture;
    use glam::Vec2;

    /// A triangle of a texture with one bright texel, and what cells of it are.
    #[test]
    fn points_of_cells_are_found_in_them() {
        let mut scene = Scene::without_picture();
        scene.mesh.positions = [Vec3::ZERO, Vec3::X, Vec3::Y].to_vec().into();
        scene.mesh.uvs = [Vec2::ZERO, Vec2::X, Vec2::Y].to_vec().into();
        scene.mesh.triangles = vec![[0, 1, 2]].into();
        scene.mesh.material = vec![0].into();
        let texels = (0..64).map(|i| [if i == 18 { 1.0 } else { 0.0 }; 3]);
        scene.textures = vec![Texture::new(8, 8, texels.collect())];
        scene.materials = vec![Material {
            emission: [2.0; 3],
            emission_texture: Some(0),
            ..Material::diffuse("", [0.0; 3])
        }];
        let sources = Sources::new(&scene);
        assert_eq!(sources.emitters.len(), (CELLS * CELLS) as usize);
        let mut integral = 0.0;
        for (i, cell) in sources.emitters.iter().enumerate() {
            for w in [[0.8, 0.1, 0.1], [0.1, 0.8, 0.1], [0.1, 0.1, 0.8]] {
                let uv = [0, 1].map(|k| (0..3).map(|c| cell.uvs[c][k] * w[c]).sum());
                assert_eq!(cell_of(uv, CELLS), i);
            }
            integral += cell.strength / sources.total_power() * 0.5 / f64::from(CELLS * CELLS);
        }
        assert!((integral - 1.0).abs() < 1e-6, "{integral}");
        // One texel of 64 is a thirty-second of the triangle, and most points go there.
        let strongest = sources.emitters.iter().map(|e| e.strength);
        assert!(strongest.fold(0.0, f64::max) > 20.0 * strength(&scene.materials[0]) / 32.0);
    }
}
