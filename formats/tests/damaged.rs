//! Any damage is found, and no bytes make a reader panic, hang or allocate without bound.

mod common;

use common::parts::{Part, Parts, repair};
use common::*;
use lvox_formats::*;
use proptest::prelude::*;

fn small_cloud() -> Vec<u8> {
    let dir = tempfile::tempdir().unwrap();
    let path = dir.path().join("a.lvc");
    let style = Style::default();
    let mut random = Random(1);
    let own = surfels(&mut random, 12, style);
    let voxels = lvoxels(&mut random, 5, style);
    write_cloud(&path, &own, &voxels, style);
    std::fs::read(path).unwrap()
}

fn small_tree() -> Vec<u8> {
    let dir = tempfile::tempdir().unwrap();
    let path = dir.path().join("a.lvt");
    write_tree(&path, Style::default(), 3, 12);
    std::fs::read(path).unwrap()
}

fn small_scatter() -> Vec<u8> {
    let dir = tempfile::tempdir().unwrap();
    let path = dir.path().join("a.lvs");
    write_scatter(&path, &clusters(&mut Random(1)));
    std::fs::read(path).unwrap()
}

fn small_packed() -> Vec<u8> {
    let dir = tempfile::tempdir().unwrap();
    let path = dir.path().join("a.lvp");
    write_packed(&path);
    std::fs::read(path).unwrap()
}

fn read_packed(bytes: &[u8]) -> Result<()> {
    Packed::open(bytes)?.verify()
}

fn read_cloud(bytes: &[u8]) -> Result<()> {
    Cloud::open(bytes)?.verify()
}

fn read_tree(bytes: &[u8]) -> Result<()> {
    Tree::open(bytes)?.verify()
}

fn read_scatter(bytes: &[u8]) -> Result<()> {
    Scatter::open(bytes)?.verify()
}

type Reader = fn(&[u8]) -> Result<()>;

fn files() -> [(Vec<u8>, Reader); 4] {
    [
        (small_cloud(), read_cloud),
        (small_tree(), read_tree),
        (small_scatter(), read_scatter),
        (small_packed(), read_packed),
    ]
}

#[test]
fn every_flipped_bit_is_found() {
    for (mut bytes, read) in files() {
        read(&bytes).unwrap();
        for i in 0..bytes.len() {
            for bit in 0..8 {
                bytes[i] ^= 1 << bit;
                assert!(read(&bytes).is_err(), "bit {bit} of byte {i}");
                bytes[i] ^= 1 << bit;
            }
        }
    }
}

#[test]
fn every_cut_and_every_addition_is_found_by_open() {
    for (bytes, read) in files() {
        for len in 0..bytes.len() {
            let error = read(&bytes[..len]).unwrap_err();
            match len {
                0 => assert!(matches!(error, FormatError::NotOurs { .. })),
                _ => assert!(
                    matches!(error, FormatError::Truncated { .. }),
                    "{len}: {error}"
                ),
            }
        }
        let longer = [&bytes[..], &[0]].concat();
        assert!(matches!(read(&longer), Err(FormatError::Truncated { .. })));
    }
}

#[test]
fn other_files_have_their_own_errors() {
    let (cloud, tree) = (small_cloud(), small_tree());
    let error = Cloud::open(&tree).err().unwrap();
    assert!(matches!(error, FormatError::WrongKind { .. }));
    assert_eq!(
        error.to_string(),
        "expected a cloud (.lvc), found a tree (.lvt)"
    );
    let error = Tree::open(&cloud).err().unwrap();
    assert!(matches!(error, FormatError::WrongKind { .. }));
    assert!(error.hint().unwrap().contains("build"));

    let error = Cloud::open(b"\x89PNG\r\n\x1a\nand so on").err().unwrap();
    assert!(matches!(error, FormatError::NotOurs { .. }));
    // A text transfer drops the carriage return.
    let mut text = cloud.clone();
    text.remove(4);
    assert!(matches!(
        Cloud::open(&text),
        Err(FormatError::NotOurs { .. })
    ));

    for found in [0u32, 2, 999] {
        let mut other = cloud.clone();
        other[12..16].copy_from_slice(&found.to_le_bytes());
        let error = Cloud::open(&other).err().unwrap();
        assert!(matches!(
            error,
            FormatError::Version {
                supported: VERSION,
                ..
            }
        ));
        assert!(error.to_string().contains(&found.to_string()));
    }
    assert_eq!(FileKind::of(&tree).unwrap(), FileKind::Tree);
    assert!(FileKind::of(&cloud[..9]).is_err());
}

#[test]
fn errors_name_the_file() {
    let dir = tempfile::tempdir().unwrap();
    let path = dir.path().join("scene.lvc");
    let error = Cloud::open_path(&path).err().unwrap();
    assert!(error.to_string().contains("scene.lvc") && error.io_error().is_some());
    std::fs::write(&path, "").unwrap();
    let error = Cloud::open_path(&path).err().unwrap();
    assert!(error.to_string().contains("scene.lvc"));
    let mut bytes = small_cloud();
    bytes[150] ^= 1;
    std::fs::write(&path, bytes).unwrap();
    let error = Cloud::open_path(&path).unwrap().verify().unwrap_err();
    assert!(error.to_string().contains("scene.lvc"), "{error}");
    assert!(matches!(error.cause(), FormatError::Checksum { .. }));
    assert!(Cloud::open_path(dir.path()).is_err(), "a folder");
}

