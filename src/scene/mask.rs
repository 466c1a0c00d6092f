//! Masks: where a surface is there, and where rays pass it.

use super::{Material, Mesh, Scene, Texture};
use crate::math::sampling;
use glam::Vec2;

/// How much of a surface is there, from place to place.
///
/// With a cut-off a place is there or not. Without one the opacity is the share of a place that is
/// there: the surface is a screen of holes that are too small to be seen, in fixed places, so that
/// all rays meet the same one.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Mask {
    /// Opacity from 0, clear, to 1; texture and vertices have factors on it.
    pub opacity: f32,
    /// Factor on the opacity, by its luminance: index into the scene's textures.
    pub texture: Option<u32>,
    /// The opacity from which on a place is there.
    pub cutoff: Option<f32>,
}

/// The masks of triangles.
#[derive(Clone, Copy, Debug)]
pub struct Masks<'a> {
    mesh: &'a Mesh,
    materials: &'a [Material],
    textures: &'a [Texture],
}

impl<'a> Masks<'a> {
    /// Holes of a screen, along an edge of a triangle.
    const SCREEN: f32 = 4096.0;

    /// Those of a scene; `None` if it has none.
    #[must_use]
    pub fn of(scene: &'a Scene) -> Option<Self> {
        let has_any = scene.materials.iter().any(|m| m.mask.is_some());
        has_any.then(|| Self::new(&scene.mesh, &scene.materials, &scene.textures))
    }

    pub(super) fn new(mesh: &'a Mesh, materials: &'a [Material], textures: &'a [Texture]) -> Self {
        Self {
            mesh,
            materials,
            textures,
        }
    }

    /// The mask of a triangle, by its place among those that are stored; so are those of all others
    /// here.
    #[must_use]
    #[inline]
    pub fn of_triangle(&self, triangle: u32) -> Option<&'a Mask> {
        let material = self.mesh.material[triangle as usize];
        self.materials[material as usize].mask.as_ref()
    }

    /// Whether nothing of a triangle is there at barycentric weights of its second and third
    /// corner.
    #[must_use]
    #[inline]
    pub fn is_clear(&self, triangle: u32, uv: [f32; 2]) -> bool {
        let Some(mask) = self.of_triangle(triangle) else {
            return false;
        };
        let opacity = self.opacity(mask, triangle, uv);
        match mask.cutoff {
            Some(cutoff) => opacity < cutoff,
            None => opacity < 1.0 && opacity <= Self::threshold(triangle, uv),
        }
    }

    /// The share of light that a triangle lets through there: of a screen the mean.
    #[must_use]
    pub fn let_through(&self, triangle: u32, uv: [f32; 2]) -> f32 {
        let Some(mask) = self.of_triangle(triangle) else {
            return 0.0;
        };
        let opacity = self.opacity(mask, triangle, uv);
        match mask.cutoff {
            Some(cutoff) if opacity < cutoff => 1.0,
            Some(_) => 0.0,
            None => 1.0 - opacity,
        }
    }

    fn opacity(&self, mask: &Mask, triangle: u32, uv: [f32; 2]) -> f32 {
        let mesh = self.mesh;
        let mut opacity = mask.opacity;
        let corners = mesh.triangles[triangle as usize].map(|i| i as usize);
        let weights = [1.0 - uv[0] - uv[1], uv[0], uv[1]];
        let corners = corners.into_iter().zip(weights);
        if let Some(texture) = mask.texture
            && !mesh.uvs.is_empty()
        {
            let at: Vec2 = corners.clone().map(|(i, w)| mesh.uvs[i] * w).sum();
            opacity *= self.textures[texture as usize].luminance(at);
        }
        if !mesh.opacities.is_empty() {
            opacity *= corners.map(|(i, w)| mesh.opacities[i] * w).sum::<f32>();
        }
        opacity
    }

    /// The opacity at most which a hole of a screen is clear, evenly from 0 to 1.
    fn threshold(triangle: u32, uv: [f32; 2]) -> f32 {
        // Whole numbers, lest rounding on the way to a point give it another hole.
        let [i, j] = uv.map(|w| (w * Self::SCREEN) as u64);
        sampling::unit(sampling::hash(&[u64::from(triangle), i << 32 | j]))
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use glam::Vec3;

    /// A square of two triangles, whose texture is clear in its left half.
    pub(crate) fn half(cutoff: Option<f32>, opacity: f32) -> Scene {
        let mut scene = Scene::without_picture();
        let corners = [Vec3::ZERO, Vec3::X, Vec3::X + Vec3::Y, Vec3::Y];
        scene.mesh.positions = corners.to_vec().into();
        scene.mesh.uvs = corners.map(|p| Vec2::new(p.x, p.y)).to_vec().into();
        scene.mesh.triangles = vec![[0, 1, 2], [0, 2, 3]].into();
        scene.mesh.material = vec![0, 0].into();
        let texels = (0..16).map(|i| [if i % 4 < 2 { 0.0 } else { 1.0 }; 3]);
        scene.textures = vec![Texture::new(4, 4, texels.collect())];
        scene.materials = vec![Material::diffuse("", [0.5; 3])];
        scene.materials[0].mask = Some(Mask {
            opacity,
            texture: Some(0),
            cutoff,
        });
        scene
    }

    #[test]
    fn a_cutoff_parts_what_is_there_from_what_is_not() {
        let scene = half(Some(0.5), 1.0);
        let masks = Masks::of(&scene).unwrap();
        // Weights (0, v) of the second triangle are points (0, v), of the first (u, 0).
        assert!(masks.is_clear(0, [0.3, 0.0]) && !masks.is_clear(0, [0.7, 0.0]));
        assert_eq!(masks.let_through(0, [0.3, 0.0]), 1.0);
        assert_eq!(masks.let_through(0, [0.7, 0.0]), 0.0);
        assert!(Masks::of(&Scene::without_picture()).is_none());
    }

    #[test]
    fn vertices_and_factors_have_their_share_in_the_opacity() {
        let mut scene = half(Some(0.5), 0.8);
        scene.mesh.opacities = vec![1.0, 1.0, 0.0, 0.0].into();
        let masks = Masks::of(&scene).unwrap();
        // At x = 0.75, opacity 0.8 (1 - y).
        assert!(!masks.is_clear(0, [0.40, 0.35]) && masks.is_clear(0, [0.35, 0.40]));
    }

    #[test]
    fn a_screen_has_the_share_that_its_opacity_says() {
        let mut scene = half(None, 0.3);
        scene.materials[0].mask = Some(Mask {
            opacity: 0.3,
            texture: None,
            cutoff: None,
        });
        let masks = Masks::of(&scene).unwrap();
        let points = (0..20_000).map(|i| {
            let w = sampling::triangle(sampling::r2(i, [0.5; 2]));
            [w[1], w[2]]
        });
        let met = points.clone().filter(|&uv| !masks.is_clear(1, uv)).count();
        assert!((met as f32 / 20_000.0 - 0.3).abs() < 0.01, "{met}");
        assert_eq!(masks.let_through(1, [0.2, 0.2]), 0.7);
        // As far as rounding goes, all rays meet one screen.
        let near = |[u, v]: [f32; 2]| [u + 1e-7, v - 1e-7];
        let others = points.filter(|&uv| masks.is_clear(1, uv) != masks.is_clear(1, near(uv)));
        assert!(others.count() < 40);
    }
}
