//! The light of emissive volumes at a point: their blocks, in a tree of which nodes far away count
//! as one ball each.
//!
//! A ball that sends evenly has its light on what is around it in closed form; shadow rays, chosen
//! by that, measure the share that arrives.

use super::direct::DirectLight;
use super::shading_point::{Arrival, Receiver, ShadingPoint};
use super::shadows::Shadows;
use crate::math::{Aabb, Rgb, Spectrum, sampling};
use crate::scene::{EmissiveBlock, EmissiveVolume};
use glam::Vec3;
use smallvec::SmallVec;
use std::f32::consts::PI;

/// Which of the sequences of shadow rays go to emissive volumes: they choose leaves and distances,
/// and directions.
const SETS: [u32; 2] = [60, 59];

/// The light of all emissive volumes of a scene.
#[derive(Debug)]
pub struct Glow {
    /// Depth first.
    nodes: Vec<Node>,
}

/// Blocks below a node as one ball.
#[derive(Clone, Copy, Debug)]
struct Node {
    ball: EmissiveBlock,
    /// The second half; the first follows this node. `None` of a leaf.
    second: Option<u32>,
}

/// A leaf that a ray goes to.
struct Leaf<'a> {
    ball: &'a EmissiveBlock,
    /// The chance of a ray to go there.
    chance: f32,
}

impl Glow {
    /// The share of all light that is left out, of the dimmest blocks.
    const LEFT_OUT: f64 = 1e-4;
    /// Radius of a node over its distance up to which it counts as one.
    const OPENING: f32 = 0.2;
    /// Leaves at most: of more blocks, a few that are beside each other are one.
    const MOST_LEAVES: usize = 1 << 16;

    /// The light of emissive volumes, of which the grids are read; `None` if there is none.
    pub fn new(volumes: &[EmissiveVolume]) -> Option<Self> {
        let blocks = volumes.iter().flat_map(EmissiveVolume::blocks);
        Self::of(blocks.collect())
    }

    fn of(mut blocks: Vec<EmissiveBlock>) -> Option<Self> {
        let power = |b: &EmissiveBlock| f64::from(b.intensity.mean());
        let all: f64 = blocks.iter().map(power).sum();
        let mut powers: Vec<f32> = blocks.iter().map(|b| b.intensity.mean()).collect();
        powers.sort_unstable_by(f32::total_cmp);
        let mut dimmer = 0.0;
        let least = powers.into_iter().find(|p| {
            dimmer += f64::from(*p);
            dimmer > Self::LEFT_OUT * all
        })?;
        blocks.retain(|b| b.intensity.mean() >= least);
        let together = blocks.len().div_ceil(Self::MOST_LEAVES);
        let mut nodes = Vec::with_capacity(2 * blocks.len() / together);
        add(&mut nodes, &mut blocks, together);
        Some(Self { nodes })
    }

    /// Adds what arrives at a point: all that is sent there, and the share of it that rays find to
    /// arrive.
    pub fn trace(&self, total: &mut DirectLight, at: &ShadingPoint<impl Shadows, impl Receiver>) {
        total.unshadowed += self.unshadowed(at.origin, at.receiver);
        self.trace_rays(total, at);
    }

    /// Adds what rays alone bring to a point.
    pub fn trace_alone(
        &self,
        total: &mut DirectLight,
        at: &ShadingPoint<impl Shadows, impl Receiver>,
    ) {
        let sent = self.trace_rays(total, at);
        total.unshadowed += sent * (1.0 / at.rays.count().max(1) as f32);
    }

