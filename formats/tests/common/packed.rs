//! Packed scenes.

use super::*;

/// The description of two triangles under a node, with a texture and a volume.
pub fn packed_meta() -> PackedMeta {
    let axes = |s: f64| {
        [
            [s, 0.0, 0.0],
            [0.0, s, 0.0],
            [0.0, 0.0, s],
            [-0.5, 0.0, 0.2],
        ]
    };
    let material = |name: &str, texture| PackedMaterial {
        name: name.into(),
        albedo: [0.7, 0.5, 0.2],
        texture,
        emission: [0.0, 1.0, 3.0],
        emits_both_sides: texture.is_none(),
        is_unseen: false,
    };
    PackedMeta {
        scene_hash: [9; 32],
        scene_name: "packed".into(),
        world_from_scene: [1e6, 0.0, -3.0],
        film: PackedFilm {
            width: 64,
            height: 48,
            exposure: 1.5,
        },
        frame: Some(7),
        cameras: vec![PackedCamera {
            name: "front".into(),
            scene_from_camera: axes(1.0).map(|c| c.map(|v| v as f32)),
            fov_x_rad: 0.7,
            keys: vec![
                PackedCameraKey {
                    frame: -1,
                    position: [0.0, 1.0, 4.0],
                    target: [0.0; 3],
                    up: [0.0, 1.0, 0.0],
                    fov_x_rad: 0.7,
                },
                PackedCameraKey {
                    frame: 24,
                    position: [2.0, 1.0, 4.0],
                    target: [0.0; 3],
                    up: [0.0, 1.0, 0.0],
                    fov_x_rad: 0.5,
                },
            ],
        }],
        lights: vec![
            PackedLight::Point {
                position: [0.0, 2.0, 1.0],
                intensity: [5.0; 3],
            },
            PackedLight::Environment { radiance: [0.1; 3] },
        ],
        environment: Some(PackedEnvironment {
            width: 4,
            height: 2,
            scale: [1.0, 2.0, 0.5],
            rotation_rad: 0.25,
            holes: vec![(3, [0.5; 3])],
        }),
        materials: vec![material("a", Some(0)), material("b", None)],
        images: vec![PackedImage {
            texels: 6,
            channels: 1,
            bits: 8,
        }],
        textures: vec![PackedTexture {
            image: 0,
            width: 3,
            height: 2,
            wrap: [PackedWrap::Clamp, PackedWrap::Repeat],
        }],
        volumes: vec![PackedVolume {
            name: "fog".into(),
            dims: [9, 5, 20],
            albedo: [0.9, 0.8, 0.7],
            phase: Some(PackedPhase {
                g: [0.9, -0.2],
                mix: 0.7,
            }),
            scene_from_index: axes(0.1),
            levels: packed_levels().iter().map(|l| l.len() as u64).collect(),
        }],
        warnings: vec!["none".into()],
        mesh: PackedMesh {
            vertices: 4,
            triangles: 2,
            degenerate: 1,
            has_uvs: true,
            ..PackedMesh::default()
        },
        areas: vec![2.0, 2.0],
        hierarchy: Some(PackedHierarchy {
            nodes: 2,
            blocks: 2,
            by_vertex: false,
            scale: 0.5,
        }),
        tree_bytes: 5,
        light_bytes: 0,
        parts: PackedParts::default(),
    }
}

/// Masks of the second of its materials, with factors at vertices.
pub fn packed_masks() -> PackedMasks {
    PackedMasks {
        masks: vec![PackedMask {
            material: 1,
            opacity: 0.75,
            texture: Some(0),
            cutoff: Some(0.5),
        }],
        has_opacities: true,
    }
}

/// A lens of its camera, and a shutter.
pub fn packed_lenses() -> Vec<PackedLens> {
    let camera = &packed_meta().cameras[0];
    vec![PackedLens {
        camera: 0,
        lens: Some([0.5, 2.0]),
        keys: vec![None; camera.keys.len()],
        shutter: Some([-0.25, 0.25]),
    }]
}

