//! Shapes of a Mitsuba file: meshes with their materials, in place.

use super::bsdf::Surface;
use super::color::Paint;
use super::element::Element;
use super::{Reader, geometry, plugins};
use crate::Result;
use crate::math::Rgb;
use crate::scene::builder::MeshInput;
use crate::scene::load::colors::ColorEncoding;
use crate::scene::load::transform::about;
use crate::scene::load::{obj, ply, texture};
use crate::scene::{Mask, Material, Mesh, Texture};
use glam::{DAffine2, DAffine3, DQuat, DVec3};

/// Keys of shapes that make no difference here.
const IGNORED: [&str; 5] = [
    "silhouette_sampling_weight",
    "max_smooth_angle",
    "collapse",
    "cast_shadows",
    "mesh_attributes",
];

impl Reader<'_> {
    /// Takes a shape, by a map to the world: its mesh, its light and the medium in it.
    pub(super) fn shape(&mut self, shape: &Element<'_>, world_from_group: &DAffine3) -> Result<()> {
        self.enter(shape)?;
        let taken = self.shape_of_kind(shape, world_from_group);
        self.leave();
        taken
    }

    fn shape_of_kind(&mut self, shape: &Element<'_>, world_from_group: &DAffine3) -> Result<()> {
        self.files.cancel.check()?;
        shape.take();
        let to_world = *world_from_group * shape.transform("to_world")?;
        match shape.kind() {
            // What instances show.
            "shapegroup" => {
                for (_, member) in shape.objects()? {
                    member.take();
                }
                return Ok(());
            }
            "instance" => return self.instance(shape, &to_world),
            "merge" => {
                for (_, member) in shape.objects()? {
                    if member.tag() == "shape" {
                        self.shape(&member, world_from_group)?;
                    }
                }
                return Ok(());
            }
            _ => {}
        }
        shape.ignore(&IGNORED)?;
        let medium = shape.get("interior")?;
        if let Some(medium) = medium.or(unnamed_medium(shape)?) {
            self.medium(&medium, shape, &to_world)?;
        }
        let surface = match (shape.object("bsdf")?, medium) {
            (None, Some(_)) => Surface::None,
            _ => self.surface_of(shape)?,
        };
        let emission = self.emission(shape)?;
        let paint = match (surface, &emission) {
            (Surface::Diffuse(paint), _) => Some(paint),
            (Surface::None, None) => None,
            // What only emits.
            (Surface::None, Some(_)) => Some(Paint::plain([0.0; 3])),
        };
        let Some(mut paint) = paint else {
            // Its file is not needed, but it is right that it is named.
            shape.ignore(&[
                "filename",
                "face_normals",
                "flip_normals",
                "flip_tex_coords",
                "center",
                "radius",
                "p0",
                "p1",
            ])?;
            return Ok(());
        };
        // A light without a material reflects nothing.
        if emission.is_some() && shape.object("bsdf")?.is_none() {
            paint.color = [0.0; 3];
        }
        let Some(mut mesh) = self.placed_mesh(shape, &to_world)? else {
            return Ok(());
        };
        if emission.is_some() {
            geometry::face_as_normals(&mut mesh);
        }
        if !paint.is_of_vertices {
            mesh.colors.clear();
        }
        let name = shape.id().map_or_else(|| shape.line(), str::to_owned);
        let mut material = Material::diffuse(&name, paint.color);
        let (radiance, image) = match emission {
            Some(Paint { color, texture, .. }) => (color, texture),
            None => ([0.0; 3], None),
        };
        material.emission = radiance;
        mesh.material = vec![0; mesh.triangles.len()];
        mesh.materials = vec![material];
        self.apply(shape, paint, image, &mut mesh);
        self.count(shape, mesh.triangles.len())?;
        self.builder.meshes.push(mesh);
        Ok(())
    }

    /// Gives a mesh of one material the textures of its colour, its opacity and its radiance.
    fn apply(
        &mut self,
        shape: &Element<'_>,
        paint: Paint,
        radiance: Option<(Texture, DAffine2)>,
        mesh: &mut MeshInput,
    ) {
        let material = &mut mesh.materials[0];
        let mut uv = None;
        mesh.textures.clear();
        if let Some((texture, map)) = paint.texture {
            material.texture = Some(0);
            mesh.textures.push(texture);
            uv = Some(map);
        }
        if let Some(opacity) = paint.opacity {
            let mut mask = Mask {
                opacity: Rgb(opacity.color).luminance().min(1.0),
                texture: None,
                cutoff: None,
            };
            if let Some((texture, map)) = opacity.texture {
                mask.texture = Some(mesh.textures.len() as u32);
                mesh.textures.push(texture);
                if *uv.get_or_insert(map) != map {
                    let what = "textures of opacity lie where those of colour do";
                    self.left_out.note(what, shape.line());
                }
            }
            material.mask = Some(mask);
        }
        if let Some((texture, map)) = radiance {
            material.emission_texture = Some(mesh.textures.len() as u32);
            mesh.textures.push(texture);
            if *uv.get_or_insert(map) != map {
                let what = "textures of radiance that lie otherwise than those of colour are \
                            taken as their mean";
                self.left_out.note(what, shape.line());
                texture::replace_emission_by_mean(material, &mesh.textures);
            }
        }
        let Some(uv) = uv else {
            return;
        };
        if mesh.uvs.is_empty() {
            let what = "textures of shapes without texture coordinates are taken as their mean";
            self.left_out.note(what, shape.line());
            texture::replace_by_means(mesh);
        }
        for p in &mut mesh.uvs {
            *p = uv.transform_point2(p.as_dvec2()).as_vec2();
        }
    }

    /// Refuses more triangles than a scene may have, before they take memory.
    fn count(&mut self, shape: &Element<'_>, triangles: usize) -> Result<()> {
        self.triangles += triangles;
        match self.triangles <= Mesh::MAX_TRIANGLES {
            true => Ok(()),
            false => Err(shape.error(format_args!(
                "expected at most {} triangles in all shapes and instances",
                Mesh::MAX_TRIANGLES
            ))),
        }
    }

    /// A group of shapes, once more.
    fn instance(&mut self, shape: &Element<'_>, to_world: &DAffine3) -> Result<()> {
        let objects = shape.objects()?;
        let group = objects.iter().map(|(_, object)| object);
        let group = group
            .into_iter()
            .find(|object| object.kind() == "shapegroup");
        let Some(group) = group else {
            return Err(shape.error("expected a reference to a shapegroup in it"));
        };
        for (_, member) in group.objects()? {
            if member.tag() == "shape" {
                self.shape(&member, to_world)?;
            }
        }
        Ok(())
    }

    /// The radiance of the light on a shape.
    fn emission(&mut self, shape: &Element<'_>) -> Result<Option<Paint>> {
        let Some(emitter) = shape.object("emitter")? else {
            return Ok(None);
        };
        emitter.ignore(&["sampling_weight"])?;
        match emitter.kind() {
            "area" => self.radiance(&emitter, "radiance").map(Some),
            other => {
                if let Some(error) = plugins::unknown(&emitter) {
                    return Err(error);
                }
                let what = format!("lights of the type `{other}` on shapes are left out");
                self.left_out.note(&what, emitter.line());
                Ok(None)
            }
        }
    }

    /// The triangles of a shape, in the world.
    fn placed_mesh(
        &mut self,
        shape: &Element<'_>,
        to_world: &DAffine3,
    ) -> Result<Option<MeshInput>> {
        let is_mirrored = to_world.matrix3.determinant() < 0.0;
        let Some(mut mesh) = self.mesh(shape, is_mirrored)? else {
            return Ok(None);
        };
        if shape.flag("flip_normals", false)? {
            geometry::flip(&mut mesh);
        }
        mesh.check().map_err(|e| shape.locate(e))?;
        mesh.place(to_world);
        mesh.check().map_err(|e| shape.locate(e))?;
        Ok(Some(mesh))
    }

    /// The triangles of a shape, in its own space. If its map mirrors, what Mitsuba then turns
    /// inside out is.
    fn mesh(&mut self, shape: &Element<'_>, is_mirrored: bool) -> Result<Option<MeshInput>> {
        Ok(Some(match shape.kind() {
            "rectangle" => geometry::rectangle(),
            "cube" => geometry::cube(),
            "disk" => geometry::disk(),
            "sphere" => {
                let center = shape.vector("center")?.unwrap_or(DVec3::ZERO);
                let radius = shape.number_within("radius", 1e-15, 1e15)?.unwrap_or(1.0);
                let own =
                    DAffine3::from_translation(center) * DAffine3::from_scale(DVec3::splat(radius));
                let mut sphere = geometry::sphere().transform(&own);
                if is_mirrored {
                    geometry::flip(&mut sphere);
                }
                sphere
            }
            "cylinder" => cylinder(shape)?,
            "obj" | "ply" => self.mesh_file(shape, is_mirrored)?,
            kind => {
                if let Some(error) = plugins::unknown(shape) {
                    return Err(error);
                }
                let what = format!("shapes of the type `{kind}` are left out");
                self.left_out.note(&what, shape.line());
                for &child in &shape.node().children {
                    shape.tree.nodes[child].used.set(true);
                }
                return Ok(None);
            }
        }))
    }

    fn mesh_file(&mut self, shape: &Element<'_>, is_mirrored: bool) -> Result<MeshInput> {
        let is_ply = shape.kind() == "ply";
        let path = shape
            .tree
            .find(shape.node().place, shape.require_text("filename")?);
        let has_faces = shape.flag("face_normals", false)?;
        let flips_v = shape.flag("flip_tex_coords", !is_ply)?;
        self.files.enter(&path);
        let content = self
            .files
            .read("mesh", &path)
            .map_err(|e| shape.locate(e))?;
        // Colours of vertices are linear in Mitsuba.
        let encoding = ColorEncoding::Linear;
        let mesh = match is_ply {
            true => {
                let palette = None;
                ply::read(
                    &content,
                    &path,
                    &ply::Coloring { palette, encoding },
                    self.files,
                )
            }
            false => obj::geometry(&content, &path, encoding, self.files),
        };
        let mut mesh = mesh.map_err(|e| e.at(path.display()))?;
        mesh.check().map_err(|e| e.at(path.display()))?;
        // Our readers turn v downwards.
        if !flips_v {
            mesh.uvs.iter_mut().for_each(|uv| uv.y = 1.0 - uv.y);
        }
        let has_normals = !has_faces && !mesh.normals.is_empty();
        match has_faces {
            true => mesh.normals.clear(),
            false if mesh.normals.is_empty() => geometry::smooth(&mut mesh),
            false => {}
        }
        // Normals that are not those of the file come from the mirrored corners.
        if is_mirrored && !has_normals {
            geometry::flip(&mut mesh);
        }
        Ok(mesh)
    }
}

