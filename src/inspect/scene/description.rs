//! What is told of a scene, a mesh or a volume file.

/// Description of a scene, mesh or volume file. The keys of its JSON do not change within a
/// version; positions are in world space, lengths in world units.
#[derive(Clone, Debug, serde::Serialize)]
pub struct SceneDescription {
    /// Path of the file, as given.
    pub file: String,
    /// `scene`, `mesh` or `volume`.
    pub kind: &'static str,
    /// Name of the scene.
    pub name: String,
    /// Identity of the scene: of the content of all files.
    pub scene_hash: String,
    /// The files that were read, that of the scene first.
    pub files: Vec<ReadFile>,
    /// The packed scene that its surfaces and volumes are those of; what it holds of these is told
    /// of that file.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub packed: Option<String>,
    /// All triangles.
    pub mesh: MeshDescription,
    /// Materials that triangles have.
    pub materials: Vec<MaterialDescription>,
    /// Textures, in the order that materials refer to.
    pub textures: Vec<TextureDescription>,
    /// Lights but emissive materials.
    pub lights: Vec<LightDescription>,
    /// Cameras, the default first; none of a mesh or volume file.
    pub cameras: Vec<CameraDescription>,
    /// Pixels across and down of a frame; none of a mesh or volume file.
    pub film: Option<[u32; 2]>,
    /// Volumes, one for each grid that was read.
    pub volumes: Vec<VolumeDescription>,
    /// Bytes of memory that triangles, textures and grids take.
    pub memory_bytes: u64,
    /// What was left out, and what was taken otherwise than the files say.
    pub warnings: Vec<String>,
}

/// A file that was read.
#[derive(Clone, Debug, serde::Serialize)]
pub struct ReadFile {
    /// Its path.
    pub path: String,
    /// Its length.
    pub bytes: u64,
}

/// A box along the axes of world space.
#[derive(Clone, Copy, Debug, PartialEq, serde::Serialize)]
pub struct WorldBox {
    /// Its least corner.
    pub min: [f64; 3],
    /// Its greatest corner.
    pub max: [f64; 3],
}

/// The triangles of a scene.
#[derive(Clone, Debug, serde::Serialize)]
pub struct MeshDescription {
    /// Triangles that have an area.
    pub triangles: u64,
    /// Triangles that are stored, where some are placed many times.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub stored_triangles: Option<u64>,
    /// Places of meshes that are stored once.
    #[serde(skip_serializing_if = "is_none")]
    pub instances: u64,
    /// Triangles without area, which are left out.
    pub degenerate_triangles: u64,
    /// Vertices.
    pub vertices: u64,
    /// Sum of all areas.
    pub area: f64,
    /// Box around all triangles, if there are any.
    pub bounds: Option<WorldBox>,
    /// Whether vertices have normals, colours, texture coordinates.
    pub has_normals: bool,
    /// Whether any vertex has a colour.
    pub has_colors: bool,
    /// Whether any vertex has texture coordinates that a material uses.
    pub has_uvs: bool,
    /// Bytes of memory.
    pub memory_bytes: u64,
}

#[allow(clippy::trivially_copy_pass_by_ref)]
fn is_none(count: &u64) -> bool {
    *count == 0
}

/// A material.
#[derive(Clone, Debug, serde::Serialize)]
pub struct MaterialDescription {
    /// Its name; may be empty.
    pub name: String,
    /// Diffuse albedo, a factor on the texture if there is one.
    pub albedo: [f32; 3],
    /// Emitted radiance, a factor on the texture if there is one.
    pub emission: [f32; 3],
    /// Number of its texture.
    pub texture: Option<u32>,
    /// Number of the texture of its emission.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub emission_texture: Option<u32>,
    /// Where it is there.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub mask: Option<MaskDescription>,
    /// Triangles that have it.
    pub triangles: u64,
    /// The area of these.
    pub area: f64,
    /// Whether cameras do not see it.
    #[serde(skip_serializing_if = "std::ops::Not::not")]
    pub unseen: bool,
}

/// Where a material is there.
#[derive(Clone, Copy, Debug, PartialEq, serde::Serialize)]
pub struct MaskDescription {
    /// Opacity, a factor on the texture if there is one.
    pub opacity: f32,
    /// Number of that texture.
    pub texture: Option<u32>,
    /// The opacity from which on it is there; `None` for a share.
    pub cutoff: Option<f32>,
}

/// A texture.
#[derive(Clone, Debug, PartialEq, serde::Serialize)]
pub struct TextureDescription {
    /// Texels across.
    pub width: u32,
    /// Texels down.
    pub height: u32,
    /// Bits of each channel in memory.
    pub bits: u32,
    /// Index of the texture before it whose texels it has, if there is one.
    pub shared_with: Option<u32>,
    /// Bytes of memory; 0 if they are those of another texture.
    pub memory_bytes: u64,
}

