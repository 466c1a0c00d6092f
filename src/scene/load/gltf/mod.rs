//! glTF 2.0, as text or binary: the default scene's meshes, materials, cameras and punctual lights.
//!
//! Base colour (factor, texture, vertex colours) is the albedo, whatever the metalness; emissive
//! factor times strength is radiance. Lights are taken as radiometric: candela is intensity, lux is
//! irradiance, 1:1. Skins, morph targets, animations, transparency, metal and normal maps are left
//! out, with a warning; an emissive texture is replaced by its mean. Of extensions lights, emissive
//! strength and texture transforms are read, and those that do not change looks are passed over;
//! others are warned of.

mod buffers;
mod left_out;

use super::files::Files;
use super::texture;
use crate::run::memory;
use crate::scene::builder::{
    CameraInput, DEFAULT_FILM, LightInput, MAX_EMISSION, MESH, MeshInput, SceneBuilder, is_singular,
};
use crate::scene::{Film, Light, Material, Wrap};
use crate::{Error, Result};
use ::gltf::camera::Projection;
use ::gltf::khr_lights_punctual::Kind;
use ::gltf::material::AlphaMode;
use ::gltf::mesh::{Mode, Primitive, Semantic};
use ::gltf::scene::Transform;
use ::gltf::texture::{Info, WrappingMode};
use ::gltf::{Document, Gltf, Node};
use buffers::Buffers;
use glam::{DAffine3, DMat3, DMat4, DQuat, DVec3, Vec2, Vec3};
use std::collections::HashMap;
use std::path::Path;

/// What exporters multiply by that turn radiometric lights into photometric ones.
const LUMENS_PER_WATT: f32 = 683.0;

/// What a glTF file holds.
#[derive(Default)]
pub(super) struct Import {
    /// All meshes, in place.
    pub(super) mesh: MeshInput,
    pub(super) cameras: Vec<ImportedCamera>,
    pub(super) lights: Vec<LightInput>,
}

/// A perspective camera.
pub(super) struct ImportedCamera {
    pub(super) name: String,
    /// Rotation and position.
    pub(super) world_from_camera: DAffine3,
    pub(super) fov_y_rad: f64,
    /// Width over height, if the file states it.
    pub(super) aspect: Option<f64>,
}

impl Import {
    /// The file as a whole scene, the film as wide as its first camera sees.
    pub(super) fn into_scene(self, path: &Path) -> Result<SceneBuilder> {
        self.mesh.check()?;
        let mut film = DEFAULT_FILM;
        if let Some(aspect) = self.cameras.first().and_then(|c| c.aspect) {
            film.height = (f64::from(film.width) / aspect).round().clamp(1.0, 65536.0) as u32;
        }
        let mut scene = SceneBuilder {
            name: path
                .file_stem()
                .unwrap_or_default()
                .to_string_lossy()
                .into(),
            film: Some(film),
            automatic_exposure: true,
            lights: self.lights,
            ..SceneBuilder::default()
        };
        for camera in self.cameras {
            let camera = camera.for_film(&film)?;
            scene.add_camera(camera);
        }
        scene.meshes.push(self.mesh);
        Ok(scene)
    }
}

impl ImportedCamera {
    /// The camera for a film: what it sees from top to bottom stays, from side to side goes with
    /// the film.
    pub(super) fn for_film(self, film: &Film) -> Result<CameraInput> {
        let aspect = f64::from(film.width) / f64::from(film.height);
        if !(self.fov_y_rad > 1e-4 && self.fov_y_rad < 3.13) {
            return Err(Error::input(format!(
                "camera `{}`: expected a field of view above 0 and below pi, found {}",
                self.name, self.fov_y_rad
            )));
        }
        Ok(CameraInput {
            name: self.name,
            world_from_camera: self.world_from_camera,
            fov_x_rad: 2.0 * libm::atan(libm::tan(0.5 * self.fov_y_rad) * aspect),
        })
    }
}

