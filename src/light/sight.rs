//! Which lights the rays of some points reach.

use std::fmt::Debug;
use std::ops::AddAssign;

/// What rays to lights found, of one point or of several near each other.
#[derive(Clone, Copy, Debug, Default)]
pub struct Sight<D = Dimmed> {
    /// A bit for each light of which a ray came through; of many lights some share a bit. Those
    /// without extent have the lower half.
    seen: u64,
    /// A bit for each light of which a ray was stopped.
    hidden: u64,
    /// Those of which a part of a ray came through.
    dimmed: D,
}

/// What media let through of rays to lights with an extent, as a type: without media there is
/// nothing to note.
pub trait Dimming: Copy + Debug + Default + Send + Sync + 'static {
    /// Notes the part of a ray that came through, and the light's bit.
    fn note(&mut self, bit: u64, through: f32);

    /// Whether lights that some rays reach or miss, or that are dimmed, are so to much different
    /// degrees.
    fn differs(&self, seen: u64, hidden: u64) -> bool;

    /// Adds what other rays noted.
    fn join(&mut self, other: Self);
}

/// What media let through of some rays.
#[derive(Clone, Copy, Debug)]
pub struct Dimmed {
    /// A bit for each light with an extent of which a medium let a part of a ray through.
    lights: u64,
    /// The least and the most of those parts.
    least: f32,
    most: f32,
}

impl Default for Dimmed {
    fn default() -> Self {
        Self {
            lights: 0,
            least: 1.0,
            most: 0.0,
        }
    }
}

impl Dimmed {
    /// By how much the shares of rays to a light with an extent may differ before it counts as
    /// partly hidden.
    const ALIKE: f32 = 0.3;
}

impl Dimming for Dimmed {
    fn note(&mut self, bit: u64, through: f32) {
        self.lights |= bit;
        self.least = self.least.min(through);
        self.most = self.most.max(through);
    }

    fn differs(&self, seen: u64, hidden: u64) -> bool {
        let most = if self.lights & seen != 0 {
            1.0
        } else {
            self.most
        };
        let least = if self.lights & hidden != 0 {
            0.0
        } else {
            self.least
        };
        self.lights != 0 && most - least > Self::ALIKE
    }

    fn join(&mut self, other: Self) {
        self.lights |= other.lights;
        self.least = self.least.min(other.least);
        self.most = self.most.max(other.most);
    }
}

impl<D: Dimming> Sight<D> {
    /// Bits of lights without extent.
    const SHARP: u64 = (1 << 32) - 1;

    /// Whether a light without extent is hidden from some of the points only.
    #[must_use]
    pub fn has_edge(&self) -> bool {
        self.seen & self.hidden & Self::SHARP != 0
    }

    /// Whether a light with an extent is partly hidden.
    #[must_use]
    pub fn has_penumbra(&self) -> bool {
        self.seen & self.hidden & !Self::SHARP != 0 || self.dimmed.differs(self.seen, self.hidden)
    }

    /// Notes what share of a light without extent came through along the ray to it. A medium that
    /// stops nearly all of it hides the light like a surface.
    pub(super) fn note_sharp(&mut self, index: usize, through: f32) {
        const HIDDEN: f32 = 0.25;
        const SEEN: f32 = 0.35;
        let bit = 1 << (index % 32);
        if through < HIDDEN {
            self.hidden |= bit;
        } else if through > SEEN {
            self.seen |= bit;
        }
    }

    /// Notes what share of one ray to a light with an extent came through.
    pub(super) fn note_ray(&mut self, index: usize, through: f32) {
        const HIDDEN: f32 = 0.1;
        const SEEN: f32 = 0.9;
        let bit = 1 << (32 + index % 32);
        if through < HIDDEN {
            self.hidden |= bit;
        } else if through > SEEN {
            self.seen |= bit;
        } else {
            self.dimmed.note(bit, through);
        }
    }
}

impl<D: Dimming> AddAssign for Sight<D> {
    fn add_assign(&mut self, other: Self) {
        self.seen |= other.seen;
        self.hidden |= other.hidden;
        self.dimmed.join(other.dimmed);
    }
}