/// A column of the scene that [`packed_meta`] describes.
pub fn packed_rows(column: PackedColumn) -> Vec<u8> {
    let corners = [
        [-1.0, 0.0, -1.0],
        [-1.0, 0.0, 1.0],
        [1.0, 0.0, 1.0],
        [1.0, 0.0, -1.0_f32],
    ];
    let floats = |v: &[f32]| v.iter().flat_map(|v| v.to_le_bytes()).collect::<Vec<u8>>();
    let whole = |v: &[u32]| v.iter().flat_map(|v| v.to_le_bytes()).collect::<Vec<u8>>();
    let triangles = [[0, 1, 2], [0, 2, 3]];
    let leaf = |block: u32| 1 << 31 | block;
    match column {
        PackedColumn::Positions => floats(corners.as_flattened()),
        PackedColumn::Uvs => floats(&[0.25; 8]),
        PackedColumn::Triangles => whole(triangles.as_flattened()),
        PackedColumn::Materials => whole(&[0, 1]),
        PackedColumn::Opacities => floats(&[1.0, 0.5, 0.25, 0.0]),
        PackedColumn::ByteCodes => vec![0, 1, 2, 3, 254, 255],
        PackedColumn::Environment => floats(&[3.0; 24]),
        PackedColumn::CodeValues => floats(&[0.5; 256]),
        PackedColumn::Instances => {
            let map = [1.0_f64, 0., 0., 0., 2., 0., 0., 0., -1., 5., 0., 1.];
            let place = |prototype: u32| {
                let mut row: Vec<u8> = map.iter().flat_map(|v| v.to_le_bytes()).collect();
                row.extend(floats(&[-1.0, 0.0, -1.0, 1.0, 2.0, 1.0]));
                row.extend(whole(&[prototype, 0]));
                row
            };
            [place(1), place(0), place(1)].concat()
        }
        PackedColumn::Nodes => {
            // The first has a leaf and the second, that another leaf.
            let node = |children: [u32; 2]| {
                let mut node = Vec::new();
                for (end, absent) in [(-1.0, f32::INFINITY), (1.0, f32::NEG_INFINITY)] {
                    for _ in 0..3 {
                        let of = |k: usize| {
                            if k < 2 && children[k] != 0 {
                                end
                            } else {
                                absent
                            }
                        };
                        node.extend(floats(&std::array::from_fn::<f32, 8, _>(of)));
                    }
                }
                let child = |k: usize| children.get(k).copied().unwrap_or(0);
                node.extend(whole(&std::array::from_fn::<u32, 8, _>(child)));
                node
            };
            [node([leaf(0), 1]), node([leaf(1), 0])].concat()
        }
        PackedColumn::Blocks => {
            let block = |t: usize| {
                let number = |i: usize| {
                    let (corner, axis, lane) = (i / 12, i / 4 % 3, i % 4);
                    let vertex = triangles[t][corner] as usize;
                    if lane == 0 {
                        0.5 * corners[vertex][axis]
                    } else {
                        f32::NAN
                    }
                };
                let corners = floats(&std::array::from_fn::<f32, 36, _>(number));
                let none = u32::MAX;
                [corners, whole(&[t as u32, none, none, none])].concat()
            };
            [block(0), block(1)].concat()
        }
        PackedColumn::VertexBlocks => {
            let none = u32::MAX;
            let block = |t: usize| {
                let [a, b, c] = triangles[t].map(|v| whole(&[v; 4]));
                [a, b, c, whole(&[t as u32, none, none, none])].concat()
            };
            [block(0), block(1)].concat()
        }
        PackedColumn::BrickErrors => floats(&[0.5, 1.0, 2.0, 0.0, 0.0, 0.0, 0.1, 0.2, 1e9]),
        PackedColumn::Tree => b"a tre".to_vec(),
        _ => Vec::new(),
    }
}

/// An empty prototype, and one of both triangles, with the hierarchy over all; for a scene in which
/// nothing lies flat.
pub fn packed_instances() -> PackedInstances {
    let prototype = |first_vertex, hierarchy| PackedPrototype {
        first_triangle: 0,
        first_vertex,
        hierarchy,
    };
    PackedInstances {
        prototypes: vec![prototype(2, None), prototype(3, packed_meta().hierarchy)],
        count: 3,
    }
}

/// Levels of the volume that [`packed_meta`] describes, in Morton order: one of few values, and one
/// of many.
pub fn packed_levels() -> [Vec<([u32; 3], BrickSamples)>; 2] {
    let few = |b: usize| std::array::from_fn(|i| ((i + b) % 7) as f32 * 0.3);
    let many = |b: usize| std::array::from_fn(|i| ((i * 37 + b) as f32).sqrt());
    [
        vec![([0; 3], few(0)), ([1, 0, 0], few(1)), ([0, 0, 2], few(2))],
        vec![([0; 3], many(0)), ([0, 0, 1], many(1))],
    ]
}

/// Writes the scene that [`packed_meta`] describes.
pub fn write_packed(path: &Path) {
    write_packed_as(path, packed_meta());
}

/// Writes it with another description of the same columns.
pub fn write_packed_as(path: &Path, meta: PackedMeta) {
    let mut writer = PackedWriter::create(path, meta.clone(), Overwrite::Refuse).unwrap();
    for column in meta.columns() {
        let rows = packed_rows(column.column);
        let going = || Ok::<_, FormatError>(());
        writer
            .column(column.column, column.item, &rows, going)
            .unwrap();
    }
    for level in packed_levels() {
        let entry =
            |(place, samples): &([u32; 3], BrickSamples)| BrickEntry::of(*place, samples).unwrap();
        let (palette, index) = Palette::of(level.iter().map(|(_, samples)| *samples)).unzip();
        let table = BrickTable::new(level.iter().map(entry).collect());
        writer.level(&table, palette.as_ref()).unwrap();
        let samples: Vec<BrickSamples> = level.into_iter().map(|(_, samples)| samples).collect();
        let page = MediaPage::encode(&samples, index.as_ref()).unwrap();
        writer.page(&page).unwrap();
    }
    writer.finish().unwrap();
}
