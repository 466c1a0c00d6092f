//! glTF 2.0, as text or binary: the default scene's meshes, materials, cameras and punctual lights.
//!
//! Base colour (factor, texture, vertex colours) is the albedo, whatever the metalness; emissive
//! factor times strength is radiance. Lights are taken as radiometric: candela is intensity, lux is
//! irradiance, 1:1. Materials are there where their alpha says. Skins, morph targets, animations,
//! metal and normal maps are left out, with a warning; an emissive texture that lies otherwise than
//! that of the base colour is replaced by its mean. Of extensions lights, emissive strength and
//! texture transforms are read, and those that do not change looks are passed over; others are
//! warned of.
//!
//! - `document`: parses a file and mends what others write; `extensions`: which are read
//! - `buffers`: the bytes of a document; `instancing`: meshes that are placed many times
//! - `masks`: where surfaces are there; `placed`: where textures lie
//! - here: nodes, meshes, materials, cameras and lights

mod base_color;
mod buffers;
mod document;
mod extensions;
mod instancing;
mod masks;
mod placed;

use super::colors::ColorEncoding;
use super::files::Files;
use super::left_out::LeftOut;
use super::texture::{self, Decoding};
use crate::run::memory;
use crate::scene::builder::{
    CameraInput, DEFAULT_FILM, LightInput, MAX_EMISSION, MESH, MeshInput, SceneBuilder, is_singular,
};
use crate::scene::{Film, Light, Material, Texture, Wrap};
use crate::{Error, Result};
use ::gltf::camera::Projection;
use ::gltf::khr_lights_punctual::{Kind, Light as PunctualLight};
use ::gltf::material::AlphaMode;
use ::gltf::mesh::{Mode, Primitive, Semantic};
use ::gltf::scene::Transform;
use ::gltf::{Document, Node};
use base_color::base_color;
use buffers::Buffers;
use glam::{DAffine3, DMat3, DMat4, DQuat, DVec3, Vec2, Vec3};
use instancing::{KeptOnce, PlaceLists};
use placed::{is_placed_alike, set_of, transform_uvs, wrap};
use std::collections::HashMap;
use std::path::Path;

/// What exporters multiply by that turn radiometric lights into photometric ones.
const LUMENS_PER_WATT: f32 = 683.0;
/// Its inverse, as people write it.
const LIGHT_SCALE: f32 = 0.001464;

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
    /// Warns of lights that are taken as they are and seem to be in photometric units.
    pub(super) fn tell_photometric(&self, path: &Path, files: &mut Files) {
        let bright = |light: &LightInput| match light.light {
            Light::Point { intensity, .. } | Light::Spot { intensity, .. } => Some(intensity),
            Light::Directional { irradiance, .. } => Some(irradiance),
            _ => None,
        };
        let bright = self.lights.iter().filter_map(bright);
        let mut bright = bright.filter(|i| i.iter().any(|x| *x >= LUMENS_PER_WATT));
        let Some(first) = bright.next() else {
            return;
        };
        let others = match bright.count() {
            0 => String::new(),
            n => format!(" and {n} others"),
        };
        files.warn(format!(
            "{}: a light of intensity {first:?}{others} is taken as radiometric; if it is in \
             candela or lux, as Blender writes it, radiance comes out {LUMENS_PER_WATT} times as \
             high: `light_scale = {LIGHT_SCALE}` beside `import` in a scene file mends that",
            path.display()
        ));
    }

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
        let cameras = self.cameras.into_iter().map(|c| c.for_film(&film));
        scene.add_cameras(cameras.collect::<Result<_>>()?);
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
            keys: Vec::new(),
            lens: None,
            shutter: None,
        })
    }
}

