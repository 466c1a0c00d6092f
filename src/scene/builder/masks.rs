//! What of masked triangles is known before any ray: those that are nowhere there go, and those
//! that are everywhere there need no mask.

use crate::Result;
use crate::run::Cancel;
use crate::scene::{Mask, Masks, Material, Mesh, Texture};
use glam::{DVec2, Vec2};
use rayon::prelude::*;

/// How much of a triangle is there.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Extent {
    Nowhere,
    InPart,
    Everywhere,
}

/// Gives triangles that are everywhere there a material without a mask, drops those that are
/// nowhere there, and returns the number of these. Textures that no mask needs any longer go, too.
///
/// # Errors
/// A stop on request.
pub(super) fn settle(
    mesh: &mut Mesh,
    materials: &mut Vec<Material>,
    textures: &mut Vec<Texture>,
    cancel: &Cancel,
) -> Result<u64> {
    if materials.iter().all(|m| m.mask.is_none()) {
        mesh.opacities = Vec::new().into();
        return Ok(0);
    }
    let extents = extents(mesh, materials, textures, cancel)?;
    // By material, that without a mask.
    let mut whole: Vec<Option<u32>> = vec![None; materials.len()];
    let mut has_part = vec![false; materials.len()];
    for (&material, extent) in mesh.material.iter().zip(&extents) {
        has_part[material as usize] |= *extent == Extent::InPart;
    }
    for m in 0..whole.len() {
        if materials[m].mask.is_some() && !has_part[m] {
            materials[m].mask = None;
        }
    }
    let mut kept = (Vec::new(), Vec::new());
    for (t, &extent) in extents.iter().enumerate() {
        let mut material = mesh.material[t];
        if extent == Extent::Nowhere {
            continue;
        }
        if extent == Extent::Everywhere && materials[material as usize].mask.is_some() {
            let known = &mut whole[material as usize];
            material = *known.get_or_insert_with(|| {
                let mask = None;
                let like = &materials[material as usize];
                materials.push(Material {
                    mask,
                    ..like.clone()
                });
                materials.len() as u32 - 1
            });
        }
        kept.0.push(mesh.triangles[t]);
        kept.1.push(material);
    }
    let dropped = extents.len() - kept.0.len();
    let is_kept = |t: usize| extents[t] != Extent::Nowhere;
    mesh.instances.keep(is_kept, extents.len());
    mesh.triangles = kept.0.into();
    mesh.material = kept.1.into();
    if materials.iter().all(|m| m.mask.is_none()) {
        mesh.opacities = Vec::new().into();
    }
    drop_unused(materials, textures);
    Ok(dropped as u64)
}

/// Drops textures that no material refers to.
pub(super) fn drop_unused(materials: &mut [Material], textures: &mut Vec<Texture>) {
    let mut number = vec![None; textures.len()];
    for t in materials.iter().flat_map(Material::textures) {
        number[t as usize] = Some(0);
    }
    let mut next = 0..;
    for n in number.iter_mut().flatten() {
        *n = next.next().unwrap_or(0);
    }
    let mut is_used = number.iter().map(Option::is_some);
    textures.retain(|_| is_used.next().unwrap_or(true));
    let moved = |t: Option<u32>| t.and_then(|t| number[t as usize]);
    for m in materials {
        m.texture = moved(m.texture);
        m.emission_texture = moved(m.emission_texture);
        if let Some(mask) = &mut m.mask {
            mask.texture = moved(mask.texture);
        }
    }
}

fn extents(
    mesh: &Mesh,
    materials: &[Material],
    textures: &[Texture],
    cancel: &Cancel,
) -> Result<Vec<Extent>> {
    let masks = Masks::new(mesh, materials, textures);
    // Of whole textures: most triangles ask but for those.
    let ranges: Vec<Range> = textures
        .par_iter()
        .enumerate()
        .map(|(t, texture)| {
            let is_of_mask = |m: &Material| m.mask.is_some_and(|m| m.texture == Some(t as u32));
            match materials.iter().any(is_of_mask) {
                true => Range::of_texture(texture),
                false => Range::WHOLE,
            }
        })
        .collect();
    let extent = |t: u32| {
        cancel.check()?;
        let Some(mask) = masks.of_triangle(t) else {
            return Ok(Extent::Everywhere);
        };
        let corners = mesh.triangles[t as usize].map(|v| v as usize);
        let mut range = Range::WHOLE;
        if let Some(texture) = mask.texture {
            range = ranges[texture as usize];
            if of_range(mask, mesh, corners, range) == Extent::InPart && !mesh.uvs.is_empty() {
                let uvs = corners.map(|v| mesh.uvs[v]);
                range = range_within(&textures[texture as usize], uvs, range, |range| {
                    of_range(mask, mesh, corners, range) != Extent::InPart
                });
            }
        }
        Ok(of_range(mask, mesh, corners, range))
    };
    (0..mesh.triangles.len() as u32)
        .into_par_iter()
        .map(extent)
        .collect()
}

