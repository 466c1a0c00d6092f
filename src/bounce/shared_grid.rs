//! Volumes that stand on one grid as one medium: each lights the others, and dims what they send.

use super::blocks::Blocks;
use super::light::Light;
use glam::Vec3;
use lvox_formats::morton;
use lvox_formats::record::{Lvoxel, MAX_LEVEL, VolumeInfo};

/// The lvoxels of one volume, and what they send of light that comes straight from lights.
#[derive(Debug)]
pub struct Member {
    /// Number of the volume.
    pub volume: usize,
    pub blocks: Blocks,
    pub direct: Vec<Light>,
    /// The mean directions in which that leaves; none where it leaves alike in all directions.
    pub lobes: Vec<Vec3>,
    /// The mean cosine of its phase function.
    pub mean_cosine: f32,
}

/// Volumes that are solved together.
#[derive(Debug)]
pub struct SharedGrid {
    members: Vec<Member>,
    /// Blocks of all of them, and what these send of direct light; `None` of one alone.
    together: Option<(Blocks, Vec<Light>)>,
}

impl SharedGrid {
    /// Most blocks of a medium over those of its volumes.
    pub const MOST_BLOCKS: u64 = 2;

    /// The volumes of a tree, by the grids that they share.
    pub fn of_all(infos: &[VolumeInfo], members: Vec<Member>) -> Vec<Self> {
        let mut grids: Vec<Vec<Member>> = Vec::new();
        for member in members {
            let info = &infos[member.volume];
            let joins = |of: &&mut Vec<Member>| {
                let scatters_evenly = |m: &Member| m.mean_cosine == 0.0;
                of.iter().chain([&member]).all(scatters_evenly)
                    && can_share(info, &infos[of[0].volume])
            };
            match grids.iter_mut().find(joins) {
                Some(grid) => grid.push(member),
                None => grids.push(vec![member]),
            }
        }
        let mut grids: Vec<Self> = (grids.into_iter())
            .map(|members| Self {
                together: (members.len() > 1)
                    .then(|| together(&infos[members[0].volume], &members)),
                members,
            })
            .collect();
        grids.sort_by_key(|grid| grid.members[0].volume);
        grids
    }

    /// The blocks of the medium.
    pub fn blocks(&self) -> &Blocks {
        (self.together.as_ref()).map_or(&self.members[0].blocks, |(blocks, _)| blocks)
    }

    /// What they send of light that comes straight from lights.
    pub fn direct(&self) -> &[Light] {
        (self.together.as_ref()).map_or(&self.members[0].direct, |(_, direct)| direct)
    }

    /// The only volume; `None` if there are more.
    pub fn only(&self) -> Option<&Member> {
        match &self.members[..] {
            [member] => Some(member),
            _ => None,
        }
    }

    /// By volume, its number and what its blocks send where such light arrives in those of the
    /// medium, as means over the sphere.
    pub fn sources<'a>(
        &'a self,
        incident: &'a [Light],
    ) -> impl Iterator<Item = (usize, Vec<Light>)> + 'a {
        self.members.iter().map(|member| {
            let sent = (member.direct.iter().enumerate()).map(|(i, direct)| {
                let arriving = self.mean_in(&member.blocks, i, incident);
                *direct + member.blocks.albedo_of(i) * arriving
            });
            (member.volume, sent.collect())
        })
    }

    /// The mean of what the blocks of the medium have, over a block of one of its volumes.
    fn mean_in(&self, of: &Blocks, block: usize, light: &[Light]) -> Light {
        let (corner, edge) = (of.corners[block], 1 << of.levels[block]);
        let blocks = self.blocks();
        let step = blocks.edge_at(corner);
        let (mut sum, mut count) = (Light::ZERO, 0);
        for voxel in voxels(corner, edge, step.min(edge)) {
            if let Some(i) = blocks.at(voxel) {
                sum += light[i];
                count += 1;
            }
        }
        sum / count.max(1) as f32
    }
}

