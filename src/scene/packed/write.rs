//! A scene to what a packed file holds of it.

use super::{check_machine, instances};
use crate::Result;
use crate::formats::{
    BrickTable, ExtinctionColor, MediaPage, PAGE_BRICKS, PackedCamera, PackedCameraKey,
    PackedColumn, PackedEmissionTexture, PackedEnvironment, PackedFilm, PackedImage, PackedLens,
    PackedLight, PackedMask, PackedMasks, PackedMaterial, PackedMesh, PackedMeta, PackedParts,
    PackedPhase, PackedTexture, PackedVolume, PackedWrap, PackedWriter, Palette,
};
use crate::run::Cancel;
use crate::scene::grid::VolumeGrid;
use crate::scene::texture::{CodeValues, Texels};
use crate::scene::{
    AlbedoGrid, Camera, CameraKey, Emission, EmissiveVolume, EnvironmentImage, Grid, Lens, Light,
    Material, Scene, Texture, Volume, Wrap,
};
use rayon::prelude::*;

/// Levels of a volume that are packed, at most.
const MOST_LEVELS: usize = 16;

/// Pages that are coded at a time, and then written.
const PAGES_AT_A_TIME: usize = 64;

/// By volume and level, which bricks it has.
pub type LevelTables = Vec<Vec<BrickTable>>;

/// The tables of all levels of the volumes of a scene.
///
/// # Errors
/// A level of a packed scene that cannot be read.
pub fn level_tables(scene: &Scene) -> Result<LevelTables> {
    let of = |volume: Stored<'_>| {
        let table = |grid: &Grid| BrickTable::new(grid.entries());
        Ok(volume.levels()?.into_iter().map(table).collect())
    };
    stored(scene).map(of).collect()
}

/// A volume of a packed scene.
#[derive(Clone, Copy)]
enum Stored<'a> {
    /// A medium, or one that light comes from, with its levels.
    Volume(&'a Volume),
    /// A channel of the albedo of a medium.
    Albedo(&'a Volume, &'a VolumeGrid),
}

/// The volumes of a packed scene: media, their albedos, and what light comes from.
fn stored(scene: &Scene) -> impl Iterator<Item = Stored<'_>> {
    let albedos = scene.volumes.iter().flat_map(|v| {
        let channels = v.albedo_grid.iter().flat_map(AlbedoGrid::channels);
        channels.map(move |grid| Stored::Albedo(v, grid))
    });
    let emissive = scene.emissive.iter().map(|e| Stored::Volume(&e.values));
    let media = scene.volumes.iter().map(Stored::Volume);
    media.chain(albedos).chain(emissive)
}

impl<'a> Stored<'a> {
    fn levels(self) -> Result<Vec<&'a Grid>> {
        match self {
            Self::Volume(volume) => levels(volume),
            Self::Albedo(_, grid) => {
                grid.ready()?;
                Ok(vec![grid])
            }
        }
    }

    fn describe(self, tables: &[BrickTable]) -> PackedVolume {
        match self {
            Self::Volume(of) => volume(of, tables),
            Self::Albedo(of, _) => PackedVolume {
                name: format!("albedo of {}", of.name),
                phase: None,
                ..volume(of, tables)
            },
        }
    }
}

/// The levels of a volume, down to that of a single voxel, but no more than a file has room for.
///
/// # Errors
/// One that cannot be read: its grid is empty, and must not be taken for what is stored.
fn levels(volume: &Volume) -> Result<Vec<&Grid>> {
    let mut levels: Vec<&VolumeGrid> = Vec::new();
    while levels.last().is_none_or(|l| l.dims() != [1; 3]) && levels.len() < MOST_LEVELS {
        levels.push(volume.level(levels.len()));
    }
    levels.iter().try_for_each(|grid| grid.ready())?;
    Ok(levels.into_iter().map(|grid| &**grid).collect())
}

