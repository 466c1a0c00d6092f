//! Which lights the rays of some points reach.

use std::ops::AddAssign;

/// What rays to lights found, of one point or of several near each other.
#[derive(Clone, Copy, Debug, Default)]
pub struct Sight {
    /// A bit for each light of which a ray came through; of many lights some share a bit. Those without extent have the
    /// lower half.
    seen: u64,
    /// A bit for each light of which a ray was stopped.
    hidden: u64,
}

impl Sight {
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
        self.seen & self.hidden & !Self::SHARP != 0
    }

    /// Notes what share of a light without extent came through along the ray to it. A medium that stops nearly all of it
    /// hides the light like a surface.
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

    /// Notes what share of one ray to a light with an extent came through. One that media dim says neither: what they let through
    /// changes slowly, and more rays to tell it take as long as they gain.
    pub(super) fn note_ray(&mut self, index: usize, through: f32) {
        const HIDDEN: f32 = 0.1;
        const SEEN: f32 = 0.9;
        let bit = 1 << (32 + index % 32);
        if through < HIDDEN {
            self.hidden |= bit;
        } else if through > SEEN {
            self.seen |= bit;
        }
    }
}

impl AddAssign for Sight {
    fn add_assign(&mut self, other: Self) {
        self.seen |= other.seen;
        self.hidden |= other.hidden;
    }
}
