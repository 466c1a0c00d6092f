//! Records made from a seed.
#![allow(dead_code, unused_imports)]

mod packed;
pub mod parts;
pub mod random;

use lvox_formats::*;
pub use packed::*;
pub use random::Random;
use std::path::Path;

#[derive(Clone, Copy, Debug)]
pub struct Style {
    pub overlap: f32,
    pub free_area: bool,
    pub grey: bool,
    pub back: bool,
    pub clips: bool,
    pub scale: f32,
    pub light: f32,
}

impl Default for Style {
    fn default() -> Self {
        Self {
            overlap: 1.7,
            free_area: false,
            grey: false,
            back: true,
            clips: true,
            scale: 1.0,
            light: 1.0,
        }
    }
}

pub fn surfels(random: &mut Random, n: usize, style: Style) -> Vec<Surfel> {
    (0..n)
        .map(|_| {
            let radius = style.scale * (0.01 + 0.02 * random.unit());
            let area = std::f32::consts::PI * (radius / style.overlap).powi(2);
            let mut light = || {
                let c: [f32; 3] = std::array::from_fn(|_| style.light * random.unit());
                if style.grey { [c[0]; 3] } else { c }
            };
            let front = light();
            let back = if style.back { light() } else { [0.0; 3] };
            let mut clips = Clips::default();
            if style.clips {
                clips.count = random.below(4) as u8;
                for edge in &mut clips.edges[..usize::from(clips.count)] {
                    edge.angle = random.unit() * std::f32::consts::TAU;
                    edge.offset = random.unit();
                }
            }
            Surfel {
                position: std::array::from_fn(|_| style.scale * (random.unit() - 0.5)),
                normal: random.normal(),
                radius,
                area: if style.free_area {
                    area * (0.5 + random.unit())
                } else {
                    area
                },
                front,
                back,
                clips,
            }
        })
        .collect()
}

pub fn volumes() -> Vec<VolumeInfo> {
    (0..2)
        .map(|i| VolumeInfo {
            name: format!("volume {i}"),
            dims: [64, 32, 100],
            index_from_scene: [
                [10.0, 0.0, 0.0],
                [0.0, 10.0, 0.0],
                [0.0, 0.0, 10.0],
                [5.0, 0.5, 0.0],
            ],
            albedo: [0.9, 0.8, 0.7],
            extinction_color: [1.0; 3],
        })
        .collect()
}

pub fn lvoxels(random: &mut Random, n: usize, style: Style) -> Vec<Lvoxel> {
    (0..n)
        .map(|_| {
            let level = random.below(4) as u8;
            let c: [f32; 3] = std::array::from_fn(|_| style.light * random.unit());
            let lobe = c.map(|c| (140.0 * c / style.light - 70.0) as i8);
            Lvoxel {
                incident: [0.0; 3],
                single: Default::default(),
                volume: random.below(2) as u16,
                level,
                block: [64u64, 32, 100].map(|d| (random.below(d) >> level) as u16),
                sigma_t: (0.01 + random.unit()) / style.scale,
                source: if style.grey { [c[0]; 3] } else { c },
                lobe: if style.back { lobe } else { [0; 3] },
            }
        })
        .collect()
}

/// A brick of voxels with holes and one of larger blocks, in Morton order: extinction and grey
/// source change little by little.
pub fn smooth_lvoxels() -> Vec<Lvoxel> {
    let brick = |first: u16, level: u8| {
        (0..512u16 >> (3 * level)).map(move |i| {
            let axis = |shift: u16| (0..3).fold(0, |x, k| x | (i >> (3 * k + shift) & 1) << k);
            let [x, y, z] = [axis(2), axis(1), axis(0)].map(|c| f32::from(c << level) / 8.0);
            let source = 0.4 + 0.3 * z - 0.2 * x * y;
            Lvoxel {
                volume: 1,
                level,
                block: [axis(2), axis(1), axis(0) + first],
                sigma_t: 1.0 + 0.5 * x + 0.2 * y * y - 0.3 * z,
                source: [source; 3],
                ..Lvoxel::default()
            }
        })
    };
    let holes = brick(0, 0).filter(|v| v.block[0] + v.block[1] + v.block[2] < 12);
    holes.chain(brick(4, 1)).collect()
}