/// What a packed file says of a scene with these levels of volumes, without what is made of its
/// triangles, a tree and scattered light.
#[must_use]
pub fn description(scene: &Scene, tables: &LevelTables) -> PackedMeta {
    let mesh = &scene.mesh;
    let film = &scene.film;
    let (images, numbers) = images(&scene.textures);
    let textures = scene.textures.iter().zip(numbers);
    let volumes = stored(scene).zip(tables);
    PackedMeta {
        scene_hash: scene.hash,
        scene_name: scene.name.clone(),
        world_from_scene: scene.world_from_scene.to_array(),
        film: PackedFilm {
            width: film.width,
            height: film.height,
            exposure: film.exposure,
        },
        frame: scene.files_of_frame,
        cameras: scene.cameras.iter().map(camera).collect(),
        lights: lights(scene),
        environment: scene.environment_image.as_ref().map(environment),
        materials: scene.materials.iter().map(material).collect(),
        images: images.into_iter().map(image).collect(),
        textures: textures.map(|(t, image)| texture(t, image)).collect(),
        volumes: volumes.map(|(v, tables)| v.describe(tables)).collect(),
        warnings: scene.warnings.clone(),
        mesh: PackedMesh {
            vertices: mesh.positions.len() as u64,
            triangles: mesh.triangles.len() as u64,
            degenerate: mesh.degenerate,
            has_normals: !mesh.normals.is_empty(),
            has_colors: !mesh.colors.is_empty(),
            has_uvs: !mesh.uvs.is_empty(),
        },
        areas: Vec::new(),
        hierarchy: None,
        tree_bytes: 0,
        light_bytes: 0,
        parts: PackedParts {
            masks: masks(scene),
            emission_textures: emission_textures(scene),
            lenses: lenses(scene),
            extinction_colors: extinction_colors(scene),
            albedo_grids: albedo_grids(scene),
            brick_errors: brick_errors(scene, tables),
            instances: instances::description(mesh),
            digests: scene.parts_of_assets(),
        },
    }
}

/// A texture of each image, and the number of the image of each texture.
fn images(textures: &[Texture]) -> (Vec<&Texture>, Vec<u32>) {
    let mut images: Vec<&Texture> = Vec::new();
    let numbers = textures.iter().map(|texture| {
        let known = images.iter().position(|t| t.shares_texels(texture));
        known.unwrap_or_else(|| {
            images.push(texture);
            images.len() - 1
        }) as u32
    });
    let numbers = numbers.collect();
    (images, numbers)
}

fn image(texture: &Texture) -> PackedImage {
    let channels = match &texture.texels {
        Texels::Linear(_) => 3,
        Texels::Coded(codes, _) => codes.channels as u8,
    };
    PackedImage {
        texels: texture.texels().len() as u64,
        channels,
        bits: texture.bits() as u8,
    }
}

fn texture(texture: &Texture, image: u32) -> PackedTexture {
    let wrap = |wrap: Wrap| match wrap {
        Wrap::Repeat => PackedWrap::Repeat,
        Wrap::Clamp => PackedWrap::Clamp,
        Wrap::Mirror => PackedWrap::Mirror,
    };
    PackedTexture {
        image,
        width: texture.width,
        height: texture.height,
        wrap: texture.wrap.map(wrap),
    }
}

fn camera(camera: &Camera) -> PackedCamera {
    let map = camera.scene_from_camera;
    let columns = [
        map.matrix3.x_axis,
        map.matrix3.y_axis,
        map.matrix3.z_axis,
        map.translation,
    ];
    PackedCamera {
        name: camera.name.clone(),
        scene_from_camera: columns.map(|c| c.to_array()),
        fov_x_rad: camera.fov_x_rad,
        keys: camera.keys.iter().map(key).collect(),
    }
}

fn key(key: &CameraKey) -> PackedCameraKey {
    PackedCameraKey {
        frame: key.frame,
        position: key.position.to_array(),
        target: key.target.to_array(),
        up: key.up.to_array(),
        fov_x_rad: key.fov_x_rad,
    }
}

fn lights(scene: &Scene) -> Vec<PackedLight> {
    let unseen = (!scene.is_environment_seen).then_some(PackedLight::UnseenEnvironment);
    let albedos = scene.volumes.iter().filter_map(|v| v.albedo_grid.as_ref());
    let channels = albedos.map(|grid| grid.channels().len()).sum::<usize>();
    let others = (scene.volumes.len() + channels) as u32;
    let emissive = (others..).zip(&scene.emissive).map(emissive_volume);
    let lights = scene.lights.iter().map(light).chain(unseen);
    lights.chain(emissive).collect()
}

fn light(light: &Light) -> PackedLight {
    match *light {
        Light::Point {
            position,
            intensity,
        } => PackedLight::Point {
            position: position.to_array(),
            intensity,
        },
        Light::Spot {
            position,
            direction,
            intensity,
            cos_inner,
            cos_outer,
        } => PackedLight::Spot {
            position: position.to_array(),
            direction: direction.to_array(),
            intensity,
            cos_inner,
            cos_outer,
        },
        Light::Directional {
            direction,
            irradiance,
            angular_radius_rad,
        } => PackedLight::Directional {
            direction: direction.to_array(),
            irradiance,
            angular_radius_rad,
        },
        Light::Environment { radiance } => PackedLight::Environment { radiance },
    }
}