#[test]
fn chunks_pages_and_parts_that_do_not_exist() {
    let (cloud, tree) = (small_cloud(), small_tree());
    let cloud = Cloud::open(cloud).unwrap();
    assert!(cloud.surfel_chunk(1).is_err() && cloud.lvoxel_chunk(9).is_err());
    let tree = Tree::open(tree).unwrap();
    assert!(tree.surfel_page(3).is_err() && tree.lvoxel_page(2).is_err());
    let scatter = Scatter::open(small_scatter()).unwrap();
    assert!(scatter.cluster(2).is_ok() && scatter.cluster(3).is_err());
}

/// Float numbers that no reader takes where light, an area or an extinction is meant.
const NOT_LIGHT: [f32; 4] = [f32::NAN, f32::INFINITY, -f32::INFINITY, -1.0];

/// Refused, as invalid and not as damaged, by the complete check and by the reader of each block;
/// the message says what is wrong.
#[track_caller]
fn refused(file: &[u8], read: Reader, says: &str) {
    let error = read(file).unwrap_err();
    assert!(
        matches!(error.cause(), FormatError::Invalid { .. }),
        "{error}"
    );
    assert!(error.to_string().contains(says), "{says}: {error}");
}

/// The file with one of its parts changed, and right checksums.
fn changed(file: &[u8], change: impl FnOnce(&mut Parts)) -> Vec<u8> {
    let mut parts = Parts::of(file);
    change(&mut parts);
    parts.file()
}

#[test]
fn files_put_together_again_are_whole() {
    for (bytes, read) in files() {
        let again = changed(&bytes, |_| {});
        read(&again).unwrap();
        let (a, b) = (Parts::of(&bytes), Parts::of(&again));
        assert!(a.meta == b.meta && a.summary == b.summary);
        assert!((a.blocks.iter().zip(&b.blocks)).all(|(a, b)| a.data == b.data));
    }
}

#[test]
fn scattered_light_that_is_no_light_is_refused() {
    let file = small_scatter();
    // Planes of `chosen`, then of the share and the light of its vertices.
    let start = 8 * CLUSTER_CUBES;
    for column in 0..2 {
        for value in NOT_LIGHT {
            let bytes = changed(&file, |parts| {
                let block = &mut parts.blocks[0];
                let rows = block.records as usize;
                let start = start + column * 12 * rows;
                block.set(0, (start, rows), [rows - 1, 8], &value.to_le_bytes());
            });
            let name = ["share", "light"][column];
            refused(&bytes, read_scatter, name);
            assert!(Scatter::open(&bytes).unwrap().cluster(0).is_err());
        }
    }
    // Vertices outside of the lattice, and other ones than the table counts.
    let bytes = changed(&file, |parts| {
        let at = CLUSTER_CUBES - 1;
        let first = parts.blocks[1].data[0]
            .1
            .iter()
            .position(|b| *b != 0)
            .unwrap();
        let block = &mut parts.blocks[1].data[0].1;
        block[at] = block[first];
        block[first] = 0;
    });
    refused(&bytes, read_scatter, "vertices of the cluster");
}

