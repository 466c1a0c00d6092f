//! The images of a scene: each is decoded once, and what they take together has a limit.

use crate::run::{memory, size};
use crate::scene::texture::Codes;
use crate::{Error, Result};
use image::ImageFormat;
use std::collections::HashMap;
use std::fmt::Display;
use std::sync::Arc;

/// What is taken of an image.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub(super) enum ImagePart {
    Color,
    /// Its alpha.
    Alpha,
}

/// Hash of the content of an image file, what kind of file it is taken for, and what is taken of
/// it.
pub(super) type ImageKey = ([u8; 32], Option<ImageFormat>, ImagePart);

/// Images of a scene that were decoded so far.
#[derive(Default)]
pub(super) struct Images {
    known: HashMap<ImageKey, Arc<Codes>>,
    /// Bytes of their texels.
    bytes: u64,
}

impl Images {
    /// The texels of an image that was decoded before.
    pub(super) fn get(&self, key: &ImageKey) -> Option<&Arc<Codes>> {
        self.known.get(key)
    }

    /// Refuses an image of so many bytes where that is too much.
    pub(super) fn check(&self, name: impl Display, bytes: u64, limit: u64) -> Result<()> {
        if self.bytes.saturating_add(bytes) > limit {
            let [bytes, before, limit] = [bytes, self.bytes, limit].map(size::format);
            return Err(Error::input(format!(
                "{name} takes {bytes} beside {before} of other textures, more than the \
                 `texture_limit` of {limit}"
            ))
            .hint("raise `texture_limit`, or make images smaller"));
        }
        memory::check(name, bytes)
    }

    /// Counts so many bytes of an image that is kept elsewhere.
    pub(super) fn count(&mut self, bytes: u64) {
        self.bytes += bytes;
    }

    pub(super) fn add(&mut self, key: ImageKey, codes: Arc<Codes>) {
        self.bytes += codes.bytes();
        self.known.insert(key, codes);
    }
}
