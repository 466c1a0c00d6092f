//! Meshes that a file places many times: by nodes that share one, or by lists of places. What is
//! large is kept once.

use super::{Reader, local_of};
use crate::scene::Mesh;
use crate::scene::builder::{Copies, MeshInput, is_singular};
use crate::{Error, Result};
use ::gltf::mesh::{Mode, Primitive, Semantic};
use ::gltf::{Document, Node};
use glam::{DAffine3, DQuat, DVec3};
use serde_json::Value;

/// Triangles from which on a mesh may be kept once: a place takes the memory of about six, and a
/// ray pays for each that it comes by.
const MIN_TRIANGLES: usize = 64;
/// Triangles that keeping meshes once has to save in a file, together: 80 MB or more. What takes
/// less is faster flat.
const MIN_SAVED: usize = 1 << 20;

/// Accessors of the translations, rotations and scales of a list of places.
pub(super) type PlaceLists = [Option<usize>; 3];

/// By node, the places of its mesh that EXT_mesh_gpu_instancing lists.
pub(super) fn lists(value: &Value) -> Vec<Option<PlaceLists>> {
    let nodes = value.get("nodes").and_then(Value::as_array);
    let of_node = |node: &Value| {
        let list = node.pointer("/extensions/EXT_mesh_gpu_instancing/attributes")?;
        let accessor = |name| list.get(name).and_then(Value::as_u64);
        let lists = ["TRANSLATION", "ROTATION", "SCALE"].map(accessor);
        Some(lists.map(|i| i.map(|i| usize::try_from(i).unwrap_or(usize::MAX))))
    };
    nodes.into_iter().flatten().map(of_node).collect()
}

/// By mesh, whether it is kept once, and what is found of it while nodes are read.
pub(super) type KeptOnce = Vec<Option<Option<Copies>>>;

/// Finds which meshes are kept once, by all nodes with their places.
///
/// # Errors
/// More triangles flat than a scene may have.
pub(super) fn kept_once<'a>(
    document: &Document,
    nodes: impl Iterator<Item = (&'a Node<'a>, usize)>,
) -> Result<KeptOnce> {
    let mut places = vec![0_usize; document.meshes().len()];
    for (node, count) in nodes {
        if let Some(mesh) = node.mesh() {
            places[mesh.index()] += count;
        }
    }
    let sizes: Vec<usize> = document
        .meshes()
        .map(|m| m.primitives().map(|p| triangles(&p)).sum())
        .collect();
    let is_candidate = |(m, mesh): (usize, ::gltf::Mesh<'_>)| {
        let shines = |p: Primitive<'_>| p.material().emissive_factor() != [0.0; 3];
        places[m] > 1 && sizes[m] >= MIN_TRIANGLES && !mesh.primitives().any(shines)
    };
    let candidates: Vec<bool> = document.meshes().enumerate().map(is_candidate).collect();
    let over = |of: &dyn Fn(usize) -> usize| {
        let all = (0..sizes.len()).map(|m| sizes[m].saturating_mul(of(m)));
        all.fold(0, usize::saturating_add)
    };
    let saved = over(&|m| match candidates[m] {
        true => places[m] - 1,
        false => 0,
    });
    let is_worth_it = saved >= MIN_SAVED;
    let flat = over(&|m| match candidates[m] && is_worth_it {
        true => 1,
        false => places[m],
    });
    if flat > Mesh::MAX_TRIANGLES {
        return Err(Error::input(format!(
            "the file has {flat} triangles, more than the {} that a scene may have",
            Mesh::MAX_TRIANGLES
        )));
    }
    let kept = candidates.into_iter();
    Ok(kept.map(|c| (c && is_worth_it).then_some(None)).collect())
}

/// Triangles that a primitive says it has.
fn triangles(primitive: &Primitive<'_>) -> usize {
    let positions = primitive.get(&Semantic::Positions);
    let corners = primitive.indices().or(positions);
    let corners = corners.map_or(0, |accessor| accessor.count());
    match primitive.mode() {
        Mode::Triangles => corners / 3,
        Mode::TriangleStrip | Mode::TriangleFan => corners.saturating_sub(2),
        _ => 0,
    }
}

