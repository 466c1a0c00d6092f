//! The scene a verb works on.

use super::files::Files;
use super::frames::{refuse_tokens, words as words_at_frame};
use super::options::Context;
use super::parse;
use crate::formats::Packed;
use crate::run::frames;
use crate::scene::Scene;
use crate::scene::load::{Change, Settings, packed_file};
use crate::{Error, Result};
use std::ffi::OsString;
use std::path::{Path, PathBuf};

/// A path as a word of a command line.
///
/// # Errors
/// One that is not UTF-8.
pub fn utf8(what: &str, path: &Path) -> Result<String> {
    let text = path.to_str().ok_or_else(|| {
        Error::input(format!(
            "{what} {}: expected a name in UTF-8",
            path.display()
        ))
    })?;
    Ok(text.into())
}

/// How a scene is read.
#[derive(Clone, Debug, clap::Args)]
pub struct Reading {
    /// Take at most so much memory for the texels of textures; a scene that needs more is refused
    #[arg(long, value_name = "SIZE", default_value = "4G", value_parser = parse::size)]
    texture_limit: u64,

    /// Let meshes, materials and volumes name files outside of the folders of the scene and of
    /// their own; what the scene file itself names may be anywhere
    #[arg(long)]
    allow_outside: bool,

    /// Change a value of the scene file as it is read, as light.0.intensity=[3,3,3] or
    /// camera.main.fov_x_deg=40: parts of lists by name, or by number from 0. Text needs no quotes.
    /// Of a Mitsuba file it sets the parameter $KEY. May be given several times
    #[arg(long, value_name = "KEY=VALUE", value_parser = parse::change)]
    set: Vec<Change>,

    /// Light the scene by this group of its lights alone; `default` is that of lights in no group.
    /// `lvox mix` adds groups up
    #[arg(long, value_name = "NAME")]
    group: Option<String>,
}

impl Reading {
    /// The settings that it stands for, at a frame if there are frames.
    pub fn settings(&self, frame: Option<i32>) -> Settings {
        Settings {
            texture_limit: self.texture_limit,
            allow_outside: self.allow_outside,
            frame,
            changes: self.set.clone(),
            group: self.group.clone(),
        }
    }
}

/// A scene file, or the scene that is built in.
#[derive(Clone, Debug, clap::Args)]
pub struct SceneInput {
    /// Read this scene: .toml, .xml (Mitsuba), .gltf, .glb, or .lvp of `lvox pack`
    #[arg(value_name = "SCENE", required_unless_present = "demo")]
    scene: Option<PathBuf>,

    /// Use the scene that is built in: coloured walls, a torus, smoke
    #[arg(long, conflicts_with = "scene")]
    demo: bool,

    /// Make images of this size instead of the scene's film: pixels across and down
    #[arg(long, value_name = "WxH", value_parser = parse::resolution)]
    resolution: Option<(u32, u32)>,

    #[command(flatten)]
    reading: Reading,
}

impl SceneInput {
    /// A scene file, or else the built-in scene.
    pub fn new(scene: Option<PathBuf>, demo: bool, reading: Reading) -> Self {
        Self {
            scene,
            demo,
            reading,
            resolution: None,
        }
    }

    /// What it reads; the files that it names are known once it is loaded.
    pub fn files(&self) -> Files {
        match &self.scene {
            Some(path) => Files::default().reads("scene", path),
            None => Files::default(),
        }
    }

    /// The words of a command line that stand for it.
    ///
    /// # Errors
    /// A path that is not UTF-8.
    pub fn words(&self) -> Result<Vec<String>> {
        let mut words = match &self.scene {
            Some(path) => vec![utf8("scene", path)?],
            None => vec!["--demo".into()],
        };
        if let Some((width, height)) = self.resolution {
            words.extend(["--resolution".into(), format!("{width}x{height}")]);
        }
        if self.reading.texture_limit != Settings::default().texture_limit {
            let limit = self.reading.texture_limit.to_string();
            words.extend(["--texture-limit".into(), limit]);
        }
        if self.reading.allow_outside {
            words.push("--allow-outside".into());
        }
        for Change { key, value } in &self.reading.set {
            words.extend(["--set".into(), format!("{key}={value}")]);
        }
        if let Some(group) = &self.reading.group {
            words.extend(["--group".into(), group.clone()]);
        }
        Ok(words)
    }

