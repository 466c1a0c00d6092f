//! What a packed scene says of itself: all but its columns.

mod instances;
mod light;
mod parts;
mod rules;
mod surface;
mod view;
mod volume;

use super::column::{ColumnRows, PackedColumn};
use crate::Result;
use crate::record::MAX_VOLUMES;
pub use instances::{PackedInstances, PackedPrototype, check_instances};
pub use light::{PackedEnvironment, PackedLight};
pub use parts::{PackedEmissionTexture, PackedLens, PackedMask, PackedMasks, PackedParts};
pub use rules::MAX_EMISSION;
use rules::check;
use std::ops::Range;
pub use surface::{
    PackedHierarchy, PackedImage, PackedMaterial, PackedMesh, PackedTexture, PackedWrap,
};
pub use view::{PackedCamera, PackedCameraKey, PackedFilm};
pub use volume::{PackedPhase, PackedVolume};

/// Metadata of a packed scene: the scene itself, without its columns.
#[derive(
    Clone,
    Debug,
    Default,
    PartialEq,
    serde::Serialize,
    serde::Deserialize,
    bincode::Encode,
    bincode::Decode,
)]
pub struct PackedMeta {
    /// Identity of the scene.
    pub scene_hash: [u8; 32],
    /// Name of the scene, for people: identity is by hash.
    pub scene_name: String,
    /// Add this to a position in scene space to get world space.
    pub world_from_scene: [f64; 3],
    /// Image size and tone map.
    pub film: PackedFilm,
    /// The frame whose files it holds; `None` if they are the same in all frames.
    pub frame: Option<i32>,
    /// Cameras; the first is the default. Never empty.
    pub cameras: Vec<PackedCamera>,
    /// Lights other than emissive materials.
    pub lights: Vec<PackedLight>,
    /// An image of what comes from where no surface is.
    pub environment: Option<PackedEnvironment>,
    /// Materials that triangles refer to.
    pub materials: Vec<PackedMaterial>,
    /// Images that textures refer to.
    pub images: Vec<PackedImage>,
    /// Textures that materials refer to.
    pub textures: Vec<PackedTexture>,
    /// Participating media, then the volumes that lights name.
    pub volumes: Vec<PackedVolume>,
    /// What the user should know of how the scene was read.
    pub warnings: Vec<String>,
    /// Triangles and vertices.
    pub mesh: PackedMesh,
    /// Area of all triangles of each material.
    pub areas: Vec<f64>,
    /// The hierarchy over the triangles; `None` without any.
    pub hierarchy: Option<PackedHierarchy>,
    /// Bytes of the tree file that is in it; 0 for none.
    pub tree_bytes: u64,
    /// Bytes of the file of scattered light that is in it; 0 for none.
    pub light_bytes: u64,
    /// What most scenes have not.
    pub parts: PackedParts,
}

/// Summary of a packed scene: which columns it has, in the order of the file.
#[derive(
    Clone,
    Debug,
    Default,
    PartialEq,
    serde::Serialize,
    serde::Deserialize,
    bincode::Encode,
    bincode::Decode,
)]
pub struct PackedSummary {
    /// Columns that are there.
    pub columns: Vec<ColumnRows>,
    /// By volume and level, bricks that are stored.
    pub bricks: Vec<Vec<u64>>,
}

impl PackedMeta {
    /// The volumes that are media, which come first.
    #[must_use]
    pub fn media(&self) -> &[PackedVolume] {
        self.volumes_by_use()[0]
    }

    /// The volumes that are albedos of media, three for each of [`PackedParts::albedo_grids`].
    #[must_use]
    pub fn albedos(&self) -> &[PackedVolume] {
        self.volumes_by_use()[1]
    }

    /// Media, albedos of media, and what light comes from.
    fn volumes_by_use(&self) -> [&[PackedVolume]; 3] {
        let lights = self.lights.iter();
        let emissive = lights.filter(|l| l.volume().is_some()).count();
        let albedos = PackedParts::CHANNELS * self.parts.albedo_grids.len();
        let others = self.volumes.len().saturating_sub(emissive);
        let (others, emissive) = self.volumes.split_at(others);
        let (media, albedos) = others.split_at(others.len().saturating_sub(albedos));
        [media, albedos, emissive]
    }

