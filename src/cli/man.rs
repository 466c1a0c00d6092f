//! `lvox man`

use crate::{Error, Result};
use std::path::PathBuf;

/// Write the manual into a folder: lvox.1, and a page for each verb
#[derive(Debug, clap::Args)]
#[command(hide = true)]
pub struct Args {
    /// The folder, which has to be there; pages of an earlier manual are replaced
    #[arg(value_name = "DIR")]
    folder: PathBuf,
}

impl Args {
    pub fn run(self) -> Result<()> {
        let folder = self.folder.display();
        if !self.folder.is_dir() {
            return Err(Error::input(format!("{folder}: expected a folder"))
                .hint("make it, or name another"));
        }
        clap_mangen::generate_to(super::command(), &self.folder)
            .map_err(|e| Error::failed(format!("{folder}: cannot write the manual: {e}")))
    }
}