/// A medium that is in a shape by its tag alone.
fn unnamed_medium<'t>(shape: &Element<'t>) -> Result<Option<Element<'t>>> {
    let is_inside =
        |(name, object): &(String, Element<'t>)| object.tag() == "medium" && name.is_empty();
    let found = shape.objects()?.into_iter().find(is_inside);
    Ok(found.map(|(_, medium)| medium))
}

fn cylinder(shape: &Element<'_>) -> Result<MeshInput> {
    let p0 = shape.vector("p0")?.unwrap_or(DVec3::ZERO);
    let p1 = shape.vector("p1")?.unwrap_or(p0 + DVec3::Z);
    let radius = shape.number_within("radius", 1e-15, 1e15)?.unwrap_or(1.0);
    let axis = p1 - p0;
    let length = axis.length();
    let Some(along) = axis.try_normalize() else {
        return Err(shape.error("`p0` and `p1` of the cylinder are one point"));
    };
    let turn = match DVec3::Z.cross(along).try_normalize() {
        Some(normal) => about(normal, libm::acos(along.z.clamp(-1.0, 1.0)).to_degrees()),
        None if along.z > 0.0 => DQuat::IDENTITY,
        None => about(DVec3::X, 180.0),
    };
    let own = DAffine3::from_translation(p0) * DAffine3::from_quat(turn);
    let own = own * DAffine3::from_scale(DVec3::new(radius, radius, length));
    Ok(geometry::cylinder().transform(&own))
}