/// Each row of a packed scene that would lead a reader astray is refused.
#[test]
fn rows_of_packed_scenes_are_checked() {
    let file = small_packed();
    let opened = Packed::open(&file[..]).unwrap();
    let changed_row = |column: PackedColumn, at: usize, value: [u8; 4]| {
        let mut columns = opened.columns().iter();
        let (_, blocks) = columns.find(|(c, _)| c.column == column).unwrap();
        let block = blocks.start;
        changed(&file, |parts| {
            parts.blocks[block].data[0].1[at..at + 4].copy_from_slice(&value)
        })
    };
    let float = |v: f32| v.to_le_bytes();
    let whole = |v: u32| v.to_le_bytes();
    let leaf = |first: u32, count: u32| whole(1 << 31 | (count - 1) << 27 | first);
    let (of_second, children) = (224, 192);
    for (column, at, value, says) in [
        (
            PackedColumn::Positions,
            4,
            float(f32::NAN),
            "row 0 of the positions",
        ),
        (
            PackedColumn::Positions,
            20,
            float(5e15),
            "row 1 of the positions",
        ),
        (
            PackedColumn::Uvs,
            0,
            float(f32::INFINITY),
            "row 0 of the uvs",
        ),
        (
            PackedColumn::Triangles,
            12,
            whole(4),
            "row 1 of the triangles",
        ),
        (
            PackedColumn::Materials,
            4,
            whole(2),
            "row 1 of the materials",
        ),
        (
            PackedColumn::CodeValues,
            40,
            float(1.5),
            "row 10 of the code values",
        ),
        // A box that is none, and one of a child that is not there.
        (
            PackedColumn::Nodes,
            0,
            float(f32::NAN),
            "row 0 of the nodes",
        ),
        (PackedColumn::Nodes, 0, float(2.0), "row 0 of the nodes"),
        (PackedColumn::Nodes, 8, float(0.0), "row 0 of the nodes"),
        // Children: none with a box, nodes at or before their parent, beyond the end, leaves
        // beyond the blocks.
        (
            PackedColumn::Nodes,
            children,
            whole(0),
            "row 0 of the nodes",
        ),
        (
            PackedColumn::Nodes,
            of_second + children,
            whole(1),
            "row 1 of the nodes",
        ),
        (
            PackedColumn::Nodes,
            children,
            whole(2),
            "row 0 of the nodes",
        ),
        (
            PackedColumn::Nodes,
            children,
            leaf(2, 1),
            "row 0 of the nodes",
        ),
        (
            PackedColumn::Nodes,
            children,
            leaf(1, 2),
            "row 0 of the nodes",
        ),
        // A node of two parents, and one of none.
        (PackedColumn::Nodes, children, whole(1), "one parent"),
        (PackedColumn::Nodes, children + 4, leaf(1, 1), "one parent"),
        (PackedColumn::Blocks, 144, whole(2), "row 0 of the blocks"),
        (
            PackedColumn::Blocks,
            0,
            float(f32::NAN),
            "row 0 of the blocks",
        ),
        (PackedColumn::Blocks, 4, float(1.0), "row 0 of the blocks"),
    ] {
        refused(&changed_row(column, at, value), read_packed, says);
    }
    let dir = tempfile::tempdir().unwrap();
    let path = dir.path().join("b.lvp");
    let mut meta = packed_meta();
    meta.hierarchy.as_mut().unwrap().by_vertex = true;
    write_packed_as(&path, meta);
    let by_vertex = std::fs::read(path).unwrap();
    read_packed(&by_vertex).unwrap();
    let opened = Packed::open(&by_vertex[..]).unwrap();
    let mut columns = opened.columns().iter();
    let blocks = columns.find(|(c, _)| c.column == PackedColumn::VertexBlocks);
    let block = blocks.unwrap().1.start;
    for (at, value) in [(0, 4), (20, u32::MAX), (48, 2)] {
        let bytes = changed(&by_vertex, |parts| {
            parts.blocks[block].data[0].1[at..at + 4].copy_from_slice(&whole(value));
        });
        refused(&bytes, read_packed, "row 0 of the vertex blocks");
    }
}

/// Places whose maps, boxes or prototypes would lead a reader astray, and blocks of prototypes with
/// triangles of others.
#[test]
fn rows_of_instances_are_checked() {
    let dir = tempfile::tempdir().unwrap();
    let path = dir.path().join("i.lvp");
    let mut meta = packed_meta();
    meta.hierarchy = None;
    meta.parts.instances = Some(packed_instances());
    write_packed_as(&path, meta.clone());
    let file = std::fs::read(path).unwrap();
    read_packed(&file).unwrap();
    let opened = Packed::open(&file[..]).unwrap();
    assert_eq!(opened.meta(), &meta);
    let block = |column: PackedColumn, item: u32| {
        let mut columns = opened.columns().iter();
        let found = columns.find(|(c, _)| (c.column, c.item) == (column, item));
        found.unwrap().1.start
    };
    let changed_row = |column, item, at: usize, value: &[u8]| {
        let block = block(column, item);
        changed(&file, |parts| {
            parts.blocks[block].data[0].1[at..at + value.len()].copy_from_slice(value);
        })
    };
    let places = PackedColumn::Instances;
    for (at, value) in [
        (0, &f64::NAN.to_le_bytes()[..]),
        (8, &f64::INFINITY.to_le_bytes()),
        // Two columns alike: the map flattens space.
        (24, &[1.0_f64, 0.0, 0.0].map(f64::to_le_bytes).concat()),
        (96, &9_f32.to_le_bytes()),
        (116, &f32::INFINITY.to_le_bytes()),
        (120, &2_u32.to_le_bytes()),
        (124, &1_u32.to_le_bytes()),
    ] {
        let bytes = changed_row(places, 0, at, value);
        refused(&bytes, read_packed, "row 0 of the instances");
    }
    let bytes = changed_row(PackedColumn::Nodes, 2, 192, &1_u32.to_le_bytes());
    refused(&bytes, read_packed, "one parent");
    // A triangle of the first prototype among those of the second.
    let prototypes = &mut meta.parts.instances.as_mut().unwrap().prototypes;
    prototypes[1].first_triangle = 1;
    let path = dir.path().join("j.lvp");
    let mut writer = PackedWriter::create(&path, meta.clone(), Overwrite::Refuse).unwrap();
    let mut columns = meta.columns().into_iter();
    let written = columns.try_for_each(|c| {
        let going = || Ok::<_, FormatError>(());
        writer.column(c.column, c.item, &packed_rows(c.column), going)
    });
    let error = written.unwrap_err().to_string();
    assert!(error.contains("row 0 of the blocks"), "{error}");
}