pub fn cloud_meta(style: Style) -> CloudMeta {
    CloudMeta {
        scene_hash: std::array::from_fn(|i| i as u8),
        scene_name: "a scene".into(),
        world_from_scene: [1e6, 0.0, -3.5],
        volumes: volumes(),
        settings: vec![("seed".into(), "1".into())],
        disk_overlap: style.overlap,
    }
}

pub fn write_cloud(
    path: &Path,
    surfels: &[Surfel],
    lvoxels: &[Lvoxel],
    style: Style,
) -> CloudSummary {
    let mut writer = CloudWriter::create(path, cloud_meta(style), Overwrite::Replace).unwrap();
    writer.push_surfels(surfels).unwrap();
    writer.push_lvoxels(lvoxels).unwrap();
    writer.finish().unwrap()
}

/// A page over the surfels: leaves of up to five, then parents of up to four, and links to pages
/// before it.
pub fn page(random: &mut Random, surfels: &[Surfel], links: &[(u32, Bounds)]) -> SurfelPage {
    enum Tree {
        Surfels(Vec<Surfel>),
        Link(u32, Bounds),
        Nodes(Vec<Tree>),
    }
    let mut layer: Vec<Tree> = surfels
        .chunks(5)
        .map(|c| Tree::Surfels(c.to_vec()))
        .collect();
    layer.extend(links.iter().map(|(id, b)| Tree::Link(*id, *b)));
    while layer.len() > 1 {
        let mut next = Vec::new();
        let mut items = layer.into_iter().peekable();
        while items.peek().is_some() {
            next.push(Tree::Nodes(items.by_ref().take(4).collect()));
        }
        layer = next;
    }
    let mut page = SurfelPage::default();
    let mut queue: std::collections::VecDeque<Tree> = layer.into();
    let mut next_node = 1;
    fn bounds(tree: &Tree) -> Bounds {
        match tree {
            Tree::Surfels(s) => s
                .iter()
                .fold(Bounds::EMPTY, |b, s| b.union(Bounds::of_surfel(s))),
            Tree::Link(_, b) => *b,
            Tree::Nodes(n) => n.iter().fold(Bounds::EMPTY, |b, t| b.union(bounds(t))),
        }
    }
    while let Some(tree) = queue.pop_front() {
        let bounds = bounds(&tree);
        let area = random.unit() * 10.0;
        let signed = |random: &mut Random| area * (random.unit() * 2.0 - 1.0);
        let mut aggregate = SurfelAggregate {
            area,
            centre: std::array::from_fn(|k| {
                bounds.min[k] + random.unit() * (bounds.max[k] - bounds.min[k])
            }),
            normal_sum: std::array::from_fn(|_| signed(random)),
            second_moment: std::array::from_fn(|_| signed(random)),
            axis_area: std::array::from_fn(|k| {
                if k % 2 == 0 {
                    area * random.unit()
                } else {
                    0.0
                }
            }),
            axis_radiance: std::array::from_fn(|k| {
                std::array::from_fn(|_| if k % 2 == 0 { random.unit() } else { 0.0 })
            }),
            back_radiance: [[0.0; 3]; 6],
        };
        // Backs face away from fronts.
        for k in [1, 5] {
            aggregate.back_radiance[k] = aggregate.axis_radiance[k - 1].map(|v| 0.5 * v);
        }
        let below = match tree {
            Tree::Surfels(s) => {
                let first = page.surfels.len() as u32;
                let count = s.len() as u8;
                page.surfels.extend(s);
                Below::Surfels { first, count }
            }
            Tree::Link(id, _) => Below::Page(id),
            Tree::Nodes(nodes) => {
                let first = next_node;
                let count = nodes.len() as u8;
                next_node += nodes.len() as u32;
                queue.extend(nodes);
                Below::Nodes { first, count }
            }
        };
        page.nodes.push(Node {
            bounds,
            below,
            aggregate,
        });
    }
    page
}