/// Reads a `.gltf` or `.glb` file and the files that it names.
pub(super) fn read(content: &[u8], path: &Path, files: &mut Files) -> Result<Import> {
    check_length(content)?;
    let gltf = Gltf::from_slice_without_validation(content).map_err(unreadable)?;
    let mut json = gltf.document.into_json();
    check_attributes(&json)?;
    mend_textures(&mut json);
    let mut gltf = Gltf {
        document: Document::from_json(json).map_err(unreadable)?,
        blob: gltf.blob,
    };
    let buffers = Buffers::read(&mut gltf, path, files)?;
    let mut reader = Reader {
        path,
        files,
        document: &gltf.document,
        buffers,
        materials: HashMap::new(),
        textures: HashMap::new(),
        out: Import::default(),
        list: MeshInput::default(),
    };
    for what in left_out::told(reader.document) {
        reader.warn(what);
    }
    reader.nodes()?;
    reader.out.mesh.materials = reader.list.materials;
    reader.out.mesh.textures = reader.list.textures;
    Ok(reader.out)
}

/// The crate takes the length in the header on trust.
fn check_length(content: &[u8]) -> Result<()> {
    if !content.starts_with(b"glTF") {
        return Ok(());
    }
    let stated = content
        .get(8..12)
        .map(|b| u32::from_le_bytes([b[0], b[1], b[2], b[3]]));
    match stated {
        Some(n) if n >= 20 && n as usize <= content.len() => Ok(()),
        _ => Err(Error::input(format!(
            "expected {} bytes as the header says, found {}; the file is truncated or damaged",
            stated.unwrap_or(20),
            content.len()
        ))),
    }
}

fn unreadable(e: ::gltf::Error) -> Error {
    Error::input(format!("not a glTF file that can be read: {e}"))
}

/// The crate's own validation takes it on trust that positions have an accessor.
fn check_attributes(json: &::gltf::json::Root) -> Result<()> {
    for (m, mesh) in json.meshes.iter().enumerate() {
        for (p, primitive) in mesh.primitives.iter().enumerate() {
            for accessor in primitive.attributes.values() {
                let count = json.accessors.len();
                if accessor.value() >= count {
                    return Err(Error::input(format!(
                        "mesh {m}, primitive {p}: refers to accessor {}, but there are {count}",
                        accessor.value()
                    )));
                }
            }
        }
    }
    Ok(())
}

/// Some writers list textures of images that are not there; that is wrong only where a material
/// uses one.
fn mend_textures(json: &mut ::gltf::json::Root) {
    let count = json.images.len();
    let nowhere = ::gltf::json::Index::new(count as u32);
    let mut mended = false;
    for texture in &mut json.textures {
        if texture.source.value() >= count {
            texture.source = nowhere;
            mended = true;
        }
    }
    if mended {
        json.images.push(::gltf::json::Image {
            buffer_view: None,
            mime_type: None,
            name: None,
            uri: None,
            extensions: None,
            extras: None,
        });
    }
}

struct Reader<'a> {
    path: &'a Path,
    files: &'a mut Files,
    document: &'a Document,
    buffers: Buffers,
    /// Index in `list` of each material of the file; `None` is the default material.
    materials: HashMap<Option<usize>, u32>,
    /// Index in `list` of each image of the file, for each way in which it goes on beyond its
    /// borders.
    textures: HashMap<(usize, [Wrap; 2]), u32>,
    out: Import,
    /// Holds the materials and textures, which all meshes share.
    list: MeshInput,
}

