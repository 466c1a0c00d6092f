//! Imports flow one way. Each module of the library may use only what the table below allows; a new
//! module needs a row.
//!
//! Tests inside a file (from `#[cfg(test)]` to its end), files named `tests.rs` and those in
//! folders named `tests` may use anything.

use std::collections::BTreeMap;
use std::fmt::Write;
use std::fs;
use std::path::{Path, PathBuf};

/// Module of the library, and the paths below `crate::` that it may name. `error` stands for
/// `Error`, `Kind`, `Result`. Of several rows that hold for a module, the longest counts.
const MAY_USE: &[(&str, &[&str])] = &[
    ("error", &["formats"]),
    ("processor", &[]),
    ("math", &[]),
    ("run", &["error", "formats"]),
    ("column", &["formats"]),
    ("scene", &["column", "error", "formats", "math", "run"]),
    (
        "trace",
        &["column", "error", "formats", "math", "run", "scene"],
    ),
    ("light", &["error", "math", "run::List", "scene", "trace"]),
    // A tree is opened, and gathered from, on a machine that has no scene.
    ("tree", &["error", "formats", "math", "run"]),
    ("gather", &["error", "formats", "math", "run", "tree"]),
    ("image", &["error", "run", "scene::Film"]),
    (
        "view",
        &["error", "gather", "image::Region", "math", "scene", "trace"],
    ),
    (
        "inscatter",
        &[
            "error", "formats", "gather", "light", "math", "run", "scene", "trace", "tree", "view",
        ],
    ),
    ("bake", LEAVES),
    (
        "bounce",
        &[
            "error", "formats", "gather", "light", "math", "run", "scene", "trace", "tree", "view",
        ],
    ),
    ("build", LEAVES),
    ("pack", LEAVES),
    // Where there are no triangles a tree is all that it needs.
    (
        "points",
        &[
            "error",
            "formats",
            "gather",
            "image::npy",
            "math",
            "run",
            "scene",
            "trace",
            "tree",
            "view",
        ],
    ),
    ("scatter", LIT_BY_MEDIA),
    ("shade", LIT_BY_MEDIA),
    (
        "inspect",
        &["error", "formats", "image", "run", "scene", "trace"],
    ),
    // What judges the pipeline may use all of it; nothing that renders uses the laboratory.
    ("lab", LABORATORY),
    // The truth that lvox is measured by shares scenes and rays with it, and nothing else.
    (
        "lab::reference",
        &["error", "image", "math", "run", "scene", "trace"],
    ),
    // The command line is for people: what it needs has to be public, or part of the laboratory.
    (
        "cli",
        &[
            "bake", "bounce", "build", "error", "formats", "gather", "image", "inspect", "lab",
            "pack", "points", "run", "scatter", "scene", "shade", "tree",
        ],
    ),
];

/// What stages share; no stage uses another.
const LEAVES: &[&str] = &[
    "error", "formats", "gather", "image", "light", "math", "run", "scene", "trace", "tree",
];

const LABORATORY: &[&str] = &[
    "bake", "bounce", "build", "error", "formats", "gather", "image", "light", "math", "run",
    "scatter", "scene", "shade", "trace", "tree",
];

/// What stages share that light media.
const LIT_BY_MEDIA: &[&str] = &[
    "error",
    "formats",
    "gather",
    "image",
    "inscatter",
    "light",
    "math",
    "run",
    "scene",
    "trace",
    "tree",
    "view",
];

/// Below these folders results are figures for people and no pixels or files depend on the last bit
/// of them.
const MAY_USE_PLATFORM_MATHS: &[&str] = &[
    "src/image/metrics",
    "src/inspect",
    "src/lab/stability",
    "src/lab/study",
];

