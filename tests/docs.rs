//! What documents name is there: links, the headings that they lead to, and files and constants of
//! this repository in backticks.

use std::collections::HashSet;
use std::fmt::Write;
use std::fs;
use std::path::{Path, PathBuf};

/// Folders of the repository whose files documents name by their paths.
const FOLDERS: &[&str] = &[
    ".ci/",
    "benches/",
    "docs/",
    "examples/",
    "formats/",
    "src/",
    "tests/",
];

fn root() -> &'static Path {
    Path::new(env!("CARGO_MANIFEST_DIR"))
}

/// Documents at the root, in `docs` and in `formats`.
fn documents() -> Vec<PathBuf> {
    let mut found = Vec::new();
    for folder in ["", "docs", "formats"] {
        for entry in fs::read_dir(root().join(folder)).unwrap() {
            let path = entry.unwrap().path();
            if path.extension().is_some_and(|e| e == "md") {
                found.push(path);
            }
        }
    }
    found.sort();
    found
}

/// The sources below a folder.
fn sources(folder: &Path) -> String {
    let entries = fs::read_dir(folder).unwrap().map(|e| e.unwrap().path());
    entries
        .map(|path| match path.extension() {
            _ if path.is_dir() => sources(&path),
            Some(extension) if extension == "rs" => fs::read_to_string(&path).unwrap(),
            _ => String::new(),
        })
        .collect()
}

/// A document without its blocks of code.
fn prose(text: &str) -> String {
    text.split("```").step_by(2).collect()
}

/// The anchors of the headings of a document, as hosts of repositories make them.
fn anchors(text: &str) -> HashSet<String> {
    let headings = text.lines().filter(|l| l.starts_with('#'));
    headings
        .map(|line| {
            let title = line.trim_start_matches('#').trim().to_lowercase();
            let kept = title
                .chars()
                .filter(|c| c.is_alphanumeric() || matches!(c, ' ' | '-' | '_'));
            kept.map(|c| if c == ' ' { '-' } else { c }).collect()
        })
        .collect()
}

#[test]
fn links_lead_somewhere() {
    let mut faults = String::new();
    for document in documents() {
        let text = prose(&fs::read_to_string(&document).unwrap());
        for rest in text.split("](").skip(1) {
            let link = rest.split(')').next().unwrap();
            if link.contains("://") {
                continue;
            }
            let (file, anchor) = link.split_once('#').unwrap_or((link, ""));
            let target = match file {
                "" => document.clone(),
                _ => document.parent().unwrap().join(file),
            };
            let leads = if anchor.is_empty() {
                target.exists()
            } else {
                fs::read_to_string(&target)
                    .is_ok_and(|text| anchors(&prose(&text)).contains(anchor))
            };
            if !leads {
                let _ = writeln!(faults, "{}: {link}", document.display());
            }
        }
    }
    assert!(faults.is_empty(), "links that lead nowhere:\n{faults}");
}

#[test]
fn files_in_backticks_exist() {
    let mut faults = String::new();
    let mut found = 0;
    for document in documents() {
        let text = prose(&fs::read_to_string(&document).unwrap());
        for span in text.split('`').skip(1).step_by(2) {
            for word in span.split_whitespace() {
                if !FOLDERS.iter().any(|f| word.starts_with(f)) || word.contains('*') {
                    continue;
                }
                found += 1;
                if !root().join(word).exists() {
                    let _ = writeln!(faults, "{}: {word}", document.display());
                }
            }
        }
    }
    assert!(faults.is_empty(), "files that are not there:\n{faults}");
    assert!(found > 10, "{found} files named");
}

#[test]
fn constants_in_backticks_exist() {
    let code = sources(&root().join("src"));
    let mut faults = String::new();
    let text = fs::read_to_string(root().join("docs/gather.md")).unwrap();
    for name in prose(&text).split('`').skip(1).step_by(2) {
        let is_constant =
            name.len() > 1 && name.chars().all(|c| c.is_ascii_uppercase() || c == '_');
        if is_constant && !code.contains(&format!("const {name}:")) {
            let _ = writeln!(faults, "{name}");
        }
    }
    assert!(faults.is_empty(), "constants that are not there:\n{faults}");
}
