//! Whether a node says so much like those right below it that nobody need look at them.

use super::page::facing_axes;
use lvox_formats::record::SurfelAggregate;

/// What a node sends misleads where nodes below it that stand for the place in question send more
/// or less by this share of it.
pub const MISLEADING_DIFFERENCE: f32 = 0.5;

/// Whether no mean over any of its parts, towards any direction, is off by
/// [`MISLEADING_DIFFERENCE`] from what the whole sends there; `false` where that is not known.
///
/// The means are over axes that surfels face: where the parts face the same ones as the whole does,
/// each lies between the least and the most that is sent to one of them.
pub fn is_even<'a>(
    whole: &SurfelAggregate,
    parts: impl Iterator<Item = &'a SurfelAggregate> + Clone,
) -> bool {
    /// What rounding in files may add to a difference.
    const ROUNDING: f32 = 0.02;
    let most = MISLEADING_DIFFERENCE - ROUNDING;
    let axes = |of| facing_axes(of).fold(0, |axes, (axis, _)| axes | 1 << axis);
    let faced: u32 = axes(whole);
    parts.clone().all(|part| axes(part) == faced)
        && [Side::Front, Side::Back].into_iter().all(|side| {
            let [least, greatest] = side.sent(whole);
            parts.clone().all(|part| {
                let [low, high] = side.sent(part);
                high - least <= most * least && greatest - low <= most * greatest
            })
        })
}

/// A side of surfels.
#[derive(Clone, Copy, Debug)]
enum Side {
    Front,
    Back,
}

impl Side {
    /// The least and the most that surfels send from it towards an axis, as the mean over channels.
    fn sent(self, of: &SurfelAggregate) -> [f32; 2] {
        let sent = facing_axes(of).map(|(axis, _)| match self {
            Self::Front => of.axis_radiance[axis],
            // Backs face the axis across.
            Self::Back => of.back_radiance[axis ^ 1],
        });
        let means = sent.map(|radiance| radiance.iter().sum::<f32>() / 3.0);
        means.fold([f32::INFINITY, 0.0], |[least, most], mean| {
            [least.min(mean), most.max(mean)]
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Surfels that face +x, or +x and +y, and send so much there from their fronts.
    fn facing(to_x: f32, to_y: Option<f32>) -> SurfelAggregate {
        let mut of = SurfelAggregate {
            area: 1.0,
            ..SurfelAggregate::default()
        };
        for (axis, sent) in [(0, Some(to_x)), (2, to_y)] {
            if let Some(sent) = sent {
                of.axis_area[axis] = 0.5;
                of.axis_radiance[axis] = [sent; 3];
            }
        }
        of
    }

    fn is_even_of(whole: &SurfelAggregate, parts: &[SurfelAggregate]) -> bool {
        is_even(whole, parts.iter())
    }

    #[test]
    fn parts_that_send_about_as_much_are_even() {
        let wall = |sent| facing(sent, None);
        assert!(is_even_of(&wall(1.0), &[wall(0.6), wall(1.4)]));
        assert!(!is_even_of(&wall(1.0), &[wall(0.5), wall(1.0)]));
        assert!(!is_even_of(&wall(1.0), &[wall(1.0), wall(1.5)]));
        // In the dark all are alike.
        assert!(is_even_of(&wall(0.0), &[wall(0.0), wall(0.0)]));
        assert!(!is_even_of(&wall(0.0), &[wall(0.0), wall(1e-6)]));
    }

    #[test]
    fn parts_of_an_edge_are_not_even() {
        // One of them knows nothing of what the other says.
        let edge = facing(1.0, Some(1.0));
        assert!(!is_even_of(&edge, &[facing(1.0, None), edge]));
        assert!(is_even_of(&edge, &[edge, facing(0.8, Some(1.2))]));
        // Between the axes that a mean is over there may be any mixture.
        assert!(!is_even_of(
            &facing(1.0, Some(2.0)),
            &[facing(1.0, Some(2.0))]
        ));
    }

    #[test]
    fn backs_count_too() {
        let mut lit = facing(1.0, None);
        lit.back_radiance[1] = [0.3; 3];
        let mut dark = lit;
        dark.back_radiance[1] = [0.1; 3];
        assert!(is_even_of(&lit, &[lit, lit]));
        assert!(!is_even_of(&lit, &[lit, dark]));
    }
}
