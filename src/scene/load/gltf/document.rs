//! From the bytes of a glTF file to its document: what other programs write and the crate would
//! refuse is mended, and what cannot be read is refused in a line.

use super::super::files::text_start;
use super::extensions;
use super::instancing::{self, PlaceLists};
use crate::{Error, Result};
use ::gltf::json::Root;
use ::gltf::{Document, Glb, Gltf};
use serde_json::{Value, json};
use std::borrow::Cow;

/// Characters of an error of a library that are passed on.
const MAX_REASON: usize = 160;

/// A document, and what of it the crate does not know of.
pub(super) struct Opened {
    pub(super) gltf: Gltf,
    /// Whether each node is hidden, and what is below it.
    pub(super) is_hidden: Vec<bool>,
    /// By node, the places of its mesh, if they are listed.
    pub(super) place_lists: Vec<Option<PlaceLists>>,
    /// Extensions of materials that say of each that it has nothing of their kind.
    pub(super) idle: Vec<&'static str>,
}

/// Parses a file.
pub(super) fn open(content: &[u8]) -> Result<Opened> {
    check_length(content)?;
    let (text, blob) = match content.starts_with(b"glTF") {
        true => {
            check_version(&content[4])?;
            let glb = Glb::from_slice(content).map_err(|e| unreadable(&e))?;
            (glb.json, glb.bin.map(Cow::into_owned))
        }
        false => (Cow::Borrowed(text_start(content)?), None),
    };
    let mut value: Value = serde_json::from_slice(&text).map_err(|e| unreadable(&e))?;
    if let Some(version) = value.pointer("/asset/version")
        && !version.as_str().is_some_and(|v| v.starts_with('2'))
    {
        return Err(other_version(version));
    }
    extensions::check_required(&value)?;
    mend(&mut value);
    let is_hidden = hidden(&value);
    let place_lists = instancing::lists(&value);
    let idle = extensions::idle(&value);
    let root: Root = serde_json::from_value(value).map_err(|e| unreadable(&e))?;
    check_attributes(&root)?;
    let document = Document::from_json(root).map_err(|e| unreadable(&e))?;
    Ok(Opened {
        gltf: Gltf { document, blob },
        is_hidden,
        place_lists,
        idle,
    })
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

fn check_version(version: &u8) -> Result<()> {
    match version {
        2 => Ok(()),
        other => Err(other_version(other)),
    }
}

fn other_version(found: impl std::fmt::Display) -> Error {
    Error::input(format!("expected glTF of version 2.0, found {found}"))
        .hint("convert it, for example by importing and exporting it with Blender")
}

/// What a library says of a file, in one short line.
pub(super) fn unreadable(e: &dyn std::fmt::Display) -> Error {
    let text = e.to_string();
    let line = text.lines().next().unwrap_or_default();
    let mut reason: String = line.chars().take(MAX_REASON).collect();
    if reason.len() < text.trim_end().len() {
        reason.push('…');
    }
    Error::input(format!("not a glTF file that can be read: {reason}"))
}

/// The items of a list at the top of a document.
fn items<'a>(value: &'a mut Value, list: &str) -> impl Iterator<Item = &'a mut Value> {
    let items = value.get_mut(list).and_then(Value::as_array_mut);
    items.into_iter().flatten().filter(|item| item.is_object())
}

/// Mends what is wrong by the standard and yet says what is meant.
fn mend(value: &mut Value) {
    if let Some(top) = value.as_object_mut() {
        top.remove("extensionsRequired");
    }
    for scene in items(value, "scenes") {
        if scene.get("nodes").is_none() {
            scene["nodes"] = json!([]);
        }
    }
    // Positions must state a range, which nothing here uses.
    let mut positions = Vec::new();
    for mesh in items(value, "meshes") {
        for primitive in items(mesh, "primitives") {
            positions.extend(
                primitive
                    .pointer("/attributes/POSITION")
                    .and_then(Value::as_u64),
            );
        }
    }
    positions.sort_unstable();
    for (i, accessor) in items(value, "accessors").enumerate() {
        if positions.binary_search(&(i as u64)).is_ok() {
            for bound in ["min", "max"] {
                if accessor.get(bound).is_none() {
                    accessor[bound] = json!([0.0, 0.0, 0.0]);
                }
            }
        }
    }
    mend_textures(value);
}

/// Takes WebP images as sources. Some writers list textures of images that are not there; that is
/// wrong only where a material uses one.
fn mend_textures(value: &mut Value) {
    let images = value.get("images").and_then(Value::as_array);
    let count = images.map_or(0, Vec::len) as u64;
    let mut mended = false;
    for texture in items(value, "textures") {
        if texture.get("source").is_none() {
            let webp = texture.pointer("/extensions/EXT_texture_webp/source");
            if let Some(source) = webp.cloned() {
                texture["source"] = source;
            }
        }
        let source = texture.get("source").and_then(Value::as_u64);
        if texture.get("source").is_none() || source.is_some_and(|s| s >= count) {
            texture["source"] = json!(count);
            mended = true;
        }
    }
    if mended && let Some(top) = value.as_object_mut() {
        let images = top.entry("images").or_insert(json!([]));
        if let Some(images) = images.as_array_mut() {
            images.push(json!({}));
        }
    }
}

/// Whether each node is hidden by KHR_node_visibility.
fn hidden(value: &Value) -> Vec<bool> {
    let nodes = value.get("nodes").and_then(Value::as_array);
    let is_hidden = |node: &Value| {
        let visible = node.pointer("/extensions/KHR_node_visibility/visible");
        visible.and_then(Value::as_bool) == Some(false)
    };
    nodes.into_iter().flatten().map(is_hidden).collect()
}

/// The crate's own validation takes it on trust that positions have an accessor.
fn check_attributes(json: &Root) -> Result<()> {
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
