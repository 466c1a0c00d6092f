//! Runs: surfels below one node that face nearly one way, for all of which light is gathered once.

use crate::math::Rgb;
use lvox_formats::record::{Below, Surfel, SurfelPage};

/// Directions that surfels are told apart by: along and against each axis.
pub const FACINGS: usize = 6;

/// The surfels below a node of a page that face one way.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Run {
    /// The node.
    pub node: u32,
    /// The way they face, below [`FACINGS`].
    pub facing: u8,
    /// The one at which light is gathered, the nearest to the middle of all.
    pub surfel: u32,
    /// Area of all.
    pub area: f32,
    /// The mean radiance that leaves their fronts and their backs.
    pub sent: [Rgb; 2],
    /// Radius of a sphere around the middle that holds the centres of all, scene units.
    pub radius: f32,
}

/// The way a surfel faces: the axis along which its normal is longest.
pub fn facing(surfel: &Surfel) -> u8 {
    let n = surfel.normal;
    let axis = (0..3).fold(
        0,
        |best, a| if n[a].abs() > n[best].abs() { a } else { best },
    );
    2 * axis as u8 + u8::from(n[axis] < 0.0)
}

/// The surfels of a page below its nodes.
pub struct PageSurfels<'a> {
    page: &'a SurfelPage,
    /// Surfels below each node, of this page alone.
    counts: Vec<u32>,
}

impl<'a> PageSurfels<'a> {
    /// Counts the surfels below each node.
    pub fn new(page: &'a SurfelPage) -> Self {
        let mut counts = vec![0; page.nodes.len()];
        // Children come after their parents.
        for (i, node) in page.nodes.iter().enumerate().rev() {
            counts[i] = match node.below {
                Below::Nodes { first, count } => {
                    let first = first as usize;
                    counts[first..first + usize::from(count)].iter().sum()
                }
                Below::Surfels { count, .. } => u32::from(count),
                Below::Page(_) | Below::EvenPage(_) => 0,
            };
        }
        Self { page, counts }
    }

    /// The nodes at which runs start: those nearest to the root with no more than `most` surfels
    /// below them.
    pub fn roots(&self, most: u32) -> Vec<u32> {
        let mut roots = Vec::new();
        let mut open = vec![0_u32];
        while let Some(node) = open.pop() {
            let count = self.counts[node as usize];
            if count <= most || self.children(node).is_empty() {
                if count > 0 {
                    roots.push(node);
                }
            } else {
                open.extend(self.children(node).rev());
            }
        }
        roots
    }

    /// The nodes right below one that have surfels of this page below them.
    pub fn children(&self, node: u32) -> std::ops::Range<u32> {
        match self.page.nodes[node as usize].below {
            Below::Nodes { first, count } => first..first + u32::from(count),
            _ => 0..0,
        }
    }

    /// Gives the numbers of all surfels below a node, in the order of its leaves.
    pub fn each_below(&self, node: u32, mut visit: impl FnMut(u32)) {
        // A file may hold a chain of as many nodes as a page has.
        let mut open = vec![node];
        while let Some(node) = open.pop() {
            match self.page.nodes[node as usize].below {
                Below::Nodes { .. } => open.extend(self.children(node).rev()),
                Below::Surfels { first, count } => {
                    (first..first + u32::from(count)).for_each(&mut visit);
                }
                Below::Page(_) | Below::EvenPage(_) => {}
            }
        }
    }

    /// The surfels of a run, in the order of leaves.
    pub fn of_run(&self, run: &Run) -> Vec<&'a Surfel> {
        let mut own = Vec::new();
        self.each_below(run.node, |i| {
            let surfel = &self.page.surfels[i as usize];
            if facing(surfel) == run.facing {
                own.push(surfel);
            }
        });
        own
    }

    /// The runs below a node, one for each way that surfels face there.
    pub fn runs(&self, node: u32) -> impl Iterator<Item = Run> {
        (0..FACINGS as u8).filter_map(move |f| self.run(node, f))
    }

    /// The run of one facing below a node; `None` where no surfel faces that way.
    pub fn run(&self, node: u32, way: u8) -> Option<Run> {
        let mut own = Vec::new();
        self.each_below(node, |i| {
            if facing(&self.page.surfels[i as usize]) == way {
                own.push(i);
            }
        });
        let (mut area, mut moment) = (0.0_f64, [0.0_f64; 3]);
        let mut sent = [[0.0_f64; 3]; 2];
        for surfel in own.iter().map(|&i| &self.page.surfels[i as usize]) {
            // A surfel without an area has a place, too.
            let a = f64::from(surfel.area).max(f64::MIN_POSITIVE);
            area += a;
            for (m, p) in moment.iter_mut().zip(surfel.position) {
                *m += a * f64::from(p);
            }
            for (sum, light) in sent.iter_mut().zip([surfel.front, surfel.back]) {
                (sum.iter_mut().zip(light)).for_each(|(s, l)| *s += a * f64::from(l));
            }
        }
        let middle = moment.map(|m| m / area);
        let distance2 = |i: u32| {
            let offset = self.page.surfels[i as usize].position.iter().zip(middle);
            offset
                .map(|(p, m)| (f64::from(*p) - m).powi(2))
                .sum::<f64>()
        };
        let surfel = own
            .iter()
            .copied()
            .min_by(|&i, &j| distance2(i).total_cmp(&distance2(j)))?;
        let radius2 = own.iter().map(|&i| distance2(i)).fold(0.0, f64::max);
        Some(Run {
            node,
            facing: way,
            surfel,
            area: area as f32,
            sent: sent.map(|sum| Rgb(sum.map(|s| (s / area) as f32))),
            radius: radius2.sqrt() as f32,
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use lvox_formats::record::{Bounds, Node, SurfelAggregate};

    /// A root over two leaves of two surfels, which face up and to the side.
    fn page() -> SurfelPage {
        let node = |below| Node {
            bounds: Bounds::EMPTY,
            below,
            aggregate: SurfelAggregate::default(),
        };
        let surfel = |x: f32, normal| Surfel {
            position: [x, 0.0, 0.0],
            normal,
            area: 1.0,
            ..Surfel::default()
        };
        let (up, side) = ([0.0, 1.0, 0.0], [-0.8, 0.0, 0.6]);
        SurfelPage {
            nodes: vec![
                node(Below::Nodes { first: 1, count: 3 }),
                node(Below::Surfels { first: 0, count: 2 }),
                node(Below::Page(0)),
                node(Below::Surfels { first: 2, count: 2 }),
            ],
            surfels: vec![
                surfel(0.0, up),
                surfel(1.0, up),
                surfel(2.0, up),
                surfel(3.0, side),
            ],
        }
    }

    #[test]
    fn runs_hold_each_surfel_once() {
        let page = page();
        let surfels = PageSurfels::new(&page);
        assert_eq!(surfels.roots(4), [0]);
        assert_eq!(surfels.roots(3), [1, 3]);
        assert_eq!(surfels.roots(1), [1, 3]);
        let runs: Vec<_> = surfels.runs(0).collect();
        assert_eq!(
            runs.iter()
                .map(|r| (r.facing, r.surfel))
                .collect::<Vec<_>>(),
            [(1, 3), (2, 1)]
        );
        assert_eq!((runs[1].area, runs[1].radius), (3.0, 1.0));
        assert_eq!(surfels.run(3, 2).unwrap().surfel, 2);
        assert_eq!(surfels.run(1, 1), None);
    }
}
