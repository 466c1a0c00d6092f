//! Licences and sources of all dependencies, held against `deny.toml` where cargo-deny is not
//! installed.

use serde_json::Value;
use std::path::Path;
use std::process::Command;

const CRATES_IO: &str = "registry+https://github.com/rust-lang/crates.io-index";

/// Reads SPDX expressions; `/` is an old way to write OR.
struct Expression<'a> {
    words: Vec<&'a str>,
    allowed: &'a [String],
}

impl Expression<'_> {
    fn is_allowed(text: &str, allowed: &[String]) -> bool {
        let spaced = text
            .replace('(', " ( ")
            .replace(')', " ) ")
            .replace('/', " OR ");
        let mut words: Vec<&str> = spaced.split_whitespace().collect();
        words.reverse();
        let mut expression = Expression { words, allowed };
        expression.any_of() && expression.words.is_empty()
    }

    fn takes(&mut self, word: &str) -> bool {
        let is_next = self.words.last() == Some(&word);
        if is_next {
            self.words.pop();
        }
        is_next
    }

    fn any_of(&mut self) -> bool {
        let mut is_allowed = self.all_of();
        while self.takes("OR") {
            is_allowed |= self.all_of();
        }
        is_allowed
    }

    fn all_of(&mut self) -> bool {
        let mut is_allowed = self.licence();
        while self.takes("AND") {
            is_allowed &= self.licence();
        }
        is_allowed
    }

    fn licence(&mut self) -> bool {
        if self.takes("(") {
            return self.any_of() & self.takes(")");
        }
        let mut name = self.words.pop().unwrap_or_default().to_owned();
        if self.takes("WITH") {
            name += " WITH ";
            name += self.words.pop().unwrap_or_default();
        }
        self.allowed.contains(&name)
    }
}

#[test]
fn licences_and_sources_are_as_deny_toml_allows_them() {
    let root = Path::new(env!("CARGO_MANIFEST_DIR"));
    let rules: toml::Table =
        toml::from_str(&std::fs::read_to_string(root.join("deny.toml")).unwrap()).unwrap();
    let allowed = rules["licenses"]["allow"].as_array().unwrap();
    let allowed: Vec<String> = (allowed.iter())
        .map(|name| name.as_str().unwrap().to_owned())
        .collect();
    let cargo = std::env::var("CARGO").unwrap_or_else(|_| "cargo".into());
    let output = Command::new(cargo)
        .current_dir(root)
        .args(["metadata", "--format-version", "1", "--all-features"])
        // What other systems need may have to be downloaded first.
        .arg("--locked")
        .output()
        .unwrap();
    assert!(output.status.success(), "{output:?}");
    let metadata: Value = serde_json::from_slice(&output.stdout).unwrap();
    let packages = metadata["packages"].as_array().unwrap();
    assert!(packages.len() > 100, "{} packages", packages.len());
    for package in packages {
        let name = &package["name"];
        let licence = package["license"].as_str().unwrap_or_default();
        let is_allowed = Expression::is_allowed(licence, &allowed);
        assert!(is_allowed, "{name} is under {licence:?}");
        let Some(source) = package["source"].as_str() else {
            // A package of this repository.
            for dependency in package["dependencies"].as_array().unwrap() {
                let required = &dependency["req"];
                let is_own = dependency["path"].is_string();
                assert!(is_own || required != "*", "{name} needs any {dependency}");
            }
            continue;
        };
        assert_eq!(source, CRATES_IO, "{name}");
    }
}

#[test]
fn expressions_are_read() {
    let allowed = ["MIT", "Apache-2.0", "Apache-2.0 WITH LLVM-exception"].map(str::to_owned);
    for (text, is_allowed) in [
        ("MIT", true),
        ("GPL-3.0", false),
        ("GPL-3.0 OR MIT", true),
        ("GPL-3.0/MIT", true),
        ("MIT AND GPL-3.0", false),
        ("GPL-3.0 OR MIT AND Apache-2.0", true),
        ("(GPL-3.0 OR MIT) AND Apache-2.0", true),
        ("(GPL-3.0 OR MIT) AND ISC", false),
        ("Apache-2.0 WITH LLVM-exception", true),
        ("MIT WITH LLVM-exception", false),
        ("MIT MIT", false),
        ("", false),
    ] {
        assert_eq!(Expression::is_allowed(text, &allowed), is_allowed, "{text}");
    }
}