/// A tree of a few pages; returns them as given.
pub fn write_tree(path: &Path, style: Style, pages: usize, per_page: usize) -> Vec<SurfelPage> {
    let meta = TreeMeta {
        cloud: cloud_meta(style),
        cloud_hash: [7; 16],
        settings: vec![("page_bytes".into(), "65536".into())],
    };
    let mut random = Random(5);
    let mut writer = TreeWriter::create(path, meta, Overwrite::Replace).unwrap();
    let mut written = Vec::new();
    let mut links = Vec::new();
    for i in 0..pages {
        let last = i + 1 == pages;
        let own = surfels(&mut random, per_page, style);
        let page = page(&mut random, &own, if last { &links } else { &[] });
        let encoded = EncodedPage::new(&page, i as u32, style.overlap).unwrap();
        let id = writer.push_surfel_page(&encoded).unwrap();
        assert_eq!(id as usize, i);
        links.push((id, encoded.bounds()));
        written.push(page);
    }
    let voxels = lvoxels(&mut random, per_page, style);
    if !voxels.is_empty() {
        push_lvoxels(&mut writer, &voxels, style);
        push_lvoxels(&mut writer, &smooth_lvoxels(), style);
    }
    let sums = Sums::of_nothing(2);
    let root = (pages > 0).then(|| pages as u32 - 1);
    writer
        .finish(root, sums, vec![TreeLevel::default(); 3])
        .unwrap();
    written
}

/// Direct light with and without point lights, and grey indirect light, at some vertices of the
/// second volume.
pub fn clusters(random: &mut Random) -> Vec<(BlockKind, ClusterId, VertexCluster)> {
    let id = |level: u8, x: u16| ClusterId {
        volume: 1,
        level,
        zyx: [0, 0, x],
    };
    let kinds = [
        (BlockKind::Direct, id(0, 1), true, false),
        (BlockKind::Direct, id(1, 0), false, false),
        (BlockKind::Indirect, id(1, 0), false, true),
    ];
    kinds
        .into_iter()
        .map(|(kind, id, has_point_lights, is_grey)| {
            let mut chosen = vec![0; CLUSTER_CUBES];
            for i in [0, 9, 70] {
                chosen[i] = 1 << random.below(64) | 1 << random.below(64);
            }
            let mut cluster = VertexCluster {
                chosen,
                ..VertexCluster::default()
            };
            let mut light = |n: usize| -> Vec<[f32; 3]> {
                let colour = |_| {
                    let c: [f32; 3] = std::array::from_fn(|_| random.unit());
                    if is_grey { [c[0]; 3] } else { c }
                };
                (0..n).map(colour).collect()
            };
            cluster.light = light(cluster.len());
            if has_point_lights {
                cluster.share = light(cluster.len());
            }
            (kind, id, cluster)
        })
        .collect()
}

pub fn scatter_meta() -> ScatterMeta {
    ScatterMeta {
        scene_hash: std::array::from_fn(|i| i as u8),
        scene_name: "a scene".into(),
        volumes: volumes(),
        tree_hash: [7; 16],
        settings: vec![("seed".into(), "1".into())],
    }
}

pub fn write_scatter(
    path: &Path,
    clusters: &[(BlockKind, ClusterId, VertexCluster)],
) -> ScatterSummary {
    let mut writer = ScatterWriter::create(path, scatter_meta(), Overwrite::Replace).unwrap();
    for (kind, id, cluster) in clusters {
        writer.push(*kind, *id, cluster).unwrap();
    }
    writer.finish().unwrap()
}

/// Appends a page of lvoxels of a cloud of [`cloud_meta`].
pub fn push_lvoxels(writer: &mut TreeWriter, lvoxels: &[Lvoxel], style: Style) {
    let page = EncodedLvoxels::new(lvoxels, &cloud_meta(style).volumes).unwrap();
    writer.push_lvoxel_page(&page).unwrap();
}
