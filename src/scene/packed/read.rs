//! A scene from a packed file.

use super::PackedScene;
use super::instances;
use crate::column::Column;
use crate::formats::{
    BrickSamples, MediaLevel, Packed, PackedCamera, PackedCameraKey, PackedColumn,
    PackedEnvironment, PackedLight, PackedMaterial, PackedMeta, PackedTexture, PackedVolume,
    PackedWrap,
};
use crate::run::{Cancel, Lists, size};
use crate::scene::grid::{Errors, Known, StoredBricks, StoredLevels, VolumeGrid};
use crate::scene::texture::{CodeValues, Codes, Texels};
use crate::scene::{
    AlbedoGrid, Camera, CameraKey, Emission, EmissiveVolume, EnvironmentImage, Film, Grid, Lens,
    Light, Mask, Material, Mesh, PhaseFunction, Scene, Texture, Volume, Wrap,
};
use crate::{Error, Result};
use glam::{Affine3A, DAffine3, DMat3, DVec3, Mat3A, Vec3A};
use rayon::prelude::*;
use std::path::Path;
use std::sync::Arc;

/// Opens a packed scene, at a frame if there is one: checks all that is used where it lies, and
/// decodes the rest.
///
/// # Errors
/// A file that is no whole packed scene, no memory for its volumes, or a stop on request.
pub fn read(
    path: &Path,
    frame: Option<i32>,
    texture_limit: u64,
    lists: &Lists,
    cancel: &Cancel,
) -> Result<Scene> {
    let file = Arc::new(Packed::open_path(path)?);
    lists.watch(file.data());
    let packed = PackedScene {
        file,
        path: path.to_owned(),
        lists: lists.clone(),
    };
    check(&packed, cancel)?;
    lists.expect_random_access(packed.file().data());
    let scene = scene(&packed, path, frame, texture_limit, cancel);
    scene.map_err(|e| e.at(path.display()))
}

/// Checks every column that is used where it lies; a tree and scattered light are checked by
/// whoever reads them.
fn check(packed: &PackedScene, cancel: &Cancel) -> Result<()> {
    let file = packed.file();
    let is_used =
        |column: PackedColumn| !matches!(column, PackedColumn::Tree | PackedColumn::Light);
    let used = file.columns().iter().filter(|(c, _)| is_used(c.column));
    let blocks: Vec<usize> = used.flat_map(|(_, blocks)| blocks.clone()).collect();
    blocks.into_par_iter().try_for_each(|i| {
        cancel.check()?;
        file.check_block(i)?;
        // Whoever needs it reads it again; much of a large scene is never needed.
        file.release_block(i);
        Ok::<_, Error>(())
    })?;
    Ok(file.check_hierarchy()?)
}

fn scene(
    packed: &PackedScene,
    path: &Path,
    frame: Option<i32>,
    texture_limit: u64,
    cancel: &Cancel,
) -> Result<Scene> {
    let meta = packed.file().meta();
    let textures = textures(packed, texture_limit)?;
    check_tables(packed)?;
    let sky = meta.environment.as_ref();
    let sky = sky.map(|info| environment_image(packed, info));
    let media = meta.media().iter().enumerate();
    let volumes = media.map(|(i, info)| medium(packed, i, info, cancel));
    let mut volumes = volumes.collect::<Result<Vec<Volume>>>()?;
    for of in &meta.parts.extinction_colors {
        volumes[of.volume as usize].extinction_color = of.color;
    }
    let first = volumes.len();
    for (i, &medium) in meta.parts.albedo_grids.iter().enumerate() {
        let channel = |c: usize| albedo(packed, first + 3 * i + c, cancel);
        let grid = AlbedoGrid::new([channel(0)?, channel(1)?, channel(2)?]);
        volumes[medium as usize].albedo_grid = Some(grid);
    }
    let emissive = meta.lights.iter();
    let emissive = emissive.filter_map(|l| emissive_volume(packed, l, cancel).transpose());
    let mut scene = Scene {
        name: meta.scene_name.clone(),
        world_from_scene: DVec3::from(meta.world_from_scene),
        cameras: cameras(meta),
        film: Film {
            width: meta.film.width,
            height: meta.film.height,
            exposure: meta.film.exposure,
        },
        mesh: Mesh {
            positions: packed.column(PackedColumn::Positions, 0)?,
            normals: packed.column(PackedColumn::Normals, 0)?,
            colors: packed.column(PackedColumn::Colors, 0)?,
            uvs: packed.column(PackedColumn::Uvs, 0)?,
            triangles: packed.column(PackedColumn::Triangles, 0)?,
            material: packed.column(PackedColumn::Materials, 0)?,
            opacities: packed.column(PackedColumn::Opacities, 0)?,
            degenerate: meta.mesh.degenerate,
            instances: instances::read(packed)?,
        },
        materials: materials(meta),
        textures,
        lights: meta.lights.iter().filter_map(light).collect(),
        environment_image: sky.transpose()?,
        is_environment_seen: !meta.lights.contains(&PackedLight::UnseenEnvironment),
        volumes,
        emissive: emissive.collect::<Result<_>>()?,
        hash: meta.scene_hash,
        files: vec![path.to_owned()],
        warnings: meta.warnings.clone(),
        notes: Vec::new(),
        groups: Vec::new(),
        group: None,
        frame: None,
        files_of_frame: meta.frame,
        has_empty_volumes: false,
        packed: Some(packed.clone()),
    };
    match frame.or(meta.frame) {
        Some(frame) => scene.go_to_frame(frame)?,
        None => scene.open_shutters()?,
    }
    Ok(scene)
}

