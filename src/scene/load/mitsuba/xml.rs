//! The elements of a Mitsuba file and of all that it includes, with its parameters in place.

use super::super::changes::Change;
use super::super::files::{Files, beside, text_start};
use super::super::nearest::nearest;
use super::super::table::check_bytes;
use crate::{Error, Result};
use roxmltree::{Document, NodeType, ParsingOptions};
use std::cell::Cell;
use std::collections::{BTreeMap, BTreeSet};
use std::path::{Path, PathBuf};

/// Elements in each other; scenes have some ten.
const MAX_DEPTH: usize = 64;
/// Files that include each other in a chain, as Mitsuba has it.
const MAX_INCLUDES: usize = 15;
/// Elements of a scene with all that it includes, and bytes of the files.
const MAX_ELEMENTS: usize = 4 << 20;
const MAX_BYTES: usize = 64 << 20;

/// Where an element stands.
#[derive(Clone, Copy, Debug)]
pub(super) struct Place {
    file: usize,
    pub(super) line: usize,
}

/// An element with its attributes, after parameters took their places.
#[derive(Debug)]
pub(super) struct Node {
    pub(super) tag: String,
    pub(super) attributes: Vec<(String, String)>,
    pub(super) children: Vec<usize>,
    pub(super) place: Place,
    /// Whether somebody asked for it.
    pub(super) used: Cell<bool>,
}

impl Node {
    /// The value of an attribute.
    pub(super) fn get(&self, name: &str) -> Option<&str> {
        let found = self.attributes.iter().find(|(key, _)| key == name);
        found.map(|(_, value)| value.as_str())
    }
}

/// All elements; the first is the scene.
#[derive(Debug, Default)]
pub(super) struct Tree {
    pub(super) nodes: Vec<Node>,
    /// Those with an `id`, and those that an `alias` names.
    pub(super) ids: BTreeMap<String, usize>,
    files: Vec<PathBuf>,
    /// Folders of `path` elements, in which files are looked for, too.
    pub(super) folders: Vec<PathBuf>,
}

impl Tree {
    /// Reads a file and all that it includes.
    pub(super) fn read(path: &Path, files: &mut Files) -> Result<Self> {
        let mut parser = Parser {
            tree: Self::default(),
            parameters: Vec::new(),
            known: BTreeSet::new(),
            bytes: 0,
        };
        let changes = files.settings.changes.clone();
        for Change { key, value } in &changes {
            parser.set(key, value);
        }
        parser.file(path, "scene", 0, files)?;
        parser.check_changes(&changes, path)?;
        Ok(parser.tree)
    }

    /// Whether the scene is one of Mitsuba 0.6 or before.
    pub(super) fn is_of_version_0(&self) -> bool {
        let version = self.nodes.first().and_then(|scene| scene.get("version"));
        version.is_some_and(|version| version.trim().starts_with("0."))
    }

    /// Where an element stands, for messages: the file if that is not the scene itself.
    pub(super) fn told(&self, place: Place) -> String {
        match place.file {
            0 => format!("line {}", place.line),
            file => format!("{} line {}", self.files[file].display(), place.line),
        }
    }

    /// An error at an element.
    pub(super) fn error(&self, place: Place, message: impl std::fmt::Display) -> Error {
        let file = self.files[place.file].display();
        Error::input(format!("{file}: line {}: {message}", place.line))
    }

    /// The file in which an element stands.
    pub(super) fn file(&self, place: Place) -> &Path {
        &self.files[place.file]
    }
}

struct Parser {
    tree: Tree,
    /// Names without their `$`, the longest first, and their values.
    parameters: Vec<(String, String)>,
    /// Those that the file names.
    known: BTreeSet<String>,
    /// Of files and of values that took the places of parameters.
    bytes: usize,
}

impl Parser {
    /// Gives a parameter a value, if it has none.
    fn set(&mut self, name: &str, value: &str) {
        if self.parameters.iter().any(|(known, _)| known == name) {
            return;
        }
        let shorter = self
            .parameters
            .iter()
            .position(|(n, _)| n.len() < name.len());
        let at = shorter.unwrap_or(self.parameters.len());
        self.parameters.insert(at, (name.into(), value.into()));
    }

