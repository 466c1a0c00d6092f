//! Digests of what a bake reads of a scene, one for each kind of thing: they tell a scene that only
//! has another picture from one whose light has changed.

use super::{
    AlbedoGrid, Camera, Emission, EmissiveVolume, Grid, Light, Mesh, Scene, Texture, Volume, Wrap,
};
use crate::formats::PackedMeta;
use crate::math::unflatten;
use glam::DVec3;
use rayon::prelude::*;

/// Leads the names of parts in a list of settings.
const PREFIX: &str = "scene/";
/// The part that is there only if volumes emit.
const EMISSION: &str = "scene/emission";
/// All parts, in the order in which they are listed. The last is there only if a camera chose the
/// surfels.
const PARTS: [&str; 6] = [
    "scene/surfaces",
    "scene/materials",
    "scene/lights",
    "scene/volumes",
    EMISSION,
    "scene/camera",
];

impl Scene {
    /// Names and digests of what a bake reads: surfaces, materials, lights and volumes. Cameras,
    /// film and names do not matter to it, but for the camera that surfels are taken from, if there
    /// is one.
    #[must_use]
    pub fn parts(&self, surfels_from: Option<&Camera>) -> Vec<(String, String)> {
        let mut parts = self.parts_of_assets();
        parts.push(named("lights", lights(self)));
        parts.extend(surfels_from.map(|c| named("camera", camera(c, self))));
        let place = |(name, _): &(String, String)| PARTS.iter().position(|part| name == part);
        parts.sort_by_key(place);
        parts
    }

    /// Those of surfaces, materials and volumes, by rising name: as a packed scene keeps them.
    pub(super) fn parts_of_assets(&self) -> Vec<(String, String)> {
        let kept = self.as_packed().map(|packed| packed.file().meta());
        let emits = |kept: &[(String, String)]| kept.iter().any(|(name, _)| name == EMISSION);
        let is_of_scene = |meta: &&PackedMeta| {
            meta.world_from_scene == self.world_from_scene.to_array()
                && emits(&meta.parts.digests) != self.emissive.is_empty()
        };
        match kept.filter(is_of_scene).map(|meta| &meta.parts.digests) {
            Some(kept) if !kept.is_empty() => kept.clone(),
            _ => self.made_parts_of_assets(),
        }
    }

    /// The same, made of all of them.
    fn made_parts_of_assets(&self) -> Vec<(String, String)> {
        let mut parts = vec![
            named("materials", materials(self)),
            named("surfaces", surfaces(&self.mesh, self.world_from_scene)),
            named("volumes", volumes(&self.volumes)),
        ];
        if !self.emissive.is_empty() {
            parts.insert(0, (EMISSION.into(), emissive(&self.emissive).hex()));
        }
        parts
    }

    /// Whether the digests that a packed scene keeps are those of its assets.
    pub(crate) fn has_right_digests(&self) -> bool {
        let kept = self.packed.as_ref().map(|p| &p.file().meta().parts.digests);
        kept.is_none_or(|kept| kept.is_empty() || *kept == self.made_parts_of_assets())
    }

    /// One digest over all that surfaces are and reflect.
    pub(crate) fn surface_digest(&self) -> String {
        let (surfaces, materials) = (surfaces(&self.mesh, self.world_from_scene), materials(self));
        surfaces.hex() + &materials.hex()
    }

    /// One digest over meshes, materials, lights and volumes, for a scene that has no files.
    pub(super) fn content_hash(&self) -> [u8; 32] {
        let mut hasher = blake3::Hasher::new();
        for (_, digest) in self.parts(None) {
            hasher.update(digest.as_bytes());
        }
        for (i, _) in (self.materials.iter().enumerate()).filter(|(_, m)| !m.is_seen) {
            hasher.update(b"unseen");
            hasher.update(&(i as u64).to_le_bytes());
        }
        if !self.is_environment_seen {
            hasher.update(b"unseen environment");
        }
        hasher.finalize().into()
    }

    /// Names of the parts in which this scene differs from one that was baked, by the digests among
    /// the settings that its cloud keeps; `None` if those have no digests.
    #[must_use]
    pub fn parts_that_differ(&self, baked: &[(String, String)]) -> Option<Vec<String>> {
        let known = |name: &str| baked.iter().find(|(n, _)| n == name).map(|(_, v)| v);
        let camera = known("surfels-from-camera").map(|name| {
            let name = (!name.is_empty()).then_some(name.as_str());
            self.camera(name).ok()
        });
        let own = self.parts(camera.flatten());
        let own = &own;
        let differs = |(name, digest): &&(String, String)| {
            let own = own.iter().find(|(n, _)| n == name);
            own.is_none_or(|(_, d)| d != digest)
        };
        let mut parts = baked
            .iter()
            .filter(|(n, _)| n.starts_with(PREFIX))
            .peekable();
        parts.peek()?;
        let name = |(name, _): &(String, String)| name[PREFIX.len()..].to_owned();
        let added = own
            .iter()
            .filter(|(n, _)| !baked.iter().any(|(b, _)| b == n));
        Some(parts.filter(differs).chain(added).map(name).collect())
    }
}