    /// The hierarchies: over triangles in scene space, then over those of each prototype.
    pub(crate) fn hierarchies(&self) -> impl Iterator<Item = &Option<PackedHierarchy>> {
        let instances = self.parts.instances.iter();
        let prototypes = instances.flat_map(|i| i.prototypes.iter().map(|p| &p.hierarchy));
        std::iter::once(&self.hierarchy).chain(prototypes)
    }

    /// The triangles that a hierarchy is over, by its number among [`Self::hierarchies`].
    pub(crate) fn triangles_of(&self, hierarchy: u32) -> Range<u64> {
        let Some(instances) = &self.parts.instances else {
            return 0..self.mesh.triangles;
        };
        match hierarchy.checked_sub(1) {
            None => 0..instances.triangles(0, &self.mesh).start,
            Some(prototype) => instances.triangles(prototype as usize, &self.mesh),
        }
    }

    /// The columns that this scene has, in the order of the file.
    #[must_use]
    pub fn columns(&self) -> Vec<ColumnRows> {
        let mesh = &self.mesh;
        let of = |has: bool| if has { mesh.vertices } else { 0 };
        let instances = self.parts.instances.as_ref();
        let masks = self.parts.masks.as_ref();
        let has_opacities = masks.is_some_and(|masks| masks.has_opacities);
        let whole = [
            (PackedColumn::Positions, mesh.vertices),
            (PackedColumn::Normals, of(mesh.has_normals)),
            (PackedColumn::Colors, of(mesh.has_colors)),
            (PackedColumn::Uvs, of(mesh.has_uvs)),
            (PackedColumn::Triangles, mesh.triangles),
            (PackedColumn::Materials, mesh.triangles),
            (PackedColumn::Opacities, of(has_opacities)),
            (PackedColumn::Instances, instances.map_or(0, |i| i.count)),
        ];
        let whole = whole.into_iter().map(|(column, rows)| (column, 0, rows));
        let images = (0..).zip(&self.images).map(|(i, image)| {
            let codes = image.texels.saturating_mul(image.channels.into());
            match image.bits {
                8 => (PackedColumn::ByteCodes, i, codes),
                16 => (PackedColumn::WordCodes, i, codes),
                _ => (PackedColumn::Texels, i, image.texels),
            }
        });
        let textures = (0..).zip(&self.textures).map(|(i, texture)| {
            let image = self.images.get(texture.image as usize);
            let bits = image.map_or(32, |image| image.bits);
            let values = if bits < 32 { 1 << bits } else { 0 };
            (PackedColumn::CodeValues, i, values)
        });
        let hierarchies = || (0..).zip(self.hierarchies());
        let hierarchies = || hierarchies().filter_map(|(item, h)| Some((item, (*h)?)));
        let nodes = hierarchies().map(|(item, h)| (PackedColumn::Nodes, item, h.nodes));
        let blocks = hierarchies().map(|(item, h)| match h.by_vertex {
            true => (PackedColumn::VertexBlocks, item, h.blocks),
            false => (PackedColumn::Blocks, item, h.blocks),
        });
        let sky = self.environment.as_ref();
        let sky = sky.map_or(0, |e| u64::from(e.width) * u64::from(e.height));
        let sky = [(PackedColumn::Environment, 0, sky)];
        let errors = self.parts.brick_errors.iter().filter_map(|&i| {
            let volume = self.volumes.get(i as usize)?;
            Some((PackedColumn::BrickErrors, i, volume.bricks_with_errors()))
        });
        let rest = [
            (PackedColumn::Tree, 0, self.tree_bytes),
            (PackedColumn::Light, 0, self.light_bytes),
        ];
        let all = whole.chain(images).chain(textures).chain(sky).chain(errors);
        let all = all.chain(nodes).chain(blocks).chain(rest);
        all.filter(|(_, _, rows)| *rows > 0)
            .map(|(column, item, rows)| ColumnRows { column, item, rows })
            .collect()
    }