    /// Refuses a change of what is no parameter of the scene.
    fn check_changes(&self, changes: &[Change], path: &Path) -> Result<()> {
        let known: Vec<&str> = self.known.iter().map(String::as_str).collect();
        let is_unknown = |change: &&Change| !known.contains(&change.key.as_str());
        let Some(Change { key, .. }) = changes.iter().find(is_unknown) else {
            return Ok(());
        };
        let path = path.display();
        let error = Error::input(format!("{path}: `set` {key}: the scene has no ${key}"));
        Err(match nearest(key, &known) {
            Some(near) => error.hint(format!("did you mean {near}?")),
            None if known.is_empty() => error.hint("it has no parameters"),
            None => error.hint(format!("its parameters are {}", known.join(", "))),
        })
    }

    /// Reads a file; the indices of the elements that stand for it where it is included.
    fn file(
        &mut self,
        path: &Path,
        what: &str,
        depth: usize,
        files: &mut Files,
    ) -> Result<Vec<usize>> {
        let at = path.display();
        if depth > MAX_INCLUDES {
            return Err(Error::input(format!(
                "{at}: expected at most {MAX_INCLUDES} files that include each other"
            ))
            .hint("does the file include itself?"));
        }
        check_bytes(path)?;
        let content = files.read(what, path)?;
        self.count(content.len()).map_err(|e| e.at(&at))?;
        let text = text_start(&content).map_err(|e| e.at(&at))?;
        let text = std::str::from_utf8(text)
            .map_err(|e| Error::input(format!("{at}: not UTF-8 text: {e}")))?;
        let options = ParsingOptions {
            nodes_limit: MAX_ELEMENTS as u32 * 2,
            ..ParsingOptions::default()
        };
        let document = Document::parse_with_options(text, options)
            .map_err(|e| Error::input(format!("{at}: not valid XML: {e}")))?;
        let ends = text.bytes().enumerate();
        let line_ends = ends
            .filter_map(|(i, b)| (b == b'\n').then_some(i))
            .collect();
        let file = self.tree.files.len();
        self.tree.files.push(path.to_owned());
        let source = Source {
            file,
            depth,
            line_ends,
        };
        let root = document.root_element();
        let index = self.element(root, &source, 0, files)?;
        let Some(&index) = index.first() else {
            return Ok(Vec::new());
        };
        let place = self.tree.nodes[index].place;
        match (depth, self.tree.nodes[index].tag.as_str()) {
            (0, "scene") => Ok(vec![index]),
            (0, other) => Err(self
                .tree
                .error(place, format_args!("expected <scene>, found <{other}>"))),
            // What a scene holds takes the place of the include.
            (_, "scene") => Ok(self.tree.nodes[index].children.clone()),
            _ => Ok(vec![index]),
        }
    }

    /// Counts bytes, so that files that include many others come to an end.
    fn count(&mut self, bytes: usize) -> Result<()> {
        self.bytes += bytes;
        match self.bytes > MAX_BYTES {
            true => Err(Error::input(format!(
                "expected at most {} MiB of scene descriptions with all that they include",
                MAX_BYTES >> 20
            ))
            .hint("put what is large into mesh and volume files")),
            false => Ok(()),
        }
    }

    /// Takes an element and all below it; what stands for it in the one around it.
    fn element(
        &mut self,
        node: roxmltree::Node<'_, '_>,
        source: &Source,
        depth: usize,
        files: &mut Files,
    ) -> Result<Vec<usize>> {
        let place = source.place(&node);
        let wrong = |tree: &Tree, message: String| Err(tree.error(place, message));
        if depth > MAX_DEPTH {
            let message = format!("expected at most {MAX_DEPTH} elements in each other");
            return wrong(&self.tree, message);
        }
        if self.tree.nodes.len() >= MAX_ELEMENTS {
            return wrong(
                &self.tree,
                format!("expected at most {MAX_ELEMENTS} elements"),
            );
        }
        let mut attributes = Vec::new();
        for attribute in node.attributes() {
            let value = match attribute.value().contains('$') {
                true => self.substituted(attribute.value(), place)?,
                false => attribute.value().to_owned(),
            };
            attributes.push((attribute.name().to_owned(), value));
        }
        let index = self.tree.nodes.len();
        self.tree.nodes.push(Node {
            tag: node.tag_name().name().into(),
            attributes,
            children: Vec::new(),
            place,
            used: Cell::new(false),
        });
        if let Some(found) = self.directive(index, place, source.depth, files)? {
            return Ok(found);
        }
        let own = &self.tree.nodes[index];
        // A reference has the id of another.
        if own.tag != "ref"
            && let Some(id) = own.get("id").map(str::to_owned)
            && self.tree.ids.insert(id.clone(), index).is_some()
        {
            return wrong(
                &self.tree,
                format!("another element has the id `{id}`, too"),
            );
        }
        for child in node.children() {
            match child.node_type() {
                NodeType::Element => {
                    let found = self.element(child, source, depth + 1, files)?;
                    self.tree.nodes[index].children.extend(found);
                }
                NodeType::Text if !child.text().unwrap_or_default().trim().is_empty() => {
                    let text: String = child
                        .text()
                        .unwrap_or_default()
                        .trim()
                        .chars()
                        .take(40)
                        .collect();
                    return wrong(
                        &self.tree,
                        format!("expected elements alone, found the text {text}"),
                    );
                }
                _ => {}
            }
        }
        Ok(vec![index])
    }