/// Tables and pages of volumes say the same of each brick, and nothing that leads a reader astray.
#[test]
fn levels_of_packed_volumes_are_checked() {
    let file = small_packed();
    let opened = Packed::open(&file[..]).unwrap();
    let of_level = |level: usize| opened.level_blocks(0, level).unwrap();
    let with = |block: usize, at: usize, value: &[u8]| {
        changed(&file, |parts| {
            parts.blocks[block].data[0].1[at..at + value.len()].copy_from_slice(value)
        })
    };
    // The first table: a palette of seven values, then three bricks.
    let (palette, bricks) = (4, 4 + 7 * 4);
    let table = of_level(0).start;
    let (maxima, ends) = (bricks + 3 * 8, bricks + 3 * 12);
    for (at, value, says) in [
        (0, &[255, 255, 1, 0][..], "values of a palette"),
        (0, &[8], "palette"),
        (palette + 3 * 7 + 3, &[0x7f], "values of a palette"),
        (palette + 3 * 7, &[0x80], "values of a palette"),
        (bricks + 1, &[0], "place of brick 1"),
        (bricks + 2, &[2], "place of brick 2"),
        (bricks + 3 * 7, &[0xff], "place of brick 0"),
        (maxima + 3 * 3, &[0xff], "maximum of brick 0"),
        (maxima + 3 * 3, &[0x3e], "samples of the brick at [0, 0, 0]"),
        (ends + 1, &[0x80], "ends of brick 1"),
        (ends + 1, &[0x3f], "samples of the brick at [1, 0, 0]"),
    ] {
        refused(&with(table, at, value), read_packed, says);
    }
    // Numbers beyond the palette; bits that are no finite number; and another sample than before.
    let page = of_level(0).start + 1;
    refused(
        &with(page, 0, &[14]),
        read_packed,
        "numbers of the palette in brick 0",
    );
    let page = of_level(1).start + 1;
    refused(
        &with(page, 3 * 1024, &[0xff]),
        read_packed,
        "finite samples",
    );
    refused(
        &with(page, 1023, &[0xfe]),
        read_packed,
        "samples of the brick at [0, 0, 1]",
    );
    // Blocks that are not those that come next.
    for (change, says) in [
        (
            &|part: &mut Part| part.columns = 1 << 16 | 1 << 8 | 1,
            "coding",
        ),
        (&|part: &mut Part| part.columns = 0, "coding"),
        (&|part: &mut Part| part.records = 2, "a page of 3 bricks"),
        (&|part: &mut Part| part.nodes = 1, "of volume 0"),
    ] as [(&dyn Fn(&mut Part), &str); 4]
    {
        let page = of_level(0).start + 1;
        refused(
            &changed(&file, |parts| change(&mut parts.blocks[page])),
            read_packed,
            says,
        );
    }
    let swapped = changed(&file, |parts| parts.blocks.swap(table, table + 2));
    refused(&swapped, read_packed, "the table of 3 bricks");
    assert!(opened.level(0, 2).is_err() && opened.level(1, 0).is_err());
    let level = opened.level(0, 0).unwrap();
    assert!(opened.media_page(&level, 1, |_, _| ()).is_err());
}