fn emissive_volume((volume, emissive): (u32, &EmissiveVolume)) -> PackedLight {
    match emissive.emission {
        Emission::Proportional { radiance } => PackedLight::EmissiveVolume { volume, radiance },
        Emission::Blackbody { scale } => PackedLight::BlackbodyVolume { volume, scale },
    }
}

fn environment(image: &EnvironmentImage) -> PackedEnvironment {
    let [width, height] = image.size();
    PackedEnvironment {
        width,
        height,
        scale: image.scale(),
        rotation_rad: image.rotation_rad(),
        holes: image.holes().to_vec(),
    }
}

fn material(material: &Material) -> PackedMaterial {
    PackedMaterial {
        name: material.name.clone(),
        albedo: material.albedo,
        texture: material.texture,
        emission: material.emission,
        emits_both_sides: material.emits_both_sides,
        is_unseen: !material.is_seen,
    }
}

fn emission_textures(scene: &Scene) -> Vec<PackedEmissionTexture> {
    let textures = (0..).zip(&scene.materials).filter_map(|(material, m)| {
        let texture = m.emission_texture?;
        Some(PackedEmissionTexture { material, texture })
    });
    textures.collect()
}

fn masks(scene: &Scene) -> Option<PackedMasks> {
    let masks = (0..).zip(&scene.materials).filter_map(|(material, m)| {
        let mask = m.mask?;
        Some(PackedMask {
            material,
            opacity: mask.opacity,
            texture: mask.texture,
            cutoff: mask.cutoff,
        })
    });
    let masks: Vec<PackedMask> = masks.collect();
    (!masks.is_empty()).then(|| PackedMasks {
        masks,
        has_opacities: !scene.mesh.opacities.is_empty(),
    })
}

/// Media whose albedo varies.
fn albedo_grids(scene: &Scene) -> Vec<u32> {
    let media = (0..).zip(&scene.volumes);
    let varying = media.filter(|(_, v)| v.albedo_grid.is_some());
    varying.map(|(volume, _)| volume).collect()
}

/// Media that may stand on levels by brick.
fn brick_errors(scene: &Scene, tables: &LevelTables) -> Vec<u32> {
    let media = (0..).zip(scene.volumes.iter().zip(tables));
    let has_errors = |v: &Volume, tables: &[BrickTable]| {
        v.albedo_grid.is_none() && volume(v, tables).bricks_with_errors() > 0
    };
    let large = media.filter(|(_, (v, tables))| has_errors(v, tables));
    large.map(|(i, _)| i).collect()
}

/// Of media that stop red, green and blue unlike.
fn extinction_colors(scene: &Scene) -> Vec<ExtinctionColor> {
    let media = (0..).zip(&scene.volumes);
    let colored = media.filter(|(_, v)| !v.is_grey());
    let of = colored.map(|(volume, v)| ExtinctionColor {
        volume,
        color: v.extinction_color,
    });
    of.collect()
}

/// Of cameras that are more than pinholes whose shutter opens for a moment.
fn lenses(scene: &Scene) -> Vec<PackedLens> {
    let lengths = |lens: Option<Lens>| lens.map(|l| [l.aperture, l.focus_distance]);
    let of = |(number, camera): (u32, &Camera)| PackedLens {
        camera: number,
        lens: lengths(camera.lens),
        keys: camera.keys.iter().map(|key| lengths(key.lens)).collect(),
        shutter: camera.shutter,
    };
    let lenses = (0..).zip(&scene.cameras).map(of);
    let says_something = |l: &PackedLens| {
        l.lens.is_some() || l.shutter.is_some() || l.keys.iter().any(|k| k.is_some())
    };
    lenses.filter(says_something).collect()
}

fn volume(volume: &Volume, tables: &[BrickTable]) -> PackedVolume {
    let map = volume.scene_from_index;
    let columns = [
        map.matrix3.x_axis,
        map.matrix3.y_axis,
        map.matrix3.z_axis,
        map.translation,
    ];
    PackedVolume {
        name: volume.name.clone(),
        // More than the format takes is for its check to tell.
        dims: volume
            .sigma_t
            .dims()
            .map(|n| u32::try_from(n).unwrap_or(u32::MAX)),
        albedo: volume.albedo,
        phase: (!volume.phase.is_isotropic()).then(|| PackedPhase {
            g: volume.phase.lobes(),
            mix: volume.phase.mix(),
        }),
        scene_from_index: columns.map(|c| c.to_array()),
        levels: tables.iter().map(|t| t.entries().len() as u64).collect(),
    }
}

