//! The `lvox` program: reads the command line, runs one verb, prints at most one error.

mod cli;

use lvox::Kind;
use std::process::ExitCode;

fn main() -> ExitCode {
    let result = match cli::parse() {
        Ok(cli) => cli.run(),
        Err(exit) => return exit,
    };
    match result {
        Ok(()) => ExitCode::SUCCESS,
        Err(error) => {
            cli::output::print_error(&error);
            match error.kind() {
                Kind::Input => ExitCode::from(2),
                Kind::Failed | Kind::Cancelled => ExitCode::FAILURE,
            }
        }
    }
}