/// Reads a `.gltf` or `.glb` file and the files that it names.
pub(super) fn read(content: &[u8], path: &Path, files: &mut Files) -> Result<Import> {
    let opened = document::open(content)?;
    let mut gltf = opened.gltf;
    let buffers = Buffers::read(&mut gltf, path, files)?;
    let mut reader = Reader {
        path,
        files,
        document: &gltf.document,
        buffers,
        materials: HashMap::new(),
        textures: HashMap::new(),
        alphas: HashMap::new(),
        is_hidden: opened.is_hidden,
        place_lists: opened.place_lists,
        kept_once: Vec::new(),
        out: Import::default(),
        list: MeshInput::default(),
        left_out: LeftOut::default(),
    };
    extensions::note(reader.document, &opened.idle, &mut reader.left_out);
    let nodes = reader.nodes()?;
    let counts = nodes.iter().map(|(n, _)| (n, reader.count_of_places(n)));
    reader.kept_once = instancing::kept_once(reader.document, counts)?;
    for (node, world_from_node) in &nodes {
        let place = || format!("node {}{}", node.index(), quoted(node.name()));
        let read = reader.node(node, world_from_node);
        read.map_err(|e| e.at(place()))?;
    }
    let kept = std::mem::take(&mut reader.kept_once);
    (reader.out.mesh.copies).extend(kept.into_iter().flatten().flatten());
    let materials = reader.document.materials().len();
    reader.left_out.tell(path, materials, reader.files);
    reader.out.mesh.materials = reader.list.materials;
    reader.out.mesh.textures = reader.list.textures;
    Ok(reader.out)
}

struct Reader<'a> {
    path: &'a Path,
    files: &'a mut Files,
    document: &'a Document,
    buffers: Buffers,
    /// Index in `list` of each material of the file, for meshes with texture coordinates and for
    /// those without; `None` is the default material.
    materials: HashMap<(Option<usize>, bool), u32>,
    /// Index in `list` of each image of the file, for each way in which it goes on beyond its
    /// borders.
    textures: HashMap<(usize, [Wrap; 2]), Option<u32>>,
    /// The same of the alpha of images.
    alphas: HashMap<(usize, [Wrap; 2]), Option<u32>>,
    /// Whether each node is hidden, and what is below it.
    is_hidden: Vec<bool>,
    /// By node, the places of its mesh, if they are listed.
    place_lists: Vec<Option<PlaceLists>>,
    kept_once: KeptOnce,
    out: Import,
    left_out: LeftOut,
    /// Holds the materials and textures, which all meshes share.
    list: MeshInput,
}

impl<'a> Reader<'a> {
    /// The nodes of the scene that are to be seen, parents first, with their maps to the world.
    fn nodes(&self) -> Result<Vec<(Node<'a>, DAffine3)>> {
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
        let mut nodes = Vec::new();
        while let Some((node, world_from_parent)) = stack.pop() {
            let index = node.index();
            if std::mem::replace(&mut seen[index], true) {
                return Err(Error::input(format!(
                    "node {index} has two parents, or is among its own descendants"
                )));
            }
            if self.is_hidden.get(index) == Some(&true) {
                continue;
            }
            let world_from_node = world_from_parent * local(&node);
            let children = stack.len();
            stack.extend(node.children().map(|child| (child, world_from_node)));
            stack[children..].reverse();
            nodes.push((node, world_from_node));
        }
        Ok(nodes)
    }

    fn node(&mut self, node: &Node<'_>, world_from_node: &DAffine3) -> Result<()> {
        let is_used = node.mesh().is_some() || node.camera().is_some() || node.light().is_some();
        if is_used && is_singular(world_from_node) {
            let what = match world_from_node.is_finite() {
                true => "nodes that are scaled to nothing are left out",
                false => "nodes whose places are not finite are left out",
            };
            let (index, name) = (node.index(), quoted(node.name()));
            self.left_out.note(what, format_args!("node {index}{name}"));
            return Ok(());
        }
        if let Some(mesh) = node.mesh() {
            let places = self.places(node)?.into_iter();
            let places = places.map(|place| *world_from_node * place);
            let places = self.drawn(places);
            let flat = self.keep_once(&mesh, places)?.unwrap_or_default();
            for world_from_mesh in &flat {
                self.flat(&mesh, world_from_mesh)?;
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
                Projection::Orthographic(_) => {
                    let what = "orthographic cameras are left out: only perspective is supported";
                    self.left_out.note(what, format_args!("`{name}`"));
                }
            }
        }
        match node.light() {
            Some(light) => self.light(&light, world_from_node),
            None => Ok(()),
        }
    }