/// The cameras, with their lenses and shutters.
fn cameras(meta: &PackedMeta) -> Vec<Camera> {
    let lens = |lengths: Option<[f32; 2]>| {
        lengths.and_then(|[aperture, focus_distance]| Lens::new(aperture, focus_distance))
    };
    let mut cameras: Vec<Camera> = meta.cameras.iter().map(camera).collect();
    for part in &meta.parts.lenses {
        let camera = &mut cameras[part.camera as usize];
        camera.lens = lens(part.lens);
        camera.shutter = part.shutter;
        for (key, lengths) in camera.keys.iter_mut().zip(&part.keys) {
            key.lens = lens(*lengths);
        }
    }
    cameras
}

fn camera(camera: &PackedCamera) -> Camera {
    let [x, y, z, position] = camera.scene_from_camera.map(Vec3A::from);
    Camera {
        name: camera.name.clone(),
        scene_from_camera: Affine3A {
            matrix3: Mat3A::from_cols(x, y, z),
            translation: position,
        },
        fov_x_rad: camera.fov_x_rad,
        keys: camera.keys.iter().map(key).collect(),
        lens: None,
        shutter: None,
        path: Vec::new(),
    }
}

fn key(key: &PackedCameraKey) -> CameraKey {
    CameraKey {
        frame: key.frame,
        position: key.position.into(),
        target: key.target.into(),
        up: key.up.into(),
        fov_x_rad: key.fov_x_rad,
        lens: None,
    }
}

/// A light, unless it is a volume.
fn light(light: &PackedLight) -> Option<Light> {
    Some(match *light {
        PackedLight::Point {
            position,
            intensity,
        } => Light::Point {
            position: position.into(),
            intensity,
        },
        PackedLight::Spot {
            position,
            direction,
            intensity,
            cos_inner,
            cos_outer,
        } => Light::Spot {
            position: position.into(),
            direction: direction.into(),
            intensity,
            cos_inner,
            cos_outer,
        },
        PackedLight::Directional {
            direction,
            irradiance,
            angular_radius_rad,
        } => Light::Directional {
            direction: direction.into(),
            irradiance,
            angular_radius_rad,
        },
        PackedLight::Environment { radiance } => Light::Environment { radiance },
        PackedLight::UnseenEnvironment
        | PackedLight::EmissiveVolume { .. }
        | PackedLight::BlackbodyVolume { .. } => return None,
    })
}

/// The volume that a light is, if it is one.
fn emissive_volume(
    packed: &PackedScene,
    light: &PackedLight,
    cancel: &Cancel,
) -> Result<Option<EmissiveVolume>> {
    let emission = match *light {
        PackedLight::EmissiveVolume { radiance, .. } => Emission::Proportional { radiance },
        PackedLight::BlackbodyVolume { scale, .. } => Emission::Blackbody { scale },
        _ => return Ok(None),
    };
    let volumes = &packed.file().meta().volumes;
    let index = light.volume().map(|v| v as usize);
    let found = index.and_then(|i| Some((i, volumes.get(i)?)));
    let (index, info) = found.ok_or_else(|| Error::input("a light names no volume"))?;
    Ok(Some(EmissiveVolume {
        values: volume(packed, index, info, cancel)?,
        emission,
    }))
}