/// A digest in the making. Lists are led by their lengths, so that one cannot pass for two.
#[derive(Default)]
struct Digest {
    hasher: blake3::Hasher,
    /// What is not hashed yet: the hash is fast for long pieces only.
    pending: Vec<u8>,
}

impl Digest {
    /// Bytes of a long piece, which all threads hash together.
    const LONG: usize = 1 << 20;

    fn count(&mut self, n: usize) {
        self.pending.extend((n as u64).to_le_bytes());
        self.hash_if_long();
    }

    fn bytes<const N: usize>(&mut self, values: impl ExactSizeIterator<Item = [u8; N]>) {
        self.count(values.len());
        self.stream(values);
    }

    /// Values without their number.
    fn stream<const N: usize>(&mut self, values: impl Iterator<Item = [u8; N]>) {
        for value in values {
            self.pending.extend_from_slice(&value);
            self.hash_if_long();
        }
    }

    fn hash_if_long(&mut self) {
        // Pieces of any other length end within blocks of the hash.
        let long = self.pending.len() / Self::LONG * Self::LONG;
        if long > 0 {
            self.hasher.update_rayon(&self.pending[..long]);
            self.pending.drain(..long);
        }
    }

    fn finish(mut self) -> blake3::Hash {
        self.hasher.update(&self.pending);
        self.hasher.finalize()
    }

    fn floats(&mut self, values: &[f32]) {
        if cfg!(target_endian = "little") {
            self.count(values.len());
            self.pending.extend_from_slice(bytemuck::cast_slice(values));
            self.hash_if_long();
        } else {
            self.bytes(values.iter().map(|v| v.to_le_bytes()));
        }
    }

    fn triples(&mut self, values: &[[f32; 3]]) {
        self.floats(values.as_flattened());
    }

    fn doubles(&mut self, values: &[f64]) {
        self.bytes(values.iter().map(|v| v.to_le_bytes()));
    }

    fn hex(self) -> String {
        self.finish().to_hex()[..32].to_owned()
    }
}

/// A part by its name, and its digest.
fn named(name: &str, digest: Digest) -> (String, String) {
    (format!("{PREFIX}{name}"), digest.hex())
}

/// The digest of what is digested side by side.
fn all<T: Sync>(items: &[T], digest: impl Fn(&T, &mut Digest) + Sync) -> Digest {
    let each: Vec<[u8; 32]> = items
        .par_iter()
        .map(|item| {
            let mut one = Digest::default();
            digest(item, &mut one);
            one.finish().into()
        })
        .collect();
    let mut sum = Digest::default();
    sum.bytes(each.into_iter());
    sum
}

fn bytes12([x, y, z]: [f32; 3]) -> [u8; 12] {
    let [x, y, z] = [x, y, z].map(f32::to_le_bytes);
    std::array::from_fn(|i| [x, y, z][i / 4][i % 4])
}

fn surfaces(mesh: &Mesh, world_from_scene: DVec3) -> Digest {
    let mut digest = Digest::default();
    digest.doubles(&world_from_scene.to_array());
    for points in [&mesh.positions, &mesh.normals] {
        digest.bytes(points.iter().map(|p| bytes12(p.to_array())));
    }
    digest.bytes(
        mesh.triangles
            .as_flattened()
            .iter()
            .map(|v| v.to_le_bytes()),
    );
    for prototype in mesh.instances.prototypes() {
        digest.count(prototype.triangles.start as usize);
        digest.count(prototype.vertices.start as usize);
    }
    for instance in mesh.instances.list() {
        digest.count(instance.prototype as usize);
        digest.doubles(&instance.scene_from_prototype.to_cols_array());
    }
    digest
}

