//! A scene file whose surfaces and volumes are those of a packed scene.

use super::ROOT;
use crate::Result;
use crate::scene::builder::PackedInput;
use crate::scene::load::changes;
use crate::scene::load::files::{Files, beside};
use crate::scene::load::groups::Groups;
use crate::scene::load::table::{Document, Item, Table};
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
    let path = path(item, scene, files)?;
    let Settings {
        frame,
        texture_limit,
        ..
    } = files.settings;
    let opened = packed::read(&path, frame, texture_limit, &files.lists, &files.cancel);
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

/// The packed scene that a scene file with this text names, if it names one.
pub fn packed_file(text: &str, scene: &Path, files: &mut Files) -> Result<Option<PathBuf>> {
    let changes = files.settings.changes.clone();
    let (all, changed) = changes::append(text, &changes);
    let document = Document::changed(scene, &all, text.len(), &changes, changed);
    let parsed = document.parse()?;
    let root = document.root(&parsed, &ROOT)?;
    let path = root.get(PACKED).map(|item| path(&item, scene, files));
    path.transpose()
}

/// Where a packed scene is.
fn path(item: &Item<'_>, scene: &Path, files: &mut Files) -> Result<PathBuf> {
    let name = files.at_frame(item.text()?).map_err(|e| item.locate(e))?;
    let path = beside(scene, &name);
    match is_packed(&path) {
        true => Ok(path),
        false => Err(item.error("expected a packed scene (.lvp)")),
    }
}