/// Functions of f32 and f64 that the standard library takes from the platform: their last bits
/// differ between systems. `sqrt` is exact, and `powi` only multiplies.
const PLATFORM_MATHS: &[&str] = &[
    "acos", "acosh", "asin", "asinh", "atan", "atan2", "atanh", "cbrt", "cos", "cosh", "exp",
    "exp2", "exp_m1", "hypot", "ln", "ln_1p", "log", "log10", "log2", "powf", "sin", "sin_cos",
    "sinh", "tan", "tanh",
];

/// Functions of glam that call those.
const PLATFORM_MATHS_OF_GLAM: &[&str] = &[
    "angle_between",
    "angle_to",
    "from_angle",
    "from_axis_angle",
    "from_euler",
    "from_rotation_x",
    "from_rotation_y",
    "from_rotation_z",
    "from_scaled_axis",
    "perspective_infinite_rh",
    "perspective_rh",
    "rotate_axis",
    "rotate_towards",
    "rotate_x",
    "rotate_y",
    "rotate_z",
    "slerp",
    "to_angle",
    "to_axis_angle",
    "to_euler",
    "to_scaled_axis",
];

/// What a reader of the file formats must not need.
const NOT_FOR_FORMATS: &[&str] = &[
    "lvox",
    "clap",
    "exr",
    "gltf",
    "image",
    "indicatif",
    "obvhs",
    "ply-rs-bw",
    "rayon",
];

fn root() -> &'static Path {
    Path::new(env!("CARGO_MANIFEST_DIR"))
}

fn sources(folder: &Path) -> Vec<PathBuf> {
    let mut found = Vec::new();
    for entry in fs::read_dir(folder).unwrap() {
        let path = entry.unwrap().path();
        if path.is_dir() {
            found.extend(sources(&path));
        } else if path.extension().is_some_and(|e| e == "rs") {
            found.push(path);
        }
    }
    found.sort();
    found
}

/// Blanks comments, literals and tests out, keeping every line where it is.
fn code(source: &str) -> String {
    let mut out = String::with_capacity(source.len());
    let mut rest = source;
    while let Some(c) = rest.chars().next() {
        let skip = if rest.starts_with("//") {
            rest.find('\n').unwrap_or(rest.len())
        } else if rest.starts_with("/*") {
            rest.find("*/").map_or(rest.len(), |at| at + 2)
        } else if rest.starts_with("r#\"") {
            rest.find("\"#").map_or(rest.len(), |at| at + 2)
        } else if rest.starts_with("'\"'") {
            3
        } else if c == '"' {
            literal_end(rest)
        } else {
            out.push(c);
            rest = &rest[c.len_utf8()..];
            continue;
        };
        out.extend(
            rest[..skip]
                .chars()
                .map(|c| if c == '\n' { '\n' } else { ' ' }),
        );
        rest = &rest[skip..];
    }
    without_tests(&out)
}

/// Blanks every item out that is compiled for tests only.
fn without_tests(code: &str) -> String {
    const MARK: &str = "#[cfg(test)]";
    let mut out = String::with_capacity(code.len());
    let mut rest = code;
    while let Some(at) = rest.find(MARK) {
        out.push_str(&rest[..at]);
        let item = &rest[at..];
        let end = item_end(item);
        out.extend(item[..end].chars().filter(|&c| c == '\n'));
        rest = &item[end..];
    }
    out + rest
}

/// Where an item ends: at its first semicolon outside of braces, or where its braces close.
fn item_end(item: &str) -> usize {
    let mut depth = 0;
    for (at, c) in item.char_indices() {
        match c {
            '{' => depth += 1,
            '}' => depth -= 1,
            _ => {}
        }
        if depth == 0 && matches!(c, ';' | '}') {
            return at + 1;
        }
    }
    item.len()
}

fn literal_end(text: &str) -> usize {
    let mut escaped = false;
    for (at, c) in text.char_indices().skip(1) {
        match c {
            '"' if !escaped => return at + 1,
            '\\' => escaped = !escaped,
            _ => escaped = false,
        }
    }
    text.len()
}