/// Writes the columns of a scene, in the order of its description; those of files that a
/// description adds come next.
///
/// # Errors
/// As [`PackedWriter::column`], and if cancelled.
pub fn columns(
    scene: &Scene,
    tables: &LevelTables,
    writer: &mut PackedWriter,
    cancel: &Cancel,
) -> Result<()> {
    check_machine()?;
    let mut column = |column: PackedColumn, item: u32, rows: &[u8]| match rows.is_empty() {
        true => Ok(()),
        false => writer.column(column, item, rows, || cancel.check()),
    };
    let mesh = &scene.mesh;
    for (kind, rows) in [
        (
            PackedColumn::Positions,
            bytemuck::cast_slice(&mesh.positions),
        ),
        (PackedColumn::Normals, bytemuck::cast_slice(&mesh.normals)),
        (PackedColumn::Colors, bytemuck::cast_slice(&mesh.colors)),
        (PackedColumn::Uvs, bytemuck::cast_slice(&mesh.uvs)),
        (
            PackedColumn::Triangles,
            bytemuck::cast_slice(&mesh.triangles),
        ),
        (
            PackedColumn::Materials,
            bytemuck::cast_slice(&mesh.material),
        ),
        (
            PackedColumn::Opacities,
            bytemuck::cast_slice(&mesh.opacities),
        ),
        (PackedColumn::Instances, &instances::rows(mesh)),
    ] {
        column(kind, 0, rows)?;
    }
    let (images, _) = images(&scene.textures);
    for (i, image) in (0..).zip(images) {
        match &image.texels {
            Texels::Linear(texels) => {
                column(PackedColumn::Texels, i, bytemuck::cast_slice(texels))?;
            }
            Texels::Coded(codes, _) => match &codes.values {
                CodeValues::Bytes(codes) => column(PackedColumn::ByteCodes, i, codes)?,
                CodeValues::Words(codes) => {
                    column(PackedColumn::WordCodes, i, bytemuck::cast_slice(codes))?;
                }
            },
        }
    }
    for (i, texture) in (0..).zip(&scene.textures) {
        if let Texels::Coded(_, values) = &texture.texels {
            column(PackedColumn::CodeValues, i, bytemuck::cast_slice(values))?;
        }
    }
    if let Some(image) = &scene.environment_image {
        let rows = bytemuck::cast_slice(image.texels());
        column(PackedColumn::Environment, 0, rows)?;
    }
    for i in brick_errors(scene, tables) {
        let (of, tables) = (&scene.volumes[i as usize], &tables[i as usize]);
        let levels = volume(of, tables).levels_of_many_voxels();
        let errors = (0..levels).zip(tables).map(|(level, table)| {
            cancel.check()?;
            of.errors_of_bricks(level, table.entries())
        });
        let errors = errors.collect::<Result<Vec<_>>>()?.concat();
        column(PackedColumn::BrickErrors, i, bytemuck::cast_slice(&errors))?;
    }
    Ok(())
}

/// Writes the levels of all volumes, which end the file, by their tables.
///
/// # Errors
/// As [`PackedWriter::level`], [`PackedWriter::page`] and [`level_tables`], and if cancelled.
pub fn media(
    scene: &Scene,
    tables: &LevelTables,
    writer: &mut PackedWriter,
    cancel: &Cancel,
) -> Result<()> {
    for (volume, tables) in stored(scene).zip(tables) {
        for (grid, table) in volume.levels()?.into_iter().zip(tables) {
            level(grid, table, writer, cancel)?;
        }
    }
    Ok(())
}

fn level(
    grid: &Grid,
    table: &BrickTable,
    writer: &mut PackedWriter,
    cancel: &Cancel,
) -> Result<()> {
    let samples = table.entries().iter().map(|e| grid.own_samples(e.place));
    let (palette, index) = Palette::of(samples).unzip();
    writer.level(table, palette.as_ref())?;
    let pages: Vec<_> = table.entries().chunks(PAGE_BRICKS).collect();
    for some in pages.chunks(PAGES_AT_A_TIME) {
        cancel.check()?;
        let coded = some.par_iter().map(|entries| {
            let bricks: Vec<_> = entries.iter().map(|e| grid.own_samples(e.place)).collect();
            Ok(MediaPage::encode(&bricks, index.as_ref())?)
        });
        for page in coded.collect::<Result<Vec<_>>>()? {
            writer.page(&page)?;
        }
    }
    Ok(())
}
