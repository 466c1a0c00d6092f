//! `lvox completions`

use super::output;
use crate::{Error, Result};

/// Print what a shell needs to complete the words of a command line
///
/// As in: lvox completions bash > /etc/bash_completion.d/lvox
#[derive(Debug, clap::Args)]
#[command(hide = true)]
pub struct Args {
    /// The shell
    shell: clap_complete::Shell,
}

impl Args {
    pub fn run(self) -> Result<()> {
        let mut script = Vec::new();
        clap_complete::generate(self.shell, &mut super::command(), "lvox", &mut script);
        let script = String::from_utf8(script)
            .map_err(|e| Error::failed(format!("the script is not text: {e}")))?;
        output::print(&script)
    }
}
