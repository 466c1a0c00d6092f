//! Emissive triangles with a texture, cut into parts that each send the mean of the texture over
//! them: many where the texture differs from place to place and that is much of the scene's light,
//! one where it is even, none where it is black.

use super::emitter::Emitter;
use crate::math::Rgb;
use crate::scene::{Material, Scene, Texture};
use crate::trace::unit_normal;
use glam::{DVec2, DVec3, Vec3};
use rayon::prelude::*;

/// How far light within a part may be from even, over the light of all emitters: half as much makes
/// up to twice as many parts.
const TOLERANCE: f64 = 1.0 / 2048.0;
/// The same of parts that send more than this share of all light: where light changes slowly, what
/// is wrong about neighbours adds up.
const LARGE_TOLERANCE: f64 = TOLERANCE / 16.0;
const LARGE_SHARE: f64 = 1.0 / 2048.0;
/// Times that a triangle is halved, at most.
const MAX_DEPTH: u32 = 24;
/// Times that a part is halved to tell whether it is even.
const LOOK_AHEAD: usize = 4;
/// Times that it is halved at once, at most: what is learnt of a large texture serves many parts.
const MAX_LEVELS: usize = 12;
/// Texels of the smallest parts that large textures are halved to at once.
const TEXELS_AT_ONCE: f64 = 8.0;

/// The emitters of a scene, in the order of its triangles.
pub(super) fn emitters(scene: &Scene) -> Vec<Emitter> {
    let mut whole = Vec::new();
    for (t, &m) in scene.mesh.material.iter().enumerate() {
        let material = &scene.materials[m as usize];
        if material.emits() {
            let corners = scene.mesh.corners(t);
            whole.push(Emitter {
                corners,
                normal: unit_normal(corners),
                radiance: Rgb(material.emission),
                area: scene.mesh.area(t),
                both_sides: material.emits_both_sides,
                surface: whole.len() as u32,
            });
        }
    }
    let has_texture = |m: &Material| m.emission_texture.is_some();
    if scene.mesh.uvs.is_empty() || !scene.materials.iter().any(has_texture) {
        return whole;
    }
    cut(scene, whole)
}

/// An emissive triangle, with its texture if it has one.
struct Textured<'a> {
    emitter: Emitter,
    texture: Option<(&'a Texture, [DVec2; 3])>,
    /// Mean radiance.
    mean: DVec3,
}

/// Cuts what has a texture of such emissive triangles of a scene.
fn cut(scene: &Scene, whole: Vec<Emitter>) -> Vec<Emitter> {
    let mesh = &scene.mesh;
    let emissive = (0..mesh.material.len()).filter(|t| {
        let material = &scene.materials[mesh.material[*t] as usize];
        material.emits()
    });
    let all: Vec<(usize, Emitter)> = emissive.zip(whole).collect();
    let all: Vec<Textured> = (all.into_par_iter())
        .map(|(t, emitter)| {
            let material = &scene.materials[mesh.material[t] as usize];
            let radiance = Vec3::from(emitter.radiance.0).as_dvec3();
            let texture = material.emission_texture.map(|index| {
                let uvs = mesh.triangles[t].map(|v| mesh.uvs[v as usize].as_dvec2());
                (&scene.textures[index as usize], uvs)
            });
            let mean = texture.map_or(DVec3::ONE, |(texture, uvs)| texture.mean_within(uvs));
            Textured {
                emitter,
                texture,
                mean: radiance * mean,
            }
        })
        .collect();
    let power = |t: &Textured| f64::from(t.emitter.area) * brightness(t.mean);
    let total = all.iter().map(power).sum::<f64>();
    let parts: Vec<Vec<Emitter>> = all.par_iter().map(|t| t.parts(total)).collect();
    parts.concat()
}

fn brightness(radiance: DVec3) -> f64 {
    radiance.element_sum() / 3.0
}

/// A part of a triangle: corners of it in space and in the texture.
#[derive(Clone, Copy)]
struct Part {
    corners: [DVec3; 3],
    uvs: [DVec2; 3],
}

