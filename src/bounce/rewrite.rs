//! The tree of another one with more light.

use super::links::{ASKED, Sites};
use super::receivers::LitRun;
use super::runs::{PageSurfels, facing};
use super::surface_below::surface_below;
use super::sweeps::Light;
use crate::math::Rgb;
use crate::run::Job;
use crate::tree::media::TwoLobes;
use crate::tree::{AggregateSums, is_even};
use crate::{Error, Result};
use arrayvec::ArrayVec;
use glam::Vec3;
use lvox_formats::record::{Below, LightPart, Lvoxel, Surfel, SurfelPage};
use lvox_formats::{EncodedLvoxels, EncodedPage, MappedFile, Tree, TreeWriter};
use rayon::prelude::*;

/// The light that surfels are given beside what they send.
pub struct NewLight<'a> {
    /// Receivers of all pages.
    pub sites: &'a Sites<'a>,
    /// By receiver: irradiance over pi.
    pub light: &'a [Rgb],
    /// By receiver: those whose light is interpolated around it.
    pub neighbours: &'a [Neighbours],
    /// By page: its runs, with receivers among all.
    pub runs: &'a [Vec<LitRun>],
    /// By volume: the sources of its lvoxels in the order of pages; none if they stay as they are.
    pub sources: &'a [Vec<Light>],
    /// By volume: the lobes in which their light leaves; none if it does so alike in all
    /// directions.
    pub lobes: &'a [Vec<TwoLobes>],
    /// By lvoxel of the only volume: what the others send to it; none if that is not told.
    pub incident: &'a [Light],
}

/// The receivers around one that it sees, itself included: none where they are dark.
pub type Neighbours = ArrayVec<u32, ASKED>;

/// The receivers around each, in this light.
pub fn neighbours(sites: &Sites, light: &[Rgb]) -> Vec<Neighbours> {
    let sides = sites.receivers.par_chunks(2).flat_map_iter(|sides| {
        let [point, normal] = [sides[0].point, sides[0].normal];
        let of_fronts = sites.around(point, normal);
        (0..).zip(sides).map(move |(back, side)| {
            // The other side of each is the next number or the one before.
            let around = of_fronts.iter().map(|i| i ^ back);
            if around.clone().all(|i| light[i as usize].is_black()) {
                return Neighbours::new();
            }
            around
                .filter(|&i| sites.sees(point, side.normal, i))
                .collect()
        })
    });
    sides.collect()
}

impl NewLight<'_> {
    /// Adds to a page's surfels what they reflect of the light; returns how many stand on no
    /// surface of the scene.
    fn light(&self, page: &mut SurfelPage, id: usize) -> u64 {
        const NONE: [u32; 2] = [u32::MAX; 2];
        let mut receivers = vec![NONE; page.surfels.len()];
        let surfels = PageSurfels::new(page);
        for lit in &self.runs[id] {
            surfels.each_below(lit.run.node, |i| {
                if facing(&page.surfels[i as usize]) == lit.run.facing {
                    receivers[i as usize] = lit.receivers;
                }
            });
        }
        let mut lost = 0;
        for (surfel, receivers) in page.surfels.iter_mut().zip(receivers) {
            if receivers == NONE {
                continue;
            }
            match self.reflected(surfel, receivers) {
                None => lost += 1,
                Some([front, back]) => {
                    surfel.front = (Rgb(surfel.front) + front).0;
                    surfel.back = (Rgb(surfel.back) + back).0;
                }
            }
        }
        lost
    }

    /// What the sides of a surfel reflect of the light around their receivers; `None` if it stands
    /// on no surface of the scene.
    fn reflected(&self, surfel: &Surfel, receivers: [u32; 2]) -> Option<[Rgb; 2]> {
        let (point, normal) = (Vec3::from(surfel.position), Vec3::from(surfel.normal));
        let sides = [(receivers[0], normal), (receivers[1], -normal)];
        let mut light = sides.map(|(receiver, normal)| {
            let around = self.neighbours[receiver as usize].iter();
            let light = self.interpolated(around.copied(), point, normal);
            light.unwrap_or(self.light[receiver as usize])
        });
        let first = light.iter().position(|l| !l.is_black());
        let Some(first) = first else {
            return Some(light);
        };
        // What is inside of a wall has none of the light outside.
        let seen = self.sites.met(surfel, normal, receivers[first]);
        for (i, (receiver, normal)) in sides.into_iter().enumerate().skip(first) {
            let is_seen = i == first && seen.is_some();
            if is_seen || light[i].is_black() || self.sites.sees(point, normal, receiver) {
                continue;
            }
            let mut around = self.sites.around(point, normal);
            around.retain(|i| self.sites.sees(point, normal, *i));
            let between = self.interpolated(around.iter().copied(), point, normal);
            let nearest = around.first().map(|i| self.light[*i as usize]);
            light[i] = between.or(nearest).unwrap_or_default();
        }
        let surface = seen.or_else(|| surface_below(self.sites.tracer, surfel))?;
        Some(light.map(|light| light * surface.albedo))
    }

    /// The light at a point between receivers; `None` if there are none, or all at one place.
    fn interpolated(
        &self,
        around: impl Iterator<Item = u32> + Clone,
        point: Vec3,
        normal: Vec3,
    ) -> Option<Rgb> {
        let receivers = self.sites.receivers;
        let distance2 = |i: u32| receivers[i as usize].point.distance_squared(point);
        let farthest2 = around.clone().map(distance2).fold(0.0, f32::max);
        let (mut sum, mut weights) = (Rgb::BLACK, 0.0);
        for i in around {
            let near = 1.0 - distance2(i) / farthest2;
            let weight = near * near * receivers[i as usize].normal.dot(normal).max(0.0);
            if weight > 0.0 {
                sum += self.light[i as usize] * weight;
                weights += weight;
            }
        }
        (weights > 0.0).then(|| sum * (1.0 / weights))
    }
}