    /// What stands in place of an element that says how to read others; `None` for one that is part
    /// of the scene.
    fn directive(
        &mut self,
        index: usize,
        place: Place,
        depth: usize,
        files: &mut Files,
    ) -> Result<Option<Vec<usize>>> {
        let own = &self.tree.nodes[index];
        let get = |name: &str| own.get(name).unwrap_or_default().to_owned();
        let missing = |name: &str| self.tree.error(place, format_args!("`{name}` is missing"));
        match own.tag.as_str() {
            "default" => {
                let (name, value) = (get("name"), get("value"));
                if name.is_empty() {
                    return Err(missing("name"));
                }
                self.known.insert(name.clone());
                self.set(&name, &value);
            }
            "include" => {
                let name = get("filename");
                if name.is_empty() {
                    return Err(missing("filename"));
                }
                let path = self.tree.find(place, &name);
                let included = self.file(&path, "included", depth + 1, files);
                return included.map(Some).map_err(|e| self.tree.located(place, e));
            }
            "path" => {
                let folder = beside(self.tree.file(place), &get("value"));
                self.tree.folders.push(folder);
            }
            "alias" => {
                let (id, name) = (get("id"), get("as"));
                let Some(&target) = self.tree.ids.get(&id) else {
                    let message = format_args!("there is no `{id}` before this alias");
                    return Err(self.tree.error(place, message));
                };
                self.tree.ids.insert(name, target);
            }
            _ => return Ok(None),
        }
        Ok(Some(Vec::new()))
    }

    /// A value with those of parameters in it.
    fn substituted(&mut self, text: &str, place: Place) -> Result<String> {
        let mut out = String::new();
        let mut rest = text;
        while let Some(at) = rest.find('$') {
            out += &rest[..at];
            rest = &rest[at + 1..];
            let found = self
                .parameters
                .iter()
                .find(|(name, _)| rest.starts_with(name.as_str()));
            let Some((name, value)) = found else {
                let word: String = rest
                    .chars()
                    .take_while(|c| c.is_alphanumeric() || *c == '_')
                    .collect();
                return Err(self
                    .tree
                    .error(place, format_args!("the parameter ${word} has no value"))
                    .hint(format!("give it by `set` {word}=VALUE, or by <default>")));
            };
            out += value;
            rest = &rest[name.len()..];
            self.known.insert(name.clone());
            let bytes = value.len();
            self.count(bytes).map_err(|e| self.tree.located(place, e))?;
        }
        Ok(out + rest)
    }
}

impl Tree {
    /// Where a file is that an element names: beside its own, or in a folder of a `path`.
    pub(super) fn find(&self, place: Place, name: &str) -> PathBuf {
        let own = beside(self.file(place), name);
        // Included files name others from the folder of the scene, too.
        let of_scene = beside(&self.files[0], name);
        let others = self
            .folders
            .iter()
            .map(|folder| folder.join(name.replace('\\', "/")));
        let mut all = [own.clone(), of_scene].into_iter().chain(others);
        all.find(|path| path.is_file()).unwrap_or(own)
    }

    /// Leads an error by the place of an element.
    pub(super) fn located(&self, place: Place, error: Error) -> Error {
        error.at(format!(
            "{}: line {}",
            self.file(place).display(),
            place.line
        ))
    }
}

/// A file as it is parsed.
struct Source {
    file: usize,
    /// How many files include each other up to it.
    depth: usize,
    line_ends: Vec<usize>,
}

impl Source {
    fn place(&self, node: &roxmltree::Node<'_, '_>) -> Place {
        let start = node.range().start;
        Place {
            file: self.file,
            line: 1 + self.line_ends.partition_point(|&end| end < start),
        }
    }
}