    /// Values that a reader may rely on.
    pub(crate) fn validate(&self) -> Result<()> {
        let place = self.world_from_scene;
        let what = || "world_from_scene".to_owned();
        check(
            place.iter().all(|v| v.is_finite()),
            &what,
            "finite numbers",
            place,
        )?;
        self.film.validate()?;
        check(
            !self.cameras.is_empty(),
            &|| "cameras".into(),
            "at least one",
            0,
        )?;
        self.cameras.iter().try_for_each(PackedCamera::validate)?;
        self.check_lights()?;
        if let Some(environment) = &self.environment {
            environment.validate()?;
        }
        self.mesh.validate(self.materials.len())?;
        for material in &self.materials {
            material.validate(self.textures.len())?;
        }
        let (materials, textures) = (self.materials.len(), self.textures.len());
        let volumes = (self.media(), self.albedos());
        (self.parts).validate(materials, textures, &self.cameras, volumes)?;
        let areas = &self.areas;
        let are_right =
            areas.len() == self.materials.len() && areas.iter().all(|a| a.is_finite() && *a >= 0.0);
        check(
            are_right,
            &|| "areas".into(),
            "one of at least 0 for each material",
            areas,
        )?;
        self.check_images()?;
        let volumes = self.volumes.len();
        let what = || "volumes".to_owned();
        check(
            volumes <= MAX_VOLUMES,
            &what,
            &format!("at most {MAX_VOLUMES}"),
            volumes,
        )?;
        self.volumes.iter().try_for_each(PackedVolume::validate)?;
        if let Some(instances) = &self.parts.instances {
            instances.validate(&self.mesh)?;
        }
        if let Some(hierarchy) = &self.hierarchy {
            hierarchy.validate(&self.mesh)?;
        }
        let is_there = self.mesh.triangles > 0 || volumes > 0;
        check(
            is_there,
            &|| "the scene".into(),
            "triangles or volumes",
            "none",
        )?;
        let has_tree = self.light_bytes == 0 || self.tree_bytes > 0;
        check(
            has_tree,
            &|| "scattered light".into(),
            "a tree with it",
            "none",
        )
    }

    fn check_lights(&self) -> Result<()> {
        for (i, light) in self.lights.iter().enumerate() {
            light.validate(&|| format!("light {i}"))?;
        }
        let emissive: Vec<u32> = (self.lights.iter())
            .filter_map(PackedLight::volume)
            .collect();
        let first = (self.media().len() + self.albedos().len()) as u32;
        check(
            emissive
                .iter()
                .copied()
                .eq(first..self.volumes.len() as u32),
            &|| "volumes that light comes from".into(),
            "the last ones, in order",
            &emissive,
        )
    }

    fn check_images(&self) -> Result<()> {
        for (i, image) in self.images.iter().enumerate() {
            let is_right = match image.bits {
                8 | 16 => matches!(image.channels, 1 | 3),
                32 => image.channels == 3,
                _ => false,
            };
            let what = || format!("image {i}");
            check(
                is_right,
                &what,
                "1 or 3 channels of 8 or 16 bits, or 3 of 32",
                image,
            )?;
        }
        for (i, texture) in self.textures.iter().enumerate() {
            let image = self.images.get(texture.image as usize);
            let texels = u64::from(texture.width) * u64::from(texture.height);
            let is_right = texels > 0 && image.is_some_and(|image| image.texels == texels);
            let what = || format!("texture {i}");
            check(is_right, &what, "all texels of an image", texture)?;
        }
        Ok(())
    }

    /// The summary of a file of this scene.
    pub(crate) fn summary(&self) -> PackedSummary {
        PackedSummary {
            columns: self.columns(),
            bricks: self.volumes.iter().map(|v| v.levels.clone()).collect(),
        }
    }
}