/// Pages that are in work at a time.
const BATCH: usize = 256;

/// Writes the pages of a tree with more light; returns how many surfels stand on no surface of the
/// scene, and so got none.
///
/// # Errors
/// A page that cannot be read, light that a file cannot hold, a file that cannot be written, a stop
/// on request.
pub fn write(
    tree: &Tree<MappedFile>,
    light: &NewLight,
    writer: &mut TreeWriter,
    job: &Job,
) -> Result<u64> {
    let task = job
        .progress
        .task("light", tree.surfel_pages() as u64, "pages");
    // Over all that is below the root of each page.
    let mut of_pages: Vec<AggregateSums> = Vec::with_capacity(tree.surfel_pages());
    let mut even_pages: Vec<bool> = Vec::with_capacity(tree.surfel_pages());
    let mut lost = 0;
    let ids: Vec<usize> = (0..tree.surfel_pages()).collect();
    for batch in ids.chunks(BATCH) {
        job.cancel.check()?;
        let lit = batch.par_iter().map(|&id| {
            let mut page = tree.surfel_page(id)?;
            let lost = light.light(&mut page, id);
            let sums = leaf_sums(&page);
            Ok((page, sums, lost))
        });
        let mut lit = lit.collect::<Result<Vec<_>>>()?;
        for (page, sums, own_lost) in &mut lit {
            add_up(page, sums, &of_pages);
            of_pages.push(sums[0]);
            even_pages.push(is_even_below(page, sums));
            lost += *own_lost;
        }
        let encoded = batch
            .par_iter()
            .zip(&mut lit)
            .map(|(&id, (page, sums, _))| {
                for (node, sums) in page.nodes.iter_mut().zip(sums) {
                    let lit = sums.aggregate();
                    node.aggregate.axis_radiance = lit.axis_radiance;
                    node.aggregate.back_radiance = lit.back_radiance;
                    if let Some(link) = node.below.page() {
                        node.below = match even_pages[link as usize] {
                            true => Below::EvenPage(link),
                            false => Below::Page(link),
                        };
                    }
                }
                EncodedPage::relit(tree, id, page).map_err(too_bright)
            });
        for page in encoded.collect::<Result<Vec<_>>>()? {
            writer.push_surfel_page(&page)?;
        }
        task.add(batch.len() as u64);
    }
    let mut incident = light.incident.iter();
    let mut sources: Vec<_> = light.sources.iter().map(|s| s.iter()).collect();
    let mut lobes: Vec<_> = light.lobes.iter().map(|l| l.iter()).collect();
    for i in 0..tree.lvoxel_pages() {
        job.cancel.check()?;
        let mut lvoxels = tree.lvoxel_page(i)?;
        for lvoxel in &mut lvoxels {
            let volume = usize::from(lvoxel.volume);
            if let Some(source) = sources.get_mut(volume).and_then(Iterator::next) {
                lvoxel.source = source.to_array();
            }
            if let Some(lobes) = lobes.get_mut(volume).and_then(Iterator::next) {
                // That of light straight from lights stays.
                let share = (lobes.single_share * LightPart::SHARE_ONE).round() as u8;
                if share > 0 {
                    lvoxel.single = LightPart {
                        share,
                        lobe: lvoxel.lobe,
                    };
                }
                let rest = (lobes.rest * Lvoxel::LOBE_ONE).round();
                lvoxel.lobe = rest.to_array().map(|c| c as i8);
            }
            if let Some(incident) = incident.next() {
                lvoxel.incident = incident.to_array();
            }
        }
        let page = EncodedLvoxels::new(&lvoxels, &tree.meta().cloud.volumes).map_err(too_bright)?;
        writer.push_lvoxel_page(&page)?;
    }
    Ok(lost)
}

fn too_bright(error: lvox_formats::FormatError) -> Error {
    Error::input(format!("light of all bounces cannot be stored: {error}"))
        .hint("make lights darker")
}

/// Whether the nodes right below the root of a page send about what it sends.
fn is_even_below(page: &SurfelPage, sums: &[AggregateSums]) -> bool {
    let Some(&Below::Nodes { first, count }) = page.nodes.first().map(|root| &root.below) else {
        return false;
    };
    let parts: ArrayVec<_, 8> = sums[first as usize..][..usize::from(count)]
        .iter()
        .map(AggregateSums::aggregate)
        .collect();
    is_even(&sums[0].aggregate(), parts.iter())
}

/// The sums over the surfels right below each node.
fn leaf_sums(page: &SurfelPage) -> Vec<AggregateSums> {
    let of_node = |below| match below {
        Below::Surfels { first, count } => {
            let first = first as usize;
            let own = &page.surfels[first..first + usize::from(count)];
            let mut sums = AggregateSums::NOTHING;
            own.iter().for_each(|s| sums.add_surfel(s));
            sums
        }
        _ => AggregateSums::NOTHING,
    };
    page.nodes.iter().map(|n| of_node(n.below)).collect()
}

/// Adds to the sums of each node those of all below it, in the order in which `build` adds them.
fn add_up(page: &SurfelPage, sums: &mut [AggregateSums], of_pages: &[AggregateSums]) {
    for (i, node) in page.nodes.iter().enumerate().rev() {
        match node.below {
            Below::Nodes { first, count } => {
                for child in first as usize..first as usize + usize::from(count) {
                    let child = sums[child];
                    sums[i].add(&child);
                }
            }
            Below::Page(id) | Below::EvenPage(id) => sums[i] = of_pages[id as usize],
            Below::Surfels { .. } => {}
        }
    }
}
