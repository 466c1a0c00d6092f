//! Where the textures of a glTF file lie: their sets of coordinates, their transforms, and what is
//! beyond their borders.

use crate::scene::Wrap;
use ::gltf::texture::{Info, WrappingMode};
use glam::Vec2;

/// What a texture is beyond its borders.
pub(super) fn wrap(info: &Info<'_>) -> [Wrap; 2] {
    let sampler = info.texture().sampler();
    [sampler.wrap_s(), sampler.wrap_t()].map(|mode| match mode {
        WrappingMode::Repeat => Wrap::Repeat,
        WrappingMode::ClampToEdge => Wrap::Clamp,
        WrappingMode::MirroredRepeat => Wrap::Mirror,
    })
}

/// The set of texture coordinates by which a texture is placed.
pub(super) fn set_of(info: &Info<'_>) -> u32 {
    let other = info.texture_transform().and_then(|t| t.tex_coord());
    other.unwrap_or(info.tex_coord())
}

/// Whether two textures have the same place on a surface.
pub(super) fn is_placed_alike(a: &Info<'_>, b: &Info<'_>) -> bool {
    let map = |info: &Info<'_>| {
        let map = info.texture_transform();
        map.map_or(([1.0; 2], 0.0, [0.0; 2]), |t| {
            (t.scale(), t.rotation(), t.offset())
        })
    };
    set_of(a) == set_of(b) && map(a) == map(b)
}

/// Applies KHR_texture_transform: scale, then rotation from u towards -v, then offset.
pub(super) fn transform_uvs(uvs: &mut [Vec2], info: &Info<'_>) {
    let Some(transform) = info.texture_transform() else {
        return;
    };
    let (sin, cos) = libm::sincosf(transform.rotation());
    let (scale, offset) = (
        Vec2::from(transform.scale()),
        Vec2::from(transform.offset()),
    );
    for uv in uvs {
        let p = *uv * scale;
        *uv = Vec2::new(cos * p.x + sin * p.y, cos * p.y - sin * p.x) + offset;
    }
}
