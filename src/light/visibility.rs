//! Which lights the shadow rays of some points reach: what tells edges of shadows and penumbrae.

use std::ops::AddAssign;

/// The lights that shadow rays of one point, or of several near each other, reach.
#[derive(Clone, Copy, Debug, Default)]
pub struct Visibility {
    /// A bit for each light of which a ray came through; of many lights some share a bit. Delta
    /// lights have the lower half.
    reached: u64,
    /// A bit for each light of which a ray was stopped.
    blocked: u64,
    /// The lights with an extent of which media let through a part of a ray.
    dimmed: Dimmed,
}

/// What media let through of rays to lights with an extent, where that is neither nothing nor all.
#[derive(Clone, Copy, Debug)]
struct Dimmed {
    /// A bit for each light that is dimmed.
    lights: u64,
    /// The least and the most of the transmittances of such rays.
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
    /// Difference of transmittances up to which a dimmed light counts as seen evenly.
    const MAX_SPREAD: f32 = 0.3;

    fn note(&mut self, bit: u64, transmittance: f32) {
        self.lights |= bit;
        self.least = self.least.min(transmittance);
        self.most = self.most.max(transmittance);
    }

    /// Whether dimmed lights, some of which other rays may reach or miss, are seen unevenly.
    fn is_uneven(&self, reached: u64, blocked: u64) -> bool {
        let most = if self.lights & reached != 0 {
            1.0
        } else {
            self.most
        };
        let least = if self.lights & blocked != 0 {
            0.0
        } else {
            self.least
        };
        self.lights != 0 && most - least > Self::MAX_SPREAD
    }

    fn join(&mut self, other: Self) {
        self.lights |= other.lights;
        self.least = self.least.min(other.least);
        self.most = self.most.max(other.most);
    }
}

impl Visibility {
    /// Bits of delta lights.
    const DELTA: u64 = (1 << 32) - 1;

    /// Whether a delta light is hidden from some of the points only.
    #[must_use]
    pub fn has_edge(&self) -> bool {
        self.reached & self.blocked & Self::DELTA != 0
    }

    /// Whether a light with an extent is partly hidden.
    #[must_use]
    pub fn has_penumbra(&self) -> bool {
        self.reached & self.blocked & !Self::DELTA != 0
            || self.dimmed.is_uneven(self.reached, self.blocked)
    }

    /// Notes the transmittance of the ray to a delta light. A medium that stops nearly all of it
    /// hides the light like a surface.
    pub(super) fn note_delta(&mut self, index: usize, transmittance: f32) {
        const BLOCKED: f32 = 0.25;
        const REACHED: f32 = 0.35;
        let bit = 1 << (index % 32);
        if transmittance < BLOCKED {
            self.blocked |= bit;
        } else if transmittance > REACHED {
            self.reached |= bit;
        }
    }

    /// Notes the transmittance of one ray to a light with an extent.
    pub(super) fn note_ray(&mut self, index: usize, transmittance: f32) {
        const BLOCKED: f32 = 0.1;
        const REACHED: f32 = 0.9;
        let bit = 1 << (32 + index % 32);
        if transmittance < BLOCKED {
            self.blocked |= bit;
        } else if transmittance > REACHED {
            self.reached |= bit;
        } else {
            self.dimmed.note(bit, transmittance);
        }
    }
}

impl AddAssign for Visibility {
    fn add_assign(&mut self, other: Self) {
        self.reached |= other.reached;
        self.blocked |= other.blocked;
        self.dimmed.join(other.dimmed);
    }
}
