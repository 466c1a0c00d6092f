//! Lambertian materials, two-sided in reflection, with optional emission and base-colour texture.

use glam::Vec2;

/// How a surface reflects and emits.
#[derive(Clone, Debug, PartialEq)]
pub struct Material {
    /// Name, for messages.
    pub name: String,
    /// Diffuse albedo, each channel in `[0,1]`.
    pub albedo: [f32; 3],
    /// Factor on the albedo, index into the scene's textures.
    pub texture: Option<u32>,
    /// Emitted radiance.
    pub emission: [f32; 3],
    /// Whether the back emits too.
    pub emits_both_sides: bool,
}

impl Material {
    /// A material that only reflects.
    #[must_use]
    pub fn diffuse(name: &str, albedo: [f32; 3]) -> Self {
        Self {
            name: name.into(),
            albedo,
            texture: None,
            emission: [0.0; 3],
            emits_both_sides: false,
        }
    }
}

/// An image in linear RGB, wrapped in both directions and filtered bilinearly.
#[derive(Clone, Debug)]
pub struct Texture {
    /// Texels across.
    pub width: u32,
    /// Texels down.
    pub height: u32,
    /// Linear RGB, row by row from the top.
    pub texels: Vec<[f32; 3]>,
}

impl Texture {
    /// Bilinear sample at (u, v), both periodic with 1; (0,0) is the corner of the first texel.
    #[must_use]
    pub fn sample(&self, uv: Vec2) -> [f32; 3] {
        let at = |t: f32, n: u32| {
            let x = (t - t.floor()) * n as f32 - 0.5;
            let lower = x.floor();
            let n = i64::from(n);
            let wrap = |i: i64| i.rem_euclid(n) as usize;
            (wrap(lower as i64), wrap(lower as i64 + 1), x - lower)
        };
        let (x0, x1, fx) = at(uv.x, self.width);
        let (y0, y1, fy) = at(uv.y, self.height);
        let texel = |x: usize, y: usize| self.texels[y * self.width as usize + x];
        let (a, b, c, d) = (texel(x0, y0), texel(x1, y0), texel(x0, y1), texel(x1, y1));
        std::array::from_fn(|i| {
            let top = a[i] + (b[i] - a[i]) * fx;
            let bottom = c[i] + (d[i] - c[i]) * fx;
            top + (bottom - top) * fy
        })
    }
}
