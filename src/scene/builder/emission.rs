//! Triangles with a texture of emission that is black all over them: they get a material that sends
//! no light, so that lamps of a car or lit windows of a town cost what they cover.

use super::masks::{Range, drop_unused, range_within};
use crate::Result;
use crate::run::Cancel;
use crate::scene::{Material, Mesh, Texture};
use rayon::prelude::*;

/// Gives triangles that a texture leaves no light a material without emission, and takes textures
/// off materials that emit nothing in any case. Textures that no material needs any longer go, too.
///
/// # Errors
/// A stop on request.
pub(super) fn settle(
    mesh: &mut Mesh,
    materials: &mut Vec<Material>,
    textures: &mut Vec<Texture>,
    cancel: &Cancel,
) -> Result<()> {
    if materials.iter().all(|m| m.emission_texture.is_none()) {
        return Ok(());
    }
    for m in materials.iter_mut().filter(|m| !m.emits()) {
        m.emission_texture = None;
    }
    let are_dark = dark(mesh, materials, textures, cancel)?;
    let mut has_light = vec![false; materials.len()];
    let mut has_dark = vec![false; materials.len()];
    for (&material, is_dark) in mesh.material.iter().zip(&are_dark) {
        let of = if *is_dark {
            &mut has_dark
        } else {
            &mut has_light
        };
        of[material as usize] = true;
    }
    // By material, that of its dark triangles.
    let mut unlit: Vec<Option<u32>> = vec![None; materials.len()];
    for m in 0..has_dark.len() {
        if !has_dark[m] {
            continue;
        }
        let dark = Material {
            emission: [0.0; 3],
            emission_texture: None,
            ..materials[m].clone()
        };
        match has_light[m] {
            false => materials[m] = dark,
            true => {
                unlit[m] = Some(materials.len() as u32);
                materials.push(dark);
            }
        }
    }
    if unlit.iter().any(Option::is_some) {
        let of = mesh.material.iter().zip(&are_dark);
        let moved = of.map(|(&m, is_dark)| match is_dark {
            true => unlit[m as usize].unwrap_or(m),
            false => m,
        });
        mesh.material = moved.collect::<Vec<u32>>().into();
    }
    drop_unused(materials, textures);
    Ok(())
}

/// Whether the texture of its emission is black all over a triangle, for each.
fn dark(
    mesh: &Mesh,
    materials: &[Material],
    textures: &[Texture],
    cancel: &Cancel,
) -> Result<Vec<bool>> {
    let of_emission = |t: usize| {
        let mut all = materials.iter();
        all.any(|m| m.emission_texture == Some(t as u32))
    };
    let ranges: Vec<Option<Range>> = (textures.par_iter().enumerate())
        .map(|(t, texture)| of_emission(t).then(|| Range::of_texture(texture)))
        .collect();
    let is_dark = |t: usize| {
        cancel.check()?;
        let material = &materials[mesh.material[t] as usize];
        let Some(index) = material.emission_texture.map(|index| index as usize) else {
            return Ok(false);
        };
        let Some(whole) = ranges[index].filter(|whole| whole.most > 0.0) else {
            return Ok(true);
        };
        if mesh.uvs.is_empty() {
            return Ok(false);
        }
        let uvs = mesh.triangles[t].map(|v| mesh.uvs[v as usize]);
        let range = range_within(&textures[index], uvs, whole, |range| range.most <= 0.0);
        Ok(range.most <= 0.0)
    };
    (0..mesh.triangles.len())
        .into_par_iter()
        .map(is_dark)
        .collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use glam::{Vec2, Vec3};

    /// Two triangles that show the left and the right half of a texture of which the right is lit,
    /// in its first channel alone.
    fn pair() -> (Mesh, Vec<Material>, Vec<Texture>) {
        let lit = |x: usize| [if x < 8 { 0.0 } else { 1e-6 }, 0.0, 0.0];
        let texture = Texture::new(16, 16, (0..256).map(|i| lit(i % 16)).collect());
        let corner = |x: f32, y: f32| Vec2::new(x, y);
        let uvs = [
            [0.05, 0.1],
            [0.4, 0.2],
            [0.2, 0.9],
            [0.55, 0.1],
            [0.9, 0.2],
            [0.7, 0.9],
        ];
        let uvs: Vec<Vec2> = uvs.map(|[x, y]| corner(x, y)).to_vec();
        let positions: Vec<Vec3> = uvs.iter().map(|uv| uv.extend(0.0)).collect();
        let mesh = Mesh {
            positions: positions.into(),
            uvs: uvs.into(),
            triangles: vec![[0, 1, 2], [3, 4, 5]].into(),
            material: vec![0, 0].into(),
            ..Mesh::default()
        };
        let material = Material {
            emission: [3.0; 3],
            emission_texture: Some(1),
            ..Material::diffuse("screen", [0.5; 3])
        };
        (mesh, vec![material], vec![texture.clone(), texture])
    }

    #[test]
    fn triangles_that_a_texture_leaves_dark_do_not_emit() {
        let (mut mesh, mut materials, mut textures) = pair();
        settle(&mut mesh, &mut materials, &mut textures, &Cancel::default()).unwrap();
        assert_eq!(mesh.material[..], [1, 0]);
        assert!(materials[0].emits() && !materials[1].emits());
        assert_eq!(materials[0].emission_texture, Some(0));
        assert_eq!(materials[1].emission_texture, None);
        assert_eq!(textures.len(), 1);
    }

    #[test]
    fn what_is_dark_all_over_needs_no_texture() {
        let (mut mesh, mut materials, mut textures) = pair();
        mesh.material = vec![0, 1].into();
        materials.push(Material {
            emission: [0.0; 3],
            ..materials[0].clone()
        });
        settle(&mut mesh, &mut materials, &mut textures, &Cancel::default()).unwrap();
        assert_eq!(mesh.material[..], [0, 1]);
        assert!(
            materials
                .iter()
                .all(|m| !m.emits() && m.emission_texture.is_none())
        );
        assert!(textures.is_empty());
    }
}