fn materials(scene: &Scene) -> Digest {
    let mesh = &scene.mesh;
    let mut digest = all(&scene.textures, |t: &Texture, digest| {
        digest.count(t.width as usize);
        digest.count(3 * t.texels().len());
        digest.stream(t.texels().map(bytes12));
        if t.wrap != [Wrap::Repeat; 2] {
            digest.bytes(t.wrap.map(|w| [w as u8]).into_iter());
        }
    });
    digest.bytes(mesh.material.iter().map(|m| m.to_le_bytes()));
    digest.triples(&mesh.colors);
    digest.bytes(
        mesh.uvs
            .iter()
            .map(|p| (u64::from(p.x.to_bits()) << 32 | u64::from(p.y.to_bits())).to_le_bytes()),
    );
    for m in &scene.materials {
        digest.floats(&m.albedo);
        digest.count(m.texture.map_or(0, |t| t as usize + 1));
    }
    for (i, m) in scene.materials.iter().enumerate() {
        if let Some(mask) = &m.mask {
            digest.count(i);
            digest.floats(&[mask.opacity, mask.cutoff.unwrap_or(-1.0)]);
            digest.count(mask.texture.map_or(0, |t| t as usize + 1));
        }
    }
    if !mesh.opacities.is_empty() {
        digest.floats(&mesh.opacities);
    }
    digest
}

fn lights(scene: &Scene) -> Digest {
    let mut digest = Digest::default();
    for light in &scene.lights {
        match light {
            Light::Point {
                position,
                intensity,
            } => {
                digest.count(0);
                digest.triples(&[position.to_array(), *intensity]);
            }
            Light::Spot {
                position,
                direction,
                intensity,
                cos_inner,
                cos_outer,
            } => {
                digest.count(1);
                digest.triples(&[position.to_array(), direction.to_array(), *intensity]);
                digest.floats(&[*cos_inner, *cos_outer]);
            }
            Light::Directional {
                direction,
                irradiance,
                angular_radius_rad,
            } => {
                digest.count(2);
                digest.triples(&[direction.to_array(), *irradiance]);
                digest.floats(&[*angular_radius_rad]);
            }
            Light::Environment { radiance } => {
                digest.count(3);
                digest.floats(radiance);
            }
        }
    }
    if let Some(image) = &scene.environment_image {
        digest.count(4);
        digest.count(image.size()[0] as usize);
        digest.triples(image.texels());
        digest.floats(&image.scale());
        digest.floats(&[image.rotation_rad()]);
        for (texel, radiance) in image.holes() {
            digest.count(*texel as usize);
            digest.floats(radiance);
        }
    }
    for (i, m) in scene.materials.iter().enumerate() {
        if m.emits() {
            digest.count(i);
            digest.floats(&m.emission);
            digest.count(m.emits_both_sides.into());
        }
    }
    let textured = scene.materials.iter().enumerate();
    for (i, texture) in textured.filter_map(|(i, m)| Some((i, m.emission_texture?))) {
        digest.count(i);
        digest.count(texture as usize);
    }
    digest
}

fn volumes(volumes: &[Volume]) -> Digest {
    all(volumes, |v, digest| {
        digest.doubles(&v.scene_from_index.to_cols_array());
        digest.floats(&v.albedo);
        if !v.is_grey() {
            digest.floats(&v.extinction_color);
        }
        for channel in v.albedo_grid.iter().flat_map(AlbedoGrid::channels) {
            grid(channel, digest);
        }
        if !v.phase.is_isotropic() {
            let [first, second] = v.phase.lobes();
            digest.floats(&[first, second, v.phase.mix()]);
        }
        grid(&v.sigma_t, digest);
    })
}

fn emissive(volumes: &[EmissiveVolume]) -> Digest {
    all(volumes, |e, digest| {
        digest.doubles(&e.values.scene_from_index.to_cols_array());
        match e.emission {
            Emission::Proportional { radiance } => digest.floats(&radiance),
            Emission::Blackbody { scale } => digest.floats(&[scale]),
        }
        grid(&e.values.sigma_t, digest);
    })
}

fn grid(grid: &Grid, digest: &mut Digest) {
    for n in grid.dims() {
        digest.count(n);
    }
    let bricks = grid.brick_dims();
    for i in 0..bricks.iter().product() {
        if let Some(brick) = grid.brick(unflatten(i, bricks)) {
            digest.count(i);
            digest.floats(brick.samples());
        }
    }
}

/// Of a camera that surfels are taken from, and what it sees.
fn camera(camera: &Camera, scene: &Scene) -> Digest {
    let mut digest = Digest::default();
    digest.floats(&camera.scene_from_camera.to_cols_array());
    digest.floats(&[camera.fov_x_rad]);
    let unseen = scene
        .materials
        .iter()
        .enumerate()
        .filter(|(_, m)| !m.is_seen);
    unseen.for_each(|(i, _)| digest.count(i));
    digest
}