fn is_word(c: char) -> bool {
    c.is_alphanumeric() || c == '_'
}

/// The paths in a use tree or expression that begins here: `a::b` gives one, `{a::b, c::{d, e}}`
/// gives `a::b` and `c`.
fn paths(text: &str) -> Vec<String> {
    if let Some(group) = text.strip_prefix('{') {
        let mut found = Vec::new();
        let (mut depth, mut start) = (0, 0);
        for (at, c) in group.char_indices() {
            match c {
                '{' => depth += 1,
                '}' if depth > 0 => depth -= 1,
                ',' | '}' if depth == 0 => {
                    found.extend(paths(group[start..at].trim_start()));
                    start = at + 1;
                    if c == '}' {
                        break;
                    }
                }
                _ => {}
            }
        }
        return found;
    }
    let end = text.find(|c| !is_word(c) && c != ':').unwrap_or(text.len());
    let path = text[..end].trim_end_matches(':');
    if path.is_empty() {
        Vec::new()
    } else {
        vec![path.to_owned()]
    }
}

/// All paths that the code of a module names from the crate's root or by `super`, as paths from the
/// root, with their lines.
fn imports(code: &str, module: &[String]) -> Vec<(usize, String)> {
    let mut found = Vec::new();
    for start in ["crate::", "super::", "lvox_formats"] {
        for (at, _) in code.match_indices(start) {
            let before = &code[..at];
            if before.ends_with(is_word) || before.ends_with("super::") {
                continue;
            }
            let line = before.matches('\n').count() + 1;
            if start == "lvox_formats" {
                found.push((line, "formats".to_owned()));
                continue;
            }
            let mut rest = code[at..].trim_start_matches("crate::");
            let mut from = if start == "crate::" { &[] } else { module };
            while let Some(after) = rest.strip_prefix("super::") {
                rest = after;
                from = &from[..from.len().saturating_sub(1)];
            }
            let absolute = |path: String| [from, &[path]].concat().join("::");
            found.extend(paths(rest).into_iter().map(|p| (line, absolute(p))));
        }
    }
    found
}

/// The modules of the library but its root, each by its path, with its file; not those of tests.
fn modules() -> Vec<(Vec<String>, PathBuf)> {
    let src = root().join("src");
    let path = |file: &Path| {
        let relative = file.strip_prefix(&src).unwrap().with_extension("");
        let parts = relative.components();
        let mut module: Vec<String> = parts
            .map(|c| c.as_os_str().to_str().unwrap().to_owned())
            .collect();
        if module.last().is_some_and(|m| m == "mod") {
            module.pop();
        }
        module
    };
    let files = sources(&src).into_iter();
    let is_own =
        |m: &[String]| m != ["lib"] && m != ["main"] && m.last().is_some_and(|m| m != "tests");
    files
        .map(|file| (path(&file), file))
        .filter(|(module, _)| is_own(module))
        .collect()
}

fn allowed(path: &str, own: &str, rules: &[&str]) -> bool {
    let path = match path.split("::").next() {
        Some("Error" | "Kind" | "Result") => "error",
        _ => path,
    };
    let below = |rule: &str| path == rule || path.starts_with(&format!("{rule}::"));
    below(own) || rules.iter().any(|rule| below(rule))
}

