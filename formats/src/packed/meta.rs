//! What a packed scene says of itself: all but its columns.

use super::column::{ColumnRows, MAX_COORDINATE, PackedColumn};
use crate::record::{MAX_VOLUMES, MAX_VOXELS_ALONG};
use crate::{FormatError, Result};

/// Emission, intensity and irradiance are not beyond this.
pub(super) const MAX_EMISSION: f32 = 1e30;
/// Pixels along a side of the largest film.
const MAX_SIDE: u32 = 65_536;
/// Extent of a voxel in any direction, at least: half of what scenes may have.
const MIN_VOXEL_EDGE: f64 = 0.5e-15;
/// Vertices and triangles that indices have room for.
const MAX_VERTICES: u64 = u32::MAX as u64;
const MAX_TRIANGLES: u64 = 1 << 27;

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
    /// Participating media.
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
}

/// Image size and tone map.
#[derive(
    Clone,
    Copy,
    Debug,
    Default,
    PartialEq,
    serde::Serialize,
    serde::Deserialize,
    bincode::Encode,
    bincode::Decode,
)]
pub struct PackedFilm {
    /// Pixels in a row of the whole frame, 1 to 65,536.
    pub width: u32,
    /// Rows of pixels of the whole frame, 1 to 65,536.
    pub height: u32,
    /// Factor on linear radiance before clipping, 1e-30 to 1e30.
    pub exposure: f32,
}

/// A pinhole camera that looks down its local -z.
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
pub struct PackedCamera {
    /// Name, by which it is chosen.
    pub name: String,
    /// Three columns of a rotation, then the position.
    pub scene_from_camera: [[f32; 3]; 4],
    /// Full horizontal field of view, radians, in (0, pi).
    pub fov_x_rad: f32,
}

/// A light source.
#[derive(
    Clone, Debug, PartialEq, serde::Serialize, serde::Deserialize, bincode::Encode, bincode::Decode,
)]
pub enum PackedLight {
    /// Isotropic point.
    Point {
        /// Position in scene space.
        position: [f32; 3],
        /// Radiant intensity per steradian.
        intensity: [f32; 3],
    },
    /// Point light inside a cone.
    Spot {
        /// Position in scene space.
        position: [f32; 3],
        /// Unit axis of the cone, the way the light travels.
        direction: [f32; 3],
        /// Radiant intensity per steradian on the axis.
        intensity: [f32; 3],
        /// Cosine of the half angle up to which the intensity is full.
        cos_inner: f32,
        /// Cosine of the half angle beyond which there is none; less than `cos_inner`.
        cos_outer: f32,
    },
    /// Parallel light, or a disk at infinity.
    Directional {
        /// Unit direction, the way the light travels.
        direction: [f32; 3],
        /// Irradiance on a plane that faces the light.
        irradiance: [f32; 3],
        /// Half angle of the disk, radians, below pi/2; 0 for parallel light.
        angular_radius_rad: f32,
    },
    /// The same radiance from everywhere.
    Environment {
        /// Radiance from every direction.
        radiance: [f32; 3],
    },
}

/// A lat-long image of the radiance from all directions.
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
pub struct PackedEnvironment {
    /// Texels in a row: twice as many as there are rows, at most 65,536.
    pub width: u32,
    /// Rows of texels.
    pub height: u32,
    /// Factor on texels.
    pub scale: [f32; 3],
    /// Angle by which the image is turned about +y, right-handed, radians.
    pub rotation_rad: f32,
    /// Texels that send other light than is seen of them, with that, in increasing order.
    pub holes: Vec<(u32, [f32; 3])>,
}

/// How a surface reflects and emits.
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
pub struct PackedMaterial {
    /// Name, for messages.
    pub name: String,
    /// Diffuse albedo, each channel in `[0,1]`.
    pub albedo: [f32; 3],
    /// Factor on the albedo: number of a texture.
    pub texture: Option<u32>,
    /// Emitted radiance; 0 for no light.
    pub emission: [f32; 3],
    /// Whether the back emits too.
    pub emits_both_sides: bool,
}

/// The texels of an image, which textures share.
#[derive(
    Clone,
    Copy,
    Debug,
    Default,
    PartialEq,
    serde::Serialize,
    serde::Deserialize,
    bincode::Encode,
    bincode::Decode,
)]
pub struct PackedImage {
    /// Number of its texels.
    pub texels: u64,
    /// Codes of a texel: 1 for grey, or 3.
    pub channels: u8,
    /// Bits of a code, 8 or 16; 32 for texels that are linear RGB as they are.
    pub bits: u8,
}