#[test]
fn descriptions_of_packed_scenes_are_checked() {
    type Change = fn(&mut PackedMeta);
    fn masks(meta: &mut PackedMeta) -> &mut Vec<PackedMask> {
        &mut meta.parts.masks.insert(packed_masks()).masks
    }
    fn emission(meta: &mut PackedMeta, textures: &[[u32; 2]]) {
        let of = textures.iter();
        let of = of.map(|&[material, texture]| PackedEmissionTexture { material, texture });
        meta.parts.emission_textures = of.collect();
    }
    fn lens(meta: &mut PackedMeta) -> &mut PackedLens {
        meta.parts.lenses = packed_lenses();
        &mut meta.parts.lenses[0]
    }
    fn colors(meta: &mut PackedMeta, of: &[(u32, [f32; 3])]) {
        let of = of.iter().copied();
        let of = of.map(|(volume, color)| ExtinctionColor { volume, color });
        meta.parts.extinction_colors = of.collect();
    }
    fn albedos<'a>(meta: &'a mut PackedMeta, of: &[u32]) -> &'a mut [PackedVolume] {
        let mut channel = meta.volumes[0].clone();
        channel.levels.truncate(1);
        meta.volumes.extend(vec![channel; 3]);
        meta.parts.albedo_grids = of.to_vec();
        &mut meta.volumes[1..]
    }
    const RED: [f32; 3] = [1.0, 0.5, 0.25];
    fn instances(meta: &mut PackedMeta) -> &mut PackedInstances {
        meta.parts.instances.insert(packed_instances())
    }
    let changes: [(Change, &str); 55] = [
        (|m| instances(m).count = 0, "prototypes whose triangles"),
        (|m| instances(m).prototypes.clear(), "prototypes whose"),
        (
            |m| instances(m).prototypes[0].first_triangle = 3,
            "prototypes whose triangles",
        ),
        (
            |m| instances(m).prototypes[1].first_vertex = 0,
            "prototypes whose triangles",
        ),
        (
            |m| {
                let hierarchy = &mut instances(m).prototypes[1].hierarchy;
                hierarchy.as_mut().unwrap().scale = 0.3;
            },
            "hierarchy",
        ),
        (|m| m.film.width = 0, "film"),
        (|m| m.film.exposure = f32::NAN, "film"),
        (|m| m.cameras.clear(), "cameras"),
        (|m| m.cameras[0].fov_x_rad = 4.0, "camera"),
        (|m| m.cameras[0].scene_from_camera[1] = [0.0; 3], "camera"),
        (
            |m| {
                m.lights[1] = PackedLight::Environment {
                    radiance: [-1.0; 3],
                }
            },
            "light 1",
        ),
        (|m| m.environment.as_mut().unwrap().width = 5, "environment"),
        (
            |m| m.environment.as_mut().unwrap().scale[1] = -1.0,
            "environment",
        ),
        (
            |m| m.environment.as_mut().unwrap().rotation_rad = f32::NAN,
            "environment",
        ),
        (
            |m| m.environment.as_mut().unwrap().holes[0].0 = 8,
            "environment",
        ),
        (|m| m.materials[0].texture = Some(1), "a texture below 1"),
        (|m| m.materials[1].albedo[2] = 1.5, "albedo"),
        (|m| m.images[0].bits = 12, "image 0"),
        (|m| m.textures[0].image = 1, "texture 0"),
        (|m| m.textures[0].width = 4, "texture 0"),
        (|m| m.volumes[0].dims[1] = 0, "voxels"),
        (
            |m| m.volumes[0].phase.as_mut().unwrap().g[1] = 1.0,
            "mean cosines from -0.99",
        ),
        (
            |m| m.volumes[0].phase.as_mut().unwrap().mix = f32::NAN,
            "a weight from 0 to 1",
        ),
        (|m| m.volumes[0].levels[0] = 7, "at most 6 bricks"),
        (|m| m.volumes[0].levels.clear(), "levels"),
        (|m| m.volumes[0].levels = vec![1; 7], "single voxel"),
        (|m| m.volumes[0].scene_from_index[0] = [0.0; 3], "inverted"),
        (|m| m.mesh.triangles = 1 << 28, "mesh"),
        (|m| m.materials.clear(), "mesh"),
        (|m| m.areas.clear(), "areas"),
        (|m| m.areas[0] = f64::NAN, "areas"),
        (|m| m.hierarchy.as_mut().unwrap().scale = 0.3, "hierarchy"),
        (|m| m.hierarchy.as_mut().unwrap().blocks = 3, "hierarchy"),
        (|m| (m.tree_bytes, m.light_bytes) = (0, 1), "a tree with it"),
        (|m| masks(m).clear(), "some of 2 materials"),
        (|m| masks(m)[0].material = 2, "some of 2 materials"),
        (|m| masks(m)[0].cutoff = Some(1.5), "numbers from 0 to 1"),
        (|m| masks(m)[0].texture = Some(1), "a texture below 1"),
        (|m| emission(m, &[[2, 0]]), "textures of emission"),
        (|m| emission(m, &[[1, 1]]), "and textures below 1"),
        (|m| emission(m, &[[1, 0], [0, 0]]), "2 materials, in order"),
        (|m| lens(m).camera = 9, "lenses"),
        (|m| lens(m).lens = Some([-1.0, 2.0]), "lengths from 1e-15"),
        (|m| lens(m).keys.push(None), "each of its keys"),
        (|m| lens(m).shutter = Some([0.5, 0.5]), "before it closes"),
        (
            |m| {
                lens(m);
                m.parts.lenses = [packed_lenses(), packed_lenses()].concat();
            },
            "cameras in order",
        ),
        (|m| colors(m, &[(1, RED)]), "some of 1 media"),
        (|m| colors(m, &[(0, RED), (0, RED)]), "in order"),
        (|m| colors(m, &[(0, [1.0; 3])]), "that are not grey"),
        (|m| colors(m, &[(0, [0.5; 3])]), "the largest 1"),
        (
            |m| colors(m, &[(0, [1.0, f32::NAN, 1.0])]),
            "extinction colour",
        ),
        (|m| colors(m, &[(0, [1.0, 2.0, -1.0])]), "from 0 to 1"),
        (|m| m.parts.albedo_grids = vec![0], "albedo grids"),
        (|m| albedos(m, &[0])[0].dims[0] = 8, "as many voxels"),
        (
            |m| {
                albedos(m, &[1]);
            },
            "three volumes of one level",
        ),
    ];
    let dir = tempfile::tempdir().unwrap();
    for (change, says) in changes {
        let mut meta = packed_meta();
        change(&mut meta);
        let writer = PackedWriter::create(&dir.path().join("a"), meta, Overwrite::Refuse);
        let error = writer.err().unwrap();
        assert!(error.to_string().contains(says), "{says}: {error}");
    }
    // Bits of materials that no one knows yet; bits that are known.
    let file = small_packed();
    let material = find(&Parts::of(&file).meta, &[0, 0, 128, 63, 0, 0, 64, 64]) + 8;
    for (bits, is_right) in [
        (0, true),
        (1, true),
        (2, true),
        (3, true),
        (4, false),
        (255, false),
    ] {
        let bytes = changed(&file, |parts| parts.meta[material] = bits);
        match is_right {
            true => read_packed(&bytes).unwrap(),
            false => refused(&bytes, read_packed, "bits that are unknown"),
        }
    }
    // What the metadata says of columns is what there is of them.
    let file = small_packed();
    let texels = find(&Parts::of(&file).meta, &[6, 0, 0, 0, 0, 0, 0, 0, 1, 8]);
    let bytes = changed(&file, |parts| parts.meta[texels + 8] = 3);
    refused(&bytes, read_packed, "columns in the summary");
    let bytes = changed(&file, |parts| parts.blocks.swap(1, 2));
    refused(&bytes, read_packed, "block");
}