    /// Notes what rays bring; their sum with nothing between.
    fn trace_rays(
        &self,
        total: &mut DirectLight,
        at: &ShadingPoint<impl Shadows, impl Receiver>,
    ) -> Rgb {
        let mut sent = Rgb::BLACK;
        for i in 0..at.rays.count() {
            let [u, along] = at.rays.point(i, SETS[0]);
            let Some(leaf) = self.leaf(u, at.origin, at.receiver) else {
                continue;
            };
            let ray = ray_to(leaf.ball, at.origin, along, at.rays.point(i, SETS[1]));
            let weight = ray.weight * at.receiver.response(ray.direction) / leaf.chance;
            let light = leaf.ball.intensity * weight;
            if !(light.mean() > 0.0 && light.mean().is_finite()) {
                continue;
            }
            let media = at.shadows.before_emitters();
            let through = at.transmittance(ray.direction, ray.distance, media);
            at.receiver
                .note(ray.direction, through.mean_of(light), Arrival::Ray);
            total.note_ray(SETS[0] as usize, light, through);
            sent += light;
        }
        sent
    }

    /// The light of all with nothing between, where nodes far away count as one.
    fn unshadowed(&self, origin: Vec3, receiver: impl Receiver) -> Rgb {
        let mut sum = Rgb::BLACK;
        let mut todo: SmallVec<[u32; 64]> = SmallVec::new();
        todo.push(0);
        while let Some(i) = todo.pop() {
            let node = &self.nodes[i as usize];
            match node.second {
                Some(second) if node.is_near(origin) => todo.extend([second, i + 1]),
                _ => {
                    let light = node.ball.intensity * response(&node.ball, origin, receiver);
                    if light.mean().is_finite() {
                        sum += light;
                    }
                }
            }
        }
        sum
    }

    /// The leaf that a number in [0,1) chooses: half by half, by what halves send. `None` where
    /// nothing arrives.
    fn leaf(&self, mut u: f32, origin: Vec3, receiver: impl Receiver) -> Option<Leaf<'_>> {
        let (mut node, mut chance) = (0, 1.0);
        while let Some(second) = self.nodes[node as usize].second {
            let halves = [node + 1, second];
            let [first, other] = halves.map(|h| {
                let node = &self.nodes[h as usize];
                node.ball.intensity.mean() * node.promise(origin, receiver)
            });
            let share = first / (first + other);
            if !(0.0..=1.0).contains(&share) {
                return None;
            }
            (node, chance, u) = match u < share {
                true => (halves[0], chance * share, u / share),
                false => (
                    halves[1],
                    chance * (1.0 - share),
                    (u - share) / (1.0 - share),
                ),
            };
        }
        Some(Leaf {
            ball: &self.nodes[node as usize].ball,
            chance,
        })
    }
}

impl Node {
    /// Whether its parts are to be told apart at a point.
    fn is_near(&self, origin: Vec3) -> bool {
        let distance_squared = self.ball.centre.distance_squared(origin);
        let reach = Glow::OPENING * Glow::OPENING * distance_squared;
        self.ball.radius * self.ball.radius > reach
    }

    /// What is expected of it at a point, for each unit that it sends. Parts of a near one may be
    /// seen where a ball in its place would be hidden.
    fn promise(&self, origin: Vec3, receiver: impl Receiver) -> f32 {
        /// Share of the light with no surface that is expected of those at least.
        const LEAST: f32 = 0.05;
        let response = response(&self.ball, origin, receiver);
        match self.second {
            Some(_) if self.is_near(origin) => {
                let distance = self.ball.centre.distance(origin);
                response.max(LEAST * fluence(distance, self.ball.radius))
            }
            _ => response,
        }
    }
}

/// A ray to a point of a ball.
struct RayToBall {
    direction: Vec3,
    distance: f32,
    /// Fluence, of a ball that sends 1 in all, over the chance of this ray.
    weight: f32,
}

