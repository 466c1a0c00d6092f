//! Descriptions of packed scenes that would lead a reader astray.

use super::*;

type Change = fn(&mut PackedMeta);

const RED: [f32; 3] = [1.0, 0.5, 0.25];

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

fn instances(meta: &mut PackedMeta) -> &mut PackedInstances {
    meta.parts.instances.insert(packed_instances())
}

/// Changes of a description that is right, and what is said of each.
const CHANGES: [(Change, &str); 55] = [
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

#[test]
fn descriptions_of_packed_scenes_are_checked() {
    let dir = tempfile::tempdir().unwrap();
    for (change, says) in CHANGES {
        let mut meta = packed_meta();
        change(&mut meta);
        let writer = PackedWriter::create(&dir.path().join("a"), meta, Overwrite::Refuse);
        let error = writer.err().unwrap();
        assert!(error.to_string().contains(says), "{says}: {error}");
    }
}

/// Bits of materials that no one knows yet; bits that are known.
#[test]
fn bits_of_materials_are_those_that_are_known() {
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
}

/// What the metadata says of columns is what there is of them.
#[test]
fn columns_are_those_of_the_summary() {
    let file = small_packed();
    let texels = find(&Parts::of(&file).meta, &[6, 0, 0, 0, 0, 0, 0, 0, 1, 8]);
    let bytes = changed(&file, |parts| parts.meta[texels + 8] = 3);
    refused(&bytes, read_packed, "columns in the summary");
    let bytes = changed(&file, |parts| parts.blocks.swap(1, 2));
    refused(&bytes, read_packed, "block");
}