fn environment_image(packed: &PackedScene, info: &PackedEnvironment) -> Result<EnvironmentImage> {
    let texels = packed.column(PackedColumn::Environment, 0)?;
    let image = EnvironmentImage::of(info.width, info.height, texels)?;
    let image = image.scaled(info.scale).rotated(info.rotation_rad);
    Ok(image.with_holes(info.holes.clone()))
}

fn materials(meta: &PackedMeta) -> Vec<Material> {
    let mut materials: Vec<Material> = meta.materials.iter().map(material).collect();
    for mask in meta.parts.masks.iter().flat_map(|m| &m.masks) {
        materials[mask.material as usize].mask = Some(Mask {
            opacity: mask.opacity,
            texture: mask.texture,
            cutoff: mask.cutoff,
        });
    }
    for of in &meta.parts.emission_textures {
        materials[of.material as usize].emission_texture = Some(of.texture);
    }
    materials
}

fn material(material: &PackedMaterial) -> Material {
    Material {
        name: material.name.clone(),
        albedo: material.albedo,
        texture: material.texture,
        mask: None,
        emission: material.emission,
        emission_texture: None,
        emits_both_sides: material.emits_both_sides,
        is_seen: !material.is_unseen,
    }
}

/// The textures, of which those of one image share its texels.
fn textures(packed: &PackedScene, limit: u64) -> Result<Vec<Texture>> {
    let meta = packed.file().meta();
    let bytes = meta.images.iter().map(|image| {
        let codes = image.texels.saturating_mul(image.channels.into());
        codes.saturating_mul(u64::from(image.bits / 8))
    });
    let bytes = bytes.fold(0, u64::saturating_add);
    if bytes > limit {
        return Err(Error::input(format!(
            "its textures take {}, more than the `texture_limit` of {}",
            size::format(bytes),
            size::format(limit)
        ))
        .hint("raise `texture_limit`"));
    }
    enum Image {
        Linear(Texels),
        Coded(Arc<Codes>),
    }
    let image = |(i, image): (u32, &crate::formats::PackedImage)| {
        let values = match image.bits {
            8 => CodeValues::Bytes(packed.column(PackedColumn::ByteCodes, i)?),
            16 => CodeValues::Words(packed.column(PackedColumn::WordCodes, i)?),
            _ => {
                let texels = packed.column(PackedColumn::Texels, i)?;
                return Ok(Image::Linear(Texels::Linear(Arc::new(texels))));
            }
        };
        let channels = image.channels.into();
        Ok(Image::Coded(Arc::new(Codes { channels, values })))
    };
    let images = (0..).zip(&meta.images).map(image);
    let images = images.collect::<Result<Vec<Image>>>()?;
    let texture = |(i, info): (u32, &PackedTexture)| {
        let texels = match &images[info.image as usize] {
            Image::Linear(texels) => texels.clone(),
            Image::Coded(codes) => {
                let values = packed.column::<f32>(PackedColumn::CodeValues, i)?;
                Texels::Coded(codes.clone(), values[..].into())
            }
        };
        let texture = Texture {
            width: info.width,
            height: info.height,
            wrap: info.wrap.map(|wrap| match wrap {
                PackedWrap::Repeat => Wrap::Repeat,
                PackedWrap::Clamp => Wrap::Clamp,
                PackedWrap::Mirror => Wrap::Mirror,
            }),
            texels,
        };
        Ok(texture)
    };
    (0..).zip(&meta.textures).map(texture).collect()
}

/// Refuses volumes whose tables of bricks take more than a file of this length may claim.
fn check_tables(packed: &PackedScene) -> Result<()> {
    let file = packed.file();
    let table = |info: &PackedVolume| {
        let bricks = info.brick_dims(0).into_iter();
        bricks.fold(4, |n: u64, d| n.saturating_mul(d))
    };
    let all = file.meta().volumes.iter().map(table);
    let all = all.fold(0, u64::saturating_add);
    let most = size::most_of_tables(file.file_bytes());
    if all > most {
        return Err(Error::input(format!(
            "finding bricks of its volumes needs {}, of a file of this length the most is {}",
            size::format(all),
            size::format(most)
        ))
        .hint("`lvox verify` tells whether the file is whole"));
    }
    Ok(())
}