/// The ray that numbers in [0,1) choose, `along` for the distance and `u` for the direction: as
/// often to each point of an even ball as it adds to the fluence, but for a factor that is near 1.
fn ray_to(ball: &EmissiveBlock, origin: Vec3, along: f32, u: [f32; 2]) -> RayToBall {
    let (to_middle, radius) = (ball.centre - origin, ball.radius);
    let square = to_middle.length_squared() - radius * radius;
    if square < 0.0 {
        let direction = sampling::sphere(u);
        let middle = to_middle.dot(direction);
        let chord = middle + (middle * middle - square).sqrt();
        return RayToBall {
            direction,
            distance: along * chord,
            weight: 3.0 * chord / (radius * radius * radius),
        };
    }
    // Chords are as long as the root of `rest`, and so are the chances of their directions.
    let root = libm::cbrtf(1.0 - u[0]);
    let rest = root * root;
    let inverse = 1.0 / to_middle.length();
    let sin = (radius * inverse * (1.0 - rest).sqrt()).min(1.0);
    let cos = (1.0 - sin * sin).sqrt();
    let axis = to_middle * inverse;
    let (x, y) = sampling::tangents(axis);
    let (sin_turn, cos_turn) = libm::sincosf(2.0 * PI * u[1]);
    let direction = axis * cos + (x * cos_turn + y * sin_turn) * sin;
    let half = radius * rest.sqrt();
    RayToBall {
        direction: direction.normalize(),
        distance: (cos / inverse + half * (2.0 * along - 1.0)).max(0.0),
        weight: inverse * inverse / cos.max(1e-3),
    }
}

/// Adds the node over some blocks, halved along the axis on which they are most apart; as many
/// blocks as `together` are a leaf.
fn add(nodes: &mut Vec<Node>, blocks: &mut [EmissiveBlock], together: usize) {
    let Some(ball) = EmissiveBlock::joined(blocks.iter()) else {
        return;
    };
    let index = nodes.len();
    nodes.push(Node { ball, second: None });
    if let [block] = *blocks {
        nodes[index].ball = block;
    }
    if blocks.len() <= together {
        return;
    }
    let bounds = (blocks.iter()).fold(Aabb::EMPTY, |b, e| b.with(e.centre));
    let across = (bounds.max - bounds.min).max_position();
    let half = blocks.len() / 2;
    let places = |b: &EmissiveBlock| [0, 1, 2].map(|a| b.centre[(across + a) % 3]);
    blocks.select_nth_unstable_by(half, |a, b| {
        let [a, b] = [places(a), places(b)];
        let orders = a.iter().zip(&b).map(|(a, b)| a.total_cmp(b));
        orders.fold(std::cmp::Ordering::Equal, std::cmp::Ordering::then)
    });
    let (lower, upper) = blocks.split_at_mut(half);
    add(nodes, lower, together);
    nodes[index].second = Some(nodes.len() as u32);
    add(nodes, upper, together);
}

/// Response of a receiver to an even ball that sends 1 in all, with nothing between: irradiance of
/// a surface, or the integral of radiance over the sphere, by the phase function where there is
/// one.
fn response(ball: &EmissiveBlock, origin: Vec3, receiver: impl Receiver) -> f32 {
    let to_ball = ball.centre - origin;
    let distance = to_ball.length();
    let direction = to_ball.normalize_or(Vec3::Y);
    let Some([normal, face_normal]) = receiver.normals() else {
        return receiver.response(direction) * fluence(distance, ball.radius);
    };
    let [cos, of_face] = [normal, face_normal].map(|n| n.dot(direction));
    let irradiance = irradiance(distance, ball.radius, cos);
    // What is behind the face itself is hidden, however the shading normal leans.
    match of_face * distance > -ball.radius {
        true => irradiance,
        false => 0.0,
    }
}

/// Integral over an even ball that sends 1 in all of the inverse square of the distance, in closed
/// form.
fn fluence(distance: f32, radius: f32) -> f32 {
    /// Distance over the radius from which on a series is as good.
    const FAR: f32 = 2.0;
    let x = distance / radius;
    if x > FAR {
        let i = 1.0 / (x * x);
        let series = 1.0 + i * (1.0 / 5.0 + i * (3.0 / 35.0 + i * (1.0 / 21.0)));
        return series / (distance * distance);
    }
    // (R^2 - d^2) / d ln((R + d) / |R - d|) tends to 2 R in the middle, and to 0 on the border.
    let beside = match x {
        x if x < 1e-3 => 2.0,
        x if (x - 1.0).abs() < 1e-4 => 0.0,
        x => (1.0 - x * x) / x * libm::logf((1.0 + x) / (1.0 - x).abs()),
    };
    0.75 * (2.0 + beside) / (radius * radius)
}