/// What is behind the description: masks, and what a reader does not know.
#[test]
fn parts_of_packed_scenes_are_read_or_refused() {
    let dir = tempfile::tempdir().unwrap();
    let path = dir.path().join("a.lvp");
    let mut meta = packed_meta();
    meta.parts.masks = Some(packed_masks());
    meta.parts.lenses = packed_lenses();
    write_packed_as(&path, meta.clone());
    let file = std::fs::read(path).unwrap();
    read_packed(&file).unwrap();
    let opened = Packed::open(&file[..]).unwrap();
    assert_eq!(opened.meta(), &meta);
    let rows = opened.rows(PackedColumn::Opacities, 0);
    assert_eq!(rows, packed_rows(PackedColumn::Opacities));
    let mut columns = opened.columns().iter();
    let opacities = columns.find(|(c, _)| c.column == PackedColumn::Opacities);
    let block = opacities.unwrap().1.start;
    let outside = changed(&file, |parts| {
        parts.blocks[block].data[0].1[4..8].copy_from_slice(&1.5_f32.to_le_bytes());
    });
    refused(&outside, read_packed, "row 1 of the opacities");
    // Behind a file without masks nothing stands, as programs expect that know of none.
    let plain = small_packed();
    let with = Parts::of(&file).meta;
    let first = Parts::of(&plain).meta.len();
    assert_eq!(with[first..first + 4], 1_u32.to_le_bytes());
    for (number, says) in [(0, "parts out of order"), (9, "unknown kind")] {
        let bytes = changed(&file, |parts| parts.meta[first] = number);
        refused(&bytes, read_packed, says);
    }
    let twice = changed(&file, |parts| {
        let again = parts.meta[first..].to_vec();
        parts.meta.extend(again);
    });
    refused(&twice, read_packed, "parts out of order");
    let cut = changed(&file, |parts| parts.meta.truncate(first + 3));
    refused(&cut, read_packed, "metadata");
    // Textures of emission, by themselves and behind masks.
    for masks in [None, Some(packed_masks())] {
        let path = dir.path().join(format!("{}.lvp", masks.is_some()));
        let mut meta = packed_meta();
        meta.parts.masks = masks;
        meta.parts.emission_textures = vec![PackedEmissionTexture {
            material: 1,
            texture: 0,
        }];
        write_packed_as(&path, meta.clone());
        let file = std::fs::read(path).unwrap();
        read_packed(&file).unwrap();
        assert_eq!(Packed::open(&file[..]).unwrap().meta(), &meta);
        // Number of the part, length of the list, one row.
        let end = Parts::of(&file).meta.len();
        let part = [2, 1, 0, 1, 0].map(u32::to_le_bytes).concat();
        assert_eq!(Parts::of(&file).meta[end - 20..], part);
        let none = changed(&file, |parts| {
            parts.meta.truncate(end - 16);
            parts.meta.extend([0; 8]);
        });
        refused(&none, read_packed, "a part that says nothing");
    }
    let path = dir.path().join("colors.lvp");
    let mut meta = packed_meta();
    meta.parts.lenses = packed_lenses();
    meta.parts.extinction_colors = vec![ExtinctionColor {
        volume: 0,
        color: [0.25, 1.0, 0.5],
    }];
    write_packed_as(&path, meta.clone());
    let file = std::fs::read(path).unwrap();
    read_packed(&file).unwrap();
    assert_eq!(Packed::open(&file[..]).unwrap().meta(), &meta);
}

/// The files of a volume that is not grey, and those of a grey one before them.
#[test]
fn extinction_colors_are_read_or_refused() {
    const COLOR: [f32; 3] = [0.25, 1.0, 0.5];
    for (i, (grey, read)) in files().into_iter().take(3).enumerate() {
        // Behind a file of grey media nothing stands, as programs expect that know of no colours.
        let end = Parts::of(&grey).meta.len();
        let part = |volumes: &[(u32, [f32; 3])]| {
            let mut part = 1_u32.to_le_bytes().to_vec();
            part.extend((volumes.len() as u64).to_le_bytes());
            for (volume, color) in volumes {
                part.extend(volume.to_le_bytes());
                part.extend(color.map(f32::to_le_bytes).as_flattened());
            }
            part
        };
        let with = |bytes: &[u8]| changed(&grey, |parts| parts.meta.extend(bytes));
        let colored = with(&part(&[(1, COLOR)]));
        read(&colored).unwrap();
        let volumes = match i {
            0 => Cloud::open(&colored[..]).unwrap().meta().volumes.clone(),
            1 => {
                let tree = Tree::open(&colored[..]).unwrap();
                tree.meta().cloud.volumes.clone()
            }
            _ => Scatter::open(&colored[..]).unwrap().meta().volumes.clone(),
        };
        assert_eq!(volumes[0].extinction_color, [1.0; 3]);
        assert_eq!(volumes[1].extinction_color, COLOR);
        let both = part(&[(0, [1.0, 0.0, 1.0]), (1, COLOR)]);
        read(&with(&both)).unwrap();
        let [twice, unknown] = [[&both[..], &both].concat(), [&[9], &both[1..]].concat()];
        for (bytes, says) in [
            (part(&[]), "a part that says nothing"),
            (part(&[(2, COLOR)]), "of no volume"),
            (part(&[(1, COLOR), (0, COLOR)]), "out of order"),
            (part(&[(1, COLOR), (1, COLOR)]), "out of order"),
            (part(&[(1, [1.0; 3])]), "that is grey"),
            (part(&[(1, [0.5; 3])]), "the largest 1"),
            (part(&[(1, [1.0, f32::NAN, 1.0])]), "extinction colour"),
            (part(&[(1, [1.0, f32::INFINITY, 1.0])]), "from 0 to 1"),
            (part(&[(1, [1.0, -0.5, 1.0])]), "from 0 to 1"),
            (twice, "parts out of order"),
            (unknown, "unknown kind"),
            (both[..both.len() - 1].to_vec(), "metadata"),
            ([&both[..], &[0]].concat(), "metadata"),
        ] {
            refused(&with(&bytes), read, says);
        }
        assert_eq!(Parts::of(&colored).meta.len() - end, 4 + 8 + 16);
    }
}

