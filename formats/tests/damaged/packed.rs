//! Packed scenes whose rows, levels, descriptions and parts would lead a reader astray.

mod descriptions;

use super::*;

fn float(v: f32) -> [u8; 4] {
    v.to_le_bytes()
}

fn whole(v: u32) -> [u8; 4] {
    v.to_le_bytes()
}

/// A packed scene with another value in a column, refused with these words.
#[track_caller]
fn row_refused(column: PackedColumn, at: usize, value: [u8; 4], says: &str) {
    let file = small_packed();
    let opened = Packed::open(&file[..]).unwrap();
    let mut columns = opened.columns().iter();
    let (_, blocks) = columns.find(|(c, _)| c.column == column).unwrap();
    let block = blocks.start;
    let bytes = changed(&file, |parts| {
        parts.blocks[block].data[0].1[at..at + 4].copy_from_slice(&value)
    });
    refused(&bytes, read_packed, says);
}

/// Each row of a packed scene that would lead a reader astray is refused.
#[test]
fn rows_of_packed_scenes_are_checked() {
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
        (PackedColumn::Blocks, 144, whole(2), "row 0 of the blocks"),
        (
            PackedColumn::Blocks,
            0,
            float(f32::NAN),
            "row 0 of the blocks",
        ),
        (PackedColumn::Blocks, 4, float(1.0), "row 0 of the blocks"),
    ] {
        row_refused(column, at, value, says);
    }
}

#[test]
fn nodes_of_packed_scenes_are_checked() {
    let leaf = |first: u32, count: u32| whole(1 << 31 | (count - 1) << 27 | first);
    let (of_second, children) = (224, 192);
    for (at, value, says) in [
        // A box that is none, and one of a child that is not there.
        (0, float(f32::NAN), "row 0 of the nodes"),
        (0, float(2.0), "row 0 of the nodes"),
        (8, float(0.0), "row 0 of the nodes"),
        // Children: none with a box, nodes at or before their parent, beyond the end, leaves
        // beyond the blocks.
        (children, whole(0), "row 0 of the nodes"),
        (of_second + children, whole(1), "row 1 of the nodes"),
        (children, whole(2), "row 0 of the nodes"),
        (children, leaf(2, 1), "row 0 of the nodes"),
        (children, leaf(1, 2), "row 0 of the nodes"),
        // A node of two parents, and one of none.
        (children, whole(1), "one parent"),
        (children + 4, leaf(1, 1), "one parent"),
    ] {
        row_refused(PackedColumn::Nodes, at, value, says);
    }
}

#[test]
fn vertex_blocks_of_packed_scenes_are_checked() {
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

/// Errors of bricks are numbers, of volumes of many voxels alone.
#[test]
fn errors_of_bricks_are_checked() {
    let dir = tempfile::tempdir().unwrap();
    let path = dir.path().join("e.lvp");
    let mut meta = packed_meta();
    meta.parts.brick_errors = vec![0];
    let refuse = |meta: &PackedMeta| {
        let path = dir.path().join("f.lvp");
        let error = PackedWriter::create(&path, meta.clone(), Overwrite::Replace);
        let error = error.map(drop).unwrap_err().to_string();
        assert!(error.contains("of many voxels"), "{error}");
    };
    refuse(&meta);
    meta.volumes[0].dims = [256, 256, 64];
    meta.parts.brick_errors = vec![0, 0];
    refuse(&meta);
    meta.parts.brick_errors = vec![1];
    refuse(&meta);
    meta.parts.brick_errors = vec![0];
    write_packed_as(&path, meta.clone());
    let file = std::fs::read(path).unwrap();
    read_packed(&file).unwrap();
    let opened = Packed::open(&file[..]).unwrap();
    assert_eq!(opened.meta(), &meta);
    let rows = packed_rows(PackedColumn::BrickErrors);
    assert_eq!(opened.rows(PackedColumn::BrickErrors, 0), rows);
    let mut columns = opened.columns().iter();
    let block = columns.find(|(c, _)| c.column == PackedColumn::BrickErrors);
    let block = block.unwrap().1.start;
    for value in [-1.0, f32::NAN, f32::INFINITY] {
        let bytes = changed(&file, |parts| {
            parts.blocks[block].data[0].1[16..20].copy_from_slice(&value.to_le_bytes());
        });
        refused(&bytes, read_packed, "row 1 of the errors of bricks");
    }
}

/// Digests of parts of a scene are there whole, or refused.
#[test]
fn digests_are_checked() {
    let dir = tempfile::tempdir().unwrap();
    let path = dir.path().join("d.lvp");
    let mut meta = packed_meta();
    let digest = |name: &str, digit: &str| (name.to_owned(), digit.repeat(32));
    for wrong in [
        vec![digest("volumes", "0")],
        vec![digest("scene/volumes", "g")],
        vec![digest("scene/lights", "0")],
        vec![digest("scene/volumes", "00")],
        vec![digest("scene/volumes", "0"), digest("scene/surfaces", "1")],
        vec![digest("scene/volumes", "0"), digest("scene/volumes", "0")],
    ] {
        meta.parts.digests = wrong;
        let error = PackedWriter::create(&path, meta.clone(), Overwrite::Replace);
        let error = error.map(drop).unwrap_err().to_string();
        assert!(error.contains("32 hexadecimal digits"), "{error}");
    }
    meta.parts.digests = vec![digest("scene/surfaces", "a"), digest("scene/volumes", "9")];
    write_packed_as(&path, meta.clone());
    let file = std::fs::read(path).unwrap();
    read_packed(&file).unwrap();
    assert_eq!(Packed::open(&file[..]).unwrap().meta(), &meta);
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
