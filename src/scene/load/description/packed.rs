//! A scene file whose surfaces and volumes are those of a packed scene.

use crate::Result;
use crate::run::frames;
use crate::scene::builder::PackedInput;
use crate::scene::load::changes;
use crate::scene::load::files::{Files, beside, text_start};
use crate::scene::load::groups::Groups;
use crate::scene::load::table::{Document, Item, Table, check_bytes};
use crate::scene::load::{Settings, is_packed};
use crate::scene::packed;
use std::path::{Path, PathBuf};

/// Key of the packed scene.
const PACKED: &str = "packed";

/// Opens the packed scene that `item` of the scene file `root` names. Its light that no table is of
/// is in the default group.
pub fn read(
    item: &Item<'_>,
    root: &Table<'_>,
    scene: &Path,
    groups: &mut Groups,
    files: &mut Files,
) -> Result<PackedInput> {
    for key in ["mesh", "volume"] {
        if let Some(item) = root.get(key) {
            return Err(item
                .error(format_args!(
                    "with `{PACKED}` a scene has the surfaces and volumes of that file alone"
                ))
                .hint("add it to the scene file that is packed"));
        }
    }
    let name = files.at_frame(item.text()?).map_err(|e| item.locate(e))?;
    let path = beside(scene, &name);
    if !is_packed(&path) {
        return Err(item.error("expected a packed scene (.lvp)"));
    }
    let Settings {
        frame,
        texture_limit,
        ..
    } = files.settings;
    let opened = packed::read(&path, frame, texture_limit, &files.cancel);
    let mut input = PackedInput {
        scene: opened.map_err(|e| item.locate(e))?,
        keeps_lights: root.get("light").is_none(),
        keeps_emission: true,
    };
    if input.keeps_lights || input.emits() {
        input.keeps_emission = groups.add_default();
    }
    files.add_packed(&path, &input.scene)?;
    Ok(input)
}

/// The packed scene that a scene file names; `None` if it names none, or cannot be read.
pub fn packed_file(scene: &Path, settings: &Settings) -> Option<PathBuf> {
    check_bytes(scene).ok()?;
    let content = std::fs::metadata(scene)
        .is_ok_and(|m| m.is_file())
        .then(|| std::fs::read(scene));
    let content = content?.ok()?;
    let text = std::str::from_utf8(text_start(&content).ok()?).ok()?;
    let (all, changed) = changes::append(text, &settings.changes);
    let document = Document::changed(scene, &all, text.len(), &settings.changes, changed);
    let parsed = document.parse().ok()?;
    let name = parsed.get_ref().get(PACKED)?.get_ref().as_str()?;
    Some(match settings.frame {
        Some(frame) => beside(scene, &frames::at_frame(name, frame)),
        None => beside(scene, name),
    })
}