#[test]
fn clusters_outside_of_their_lattice_are_refused() {
    // In the summary: a count, then volume, level and place of each cluster.
    for (at, value, says) in [
        (8, 2, "a volume below 2"),
        (10, 4, "at most 3"),
        (10, u8::MAX, "at most 3"),
        (11, 5, "inside"),
        (12, 1, "inside"),
        (16, 200, "inside"),
    ] {
        let bytes = changed(&small_scatter(), |parts| parts.summary[at] = value);
        refused(&bytes, read_scatter, says);
        assert!(Scatter::open(&bytes).is_err(), "no stage gets hold of it");
    }
}

#[test]
fn values_of_clouds_are_checked() {
    let file = small_cloud();
    // Column, byte in the row, and what it must be.
    let columns = [
        (0, 4, "position"),
        (2, 0, "radius"),
        (3, 8, "front"),
        (4, 0, "back"),
    ];
    for (column, byte, says) in columns {
        for value in NOT_LIGHT
            .into_iter()
            .filter(|v| says != "position" || !v.is_finite())
        {
            let bytes = changed(&file, |parts| {
                let rows = parts.blocks[0].records as usize;
                parts.blocks[0].set(column, (0, rows), [rows - 1, byte], &value.to_le_bytes());
            });
            refused(&bytes, read_cloud, says);
            assert!(Cloud::open(&bytes).unwrap().surfel_chunk(0).is_err());
        }
    }
    // Volume, level, block and extinction of an lvoxel.
    for (column, value, says) in [
        (0, &[2, 0][..], "volume"),
        (1, &[4], "level"),
        (1, &[255], "level"),
        (2, &[0, 0, 255, 255], "block"),
        (3, &f32::NAN.to_le_bytes(), "sigma_t"),
        (4, &(-1f32).to_le_bytes(), "source"),
        (5, &[127], "lobe"),
    ] {
        let bytes = changed(&file, |parts| {
            let rows = parts.blocks[1].records as usize;
            parts.blocks[1].set(column, (0, rows), [1, 0], value);
        });
        refused(&bytes, read_cloud, says);
        assert!(Cloud::open(&bytes).unwrap().lvoxel_chunk(0).is_err());
    }
}

#[test]
fn values_of_trees_are_checked() {
    let file = small_tree();
    let page = &Parts::of(&file).blocks[0];
    let nodes = page.nodes as usize;
    // Areas of nodes are the first four bytes behind kinds and boxes.
    let areas = (64 + 13 * nodes, nodes);
    for value in NOT_LIGHT {
        let bytes = changed(&file, |parts| {
            parts.blocks[0].set(0, areas, [1, 0], &value.to_le_bytes());
        });
        refused(&bytes, read_tree, "area of node 1");
        let tree = Tree::open(&bytes).unwrap();
        assert!(tree.surfel_nodes(0, &mut Vec::new()).is_err());
    }
    // An area whose sum of normals is infinite, by a code beyond -1.
    let bytes = changed(&file, |parts| {
        let page = &mut parts.blocks[0];
        page.set(0, areas, [1, 0], &f32::MAX.to_le_bytes());
        let normals = (64 + (13 + 4 + 6) * nodes, nodes);
        page.set(0, normals, [1, 0], &i16::MIN.to_le_bytes());
    });
    refused(&bytes, read_tree, "normal sum of node 1");
    // The page's box, and a radius base of NaN.
    for (at, says) in [(24, "box of the page"), (48, "radius")] {
        let bytes = changed(&file, |parts| {
            parts.blocks[0].data[0].1[at..at + 4].copy_from_slice(&f32::NAN.to_le_bytes());
        });
        refused(&bytes, read_tree, says);
    }
    // The volume of a page of lvoxels, and their levels behind its header.
    for (at, value, says) in [(14, 2, "volume"), (20, 4, "gap"), (20, 255, "gap")] {
        let bytes = changed(&file, |parts| {
            parts.blocks.last_mut().unwrap().data[0].1[at] = value;
        });
        refused(&bytes, read_tree, says);
        assert!(Tree::open(&bytes).unwrap().lvoxel_page(1).is_err());
    }
}