/// The row that holds for a module: the longest that names it or a parent of it.
fn row(module: &[String]) -> Option<(&'static str, &'static [&'static str])> {
    let parents = (1..=module.len()).rev();
    let mut names = parents.map(|n| module[..n].join("::"));
    names.find_map(|name| MAY_USE.iter().find(|(own, _)| *own == name).copied())
}

#[test]
fn imports_flow_one_way() {
    let src = root().join("src");
    let mut faults = String::new();
    for (module, file) in modules() {
        let relative = file.strip_prefix(&src).unwrap();
        let Some((own, rules)) = row(&module) else {
            let _ = writeln!(
                faults,
                "src/{}:1: no row for module {}",
                relative.display(),
                module[0]
            );
            continue;
        };
        let code = code(&fs::read_to_string(&file).unwrap());
        for (line, path) in imports(&code, &module) {
            if !allowed(&path, own, rules) {
                let place = format!("src/{}:{line}", relative.display());
                let _ = writeln!(faults, "{place}: {own} may not use {path}");
            }
        }
    }
    assert!(faults.is_empty(), "\n{faults}");
}

/// Below one parent no two modules need each other, not by way of others either. What a parent
/// holds itself is for all below it.
#[test]
fn modules_of_one_parent_do_not_need_each_other() {
    let modules = modules();
    // By parent: who uses whom, and where.
    let mut uses = BTreeMap::<String, BTreeMap<(String, String), String>>::new();
    for (module, file) in &modules {
        let code = code(&fs::read_to_string(file).unwrap());
        for (line, path) in imports(&code, module) {
            let path: Vec<&str> = path.split("::").collect();
            let shared = module.iter().zip(&path).take_while(|(a, b)| a == b).count();
            if shared == 0 || shared == module.len() || shared == path.len() {
                continue;
            }
            let other = [&module[..shared], &[path[shared].to_owned()]].concat();
            if modules.iter().any(|(m, _)| *m == other) {
                let place = format!("{}:{line}", file.strip_prefix(root()).unwrap().display());
                let pair = (module[shared].clone(), path[shared].to_owned());
                let parent = module[..shared].join("::");
                uses.entry(parent).or_default().entry(pair).or_insert(place);
            }
        }
    }
    let mut faults = String::new();
    for (parent, mut pairs) in uses {
        // What nobody uses, or what uses nobody, is in no circle: without those, pair by pair, the
        // circles are left.
        while let Some(free) = pairs.keys().find_map(|pair| {
            let goes_on = pairs.keys().any(|(user, _)| *user == pair.1);
            let is_used = pairs.keys().any(|(_, used)| *used == pair.0);
            (!goes_on || !is_used).then(|| pair.clone())
        }) {
            pairs.remove(&free);
        }
        for ((user, used), place) in pairs {
            let _ = writeln!(
                faults,
                "{place}: in {parent}, {user} and {used} need each other"
            );
        }
    }
    assert!(faults.is_empty(), "\n{faults}");
}

/// Uses of the platform's maths, with their lines.
fn platform_maths(code: &str) -> Vec<(usize, &str)> {
    let mut found = Vec::new();
    let mut start = None;
    for (at, c) in code.char_indices().chain([(code.len(), ' ')]) {
        if is_word(c) {
            start = start.or(Some(at));
            continue;
        }
        let Some(from) = start.take() else { continue };
        let (before, name) = (code[..from].trim_end(), &code[from..at]);
        let of_float = before.ends_with("f32::") || before.ends_with("f64::");
        let is_call = c == '(' && before.ends_with('.');
        let is_maths = PLATFORM_MATHS.contains(&name) && (of_float || is_call);
        if is_maths || PLATFORM_MATHS_OF_GLAM.contains(&name) {
            found.push((code[..from].matches('\n').count() + 1, name));
        }
    }
    found
}

/// Whether a file holds nothing but tests.
fn is_of_tests(path: &Path) -> bool {
    let is_folder = path.iter().any(|part| part == "tests");
    is_folder || path.file_stem().is_some_and(|stem| stem == "tests")
}

#[test]
fn pixels_and_files_do_not_depend_on_the_maths_of_the_platform() {
    let mut faults = String::new();
    for file in [
        sources(&root().join("src")),
        sources(&root().join("formats/src")),
    ]
    .concat()
    {
        let path = file.strip_prefix(root()).unwrap();
        let is_allowed = MAY_USE_PLATFORM_MATHS.iter().any(|f| path.starts_with(f));
        if is_allowed || is_of_tests(path) {
            continue;
        }
        let code = code(&fs::read_to_string(&file).unwrap());
        for (line, name) in platform_maths(&code) {
            let _ = writeln!(
                faults,
                "{}:{line}: {name} is the platform's; libm has it",
                path.display()
            );
        }
    }
    assert!(faults.is_empty(), "\n{faults}");
}

#[test]
fn formats_stand_alone() {
    let mut faults = String::new();
    let folder = root().join("formats");
    for file in sources(&folder.join("src")) {
        let code = code(&fs::read_to_string(&file).unwrap());
        for (at, _) in code.match_indices("lvox::") {
            let line = code[..at].matches('\n').count() + 1;
            let _ = writeln!(
                faults,
                "{}:{line}: formats may not use lvox",
                file.display()
            );
        }
    }
    let manifest = fs::read_to_string(folder.join("Cargo.toml")).unwrap();
    let mut in_dependencies = false;
    for (i, line) in manifest.lines().enumerate() {
        if line.starts_with('[') {
            in_dependencies = line.trim_end() == "[dependencies]";
        }
        let name = line.split(['=', '.', ' ']).next().unwrap_or("");
        if in_dependencies && NOT_FOR_FORMATS.contains(&name) {
            let _ = writeln!(
                faults,
                "formats/Cargo.toml:{}: formats may not depend on {name}",
                i + 1
            );
        }
    }
    assert!(faults.is_empty(), "\n{faults}");
}

#[test]
fn the_scanner_sees_what_it_should() {
    let source = r##"//! crate::shade
use crate::{Error, scene::{Film, Mesh}, run::Job};
/* crate::bake */
fn f() { super::super::light::sun(); let _ = "crate::build \" crate::cli"; }
const Q: char = '"'; const R: &str = r#"say "crate::tree""#; use crate::math::sum;
use super::sibling;
use lvox_formats::Page;
#[cfg(test)]
mod tests;
use crate::trace::Hit;
#[cfg(test)]
mod tests { fn g() { crate::shade; } }
"##;
    let module = ["shade", "media"].map(str::to_owned);
    let mut found = imports(&code(source), &module);
    found.sort();
    let names: Vec<(usize, &str)> = found.iter().map(|(l, p)| (*l, p.as_str())).collect();
    assert_eq!(
        names,
        [
            (2, "Error"),
            (2, "run::Job"),
            (2, "scene"),
            (4, "light::sun"),
            (5, "math::sum"),
            (6, "shade::sibling"),
            (7, "formats"),
            (10, "trace::Hit")
        ]
    );
    assert!(allowed("scene::Film", "image", &["scene::Film"]));
    assert!(!allowed("scene", "image", &["scene::Film"]));
    assert!(!allowed("scene::Filmstrip", "image", &["scene::Film"]));
    assert!(allowed("Result", "run", &["error"]));
    assert!(!allowed("Result", "math", &[]));
    assert!(allowed("image::exr", "image", &[]));
    assert!(!allowed("lab::study", "lab::reference", &[]));
    let row_of = |path: &str| row(&path.split("::").map(str::to_owned).collect::<Vec<_>>());
    assert_eq!(row_of("lab::reference::sums").unwrap().0, "lab::reference");
    assert_eq!(row_of("lab::study").unwrap().0, "lab");
    assert_eq!(row_of("laboratory"), None);

    let source = "let a = x.sin() + libm::cos(y); // z.tan()\nlet b = v.map(f32::exp);\nlet c = (p\n    .q)\n    .powf(2.0);
let d = crate::math::exp::exp(log2) + s.exp + DQuat::from_rotation_x(a) + t.sqrt().powi(2);";
    assert_eq!(
        platform_maths(&code(source)),
        [(1, "sin"), (2, "exp"), (5, "powf"), (6, "from_rotation_x")]
    );
}
