//! Options of which pixels to make, for the verbs that make images.

use super::files::Files;
use super::parse;
use crate::Result;
use crate::image::{Region, tile_list};
use crate::scene::Film;
use clap::Args;
use std::path::PathBuf;

/// Which pixels, as typed.
#[derive(Clone, Debug, Args)]
pub struct RegionOptions {
    /// Make only these pixels, X1 and Y1 excluded [default: the whole frame]
    #[arg(long, num_args = 4, value_names = ["X0", "Y0", "X1", "Y1"])]
    region: Vec<u32>,

    /// Make only tile I of N, counted from 0
    #[arg(long, value_name = "I/N", value_parser = parse::tile, conflicts_with = "region")]
    tile: Option<(u32, u32)>,

    /// Take that tile from this list of N tiles, one a line, which `lvox tiles` makes [default:
    /// tiles of about equal area]
    #[arg(long, value_name = "FILE", requires = "tile")]
    tiles: Option<PathBuf>,
}

impl RegionOptions {
    /// Adds what it reads.
    pub fn files(&self, files: Files) -> Files {
        match &self.tiles {
            Some(tiles) => files.reads("--tiles", tiles),
            None => files,
        }
    }

    /// Whether they are a part of the frame.
    pub fn is_given(&self) -> bool {
        self.tile.is_some() || !self.region.is_empty()
    }

    /// The pixels of a film that they come to.
    ///
    /// # Errors
    /// A region outside the frame, or a list that is none of its tiles.
    pub fn of(&self, film: &Film) -> Result<Region> {
        let (w, h) = (film.width, film.height);
        if let Some((i, n)) = self.tile {
            return match &self.tiles {
                Some(list) => tile_list::read_one(list, [w, h], i, n),
                None => Region::tile(w, h, i, n),
            };
        }
        let region = parse::region(&self.region).unwrap_or_else(|| Region::full(w, h));
        region.check(w, h)?;
        Ok(region)
    }
}