/// Irradiance by such a ball of a surface whose normal has a cosine to its middle: that of all of
/// it where all is before the surface, and nearly that where it is cut.
fn irradiance(distance: f32, radius: f32, cos: f32) -> f32 {
    /// In the middle of a ball half of it is before any surface.
    const IN_MIDDLE: f32 = 0.75;
    /// Share of the disk that a sphere is seen as that is before the surface, times its cosine.
    fn clipped(cos: f32, sin_radius: f32) -> f32 {
        if cos >= sin_radius {
            cos
        } else if cos <= -sin_radius {
            0.0
        } else {
            (cos + sin_radius).powi(2) / (4.0 * sin_radius)
        }
    }
    let x = distance / radius;
    if x >= 1.0 {
        return clipped(cos, 1.0 / x) / (distance * distance);
    }
    (IN_MIDDLE * (1.0 - x) + clipped(cos, 1.0) * x) / (radius * radius)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::light::shading_point::{MediumReceiver, SurfaceReceiver};

    fn ball(centre: Vec3, radius: f32) -> EmissiveBlock {
        EmissiveBlock {
            centre,
            radius,
            intensity: Rgb([1.0, 0.5, 0.25]),
        }
    }

    /// Points of an even ball, by layers.
    fn points(ball: &EmissiveBlock) -> Vec<Vec3> {
        let n = 60_000;
        let point = |i: u32| {
            let direction = sampling::sphere(sampling::sobol2(i, 0, 3));
            let radius = libm::cbrtf((i as f32 + 0.5) / n as f32);
            ball.centre + direction * (radius * ball.radius)
        };
        (0..n).map(point).collect()
    }

    #[test]
    fn a_ball_sends_what_its_points_send() {
        let ball = ball(Vec3::new(0.0, 0.2, 0.0), 0.7);
        let points = points(&ball);
        // Within the ball the nearest point alone would tell.
        for distance in [1.3, 2.0, 3.0, 10.0] {
            let origin = ball.centre + Vec3::new(0.6, 0.0, 0.8) * distance * ball.radius;
            let inverse = |p: &Vec3| 1.0 / f64::from(p.distance_squared(origin));
            let expected = points.iter().map(inverse).sum::<f64>() / points.len() as f64;
            let found = f64::from(response(&ball, origin, MediumReceiver));
            assert!(
                (found / expected - 1.0).abs() < 0.02,
                "{distance}: {found} {expected}"
            );
            for tilt in [0.0_f32, 0.6, 1.2, 1.5] {
                let n = Vec3::new(-0.6, 0.0, -0.8) * tilt.cos() + Vec3::Y * tilt.sin();
                let surface = SurfaceReceiver {
                    normal: n,
                    face_normal: n,
                };
                let light = |p: &Vec3| {
                    let to = *p - origin;
                    f64::from(to.normalize().dot(n).max(0.0) / to.length_squared())
                };
                let exact = points.iter().map(light).sum::<f64>() / points.len() as f64;
                let found = f64::from(response(&ball, origin, surface));
                // Beside a ball nearly half of which is below the horizon it is about right.
                let bound = if distance > 2.0 { 0.02 } else { 0.2 };
                assert!(
                    (found - exact).abs() < bound * expected,
                    "{distance} {tilt}: {found} {exact}"
                );
            }
        }
        let middle = response(&ball, ball.centre, MediumReceiver);
        let expected = 3.0 / (0.7 * 0.7);
        assert!(
            (middle / expected - 1.0).abs() < 1e-3,
            "{middle} {expected}"
        );
    }

    /// Fluence of a ball that sends 1 in all through a medium of this extinction, by cones around
    /// the way to its middle, `distance` away.
    fn fluence_through(ball: &EmissiveBlock, distance: f64, sigma_t: f64) -> f64 {
        let n = 20_000;
        let (radius, middle) = (f64::from(ball.radius), distance);
        let of_cone = |i: i32| {
            let cos = 1.0 - 2.0 * (f64::from(i) + 0.5) / f64::from(n);
            let half = radius * radius - middle * middle * (1.0 - cos * cos);
            if half <= 0.0 {
                return 0.0;
            }
            let [near, far] = [-1.0, 1.0].map(|s| (middle * cos + s * half.sqrt()).max(0.0));
            ((-sigma_t * near).exp() - (-sigma_t * far).exp()) / sigma_t
        };
        let mean = (0..n).map(of_cone).sum::<f64>() / f64::from(n);
        3.0 * mean / radius.powi(3)
    }

    #[test]
    fn rays_find_each_point_of_a_ball_as_often_as_it_lights() {
        let ball = ball(Vec3::new(0.0, 0.2, 0.0), 0.7);
        // In a medium, light comes from the near points rather.
        let sigma_t = 2.0;
        for distance in [0.0_f32, 0.4, 0.8, 1.3, 2.0, 5.0] {
            let away = distance * ball.radius;
            let origin = ball.centre + Vec3::new(0.6, 0.0, 0.8) * away;
            let exact = fluence_through(&ball, f64::from(away), f64::from(sigma_t));
            let n = 40_000;
            let brought = |i: u32| {
                let [along, _] = sampling::r2(i.into(), [0.1, 0.7]);
                let ray = ray_to(&ball, origin, along, sampling::sobol2(i, 0, 9));
                let end = origin + ray.direction * ray.distance;
                assert!(
                    end.distance(ball.centre) < 1.001 * ball.radius,
                    "{distance}"
                );
                f64::from(ray.weight * libm::expf(-sigma_t * ray.distance))
            };
            let found = (0..n).map(brought).sum::<f64>() / f64::from(n);
            assert!(
                (found / exact - 1.0).abs() < 0.01,
                "{distance}: {found} {exact}"
            );
        }
    }

    #[test]
    fn parts_send_what_all_blocks_send() {
        let block = |i: u32| {
            let at = sampling::sphere(sampling::sobol2(i, 1, 7));
            let mut block = ball(at * (i % 97) as f32 / 97.0, 0.02);
            block.intensity *= 1.0 + (i % 13) as f32;
            block
        };
        let blocks: Vec<_> = (0..5000).map(block).collect();
        let glow = Glow::of(blocks.clone()).unwrap();
        for i in 0..60 {
            let d = sampling::sphere(sampling::r2(i, [0.3; 2]));
            let origin = d * (0.2 + 0.05 * i as f32);
            let exact: f32 = (blocks.iter())
                .map(|b| b.intensity.0[0] * response(b, origin, MediumReceiver))
                .sum();
            let found = glow.unshadowed(origin, MediumReceiver).0[0];
            assert!((found / exact - 1.0).abs() < 0.02, "{i} {found} {exact}");
            // Leaves by their chances bring as much.
            let n = 4000;
            let brought = |k: u32| {
                let u = (k as f32 + 0.5) / n as f32;
                let leaf = glow.leaf(u, origin, MediumReceiver)?;
                let light = leaf.ball.intensity.0[0] * response(leaf.ball, origin, MediumReceiver);
                Some(f64::from(light / leaf.chance))
            };
            let mean = (0..n).filter_map(brought).sum::<f64>() / f64::from(n);
            assert!(
                (mean / f64::from(exact) - 1.0).abs() < 0.02,
                "{i} {mean} {exact}"
            );
        }
        assert!(Glow::of(Vec::new()).is_none());
    }
}