    fn light(&mut self, light: &PunctualLight<'_>, world_from_node: &DAffine3) -> Result<()> {
        let intensity = light.color().map(|c| c * light.intensity());
        if !(intensity.iter()).all(|x| (0.0..=MAX_EMISSION).contains(x)) {
            return Err(Error::input(format!(
                "a light of intensity {intensity:?}: expected 0 to {MAX_EMISSION:e}"
            )));
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
                        "a spot light of cone angles {inner_cone_angle} and {outer_cone_angle}: \
                         the inner must be smaller"
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
        mesh.triangles = match triangles(primitive.mode(), &indices)? {
            Some(triangles) => triangles,
            None => {
                self.left_out
                    .note("points and lines are left out", "primitives of meshes");
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
            let what = "normals that are no numbers give way to those of faces";
            for (i, normal) in mesh.normals.iter_mut().enumerate() {
                if !normal.is_finite() {
                    self.left_out.note(what, format_args!("vertex {i}"));
                    *normal = Vec3::ZERO;
                }
            }
        }
        if let Some(accessor) = primitive.get(&Semantic::Colors(0)) {
            let has_mask = primitive.material().alpha_mode() != AlphaMode::Opaque;
            mesh.colors = match accessor.dimensions().multiplicity() {
                4 if has_mask => {
                    mesh.opacities = self.opacities(&accessor)?;
                    (self.buffers).floats(&accessor, |[r, g, b, _]| [r, g, b])?
                }
                4 => (self.buffers).floats(&accessor, |[r, g, b, _]| [r, g, b])?,
                _ => self.buffers.floats(&accessor, |rgb: [f32; 3]| rgb)?,
            };
            same_count(mesh.colors.len(), "colours")?;
            ColorEncoding::Linear.decode(&mut mesh.colors, &mut self.left_out);
        }
        let material = primitive.material();
        let placed = base_color(&material).texture;
        let placed = placed.or_else(|| material.emissive_texture());
        let set = placed.as_ref().map_or(0, set_of);
        if let Some(accessor) = primitive.get(&Semantic::TexCoords(set)) {
            mesh.uvs = self.buffers.floats(&accessor, Vec2::from_array)?;
            same_count(mesh.uvs.len(), "texture coordinates")?;
            if let Some(info) = &placed {
                transform_uvs(&mut mesh.uvs, info);
            }
            let what = "texture coordinates that are no numbers are taken as 0";
            for (i, uv) in mesh.uvs.iter_mut().enumerate() {
                if !uv.is_finite() {
                    self.left_out.note(what, format_args!("vertex {i}"));
                    *uv = Vec2::ZERO;
                }
            }
        }
        let index = self.material(&material, mesh.uvs.is_empty())?;
        mesh.material = memory::filled(MESH, index, mesh.triangles.len())?;
        // Here, while vertices are counted as in the file: joined to others a wrong index may hit
        // one of theirs.
        mesh.check()?;
        Ok(mesh)
    }

    /// The index of a material for a mesh with texture coordinates or `without_uvs`: there the mean
    /// of a texture stands for it.
    fn material(&mut self, material: &::gltf::Material<'_>, without_uvs: bool) -> Result<u32> {
        let key = (material.index(), without_uvs);
        if let Some(&index) = self.materials.get(&key) {
            return Ok(index);
        }
        let name = material.name().unwrap_or("gltf");
        let base = base_color(material);
        let [r, g, b, _] = base.factor;
        let mut made: Material = Material::diffuse(name, [r, g, b]);
        let strength = material.emissive_strength().unwrap_or(1.0);
        made.emission = material.emissive_factor().map(|e| e * strength);
        for (values, highest, what) in [
            (
                &mut made.albedo,
                1.0,
                "base colours outside of [0,1] are brought into it",
            ),
            (
                &mut made.emission,
                MAX_EMISSION,
                "emission out of range is brought into it",
            ),
        ] {
            if !values.iter().all(|v| (0.0..=highest).contains(v)) {
                self.left_out.note(what, format_args!("`{name}`"));
                *values = values.map(|v| v.max(0.0).min(highest));
            }
        }
        // Both sides are drawn, so both shine.
        made.emits_both_sides = material.double_sided();
        if let Some(info) = material.emissive_texture()
            && made.emits()
        {
            let image = info.texture().source().index();
            made.emission_texture = self.texture(image, wrap(&info))?;
            let base = base.texture.as_ref();
            let is_elsewhere = base.is_some_and(|base| !is_placed_alike(base, &info));
            if is_elsewhere && made.emission_texture.is_some() && !without_uvs {
                let what = "materials shine evenly, with the mean of their emissive texture, where \
                            that lies otherwise than that of their base colour";
                self.left_out.note(what, format_args!("`{name}`"));
            }
            if is_elsewhere || without_uvs {
                texture::replace_emission_by_mean(&mut made, &self.list.textures);
            }
        }
        made.mask = self.mask(material, name)?;
        if let Some(info) = base.texture {
            let image = info.texture().source().index();
            made.texture = self.texture(image, wrap(&info))?;
        }
        if without_uvs && let Some(index) = made.texture.take() {
            let mean = texture::mean(&self.list.textures[index as usize]);
            made.albedo = std::array::from_fn(|i| made.albedo[i] * mean[i]);
            let what = "textures without texture coordinates are replaced by their mean colour";
            self.left_out.note(what, format_args!("that of `{name}`"));
        }
        if without_uvs
            && let Some(mask) = &mut made.mask
            && let Some(index) = mask.texture.take()
        {
            mask.opacity *= texture::mean(&self.list.textures[index as usize])[0];
        }
        let index = self.list.materials.len() as u32;
        self.list.materials.push(made);
        self.materials.insert(key, index);
        Ok(index)
    }

    fn texture(&mut self, image: usize, wrap: [Wrap; 2]) -> Result<Option<u32>> {
        if let Some(&index) = self.textures.get(&(image, wrap)) {
            return Ok(index);
        }
        let texture = self.image(image)?;
        let index = texture.map(|mut texture| {
            texture.wrap = wrap;
            self.list.textures.push(texture);
            self.list.textures.len() as u32 - 1
        });
        self.textures.insert((image, wrap), index);
        Ok(index)
    }

    /// An image of the file; one that is not there or cannot be read is noted, and is none.
    fn image(&mut self, index: usize) -> Result<Option<Texture>> {
        self.image_by(index, |content, name, files| {
            texture::decode(content, name, Decoding::default(), files)
        })
    }

    /// What is decoded of an image of the file, as [`Self::image`] does.
    fn image_by<T>(
        &mut self,
        index: usize,
        decode: impl Fn(&[u8], &Path, &mut Files) -> Result<Result<T>>,
    ) -> Result<Option<T>> {
        let content = self
            .buffers
            .image(self.document, index, self.path, self.files);
        let image = match content {
            Ok(content) => {
                let name = self.path.join(format!("image {index}"));
                decode(&content, &name, self.files)?
            }
            Err(e) => Err(e),
        };
        texture::noted(image, format_args!("image {index}"), &mut self.left_out)
    }
}

/// The triangles of a list of vertices; `None` if the mode makes points or lines of them.
fn triangles(mode: Mode, indices: &[u32]) -> Result<Option<Vec<[u32; 3]>>> {
    let triangles = match mode {
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
        _ => return Ok(None),
    };
    Ok(Some(triangles))
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
        } => local_of(
            DVec3::from(translation.map(f64::from)),
            DQuat::from_array(rotation.map(f64::from)),
            DVec3::from(scale.map(f64::from)),
        ),
    }
}

fn local_of(translation: DVec3, rotation: DQuat, scale: DVec3) -> DAffine3 {
    // A quaternion of zeros becomes no rotation rather than no numbers; one that is not finite makes
    // a place that is told.
    let length = rotation.length();
    let rotation = match length == 0.0 {
        true => DQuat::IDENTITY,
        false => rotation / length,
    };
    DAffine3::from_scale_rotation_translation(scale, rotation, translation)
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
