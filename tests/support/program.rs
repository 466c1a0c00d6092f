//! The program from outside.

use std::path::Path;
use std::process::{Command, Output};

/// What a run of the program came to.
pub struct Run {
    /// The command line, for messages.
    line: String,
    pub code: i32,
    pub stdout: String,
    pub stderr: String,
}

/// The program in a folder.
pub fn command(dir: &Path, args: &[&str]) -> Command {
    let mut command = Command::new(env!("CARGO_BIN_EXE_lvox"));
    command.current_dir(dir).args(args);
    command
}

/// Runs the program in a folder.
pub fn lvox(dir: &Path, args: &[&str]) -> Run {
    Run::of(&mut command(dir, args))
}

impl Run {
    /// Runs a command to its end.
    pub fn of(command: &mut Command) -> Self {
        let output = command.output().unwrap();
        Self::new(command, output)
    }

    fn new(command: &Command, output: Output) -> Self {
        let args: Vec<_> = command.get_args().map(|a| a.to_string_lossy()).collect();
        Self {
            line: format!("lvox {}", args.join(" ")),
            code: output.status.code().unwrap_or(-1),
            stdout: String::from_utf8(output.stdout).unwrap(),
            stderr: String::from_utf8(output.stderr).unwrap(),
        }
    }

    /// It succeeded and printed no data.
    #[track_caller]
    pub fn done(&self) {
        assert_eq!(self.code, 0, "{}: {}", self.line, self.stderr);
        assert_eq!(self.stdout, "", "{}", self.line);
    }

    /// An error is one line and at most one hint, says all of `parts`, and leaves stdout alone;
    /// warnings may go before.
    #[track_caller]
    pub fn refused(&self, code: i32, parts: &[&str]) {
        let told = format!("{}: {}", self.line, self.stderr);
        assert_eq!(self.code, code, "{told}");
        assert_eq!(self.stdout, "", "{told}");
        let mut lines = self
            .stderr
            .lines()
            .skip_while(|l| l.starts_with("warning: "));
        let error = lines.next().unwrap_or_default();
        assert!(error.starts_with("error: "), "{told}");
        let rest: Vec<&str> = lines.collect();
        assert!(
            rest.is_empty() || (rest.len() == 1 && rest[0].starts_with("hint: ")),
            "{told}"
        );
        for part in parts {
            assert!(self.stderr.contains(part), "{part:?} is not in {told}");
        }
    }
}

/// Starts a command, waits for a line of its talk, asks it to stop, and gives what it says from
/// then on. The work has to outlast the line.
#[cfg(unix)]
pub fn stopped_at(command: &mut Command, is_time: impl Fn(&str) -> bool) -> Run {
    use std::io::{BufRead, BufReader};
    use std::process::Stdio;
    use std::time::{Duration, Instant};

    command.stdout(Stdio::piped()).stderr(Stdio::piped());
    let mut child = command.spawn().unwrap();
    let mut lines = BufReader::new(child.stderr.take().unwrap())
        .lines()
        .map_while(Result::ok);
    assert!(lines.any(|l| is_time(&l)), "it ended before its time");
    let asked = Instant::now();
    let pid = child.id().to_string();
    let kill = Command::new("kill").args(["-TERM", &pid]).status();
    assert!(kill.unwrap().success());
    let told: String = lines.map(|l| l + "\n").collect();
    let mut output = child.wait_with_output().unwrap();
    assert!(asked.elapsed() < Duration::from_secs(20), "{told}");
    output.stderr = told.into_bytes();
    Run::new(command, output)
}