/// What a texture is beyond its border.
#[derive(
    Clone,
    Copy,
    Debug,
    Default,
    PartialEq,
    Eq,
    serde::Serialize,
    serde::Deserialize,
    bincode::Encode,
    bincode::Decode,
)]
pub enum PackedWrap {
    /// The image again.
    #[default]
    Repeat,
    /// The texel at the border.
    Clamp,
    /// The image turned round, and so on.
    Mirror,
}

/// An image, and what its codes stand for.
#[derive(
    Clone,
    Copy,
    Debug,
    Default,
    PartialEq,
    serde::Serialize,
    serde::Deserialize,
    bincode::Encode,
    bincode::Decode,
)]
pub struct PackedTexture {
    /// Number of its image.
    pub image: u32,
    /// Texels in a row.
    pub width: u32,
    /// Rows of texels.
    pub height: u32,
    /// What is beyond the left and right border, and beyond the upper and lower.
    pub wrap: [PackedWrap; 2],
}

/// A phase function of two lobes (Henyey & Greenstein 1941).
#[derive(
    Clone,
    Copy,
    Debug,
    Default,
    PartialEq,
    serde::Serialize,
    serde::Deserialize,
    bincode::Encode,
    bincode::Decode,
)]
pub struct PackedPhase {
    /// Mean cosine of each, from -0.99 to 0.99.
    pub g: [f32; 2],
    /// Weight of the first, 0 to 1.
    pub mix: f32,
}

/// A medium in a box.
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
pub struct PackedVolume {
    /// Name, for messages.
    pub name: String,
    /// Voxels along x, y, z of index space.
    pub dims: [u32; 3],
    /// Single-scattering albedo, each channel in `[0,1]`.
    pub albedo: [f32; 3],
    /// Lobes of the phase function; `None` if it is isotropic.
    pub phase: Option<PackedPhase>,
    /// Affine map from index to scene space: three columns, then the translation.
    pub scene_from_index: [[f64; 3]; 4],
    /// Bricks that are stored of each level, the finest first.
    pub levels: Vec<u64>,
}

/// Which columns triangles and vertices have, and of how many rows.
#[derive(
    Clone,
    Copy,
    Debug,
    Default,
    PartialEq,
    serde::Serialize,
    serde::Deserialize,
    bincode::Encode,
    bincode::Decode,
)]
pub struct PackedMesh {
    /// Number of vertices.
    pub vertices: u64,
    /// Number of triangles.
    pub triangles: u64,
    /// Triangles of zero area that were dropped when the scene was read.
    pub degenerate: u64,
    /// Whether vertices have normals.
    pub has_normals: bool,
    /// Whether vertices have colours.
    pub has_colors: bool,
    /// Whether vertices have texture coordinates.
    pub has_uvs: bool,
}