impl Reader<'_> {
    /// Number of places of the mesh of a node.
    pub(super) fn count_of_places(&self, node: &Node<'_>) -> usize {
        let Some(lists) = self.lists_of(node) else {
            return 1;
        };
        let accessor = lists.iter().flatten().next();
        let accessor = accessor.and_then(|i| self.document.accessors().nth(*i));
        accessor.map_or(1, |a| a.count())
    }

    fn lists_of(&self, node: &Node<'_>) -> Option<PlaceLists> {
        *self.place_lists.get(node.index())?
    }

    /// The places of the mesh of a node, as maps to that.
    pub(super) fn places(&self, node: &Node<'_>) -> Result<Vec<DAffine3>> {
        let Some(lists) = self.lists_of(node) else {
            return Ok(vec![DAffine3::IDENTITY]);
        };
        let accessor = |i: usize| {
            let found = self.document.accessors().nth(i);
            found.ok_or_else(|| Error::input(format!("instances: there is no accessor {i}")))
        };
        let [translations, rotations, scales] = lists;
        let triples = |list: Option<usize>| {
            let of = |i| (self.buffers).floats(&accessor(i)?, |v: [f32; 3]| v.map(f64::from));
            list.map(of).transpose()
        };
        let (translations, scales) = (triples(translations)?, triples(scales)?);
        let of = |i| (self.buffers).floats(&accessor(i)?, |v: [f32; 4]| v.map(f64::from));
        let rotations = rotations.map(of).transpose()?;
        let counts = [
            translations.as_ref().map(Vec::len),
            rotations.as_ref().map(Vec::len),
            scales.as_ref().map(Vec::len),
        ];
        let mut counts = counts.into_iter().flatten();
        let count = counts.next().unwrap_or(1);
        if counts.any(|other| other != count) {
            return Err(Error::input(
                "instances: the lists of translations, rotations and scales have unlike lengths",
            ));
        }
        let place = |i: usize| {
            let translation = translations.as_ref().map_or([0.0; 3], |t| t[i]);
            let rotation = rotations.as_ref().map_or([0.0, 0.0, 0.0, 1.0], |r| r[i]);
            let scale = scales.as_ref().map_or([1.0; 3], |s| s[i]);
            local_of(
                DVec3::from(translation),
                DQuat::from_array(rotation),
                DVec3::from(scale),
            )
        };
        Ok((0..count).map(place).collect())
    }

    /// The places of a mesh at which it is drawn; those of others are counted and told.
    pub(super) fn drawn(&mut self, places: impl Iterator<Item = DAffine3>) -> Vec<DAffine3> {
        let (finite, others) = places.partition::<Vec<_>, _>(DAffine3::is_finite);
        let (flattened, drawn) = finite.into_iter().partition::<Vec<_>, _>(is_singular);
        for (what, count) in [
            (
                "instances whose places are not finite are left out",
                others.len(),
            ),
            (
                "instances that are scaled to nothing are left out",
                flattened.len(),
            ),
        ] {
            if count > 0 {
                self.left_out.note(what, format_args!("{count}"));
            }
        }
        drawn
    }

    /// Keeps a mesh that stands at some places, if it is one of those that are kept once. Gives the
    /// places back if not.
    pub(super) fn keep_once(
        &mut self,
        mesh: &::gltf::Mesh<'_>,
        places: Vec<DAffine3>,
    ) -> Result<Option<Vec<DAffine3>>> {
        match self.kept_once.get_mut(mesh.index()) {
            Some(Some(Some(copies))) => copies.world_from_mesh.extend(places),
            Some(Some(None)) => {
                let mut whole = MeshInput::default();
                for primitive in mesh.primitives() {
                    whole.append(self.part(&primitive)?)?;
                }
                self.kept_once[mesh.index()] = Some(Some(Copies {
                    mesh: whole,
                    world_from_mesh: places,
                }));
            }
            _ => return Ok(Some(places)),
        }
        Ok(None)
    }

    /// Adds a mesh at a place.
    pub(super) fn flat(
        &mut self,
        mesh: &::gltf::Mesh<'_>,
        world_from_mesh: &DAffine3,
    ) -> Result<()> {
        for primitive in mesh.primitives() {
            let mut part = self.part(&primitive)?;
            part.place(world_from_mesh);
            let total = self.out.mesh.positions.len() + part.positions.len();
            if total > u32::MAX as usize {
                return Err(Error::input(
                    "more vertices than can be indexed with 32 bits",
                ));
            }
            self.out.mesh.append(part)?;
        }
        Ok(())
    }

    fn part(&mut self, primitive: &Primitive<'_>) -> Result<MeshInput> {
        let part = self.primitive(primitive);
        part.map_err(|e| e.at(format!("primitive {}", primitive.index())))
    }
}