/// A light.
#[derive(Clone, Debug, PartialEq, serde::Serialize)]
pub struct LightDescription {
    /// `point`, `spot`, `directional`, `environment` or `environment image`.
    #[serde(rename = "type")]
    pub kind: &'static str,
    /// Where it is, of a point or a spot.
    pub position: Option<[f64; 3]>,
    /// The way its light travels, of a spot or a sun.
    pub direction: Option<[f32; 3]>,
    /// Intensity of points and spots, irradiance of suns, radiance of environments, of images the
    /// mean over all directions.
    pub color: [f32; 3],
    /// Whether it is an environment that cameras do not see.
    #[serde(skip_serializing_if = "std::ops::Not::not")]
    pub unseen: bool,
}

/// A camera.
#[derive(Clone, Debug, PartialEq, serde::Serialize)]
pub struct CameraDescription {
    /// Its name.
    pub name: String,
    /// Where it is.
    pub position: [f64; 3],
    /// The way it looks.
    pub direction: [f32; 3],
    /// Full horizontal field of view in degrees.
    pub fov_x_deg: f32,
    /// Radius of the opening of its lens, and the distance of what is sharp; none of a pinhole.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub lens: Option<LensDescription>,
    /// When its shutter opens and closes, in frames from that of the picture; none for a moment.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub shutter: Option<[f64; 2]>,
}

/// The lens of a camera.
#[derive(Clone, Copy, Debug, PartialEq, serde::Serialize)]
pub struct LensDescription {
    /// Radius of its opening.
    pub aperture: f32,
    /// Distance along the camera's axis of what is sharp.
    pub focus_distance: f32,
}

/// A volume: what is rendered, and the values in the file that it comes from.
#[derive(Clone, Debug, serde::Serialize)]
pub struct VolumeDescription {
    /// Its name.
    pub name: String,
    /// The file; `builtin:` shapes have their name.
    pub file: String,
    /// Name of the grid in a file of several.
    pub grid: Option<String>,
    /// The axes of a patient along which the file has its place, as `RAS`, if it says so.
    pub patient_space: Option<&'static str>,
    /// Voxels along each axis of the box that is read.
    pub dims: [usize; 3],
    /// Index in the file of the first voxel of the box.
    pub first: [i64; 3],
    /// Voxels of the box.
    pub voxels: u64,
    /// Voxels whose value is a number other than 0.
    pub active_voxels: u64,
    /// Voxels whose value is below 0.
    pub negative_voxels: u64,
    /// The least value in the file.
    pub min: f32,
    /// The greatest value in the file.
    pub max: f32,
    /// The mean of the values other than 0.
    pub active_mean: f64,
    /// Counts of the values other than 0 in bins of equal width.
    pub histogram: ValueHistogram,
    /// Box around it.
    pub bounds: WorldBox,
    /// Edges of a voxel.
    pub voxel_edges: [f64; 3],
    /// Single-scattering albedo.
    pub albedo: [f32; 3],
    /// Whether the albedo varies, and `albedo` is its mean.
    #[serde(skip_serializing_if = "std::ops::Not::not")]
    pub albedo_varies: bool,
    /// Extinction of red, green and blue over that of the channel that has most; none if it is
    /// grey.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub extinction_color: Option<[f32; 3]>,
    /// Mean cosines of the lobes of the phase function; none if it is isotropic.
    pub phase_g: Vec<f32>,
    /// Weight of the first of two lobes, or 1.
    pub phase_mix: f32,
    /// The greatest extinction.
    pub sigma_t_max: f32,
    /// The mean extinction over the whole box.
    pub sigma_t_mean: f64,
    /// Optical depth of a voxel along its longest edge: greatest, and mean over the active ones.
    pub voxel_depth_max: f64,
    /// The mean of that over the active voxels.
    pub voxel_depth_mean: f64,
    /// What to write into a scene, of a volume file by itself.
    pub suggested: Option<Suggestion>,
    /// Bytes of memory.
    pub memory_bytes: u64,
}

/// Values of keys with which a volume can be seen into.
#[derive(Clone, Debug, PartialEq, serde::Serialize)]
pub struct Suggestion {
    /// The values that are densities of 0 and 1.
    pub window: [f64; 2],
    /// Extinction per world unit where the density is 1.
    pub sigma_t_scale: f64,
}

/// Counts of values.
#[derive(Clone, Debug, serde::Serialize)]
pub struct ValueHistogram {
    /// Lower end of the first bin.
    pub from: f32,
    /// Upper end of the last bin.
    pub to: f32,
    /// Values in each bin.
    pub counts: Vec<u64>,
}