/// An opacity of which nothing but rounding is missing.
const FULL: f32 = 1.0 - 1e-6;

/// What a mask makes of a triangle over which the values of its texture are in a range.
fn of_range(mask: &Mask, mesh: &Mesh, corners: [usize; 3], range: Range) -> Extent {
    let vertices = match mesh.opacities.is_empty() {
        true => Range::WHOLE,
        false => Range::over(corners.map(|v| mesh.opacities[v])),
    };
    let least = mask.opacity * range.least * vertices.least;
    let most = mask.opacity * range.most * vertices.most;
    match mask.cutoff {
        Some(cutoff) if least >= cutoff => Extent::Everywhere,
        Some(cutoff) if most < cutoff => Extent::Nowhere,
        None if least >= FULL => Extent::Everywhere,
        None if most <= 0.0 => Extent::Nowhere,
        _ => Extent::InPart,
    }
}

/// The least and the most of some values.
#[derive(Clone, Copy, Debug)]
pub(super) struct Range {
    least: f32,
    pub(super) most: f32,
}

impl Range {
    /// Of what is everywhere there.
    const WHOLE: Self = Self {
        least: 1.0,
        most: 1.0,
    };
    const EMPTY: Self = Self {
        least: f32::INFINITY,
        most: f32::NEG_INFINITY,
    };

    fn over(values: impl IntoIterator<Item = f32>) -> Self {
        values.into_iter().fold(Self::EMPTY, Self::with)
    }

    fn with(self, value: f32) -> Self {
        Self {
            least: self.least.min(value),
            most: self.most.max(value),
        }
    }

    pub(super) fn of_texture(texture: &Texture) -> Self {
        Self::over((0..texture.texels().len()).map(|at| texture.luminance_of(at)))
    }
}

/// The range of a texture within a triangle of these coordinates, or one that holds it: that of the
/// `whole` texture where the triangle shows it over and over. Ends once a range is not `settled`.
pub(super) fn range_within(
    texture: &Texture,
    uvs: [Vec2; 3],
    whole: Range,
    settled: impl Fn(Range) -> bool,
) -> Range {
    /// Texels by which rounding may be off.
    const MARGIN: f64 = 1.0 / 64.0;
    let size = DVec2::new(f64::from(texture.width), f64::from(texture.height));
    // A point lies between the texels of whole numbers around it.
    let points = uvs.map(|uv| uv.as_dvec2() * size - 0.5);
    let [a, b, c] = points;
    let (low, high) = (a.min(b).min(c) - MARGIN, a.max(b).max(c) + MARGIN);
    let (across, down) = (high.x - low.x + 2.0, high.y - low.y + 2.0);
    // What is beyond the digits of a float is no texel, either.
    if across * down > 4.0 * size.x * size.y || low.abs().max(high.abs()).max_element() > 1e6 {
        return whole;
    }
    let mut range = Range::EMPTY;
    for row in low.y.floor() as i64..=high.y.floor() as i64 {
        let band = [row as f64 - MARGIN, row as f64 + 1.0 + MARGIN];
        let Some([left, right]) = across_band(points, band) else {
            continue;
        };
        let (left, right) = ((left - MARGIN).floor(), (right + MARGIN).floor() + 1.0);
        for j in [row, row + 1] {
            for i in left as i64..=right as i64 {
                range = range.with(texture.luminance_of(texture.place([i, j])));
            }
        }
        if !settled(range) {
            return range;
        }
    }
    range
}