impl Reader<'_> {
    fn nodes(&mut self) -> Result<()> {
        let document = self.document;
        let scene = document
            .default_scene()
            .or_else(|| document.scenes().next());
        let mut stack: Vec<(Node<'_>, DAffine3)> = match scene {
            Some(scene) => scene.nodes().map(|n| (n, DAffine3::IDENTITY)).collect(),
            None => {
                return Err(Error::input(
                    "the file has no scene: only a library of meshes",
                ));
            }
        };
        // Children in order of the file: the last in comes out first.
        stack.reverse();
        let mut seen = vec![false; document.nodes().len()];
        while let Some((node, world_from_parent)) = stack.pop() {
            let index = node.index();
            if std::mem::replace(&mut seen[index], true) {
                return Err(Error::input(format!(
                    "node {index} has two parents, or is among its own descendants"
                )));
            }
            let world_from_node = world_from_parent * local(&node);
            self.node(&node, &world_from_node)
                .map_err(|e| e.at(format!("node {index}{}", quoted(node.name()))))?;
            let children = stack.len();
            stack.extend(node.children().map(|child| (child, world_from_node)));
            stack[children..].reverse();
        }
        Ok(())
    }

    fn node(&mut self, node: &Node<'_>, world_from_node: &DAffine3) -> Result<()> {
        let is_used = node.mesh().is_some() || node.camera().is_some() || node.light().is_some();
        if is_used && is_singular(world_from_node) {
            self.warn(format!(
                "node {}{} is scaled to nothing and left out",
                node.index(),
                quoted(node.name())
            ));
            return Ok(());
        }
        if let Some(mesh) = node.mesh() {
            for primitive in mesh.primitives() {
                let mut mesh = self
                    .primitive(&primitive)
                    .map_err(|e| e.at(format!("primitive {}", primitive.index())))?;
                mesh.place(world_from_node);
                let total = self.out.mesh.positions.len() + mesh.positions.len();
                if total > u32::MAX as usize {
                    return Err(Error::input(
                        "more vertices than can be indexed with 32 bits",
                    ));
                }
                self.out.mesh.append(mesh)?;
            }
        }
        if let Some(camera) = node.camera() {
            let name = camera.name().or(node.name()).unwrap_or("camera");
            match camera.projection() {
                Projection::Perspective(lens) => self.out.cameras.push(ImportedCamera {
                    name: name.into(),
                    world_from_camera: without_scale(world_from_node),
                    fov_y_rad: lens.yfov().into(),
                    aspect: lens.aspect_ratio().map(f64::from),
                }),
                Projection::Orthographic(_) => self.warn(format!(
                    "camera `{name}` is orthographic and left out: only perspective is supported"
                )),
            }
        }
        if let Some(light) = node.light() {
            let intensity = light.color().map(|c| c * light.intensity());
            if !(intensity.iter()).all(|x| (0.0..=MAX_EMISSION).contains(x)) {
                return Err(Error::input(format!(
                    "a light of intensity {intensity:?}: expected 0 to {:e}",
                    MAX_EMISSION
                )));
            }
            if intensity.iter().any(|x| *x >= LUMENS_PER_WATT) {
                self.warn(format!(
                    "a light of intensity {intensity:?} is taken as radiometric; if it is in candela or lux, \
                     radiance comes out {LUMENS_PER_WATT} times as high"
                ));
            }
            let direction = -without_scale(world_from_node).matrix3.z_axis.as_vec3();
            let position = Vec3::ZERO;
            let light = match light.kind() {
                Kind::Point => Light::Point {
                    position,
                    intensity,
                },
                Kind::Spot {
                    inner_cone_angle,
                    outer_cone_angle,
                } => {
                    let (cos_inner, cos_outer) =
                        (libm::cosf(inner_cone_angle), libm::cosf(outer_cone_angle));
                    if !(inner_cone_angle >= 0.0 && cos_inner > cos_outer) {
                        return Err(Error::input(format!(
                            "a spot light of cone angles {inner_cone_angle} and {outer_cone_angle}: the inner must be smaller"
                        )));
                    }
                    Light::Spot {
                        position,
                        direction,
                        intensity,
                        cos_inner,
                        cos_outer,
                    }
                }
                Kind::Directional => Light::Directional {
                    direction,
                    irradiance: intensity,
                    angular_radius_rad: 0.0,
                },
            };
            self.out.lights.push(LightInput {
                light,
                position: world_from_node.translation,
            });
        }
        Ok(())
    }

    fn primitive(&mut self, primitive: &Primitive<'_>) -> Result<MeshInput> {
        let mut mesh = MeshInput::default();
        self.files.cancel.check()?;
        let positions = primitive.get(&Semantic::Positions);
        let positions = positions.ok_or_else(|| Error::input("a mesh without positions"))?;
        mesh.positions = self
            .buffers
            .floats(&positions, |p| Vec3::from_array(p).as_dvec3())?;
        let count = mesh.positions.len();
        self.files.cancel.check()?;
        let indices = match primitive.indices() {
            Some(accessor) => self.buffers.indices(&accessor)?,
            None => memory::listed(MESH, 0..count as u32)?,
        };
        mesh.triangles = match primitive.mode() {
            Mode::Triangles => {
                let triples = indices.chunks_exact(3);
                memory::listed(MESH, triples.map(|t| [t[0], t[1], t[2]]))?
            }
            Mode::TriangleStrip => {
                let triples = indices.windows(3).enumerate();
                let turned = triples.map(|(i, t)| match i % 2 {
                    0 => [t[0], t[1], t[2]],
                    _ => [t[0], t[2], t[1]],
                });
                memory::listed(MESH, turned)?
            }
            Mode::TriangleFan => {
                let pairs = indices.windows(2).skip(1);
                memory::listed(MESH, pairs.map(|t| [indices[0], t[0], t[1]]))?
            }
            _ => {
                self.warn("points and lines are left out".into());
                return Ok(MeshInput::default());
            }
        };
        let same_count = |found: usize, what: &str| match found == count {
            true => Ok(()),
            false => Err(Error::input(format!(
                "expected {count} {what}, one for each position, found {found}"
            ))),
        };
        self.files.cancel.check()?;
        if let Some(accessor) = primitive.get(&Semantic::Normals) {
            mesh.normals = self.buffers.floats(&accessor, Vec3::from_array)?;
            same_count(mesh.normals.len(), "normals")?;
        }
        if let Some(accessor) = primitive.get(&Semantic::Colors(0)) {
            mesh.colors = match accessor.dimensions().multiplicity() {
                4 => (self.buffers).floats(&accessor, |[r, g, b, _]| [r, g, b])?,
                _ => self.buffers.floats(&accessor, |rgb: [f32; 3]| rgb)?,
            };
            same_count(mesh.colors.len(), "colours")?;
        }
        let material = primitive.material();
        let base_color = material.pbr_metallic_roughness().base_color_texture();
        let set = base_color.as_ref().map_or(0, |info| {
            let other = info.texture_transform().and_then(|t| t.tex_coord());
            other.unwrap_or(info.tex_coord())
        });
        if let Some(accessor) = primitive.get(&Semantic::TexCoords(set)) {
            mesh.uvs = self.buffers.floats(&accessor, Vec2::from_array)?;
            same_count(mesh.uvs.len(), "texture coordinates")?;
            if let Some(info) = &base_color {
                transform_uvs(&mut mesh.uvs, info);
            }
        }
        let index = self.material(&material)?;
        let textured = self.list.materials[index as usize].texture.is_some();
        if textured && mesh.uvs.is_empty() {
            return Err(Error::input(format!(
                "the material{} has a texture, but there are no texture coordinates (set {set})",
                quoted(material.name())
            )));
        }
        mesh.material = memory::filled(MESH, index, mesh.triangles.len())?;
        // Here, while vertices are counted as in the file: joined to others a wrong index may hit
        // one of theirs.
        mesh.check()?;
        Ok(mesh)
    }

    fn material(&mut self, material: &::gltf::Material<'_>) -> Result<u32> {
        if let Some(&index) = self.materials.get(&material.index()) {
            return Ok(index);
        }
        let name = material.name().unwrap_or("gltf");
        let base = material.pbr_metallic_roughness();
        let [r, g, b, _] = base.base_color_factor();
        let mut made: Material = Material::diffuse(name, [r, g, b]);
        let strength = material.emissive_strength().unwrap_or(1.0);
        made.emission = material.emissive_factor().map(|e| e * strength);
        // Both sides are drawn, so both shine.
        made.emits_both_sides = material.double_sided();
        if let Some(info) = material.emissive_texture()
            && made.emission != [0.0; 3]
        {
            let image = info.texture().source().index();
            let mean = self
                .mean(image)
                .map_err(|e| e.at(format!("image {image}")))?;
            made.emission = std::array::from_fn(|i| made.emission[i] * mean[i]);
            self.warn(format!(
                "material `{name}` shines evenly, with the mean of its emissive texture"
            ));
        }
        if material.alpha_mode() != AlphaMode::Opaque {
            self.warn(format!("material `{name}` is taken as opaque"));
        }
        if let Some(info) = base.base_color_texture() {
            let image = info.texture().source().index();
            let sampler = info.texture().sampler();
            let wrap = [sampler.wrap_s(), sampler.wrap_t()].map(|mode| match mode {
                WrappingMode::Repeat => Wrap::Repeat,
                WrappingMode::ClampToEdge => Wrap::Clamp,
                WrappingMode::MirroredRepeat => Wrap::Mirror,
            });
            made.texture = Some(
                self.texture(image, wrap)
                    .map_err(|e| e.at(format!("image {image}")))?,
            );
        }
        let index = self.list.materials.len() as u32;
        self.list.materials.push(made);
        self.materials.insert(material.index(), index);
        Ok(index)
    }

    fn texture(&mut self, image: usize, wrap: [Wrap; 2]) -> Result<u32> {
        if let Some(&index) = self.textures.get(&(image, wrap)) {
            return Ok(index);
        }
        let content = self
            .buffers
            .image(self.document, image, self.path, self.files)?;
        let index = self.list.textures.len() as u32;
        let mut texture = texture::decode(&content)?;
        texture.wrap = wrap;
        self.list.textures.push(texture);
        self.textures.insert((image, wrap), index);
        Ok(index)
    }

    /// The mean colour of an image.
    fn mean(&mut self, image: usize) -> Result<[f32; 3]> {
        let content = self
            .buffers
            .image(self.document, image, self.path, self.files)?;
        Ok(texture::mean(&texture::decode(&content)?))
    }

    fn warn(&mut self, message: String) {
        let message = format!("{}: {message}", self.path.display());
        // One primitive after another may have the same to say.
        if !self.files.warnings.contains(&message) {
            self.files.warn(message);
        }
    }
}