    /// Words of the user in which tokens for the number of a frame may stand.
    fn typed(&self) -> impl Iterator<Item = OsString> + '_ {
        let scene = self.scene.iter().map(Into::into);
        let changes = self.reading.set.iter();
        let changes = changes.map(|Change { key, value }| format!("{key}={value}").into());
        let group = self.reading.group.iter().map(Into::into);
        scene.chain(changes).chain(group)
    }

    /// Whether there are such tokens, so that each frame has a scene of its own.
    pub fn has_tokens(&self) -> bool {
        refuse_tokens(self.typed()).is_err()
    }

    /// Refuses such tokens where there are no frames.
    ///
    /// # Errors
    /// The first of them.
    pub fn refuse_tokens(&self) -> Result<()> {
        refuse_tokens(self.typed())
    }

    /// The same at a frame, whose number takes the place of tokens.
    pub fn at_frame(&self, frame: i32) -> Self {
        let mut input = self.clone();
        let path = |path: PathBuf| words_at_frame(std::iter::once(path.into()), frame);
        input.scene = input.scene.and_then(|p| path(p).pop()).map(PathBuf::from);
        let text = |text: &mut String| *text = frames::at_frame(text, frame).into_owned();
        for Change { key, value } in &mut input.reading.set {
            text(key);
            text(value);
        }
        input.reading.group.as_mut().map(text);
        input
    }

    /// A name for what is made of it: that of the scene file, without extension and without tokens
    /// for numbers of frames, and the group that lights it.
    ///
    /// # Errors
    /// A name that is not UTF-8.
    pub fn short_name(&self) -> Result<String> {
        let mut name = match &self.scene {
            Some(path) => utf8("scene", Path::new(path.file_stem().unwrap_or_default()))?,
            None => "demo".into(),
        };
        while let Some(token) = frames::token_in(&name) {
            name = name
                .replacen(token, "", 1)
                .trim_matches(['.', '_', '-', ' '])
                .into();
        }
        if name.is_empty() {
            name = "scene".into();
        }
        if let Some(group) = &self.reading.group {
            name = format!("{name}.{group}");
        }
        Ok(name)
    }

    /// The same scene, lit by a group of its lights alone.
    pub fn lit_by(&self, group: &str) -> Self {
        let mut input = self.clone();
        input.reading.group = Some(group.into());
        input
    }

    /// The file of the tree that a verb takes in a frame: the one that is named, or the packed
    /// scene.
    ///
    /// # Errors
    /// If there is neither, a scene file that cannot be read, or what is no packed scene.
    pub fn tree(&self, named: Option<&PathBuf>, frame: Option<i32>) -> Result<PathBuf> {
        if let Some(path) = named {
            return Ok(path.clone());
        }
        let packed = self.scene.as_ref().map(|path| {
            let settings = self.reading.settings(frame);
            packed_file(path, &settings)
        });
        let packed = packed.transpose()?.flatten().ok_or_else(|| {
            Error::input("no tree was given")
                .hint("name one with --tree, or a packed scene that holds one")
        })?;
        // What is no packed scene would be told as no tree.
        Packed::open_path(&packed)?;
        Ok(packed)
    }

    /// Loads it.
    ///
    /// # Errors
    /// As [`Scene::load`], and if an output would replace a file of the scene.
    pub fn load(&self, context: &Context) -> Result<Scene> {
        let left = context
            .kept
            .borrow_mut()
            .take_scene(&self.how(), context.frame)?;
        match left {
            Some(scene) => Self::keep_apart(&scene, context).map(|()| scene),
            None => self.load_at(context.frame, context),
        }
    }

    /// Leaves it to the next frame.
    pub fn leave(&self, scene: Scene, context: &Context) {
        if context.frame.is_some() {
            context.kept.borrow_mut().leave_scene(self.how(), scene);
        }
    }

    /// All that it depends on, but for the frame.
    pub fn how(&self) -> String {
        format!("{self:?}")
    }

    /// Refuses outputs that would replace a file of the scene.
    fn keep_apart(scene: &Scene, context: &Context) -> Result<()> {
        let files = scene.files.iter().map(|p| ("file of the scene", p.clone()));
        context.keep_apart(&files.collect::<Vec<_>>())
    }

    /// Loads it at a frame, whatever the frame before has left.
    ///
    /// # Errors
    /// As [`Self::load`].
    pub fn load_at(&self, frame: Option<i32>, context: &Context) -> Result<Scene> {
        let job = &context.job;
        job.stage("load", |counts| {
            let mut scene = match &self.scene {
                Some(path) => Scene::load_with(path, &self.reading.settings(frame), job)?,
                None if self.demo => Scene::demo_with(&self.reading.settings(frame))?,
                None => {
                    return Err(
                        Error::input("no scene was given").hint("name a scene file, or use --demo")
                    );
                }
            };
            Self::keep_apart(&scene, context)?;
            if let Some((width, height)) = self.resolution {
                (scene.film.width, scene.film.height) = (width, height);
            }
            counts.insert("triangles".into(), scene.mesh.triangle_count() as f64);
            counts.insert("degenerate_triangles".into(), scene.mesh.degenerate as f64);
            counts.insert("volumes".into(), scene.volumes.len() as f64);
            Ok(scene)
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_is_made_of_a_scene_has_its_name_without_frames() {
        let reading = |group: Option<&str>| Reading {
            texture_limit: 0,
            allow_outside: false,
            set: Vec::new(),
            group: group.map(Into::into),
        };
        for (scene, group, name) in [
            (Some("a b/shot.one.toml"), None, "shot.one"),
            (Some("shot.toml"), Some("key"), "shot.key"),
            (Some("Szene 100% #1.####.toml"), None, "Szene 100% #1"),
            (Some("shot_v_.toml"), None, "shot_v_"),
            (Some("%04d/####.toml"), None, "scene"),
            (None, None, "demo"),
        ] {
            let input = SceneInput::new(scene.map(Into::into), scene.is_none(), reading(group));
            assert_eq!(input.short_name().unwrap(), name);
        }
    }
}