impl Part {
    /// Cut across its longest side.
    fn halves(&self) -> [Self; 2] {
        let side = |k: usize| self.corners[(k + 1) % 3].distance_squared(self.corners[k]);
        let (mut longest, mut length) = (0, side(0));
        for k in 1..3 {
            if side(k) > length {
                (longest, length) = (k, side(k));
            }
        }
        let (i, j) = (longest, (longest + 1) % 3);
        let corner = 0.5 * (self.corners[i] + self.corners[j]);
        let uv = 0.5 * (self.uvs[i] + self.uvs[j]);
        let with = |k: usize| {
            let mut half = *self;
            (half.corners[k], half.uvs[k]) = (corner, uv);
            half
        };
        [with(j), with(i)]
    }
}

/// Means over the parts of a part: those of a level are the halves of those of the level before.
struct Means {
    levels: Vec<Vec<DVec3>>,
}

impl Means {
    fn of(part: &Part, texture: &Texture) -> Self {
        let texels = texture.texels_within(part.uvs);
        let levels = libm::log2((texels / TEXELS_AT_ONCE).max(1.0)) as usize;
        let levels = levels.clamp(LOOK_AHEAD, MAX_LEVELS);
        let mut parts = vec![*part];
        for _ in 0..levels {
            parts = parts.iter().flat_map(Part::halves).collect();
        }
        let finest: Vec<DVec3> = parts.iter().map(|p| texture.mean_within(p.uvs)).collect();
        let mut means = vec![finest];
        for level in 0..levels {
            let halves = means[level].chunks_exact(2);
            means.push(halves.map(|pair| 0.5 * (pair[0] + pair[1])).collect());
        }
        means.reverse();
        Self { levels: means }
    }

    /// Mean over the part of this number of a level.
    fn mean(&self, level: usize, index: usize) -> DVec3 {
        self.levels[level][index]
    }

    /// Whether it is known how even the parts of a level are.
    fn tells_of(&self, level: usize) -> bool {
        level + LOOK_AHEAD < self.levels.len()
    }

    /// Root mean square by which parts of a part differ from its mean, brightness of each channel.
    fn deviation(&self, level: usize, index: usize, factor: DVec3) -> f64 {
        let mean = self.mean(level, index);
        let finer = &self.levels[level + LOOK_AHEAD];
        let own = &finer[index << LOOK_AHEAD..(index + 1) << LOOK_AHEAD];
        let squares = own.iter().map(|m| {
            let off = (*m - mean) * factor;
            off * off
        });
        brightness(squares.sum::<DVec3>() / own.len() as f64).sqrt()
    }
}

/// A part, and where its mean is known.
#[derive(Clone, Copy)]
struct At {
    part: Part,
    depth: u32,
    level: usize,
    index: usize,
}