/// Whether volumes are of voxels in the same places, and of one colour.
fn can_share(a: &VolumeInfo, b: &VolumeInfo) -> bool {
    (a.dims, a.index_from_scene, a.extinction_color)
        == (b.dims, b.index_from_scene, b.extinction_color)
}

/// Whether any of these volumes share a grid, and so may be solved together.
pub fn any_shared(infos: &[VolumeInfo]) -> bool {
    (infos.iter().enumerate()).any(|(i, a)| infos[..i].iter().any(|b| can_share(a, b)))
}

/// Voxels `step` apart along each axis of a cube of `edge` voxels.
fn voxels(corner: [u32; 3], edge: u32, step: u32) -> impl Iterator<Item = [u32; 3]> {
    let count = edge / step;
    (0..count * count * count).map(move |i| {
        let [x, y, z] = [i % count, i / count % count, i / count / count].map(|v| v * step);
        [corner[0] + x, corner[1] + y, corner[2] + z]
    })
}

/// The blocks of all members, and what these send: means over the members by extinction.
fn together(info: &VolumeInfo, members: &[Member]) -> (Blocks, Vec<Light>) {
    const BRICK: u32 = 1 << MAX_LEVEL;
    let corners = members.iter().flat_map(|m| &m.blocks.corners);
    let mut bricks: Vec<[u32; 3]> = corners.map(|c| c.map(|v| v / BRICK * BRICK)).collect();
    bricks.sort_unstable_by_key(|corner| morton::interleave(corner.map(u64::from)));
    bricks.dedup();
    let mut blocks = Blocks::new(info);
    let (mut direct, mut albedos) = (Vec::new(), Vec::new());
    for brick in bricks {
        let level = level_of(brick, members);
        for corner in voxels(brick, BRICK, 1 << level) {
            let mut sum = Sum::default();
            members.iter().for_each(|m| sum.add(m, corner, 1 << level));
            if sum.sigma_t > 0.0 {
                blocks.push(&Lvoxel {
                    level,
                    block: corner.map(|v| (v >> level) as u16),
                    sigma_t: sum.sigma_t,
                    ..Lvoxel::default()
                });
                direct.push(sum.direct / sum.sigma_t);
                albedos.push(sum.albedo / sum.sigma_t);
            }
        }
    }
    (blocks.with_albedos(albedos), direct)
}

/// Level of the blocks of a brick: the finest by which a half of it is filled, so that they are no
/// more than twice as many as those of the members, or else the coarsest.
fn level_of(brick: [u32; 3], members: &[Member]) -> u8 {
    let (mut finest, mut coarsest) = (None, 0);
    for Member { blocks, .. } in members {
        let edge = blocks.edge_at(brick);
        let filled = voxels(brick, 1 << MAX_LEVEL, edge).filter(|v| blocks.at(*v).is_some());
        let (filled, level) = (filled.count() as u32, edge.ilog2() as u8);
        if filled > 0 {
            coarsest = level.max(coarsest);
        }
        if 2 * filled >= (1 << (3 * (MAX_LEVEL - level))) {
            finest = Some(finest.map_or(level, |finest: u8| finest.min(level)));
        }
    }
    finest.unwrap_or(coarsest)
}

/// What members have in one block, as a mean over it.
#[derive(Default)]
struct Sum {
    sigma_t: f32,
    /// Times extinction.
    direct: Light,
    albedo: Light,
}

