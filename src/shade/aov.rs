//! What may be asked of pixels.

/// Extra layers of the image beside the beauty.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Aov {
    /// Directly lit and emitted light, as it comes through media.
    Direct,
    /// Light from other surfaces and media.
    Indirect,
    /// Light scattered by media towards the camera.
    Volume,
    /// Mean distance along the camera rays, scene units.
    Depth,
    /// Mean shading normal, scene space.
    Normal,
}

impl Aov {
    /// All of them, by the name of their layer.
    pub const ALL: [(&'static str, Self); 5] = [
        ("direct", Self::Direct),
        ("indirect", Self::Indirect),
        ("volume", Self::Volume),
        ("depth", Self::Depth),
        ("normal", Self::Normal),
    ];
}

/// Something about pixels that was asked for.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Part {
    /// All light of the pixel.
    Radiance,
    /// A layer of its own.
    Aov(Aov),
    /// 1 where the border of an emissive triangle runs through the pixel, else 0.
    EmitterBorder,
}

impl Part {
    /// Planes that it takes.
    #[must_use]
    pub fn planes(self) -> usize {
        match self {
            Self::Aov(Aov::Depth) | Self::EmitterBorder => 1,
            _ => 3,
        }
    }
}
