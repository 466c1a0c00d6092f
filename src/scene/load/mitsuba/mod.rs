//! Scenes of Mitsuba 3, and of 0.6, in XML.
//!
//! What lvox has no word for is told, with its line; what Mitsuba has none for is an error.

// - `xml`: elements of a file and what it includes, parameters in place; `element`: typed access
// - `plugins`: names of Mitsuba's plugins
// - `shape` with `geometry` (triangles of what is no file), `bsdf`, `color` (materials, textures)
// - `emitter`, `sensor` with `clip` (planes that cut), `medium`: lights, cameras, volumes
// - here: the scene, and what was left out of it

mod bsdf;
mod clip;
mod color;
mod element;
mod emitter;
mod geometry;
mod medium;
mod plugins;
mod sensor;
mod shape;
mod xml;

use super::files::Files;
use super::left_out::LeftOut;
use super::nearest::nearest;
use crate::Result;
use crate::scene::SceneBuilder;
use clip::ClipPlanes;
use element::Element;
use glam::DAffine3;
use std::path::Path;
use xml::Tree;

/// Objects in each other by references, as materials and groups: more are a loop.
const MAX_DEPTH: usize = 16;

/// A scene in the making.
struct Reader<'a> {
    files: &'a mut Files,
    left_out: LeftOut,
    builder: SceneBuilder,
    /// Of all shapes so far.
    triangles: usize,
    /// Objects that the one at hand is in.
    depth: usize,
    /// Of cameras that state some.
    clip_planes: Vec<ClipPlanes>,
}

/// Reads a scene file, and all files that it names.
pub(super) fn read(path: &Path, files: &mut Files) -> Result<SceneBuilder> {
    let tree = Tree::read(path, files)?;
    let name = path.file_stem().unwrap_or_default().to_string_lossy();
    let mut reader = Reader {
        files,
        left_out: LeftOut::default(),
        builder: SceneBuilder::new(name),
        triangles: 0,
        depth: 0,
        clip_planes: Vec::new(),
    };
    let taken = reader.scene(&tree);
    reader.tell_unused(&tree);
    reader.tell_distorted(&tree);
    reader.tell_clipped();
    // An error may be the last of what is odd.
    std::mem::take(&mut reader.left_out).tell(path, 0, reader.files);
    taken?;
    Ok(reader.builder)
}

impl Reader<'_> {
    fn scene(&mut self, tree: &Tree) -> Result<()> {
        let scene = Element { tree, index: 0 };
        scene.take();
        // Cameras come first: their film is that of the scene.
        let mut objects = scene.objects()?;
        objects.sort_by_key(|(_, object)| object.tag() != "sensor");
        for (_, object) in &objects {
            self.object(object)?;
        }
        Ok(())
    }

    fn object(&mut self, object: &Element<'_>) -> Result<()> {
        match object.tag() {
            "shape" => self.shape(object, &DAffine3::IDENTITY),
            "emitter" => self.emitter(object),
            "sensor" => self.sensor(object),
            "integrator" => self.integrator(object),
            // Materials and media are read where they are named.
            "bsdf" | "medium" | "texture" | "spectrum" | "phase" | "volume" | "sampler"
            | "film" | "rfilter" => Ok(()),
            other => {
                let known = [
                    "shape",
                    "emitter",
                    "sensor",
                    "integrator",
                    "bsdf",
                    "medium",
                    "texture",
                    "phase",
                    "volume",
                    "sampler",
                    "film",
                    "rfilter",
                    "ref",
                    "include",
                    "default",
                    "alias",
                    "path",
                ];
                let error = object.error(format_args!("unknown element <{other}>"));
                Err(match nearest(other, &known) {
                    Some(near) => error.hint(format!("did you mean <{near}>?")),
                    None => error.hint(format!("a scene has {}", known.join(", "))),
                })
            }
        }
    }

    /// Tells where a number of bounces is none that lvox has.
    fn integrator(&mut self, integrator: &Element<'_>) -> Result<()> {
        let Some(depth) = integrator.whole("max_depth", -1, 1 << 30)? else {
            return Ok(());
        };
        // Light that meets one surface or medium, or two, is what shade makes of a tree that is
        // just built; after bounce it has all.
        if ![-1, 3].contains(&depth) {
            let note = integrator.error(format_args!(
                "a `max_depth` of {depth}: lvox makes 3 of it, or as many as `lvox bounce` adds"
            ));
            self.files.note(note.to_string());
        }
        Ok(())
    }

    /// Goes into an object.
    ///
    /// # Errors
    /// One that is in itself.
    fn enter(&mut self, object: &Element<'_>) -> Result<()> {
        self.depth += 1;
        match self.depth <= MAX_DEPTH {
            true => Ok(()),
            false => Err(object
                .error(format_args!(
                    "expected at most {MAX_DEPTH} objects in each other"
                ))
                .hint("does it refer to itself?")),
        }
    }

    fn leave(&mut self) {
        self.depth -= 1;
    }

    /// Tells parameters of what was taken that nobody asked for.
    fn tell_unused(&mut self, tree: &Tree) {
        for (index, node) in tree.nodes.iter().enumerate() {
            let element = Element { tree, index };
            let is_quiet = ["sampler", "rfilter", "integrator"].contains(&element.tag());
            if index == 0 || !node.used.get() || is_quiet || element.is_value() {
                continue;
            }
            for &child in &node.children {
                let child = Element { tree, index: child };
                // A reference is asked for as what it refers to.
                let is_told = child.node().used.get() || child.tag() == "ref";
                if is_told || ["sampler", "rfilter"].contains(&child.tag()) {
                    continue;
                }
                let name = child.name();
                let name = match name.is_empty() {
                    true => format!("<{}>", child.tag()),
                    false => format!("`{name}`"),
                };
                let place = format!("{name} of {} {}", element.kind(), child.line());
                self.left_out
                    .note("what lvox does not know is left out", place);
            }
        }
    }

    /// Tells rotations of what was taken that are none.
    fn tell_distorted(&mut self, tree: &Tree) {
        for node in tree.nodes.iter().filter(|node| node.used.get()) {
            for &index in &node.children {
                let step = Element { tree, index };
                if step.is_distorting() {
                    let what = "a <rotate> whose axis is not of length 1 scales and shears, too, \
                                as in Mitsuba";
                    self.left_out.note(what, step.line());
                }
            }
        }
    }
}