/// Where `bytes` are in a section, the first time.
fn find(section: &[u8], bytes: &[u8]) -> usize {
    let found = section.windows(bytes.len()).position(|w| w == bytes);
    found.unwrap()
}

#[test]
fn values_of_metadata_and_summary_are_checked() {
    let albedo: Vec<u8> = [0.9f32, 0.8, 0.7]
        .iter()
        .flat_map(|v| v.to_le_bytes())
        .collect();
    let dims: Vec<u8> = [64u32, 32, 100]
        .iter()
        .flat_map(|v| v.to_le_bytes())
        .collect();
    let column: Vec<u8> = [10f64, 0.0, 0.0]
        .iter()
        .flat_map(|v| v.to_le_bytes())
        .collect();
    // A packed scene has checks of its own.
    for (bytes, read) in files().into_iter().take(3) {
        let meta = Parts::of(&bytes).meta;
        let [albedo, dims, column] = [&albedo, &dims, &column].map(|b| find(&meta, b));
        for (at, value, says) in [
            (albedo, &1.5f32.to_le_bytes()[..], "albedo"),
            (albedo + 8, &f32::NAN.to_le_bytes(), "albedo"),
            (albedo, &(-0.1f32).to_le_bytes(), "albedo"),
            (dims, &[0; 4], "size"),
            (dims + 4, &[0, 0, 9, 0], "size"),
            (dims + 8, &[255; 4], "size"),
            (column, &f64::NAN.to_le_bytes(), "place"),
            (column, &1e300f64.to_le_bytes(), "place"),
            (column, &[0; 8], "place"),
        ] {
            let changed = changed(&bytes, |parts| {
                parts.meta[at..at + value.len()].copy_from_slice(value);
            });
            refused(&changed, read, says);
        }
    }
    // Sums begin with a count, an area and three fluxes.
    for (bytes, read) in &files()[..2] {
        for at in [8, 16, 32] {
            for value in [f64::NAN, f64::INFINITY, -1.0] {
                let changed = changed(bytes, |parts| {
                    parts.summary[at..at + 8].copy_from_slice(&value.to_le_bytes());
                });
                refused(&changed, *read, "sums in the summary");
            }
        }
        // Counts of lvoxels whose sum is right where it may pass the largest number.
        let changed = changed(bytes, |parts| {
            let sums = &mut parts.summary[48..];
            let count =
                |sums: &[u8], at: usize| u64::from_le_bytes(sums[at..at + 8].try_into().unwrap());
            let (a, b) = (count(sums, 0), count(sums, 16));
            sums[..8].copy_from_slice(&a.wrapping_sub(b + 1).to_le_bytes());
            sums[16..24].copy_from_slice(&(2 * b + 1).to_le_bytes());
        });
        read(&changed).unwrap_err();
    }
}

proptest! {
    #![proptest_config(ProptestConfig {
        failure_persistence: None,
        ..ProptestConfig::with_cases(3000)
    })]

    /// Correct checksums over wrong bytes: any result will do, but it must come, and a page that is
    /// returned must be safe to walk.
    #[test]
    fn hostile_files(
        file in 0_usize..4,
        changes in prop::collection::vec((any::<prop::sample::Index>(), any::<u8>()), 1..4),
    ) {
        static FILES: std::sync::OnceLock<[Vec<u8>; 4]> = std::sync::OnceLock::new();
        let files = FILES.get_or_init(|| files().map(|(bytes, _)| bytes));
        let mut bytes = files[file].clone();
        for (at, value) in changes {
            let at = at.index(bytes.len());
            bytes[at] = value;
        }
        repair(&mut bytes);
        let _ = read_cloud(&bytes);
        let _ = read_packed(&bytes);
        if let Ok(scatter) = Scatter::open(&bytes) {
            let _ = scatter.verify();
            for (i, block) in scatter.blocks().iter().enumerate() {
                let Ok(cluster) = scatter.cluster(i) else { continue };
                prop_assert_eq!(cluster.len(), block.records as usize);
                for light in [&cluster.share, &cluster.light] {
                    prop_assert!(light.is_empty() || light.len() == cluster.len());
                }
            }
        }
        let Ok(tree) = Tree::open(&bytes) else { return Ok(()) };
        let _ = tree.verify();
        for i in 0..tree.surfel_pages() {
            let Ok(page) = tree.surfel_page(i) else { continue };
            for (n, node) in page.nodes.iter().enumerate() {
                match node.below {
                    Below::Nodes { first, count } => {
                        prop_assert!(first as usize > n && count > 0);
                        prop_assert!(first as usize + usize::from(count) <= page.nodes.len());
                    }
                    Below::Surfels { first, count } => {
                        let end = first as usize + usize::from(count);
                        prop_assert!(count > 0 && end <= page.surfels.len());
                    }
                    Below::Page(link) => prop_assert!((link as usize) < i),
                }
            }
        }
    }
}