/// A medium, of an extinction that positions can tell.
fn medium(packed: &PackedScene, i: usize, info: &PackedVolume, cancel: &Cancel) -> Result<Volume> {
    let volume = volume(packed, i, info, cancel)?;
    let (found, most) = (volume.sigma_t.max(), volume.most_extinction());
    if found > most {
        return Err(Error::input(format!(
            "the volume \"{}\": expected extinction of at most {most:e}, beyond which positions do \
             not tell where light gets, found {found:e}",
            info.name
        ))
        .hint("pack the scene again"));
    }
    Ok(volume)
}

/// A channel of the albedo of a medium.
fn albedo(packed: &PackedScene, i: usize, cancel: &Cancel) -> Result<VolumeGrid> {
    let volumes = &packed.file().meta().volumes;
    let info = volumes
        .get(i)
        .ok_or_else(|| Error::input("an albedo is not there"))?;
    let grid = volume(packed, i, info, cancel)?.sigma_t;
    match grid.max() <= 1.0 {
        true => Ok(grid),
        false => Err(Error::input(format!(
            "the volume \"{}\": expected albedos of at most 1, found {}",
            info.name,
            grid.max()
        ))),
    }
}

fn volume(packed: &PackedScene, i: usize, info: &PackedVolume, cancel: &Cancel) -> Result<Volume> {
    let file = packed.file();
    let levels = (0..info.levels.len()).map(|level| Ok(file.level(i, level)?));
    let levels: Arc<dyn StoredLevels> = Arc::new(PackedLevels {
        packed: packed.clone(),
        levels: levels.collect::<Result<_>>()?,
        errors: packed.column(PackedColumn::BrickErrors, i as u32)?,
        cancel: cancel.clone(),
    });
    let grid = VolumeGrid::stored(&levels, 0)
        .ok_or_else(|| Error::input(format!("the volume \"{}\" has no levels", info.name)))?;
    let [x, y, z, translation] = info.scene_from_index.map(DVec3::from);
    let scene_from_index = DAffine3 {
        matrix3: DMat3::from_cols(x, y, z),
        translation,
    };
    let phase = (info.phase).map_or(PhaseFunction::ISOTROPIC, |p| {
        PhaseFunction::two_lobes(p.g, p.mix)
    });
    let name = info.name.clone();
    Ok(Volume::new(name, grid, info.albedo, scene_from_index).with_phase(phase))
}

/// The levels of a volume in a packed scene, of which tables were read.
#[derive(Debug)]
struct PackedLevels {
    packed: PackedScene,
    levels: Vec<MediaLevel>,
    /// Errors of the bricks of the first levels on coarser ones, if there are any.
    errors: Column<Errors>,
    cancel: Cancel,
}

impl StoredLevels for PackedLevels {
    fn known(&self, level: usize) -> Option<Known> {
        let table = self.levels.get(level)?;
        // Boxes are that of the finest.
        let finest = self.levels.first()?.dims.map(|n| n as f32);
        let shrink = (0..level).fold(1.0, |s: f32, _| 0.5 * s);
        let entries = table.table().entries();
        let maxima = entries.iter().map(|e| e.max);
        Some(Known {
            dims: table.dims.map(|n| n as usize),
            size: finest.map(|n| n * shrink),
            max: maxima.fold(0.0, f32::max),
            bricks: entries.len(),
        })
    }

    fn read(&self, level: usize) -> Result<Grid> {
        let none = || Error::input(format!("level {level} is not stored"));
        let table = self.levels.get(level).ok_or_else(none)?;
        let known = self.known(level).ok_or_else(none)?;
        let entries = table.table().entries();
        Grid::unpack(known, &self.packed.lists, entries, |page, take| {
            self.page(table, page, take)
        })
    }

    fn bricks(&self, level: usize) -> Option<StoredBricks<'_>> {
        let before = self.levels.iter().take(level);
        let before: usize = before.map(|l| l.table().entries().len()).sum();
        let table = self.levels.get(level)?;
        let entries = table.table().entries();
        Some(StoredBricks {
            lists: &self.packed.lists,
            entries,
            errors: self.errors.get(before..before + entries.len())?,
            read: Box::new(move |page, take| self.page(table, page, take)),
        })
    }
}

impl PackedLevels {
    /// Gives the samples of the bricks of a page to another, with their numbers in it.
    fn page(
        &self,
        level: &MediaLevel,
        page: usize,
        take: &mut dyn FnMut(usize, &BrickSamples),
    ) -> Result<()> {
        self.cancel.check()?;
        let file = self.packed.file();
        file.media_page(level, page, take)?;
        file.release_page(level, page);
        Ok(())
    }
}