/// Size of the hierarchy over triangles.
#[derive(
    Clone,
    Copy,
    Debug,
    Default,
    PartialEq,
    serde::Serialize,
    serde::Deserialize,
    bincode::Encode,
    bincode::Decode,
)]
pub struct PackedHierarchy {
    /// Number of nodes, at least 1.
    pub nodes: u64,
    /// Number of blocks of four triangles.
    pub blocks: u64,
    /// Whether blocks have vertices in place of corners.
    pub by_vertex: bool,
    /// Boxes and corners are this many times larger than the mesh: a power of two.
    pub scale: f32,
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

fn wrong(what: impl Into<String>, expected: &str, found: impl std::fmt::Debug) -> FormatError {
    FormatError::invalid(what, expected, format!("{found:?}"))
}

fn check(
    is_right: bool,
    what: &dyn Fn() -> String,
    expected: &str,
    found: impl std::fmt::Debug,
) -> Result<()> {
    if is_right {
        Ok(())
    } else {
        Err(wrong(what(), expected, found))
    }
}

fn is_light(color: [f32; 3]) -> bool {
    color.iter().all(|v| (0.0..=MAX_EMISSION).contains(v))
}

fn are_shares(color: [f32; 3]) -> bool {
    color.iter().all(|v| (0.0..=1.0).contains(v))
}

fn is_near(position: [f32; 3]) -> bool {
    position.iter().all(|v| v.abs() <= MAX_COORDINATE)
}

fn is_unit(direction: [f32; 3]) -> bool {
    (0.999..=1.001).contains(&dot(direction, direction))
}

fn dot(a: [f32; 3], b: [f32; 3]) -> f32 {
    a.iter().zip(b).map(|(a, b)| a * b).sum()
}

fn cross<T>(a: [T; 3], b: [T; 3]) -> [T; 3]
where
    T: Copy + std::ops::Mul<Output = T> + std::ops::Sub<Output = T>,
{
    [1, 2, 0].map(|i| {
        let j = (i + 1) % 3;
        a[i] * b[j] - a[j] * b[i]
    })
}

impl PackedMeta {
    /// The columns that this scene has, in the order of the file.
    #[must_use]
    pub fn columns(&self) -> Vec<ColumnRows> {
        let mesh = &self.mesh;
        let of = |has: bool| if has { mesh.vertices } else { 0 };
        let hierarchy = self.hierarchy.unwrap_or_default();
        let whole = [
            (PackedColumn::Positions, mesh.vertices),
            (PackedColumn::Normals, of(mesh.has_normals)),
            (PackedColumn::Colors, of(mesh.has_colors)),
            (PackedColumn::Uvs, of(mesh.has_uvs)),
            (PackedColumn::Triangles, mesh.triangles),
            (PackedColumn::Materials, mesh.triangles),
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
        let blocks = match hierarchy.by_vertex {
            true => PackedColumn::VertexBlocks,
            false => PackedColumn::Blocks,
        };
        let sky = self.environment.as_ref();
        let sky = sky.map_or(0, |e| u64::from(e.width) * u64::from(e.height));
        let rest = [
            (PackedColumn::Environment, 0, sky),
            (PackedColumn::Nodes, 0, hierarchy.nodes),
            (blocks, 0, hierarchy.blocks),
            (PackedColumn::Tree, 0, self.tree_bytes),
            (PackedColumn::Light, 0, self.light_bytes),
        ];
        let all = whole.chain(images).chain(textures).chain(rest);
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
        for (i, light) in self.lights.iter().enumerate() {
            light.validate(&|| format!("light {i}"))?;
        }
        if let Some(environment) = &self.environment {
            environment.validate()?;
        }
        self.mesh.validate(self.materials.len())?;
        for material in &self.materials {
            material.validate(self.textures.len())?;
        }
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

impl PackedFilm {
    fn validate(&self) -> Result<()> {
        let sides = 1..=MAX_SIDE;
        let is_right = sides.contains(&self.width)
            && sides.contains(&self.height)
            && (1e-30..=1e30).contains(&self.exposure);
        let expected = "1 to 65,536 pixels a side, and an exposure from 1e-30 to 1e30";
        check(is_right, &|| "film".into(), expected, self)
    }
}

impl PackedCamera {
    fn validate(&self) -> Result<()> {
        let [x, y, z, position] = self.scene_from_camera;
        let is_rotation = [x, y, z].into_iter().all(is_unit)
            && [dot(x, y), dot(y, z), dot(z, x)]
                .iter()
                .all(|d| d.abs() <= 1e-3)
            && dot(cross(x, y), z) > 0.0;
        let is_right =
            is_rotation && is_near(position) && self.fov_x_rad >= 1e-4 && self.fov_x_rad <= 3.13;
        let what = || format!("camera {:?}", self.name);
        let expected = "a rotation, a position and a field of view below pi";
        check(is_right, &what, expected, self)
    }
}

impl PackedLight {
    fn validate(&self, what: &dyn Fn() -> String) -> Result<()> {
        let is_right = match *self {
            Self::Point {
                position,
                intensity,
            } => is_near(position) && is_light(intensity),
            Self::Spot {
                position,
                direction,
                intensity,
                cos_inner,
                cos_outer,
            } => {
                let cosines = -1.0..=1.0;
                is_near(position)
                    && is_unit(direction)
                    && is_light(intensity)
                    && cosines.contains(&cos_inner)
                    && cosines.contains(&cos_outer)
                    && cos_outer < cos_inner
            }
            Self::Directional {
                direction,
                irradiance,
                angular_radius_rad,
            } => {
                is_unit(direction)
                    && is_light(irradiance)
                    && (0.0..1.56).contains(&angular_radius_rad)
            }
            Self::Environment { radiance } => is_light(radiance),
        };
        check(
            is_right,
            what,
            "a place, a unit direction, light and angles in range",
            self,
        )
    }
}

impl PackedEnvironment {
    fn validate(&self) -> Result<()> {
        let what = || "environment".to_owned();
        let size = [self.width, self.height];
        let is_size = (1..=MAX_SIDE).contains(&self.width)
            && u64::from(self.width) == 2 * u64::from(self.height);
        let expected = "an image twice as wide as high, at most 65,536 across";
        check(is_size, &what, expected, size)?;
        let is_right = is_light(self.scale) && self.rotation_rad.is_finite();
        let expected = "a factor of at least 0 and an angle";
        check(is_right, &what, expected, (self.scale, self.rotation_rad))?;
        let texels = u64::from(self.width) * u64::from(self.height);
        let is_hole =
            |(texel, light): &(u32, [f32; 3])| u64::from(*texel) < texels && is_light(*light);
        let are_holes = self.holes.iter().all(is_hole)
            && self.holes.windows(2).all(|pair| pair[0].0 < pair[1].0);
        let expected = "texels that exist, in order, and light of at least 0";
        check(are_holes, &what, expected, self.holes.len())
    }
}

impl PackedMaterial {
    fn validate(&self, textures: usize) -> Result<()> {
        let what = || format!("material {:?}", self.name);
        let has_texture = self.texture.is_none_or(|t| (t as usize) < textures);
        check(
            has_texture,
            &what,
            &format!("a texture below {textures}"),
            self.texture,
        )?;
        let is_right = are_shares(self.albedo) && is_light(self.emission);
        check(
            is_right,
            &what,
            "an albedo from 0 to 1, and emission of at least 0",
            self,
        )
    }
}

impl PackedMesh {
    fn validate(&self, materials: usize) -> Result<()> {
        let is_right = self.vertices <= MAX_VERTICES
            && self.triangles <= MAX_TRIANGLES
            && (self.triangles == 0 || (self.vertices > 0 && materials > 0));
        let expected = "at most 2^32 - 1 vertices and 2^27 triangles, and materials for these";
        check(is_right, &|| "mesh".into(), expected, self)
    }
}

impl PackedHierarchy {
    fn validate(&self, mesh: &PackedMesh) -> Result<()> {
        let is_power = self.scale.is_normal() && self.scale > 0.0 && self.scale.to_bits() << 9 == 0;
        let is_right = (1..=MAX_TRIANGLES).contains(&self.nodes)
            && (1..=mesh.triangles).contains(&self.blocks)
            && is_power;
        let expected = "nodes, blocks of the triangles, and a power of two as scale";
        check(is_right, &|| "hierarchy".into(), expected, self)
    }
}

impl PackedVolume {
    fn validate(&self) -> Result<()> {
        let what = || format!("volume {:?}", self.name);
        let dims = self.dims;
        let sides = 1..=MAX_VOXELS_ALONG;
        check(
            dims.iter().all(|n| sides.contains(n)),
            &what,
            "voxels along each axis",
            dims,
        )?;
        let [x, y, z, _] = self.scene_from_index;
        let c = cross(x, y);
        let determinant = c[0] * z[0] + c[1] * z[1] + c[2] * z[2];
        let fits = |v: &f64| v.abs() <= f64::from(f32::MAX);
        // Voxels are as thin as their volume over the areas of their faces.
        let area = |a: [f64; 3], b: [f64; 3]| {
            let c = cross(a, b);
            (c[0] * c[0] + c[1] * c[1] + c[2] * c[2]).sqrt()
        };
        let is_thick = |face: f64| determinant.abs() >= MIN_VOXEL_EDGE * face;
        let is_map = self.scene_from_index.as_flattened().iter().all(fits)
            && determinant.is_finite()
            && determinant != 0.0
            && [area(x, y), area(y, z), area(z, x)]
                .into_iter()
                .all(is_thick);
        let expected =
            "a map of finite numbers that can be inverted, to voxels that have an extent";
        check(is_map, &what, expected, self.scene_from_index)?;
        check(
            are_shares(self.albedo),
            &what,
            "an albedo from 0 to 1",
            self.albedo,
        )?;
        let is_right = self
            .phase
            .is_none_or(|p| p.g.iter().all(|g| g.abs() <= 0.99) && (0.0..=1.0).contains(&p.mix));
        let expected = "lobes of mean cosines from -0.99 to 0.99, and a weight from 0 to 1";
        check(is_right, &what, expected, self.phase)?;
        let count = self.levels.len();
        let is_right = (1..=Self::MOST_LEVELS).contains(&count)
            && (count == 1 || self.dims_of_level(count - 2) != [1; 3]);
        let expected = "levels down to one of a single voxel at most";
        check(is_right, &what, expected, count)?;
        for (level, bricks) in self.levels.iter().enumerate() {
            let dims = self.dims_of_level(level).map(|n| u128::from(n / 8 + 1));
            let most = dims.iter().product::<u128>();
            let expected = format!("at most {most} bricks of level {level}");
            check(u128::from(*bricks) <= most, &what, &expected, bricks)?;
        }
        Ok(())
    }

    /// Levels of a volume, at most.
    const MOST_LEVELS: usize = 20;

    /// Voxels of a level along each axis: half as many as of the one before, rounded up.
    #[must_use]
    pub fn dims_of_level(&self, level: usize) -> [u32; 3] {
        self.dims.map(|n| n.div_ceil(1 << level.min(31)))
    }

    /// Bricks of 8^3 cells of a level along each axis, stored or not; there is a cell before the
    /// first sample and one behind the last.
    #[must_use]
    pub fn brick_dims(&self, level: usize) -> [u64; 3] {
        self.dims_of_level(level).map(|n| u64::from(n) / 8 + 1)
    }
}
