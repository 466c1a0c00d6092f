//! What an image says of its origin, in attributes, and whether one that is there has the same.

use super::pixels::{self, Aov};
use super::settings::Settings;
use crate::Result;
use crate::formats::TreeMeta;
use crate::image::exr::{self, Precision};
use crate::image::{CameraMatrices, Region};
use crate::run::hex;
use crate::scene::{GROUP_SETTING, Scene};
use crate::tree::OpenTree;
use std::collections::BTreeMap;
use std::path::Path;

/// Names of attributes of images begin so.
const PREFIX: &str = "lvox/";
/// The attribute that has the identity of the tree.
const TREE: &str = "tree";
/// The attribute that tells how the tree was made.
const BAKED: &str = "baked";

/// What an image says of its origin.
pub fn attributes(
    scene: &Scene,
    tree: &OpenTree,
    settings: &Settings,
) -> Result<BTreeMap<String, String>> {
    let meta = tree.tree().meta();
    let mut list = attributes_but_of_files(scene, meta, settings)?;
    let mut note = |name: &str, value: String| list.insert(format!("{PREFIX}{name}"), value);
    note(TREE, hex(&tree.tree().content_hash()));
    if let Some(scatter) = &tree.scatter {
        note("scatter", hex(&scatter.content_hash()));
    }
    Ok(list)
}

/// The same without the identities of files, as it is known before there is a tree.
fn attributes_but_of_files(
    scene: &Scene,
    tree: &TreeMeta,
    settings: &Settings,
) -> Result<BTreeMap<String, String>> {
    // The first camera is the same whether it was named or not.
    let named = Settings {
        camera: Some(scene.camera(settings.camera.as_deref())?.name.clone()),
        ..settings.clone()
    };
    let segments = OpenTree::segments_of(tree);
    let mut of_tree = tree.cloud.settings.iter();
    let of_tree = of_tree.find(|(name, _)| name == GROUP_SETTING);
    let of_tree = of_tree.map(|(_, group)| group.clone());
    let group = scene.group.clone().or(of_tree);
    let list = [
        Some(("version", env!("CARGO_PKG_VERSION").into())),
        Some(("exposure", scene.film.exposure.to_string())),
        Some(("scene", hex(&scene.hash))),
        scene.frame.map(|frame| ("frame", frame.to_string())),
        group.map(|group| ("group", group)),
        Some((BAKED, how_made(tree))),
        (segments != OpenTree::SEGMENTS_OF_ONE_BOUNCE).then(|| ("segments", segments.to_string())),
        Some((
            "settings",
            serde_json::to_string(&named).unwrap_or_default(),
        )),
    ];
    let prefixed = |(name, value): (&str, String)| (format!("{PREFIX}{name}"), value);
    Ok(list.into_iter().flatten().map(prefixed).collect())
}

/// Where an image was taken from.
pub fn camera(scene: &Scene, settings: &Settings) -> Result<CameraMatrices> {
    let camera = scene.camera(settings.camera.as_deref())?;
    let [world_to_camera, world_to_ndc] = camera.matrices(&scene.film, scene.world_from_scene);
    Ok(CameraMatrices {
        world_to_camera,
        world_to_ndc,
    })
}

/// A digest of all that a tree was made of and with: parts of the scene, settings of bake, build
/// and bounces.
fn how_made(tree: &TreeMeta) -> String {
    let mut hasher = blake3::Hasher::new();
    for text in tree.made_with().flat_map(|(name, value)| [name, value]) {
        hasher.update(&(text.len() as u64).to_le_bytes());
        hasher.update(text.as_bytes());
    }
    hex(&hasher.finalize().as_bytes()[..16])
}

/// An image that may be there already.
#[derive(Clone, Copy, Debug)]
pub struct Image<'a> {
    /// The OpenEXR file.
    pub path: &'a Path,
    /// Its pixels.
    pub region: Region,
    /// Its layers beside the beauty.
    pub aovs: &'a [Aov],
    /// How samples are stored.
    pub precision: Precision,
}

impl Image<'_> {
    /// Whether it shows the scene, lit by this tree and shaded with these settings.
    ///
    /// # Errors
    /// A file that is no image, or an unknown camera.
    pub fn is_made(&self, scene: &Scene, tree: &OpenTree, settings: &Settings) -> Result<bool> {
        self.has(scene, &attributes(scene, tree, settings)?, |_| true)
    }

    /// The same of an image whose tree has to be made yet, of which this is known.
    ///
    /// # Errors
    /// As [`Self::is_made`].
    pub fn is_made_by(&self, scene: &Scene, tree: &TreeMeta, settings: &Settings) -> Result<bool> {
        let expected = attributes_but_of_files(scene, tree, settings)?;
        self.has(scene, &expected, |name| name != TREE)
    }

    fn has(
        &self,
        scene: &Scene,
        expected: &BTreeMap<String, String>,
        counts: impl Fn(&str) -> bool,
    ) -> Result<bool> {
        let found = exr::info(self.path)?;
        let own = found.attributes.iter().filter(|(name, _)| {
            let own = name.strip_prefix(PREFIX);
            own.is_some_and(&counts)
        });
        // Of no more than three channels a layer.
        let planes = vec![Vec::new(); 3 * (1 + self.aovs.len())];
        let frame = pixels::to_frame(scene, self.region, self.aovs, planes);
        Ok(own.eq(expected)
            && found.region == self.region
            && (found.width, found.height) == (scene.film.width, scene.film.height)
            && found.channels == exr::channels(&frame, self.precision))
    }
}