impl Sum {
    fn add(&mut self, member: &Member, corner: [u32; 3], edge: u32) {
        let blocks = &member.blocks;
        let step = blocks.edge_at(corner).min(edge);
        let share = 1.0 / (edge / step).pow(3) as f32;
        for i in voxels(corner, edge, step).filter_map(|voxel| blocks.at(voxel)) {
            let sigma_t = share * blocks.sigma_t[i];
            self.sigma_t += sigma_t;
            self.direct += member.direct[i] * sigma_t;
            self.albedo += blocks.albedo_of(i) * sigma_t;
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use glam::{DAffine3, DVec3};

    fn info(dims: [u32; 3]) -> VolumeInfo {
        VolumeInfo {
            name: String::new(),
            dims,
            index_from_scene: DAffine3::from_scale(DVec3::splat(2.0)).to_cols_array_2d(),
            albedo: [0.5; 3],
            extinction_color: [1.0; 3],
        }
    }

    /// A volume of blocks with such extinction and direct light each.
    fn member(volume: usize, level: u8, albedo: f32, blocks: &[([u16; 3], f32, f32)]) -> Member {
        let info = VolumeInfo {
            albedo: [albedo; 3],
            ..info([16, 8, 8])
        };
        let mut own = Blocks::new(&info);
        for &(block, sigma_t, _) in blocks {
            own.push(&Lvoxel {
                level,
                block,
                sigma_t,
                ..Lvoxel::default()
            });
        }
        Member {
            volume,
            blocks: own,
            direct: blocks.iter().map(|b| Light::splat(b.2)).collect(),
            lobes: Vec::new(),
            mean_cosine: 0.0,
        }
    }

    #[test]
    fn blocks_of_one_medium_have_the_means_of_its_volumes() {
        // One block of 8 voxels an edge, and in it a half of 2 x 2 x 2 of 4.
        let fine: Vec<_> = (0..4)
            .map(|i| ([i % 2, i / 2, 0], 3.0, f32::from(i)))
            .collect();
        let members = vec![
            member(0, 3, 0.8, &[([0, 0, 0], 1.0, 10.0)]),
            member(1, 2, 0.4, &fine),
        ];
        let infos = [info([16, 8, 8]), info([16, 8, 8])];
        let [grid] = &SharedGrid::of_all(&infos, members)[..] else {
            panic!("expected one medium");
        };
        let blocks = grid.blocks();
        assert_eq!(blocks.sigma_t, [4.0, 4.0, 4.0, 4.0, 1.0, 1.0, 1.0, 1.0]);
        assert_eq!(blocks.albedo_of(2).x, 0.5);
        assert_eq!(blocks.albedo_of(5).x, 0.8);
        assert_eq!(grid.direct()[2].x, (10.0 + 3.0 * 2.0) / 4.0);
        assert_eq!(grid.direct()[7].x, 10.0);
        let incident: Vec<Light> = (0..8).map(|i| Light::splat(i as f32)).collect();
        let sources: Vec<_> = grid.sources(&incident).collect();
        assert_eq!(sources[0], (0, vec![Light::splat(10.0 + 0.8 * 3.5)]));
        let of_fine = (0..4).map(|i| Light::splat(i as f32 + 0.4 * i as f32));
        assert_eq!(sources[1], (1, of_fine.collect()));
    }

    #[test]
    fn a_few_fine_blocks_leave_the_others_coarse() {
        let members = vec![
            member(0, 3, 0.8, &[([0, 0, 0], 1.0, 0.0)]),
            member(1, 0, 0.4, &[([1, 2, 3], 512.0, 0.0)]),
        ];
        let infos = [info([16, 8, 8]), info([16, 8, 8])];
        let grids = SharedGrid::of_all(&infos, members);
        assert_eq!(grids[0].blocks().sigma_t, [2.0]);
        let sources: Vec<_> = grids[0].sources(&[Light::ONE]).collect();
        assert_eq!(sources[1].1, [Light::splat(0.4)]);
    }

    #[test]
    fn volumes_on_other_grids_and_of_lobes_are_alone() {
        let one = |volume| member(volume, 3, 0.5, &[([0, 0, 0], 1.0, 1.0)]);
        let infos = [info([16, 8, 8]), info([8; 3]), info([16, 8, 8])];
        let alone = |members| {
            let grids = SharedGrid::of_all(&infos, members);
            grids
                .iter()
                .map(|g| g.only().map(|m| m.volume))
                .collect::<Vec<_>>()
        };
        assert_eq!(alone(vec![one(0), one(1)]), [Some(0), Some(1)]);
        assert_eq!(alone(vec![one(0), one(1), one(2)]), [None, Some(1)]);
        let lobes = Member {
            mean_cosine: 0.4,
            ..one(2)
        };
        assert_eq!(alone(vec![one(0), lobes]), [Some(0), Some(2)]);
    }
}