/// From where to where a triangle reaches in a band of y.
fn across_band(points: [DVec2; 3], [top, bottom]: [f64; 2]) -> Option<[f64; 2]> {
    let mut ends: Option<[f64; 2]> = None;
    let mut add = |x: f64| {
        let [left, right] = ends.unwrap_or([x, x]);
        ends = Some([left.min(x), right.max(x)]);
    };
    for k in 0..3 {
        let (p, q) = (points[k], points[(k + 1) % 3]);
        if (top..=bottom).contains(&p.y) {
            add(p.x);
        }
        for y in [top, bottom] {
            if (p.y < y) != (q.y < y) {
                add(p.x + (q.x - p.x) * ((y - p.y) / (q.y - p.y)));
            }
        }
    }
    ends
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::math::sampling;
    use glam::Vec3;

    fn masked(cutoff: Option<f32>) -> Material {
        let mask = Mask {
            opacity: 1.0,
            texture: Some(0),
            cutoff,
        };
        Material {
            mask: Some(mask),
            ..Material::diffuse("leaf", [0.5; 3])
        }
    }

    /// Small triangles all over a texture with a disk in it, and beyond its borders.
    fn confetti() -> (Mesh, Vec<Texture>) {
        let texels = (0..32 * 32).map(|i: i32| {
            let (x, y) = (i % 32 - 16, i / 32 - 16);
            [if x * x + y * y < 100 { 1.0 } else { 0.0 }; 3]
        });
        let texture = Texture::new(32, 32, texels.collect());
        let mut mesh = Mesh::default();
        let (mut positions, mut uvs, mut triangles) = (Vec::new(), Vec::new(), Vec::new());
        for i in 0..500 {
            let number = |k: u64| sampling::unit(sampling::hash(&[i, k]));
            let middle = 3.0 * Vec2::new(number(0), number(1)) - 1.0;
            for k in 0..3 {
                let off = Vec2::new(number(2 + 2 * k), number(3 + 2 * k)) - 0.5;
                let uv = middle + 0.4 * off;
                uvs.push(uv);
                positions.push(Vec3::new(uv.x, uv.y, 0.0));
            }
            triangles.push([0, 1, 2].map(|k| 3 * i as u32 + k));
        }
        mesh.material = vec![0; triangles.len()].into();
        mesh.positions = positions.into();
        mesh.uvs = uvs.into();
        mesh.triangles = triangles.into();
        (mesh, vec![texture])
    }

    #[test]
    fn what_is_known_of_triangles_is_what_their_points_say() {
        let (mesh, textures) = confetti();
        for cutoff in [Some(0.5), Some(0.9), None] {
            let materials = [masked(cutoff)];
            let found = extents(&mesh, &materials, &textures, &Cancel::default()).unwrap();
            let masks = Masks::new(&mesh, &materials, &textures);
            let mut count = [0; 3];
            for (t, extent) in (0..).zip(found) {
                count[extent as usize] += 1;
                let clear = (0..300).filter(|&i| {
                    let w = sampling::triangle(sampling::r2(i, [0.5; 2]));
                    masks.is_clear(t, [w[1], w[2]])
                });
                match (extent, clear.count()) {
                    (Extent::Nowhere, n) => assert_eq!(n, 300, "{t}"),
                    (Extent::Everywhere, n) => assert_eq!(n, 0, "{t}"),
                    (Extent::InPart, _) => {}
                }
            }
            assert!(count.into_iter().min() > Some(40), "{count:?}");
        }
    }

    #[test]
    fn triangles_that_show_a_texture_over_and_over_are_there_in_part() {
        let (mut mesh, textures) = confetti();
        mesh.uvs = mesh
            .uvs
            .iter()
            .map(|uv| *uv * 1e9)
            .collect::<Vec<_>>()
            .into();
        let materials = [masked(Some(0.5))];
        let found = extents(&mesh, &materials, &textures, &Cancel::default()).unwrap();
        assert!(found.iter().all(|e| *e == Extent::InPart));
    }

    #[test]
    fn only_what_is_there_in_part_keeps_its_mask() {
        let (mut mesh, mut textures) = confetti();
        textures.push(textures[0].clone());
        let mut materials = vec![masked(Some(0.5)), masked(Some(0.0))];
        materials[1].mask.as_mut().unwrap().texture = Some(1);
        let mut of = vec![0; 500];
        of[7] = 1;
        mesh.material = of.into();
        let dropped = settle(&mut mesh, &mut materials, &mut textures, &Cancel::default());
        let dropped = dropped.unwrap();
        assert_eq!(mesh.triangles.len(), 500 - dropped as usize);
        assert_eq!(mesh.material.len(), mesh.triangles.len());
        assert_eq!((materials.len(), textures.len()), (3, 1));
        assert!(materials[0].mask.is_some());
        assert!(materials[1].mask.is_none() && materials[2].mask.is_none());
        let of = |m| mesh.material.iter().filter(|x| **x == m).count();
        assert!(dropped > 40 && of(0) > 40 && of(1) == 1 && of(2) > 40);
    }
}