impl Textured<'_> {
    /// The parts, where all emitters send `total`, as area times radiance.
    fn parts(&self, total: f64) -> Vec<Emitter> {
        let Some((texture, uvs)) = self.texture else {
            return vec![self.emitter];
        };
        let mean = Rgb(self.mean.as_vec3().to_array());
        let factor = Vec3::from(self.emitter.radiance.0).as_dvec3();
        // No texel is above 1.
        let most = f64::from(self.emitter.area) * brightness(factor);
        if most <= total * TOLERANCE.min(LARGE_SHARE) {
            let radiance = mean;
            let whole = Emitter {
                radiance,
                ..self.emitter
            };
            return Some(whole)
                .filter(|e| !e.radiance.is_black())
                .into_iter()
                .collect();
        }
        let corners = self.emitter.corners.map(|c| c.as_dvec3());
        let mut parts = Vec::new();
        let whole = Part { corners, uvs };
        self.add(&mut parts, texture, whole, 0, total);
        parts
    }

    /// Adds the parts of a part.
    fn add(&self, into: &mut Vec<Emitter>, texture: &Texture, part: Part, depth: u32, total: f64) {
        let factor = Vec3::from(self.emitter.radiance.0).as_dvec3();
        let means = Means::of(&part, texture);
        // Depth first, the first half before the second.
        let (level, index) = (0, 0);
        let mut open = vec![At {
            part,
            depth,
            level,
            index,
        }];
        while let Some(at) = open.pop() {
            let mean = means.mean(at.level, at.index);
            if mean == DVec3::ZERO {
                continue;
            }
            if !means.tells_of(at.level) {
                self.add(into, texture, at.part, at.depth, total);
                continue;
            }
            let area = f64::from(self.emitter.area) * libm::exp2(-f64::from(at.depth));
            let deviation = area * means.deviation(at.level, at.index, factor);
            let is_large = area * brightness(mean * factor) > LARGE_SHARE * total;
            let tolerance = if is_large { LARGE_TOLERANCE } else { TOLERANCE };
            if deviation <= tolerance * total || at.depth >= MAX_DEPTH {
                let radiance = Rgb((mean * factor).as_vec3().to_array());
                into.extend(Some(self.part(&at, radiance)).filter(|e| !e.radiance.is_black()));
                continue;
            }
            let halves = at.part.halves().into_iter().enumerate();
            for (k, part) in halves.rev() {
                open.push(At {
                    part,
                    depth: at.depth + 1,
                    level: at.level + 1,
                    index: 2 * at.index + k,
                });
            }
        }
    }

    fn part(&self, at: &At, radiance: Rgb) -> Emitter {
        Emitter {
            corners: at.part.corners.map(|c| c.as_vec3()),
            radiance,
            area: self.emitter.area * libm::exp2f(-(at.depth as f32)),
            ..self.emitter
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::light::shading_point::{MediumReceiver, Receiver, SurfaceReceiver};
    use crate::math::sampling;
    use crate::trace::Surface;
    use glam::Vec2;

    /// A square from 0 to 1 in the plane of x and y that faces z, with such a texture.
    fn square(side: u32, texel: impl Fn(u32, u32) -> [f32; 3]) -> Scene {
        let corners = [Vec2::ZERO, Vec2::X, Vec2::ONE, Vec2::Y];
        let mut scene = Scene::without_picture();
        scene.mesh.positions = corners.map(|c| c.extend(0.0)).to_vec().into();
        scene.mesh.uvs = corners.to_vec().into();
        scene.mesh.triangles = vec![[0, 1, 2], [0, 2, 3]].into();
        scene.mesh.material = vec![0, 0].into();
        let texels = (0..side * side).map(|i| texel(i % side, i / side));
        scene.textures = vec![Texture::new(side, side, texels.collect())];
        scene.materials = vec![Material {
            emission: [4.0, 3.0, 2.0],
            emission_texture: Some(0),
            ..Material::diffuse("screen", [0.0; 3])
        }];
        scene
    }

    fn noise(x: u32, y: u32) -> [f32; 3] {
        [0, 1, 2].map(|c| sampling::unit(sampling::hash(&[x.into(), y.into(), c])).powi(4))
    }

    fn waves(x: u32, y: u32) -> [f32; 3] {
        let wave = |t: u32, times: f32| 0.5 + 0.5 * libm::sinf(t as f32 * times / 64.0);
        [wave(x, 9.0), wave(y, 5.0), wave(x + y, 3.0)]
    }

    /// Bright in a corner of 6 texels a side.
    fn lamp(x: u32, y: u32) -> [f32; 3] {
        let is_lit = (40..46).contains(&x) && (9..15).contains(&y);
        if is_lit { [1.0, 0.8, 0.4] } else { [0.0; 3] }
    }

    /// What the texture sends to a receiver, by parts of a 256th of an edge.
    fn sent(scene: &Scene, at: Vec3, receiver: impl Receiver) -> DVec3 {
        const N: u32 = 256;
        let step = 1.0 / N as f32;
        let mut sum = DVec3::ZERO;
        for t in 0..2 {
            let [a, b, c] = scene.mesh.corners(t).map(|p| p - at);
            for j in 0..N {
                for i in 0..N - j {
                    let point = |x: u32, y: u32| [(i + x) as f32 * step, (j + y) as f32 * step];
                    let lower = [point(0, 0), point(1, 0), point(0, 1)];
                    let upper = [point(1, 1), point(0, 1), point(1, 0)];
                    let count = if i + j + 1 < N { 2 } else { 1 };
                    for uvs in [lower, upper].into_iter().take(count) {
                        let middle = [0, 1].map(|k| (uvs[0][k] + uvs[1][k] + uvs[2][k]) / 3.0);
                        let light = Surface::emission_at(scene, t as u32, middle);
                        if !light.is_black() {
                            let corners = uvs.map(|[u, v]| a + (b - a) * u + (c - a) * v);
                            let response = receiver.response_to_triangle(corners);
                            sum += Vec3::from((light * response).0).as_dvec3();
                        }
                    }
                }
            }
        }
        sum
    }

    #[test]
    fn parts_send_what_the_texture_sends() {
        for (name, texel, most) in [
            ("noise", noise as fn(u32, u32) -> [f32; 3], 4000),
            ("waves", waves, 2500),
            ("lamp", lamp, 1200),
        ] {
            let scene = square(64, texel);
            let parts = emitters(&scene);
            assert!(parts.len() < most, "{name}: {}", parts.len());
            let near = Vec3::new(0.3, 0.9, 0.5);
            for (at, normal) in [
                (near, -Vec3::Z),
                (Vec3::new(0.6, 0.2, 0.5), Vec3::new(0.6, 0.0, -0.8)),
                (Vec3::new(-0.4, 0.5, 0.3), Vec3::X),
                (Vec3::new(0.5, 0.5, 3.0), -Vec3::Z),
            ] {
                let surface = SurfaceReceiver {
                    normal,
                    face_normal: normal,
                };
                let of = |receiver: &dyn Fn(&Emitter) -> f32| {
                    let light = parts.iter().map(|e| (e.radiance * receiver(e)).0);
                    light.map(|l| Vec3::from(l).as_dvec3()).sum::<DVec3>()
                };
                let corners = |e: &Emitter| e.corners.map(|c| c - at);
                let on_surface = of(&|e| surface.response_to_triangle(corners(e)));
                let in_medium = of(&|e| MediumReceiver.response_to_triangle(corners(e)));
                for (found, expected) in [
                    (on_surface, sent(&scene, at, surface)),
                    (in_medium, sent(&scene, at, MediumReceiver)),
                ] {
                    let off = (found / expected - 1.0).abs().max_element();
                    assert!(off < 1e-3, "{name} {at}: {off}");
                }
            }
        }
    }

    #[test]
    fn even_and_black_textures_have_few_parts() {
        let parts = emitters(&square(16, |_, _| [0.5, 0.25, 1.0]));
        assert_eq!(parts.len(), 2);
        assert!(parts.iter().all(|e| e.radiance == Rgb([2.0, 0.75, 2.0])));
        assert_eq!(parts[1].surface, 1);
        assert!(emitters(&square(16, |_, _| [0.0; 3])).is_empty());
        // A lamp, of which each part is small.
        let parts = emitters(&square(64, lamp));
        let area: f32 = parts.iter().map(|e| e.area).sum();
        assert!(area < 2.0 * 64.0 / 4096.0, "{area}");
    }

    #[test]
    fn parts_have_the_power_of_their_textures() {
        for side in [16, 300] {
            let scene = square(side, noise);
            let parts = emitters(&scene);
            let power: DVec3 = (parts.iter())
                .map(|e| Vec3::from((e.radiance * e.area).0).as_dvec3())
                .sum();
            let texels = scene.textures[0].texels();
            let mean = texels.map(|t| Vec3::from(t).as_dvec3()).sum::<DVec3>();
            let mean = mean / f64::from(side * side);
            let expected = mean * DVec3::new(4.0, 3.0, 2.0);
            let off = (power / expected - 1.0).abs().max_element();
            assert!(off < 1e-6, "{off}");
        }
    }
}