/// Applies KHR_texture_transform: scale, then rotation from u towards -v, then offset.
fn transform_uvs(uvs: &mut [Vec2], info: &Info<'_>) {
    let Some(transform) = info.texture_transform() else {
        return;
    };
    let (sin, cos) = libm::sincosf(transform.rotation());
    let (scale, offset) = (
        Vec2::from(transform.scale()),
        Vec2::from(transform.offset()),
    );
    for uv in uvs {
        let p = *uv * scale;
        *uv = Vec2::new(cos * p.x + sin * p.y, cos * p.y - sin * p.x) + offset;
    }
}

fn quoted(name: Option<&str>) -> String {
    name.map_or(String::new(), |n| format!(" `{n}`"))
}

/// The map from a node to its parent, in f64.
fn local(node: &Node<'_>) -> DAffine3 {
    match node.transform() {
        Transform::Matrix { matrix } => {
            let columns = matrix.map(|column| column.map(f64::from));
            DAffine3::from_mat4(DMat4::from_cols_array_2d(&columns))
        }
        Transform::Decomposed {
            translation,
            rotation,
            scale,
        } => {
            let rotation = DQuat::from_array(rotation.map(f64::from));
            // A quaternion of zeros becomes no rotation rather than no numbers.
            let length = rotation.length();
            let rotation = match length.is_finite() && length > 0.0 {
                true => rotation / length,
                false => DQuat::IDENTITY,
            };
            DAffine3::from_scale_rotation_translation(
                DVec3::from(scale.map(f64::from)),
                rotation,
                DVec3::from(translation.map(f64::from)),
            )
        }
    }
}

/// The rotation and position that come nearest to a map that is not singular; its z axis keeps its
/// direction.
pub(super) fn without_scale(map: &DAffine3) -> DAffine3 {
    let m = map.matrix3;
    let back = m.z_axis.normalize();
    let right = m.y_axis.cross(back).normalize();
    DAffine3 {
        matrix3: DMat3::from_cols(right, back.cross(right), back),
        translation: map.translation,
    }
}

#[cfg(test)]
mod tests;
