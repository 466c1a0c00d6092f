//! The cases of `lvox study --stability`, with the heavy ones made lighter, and the table in the
//! docs.

use lvox::lab::stability::{self, Effort};
use lvox::run::Job;
use lvox::scene::Scene;
use std::fmt::Write;

#[test]
fn every_case_is_within_its_limit_and_in_the_docs() {
    let scene = Scene::demo().unwrap();
    let families = stability::run(&scene, Effort::Brief, &Job::default()).unwrap();
    let docs = std::fs::read_to_string("docs/stability.md").unwrap();
    let mut faults = String::new();
    let mut rows = 0;
    for family in &families {
        if !docs.contains(&format!("## {}\n\n{}\n", family.name, family.note)) {
            let _ = writeln!(faults, "docs/stability.md has no part {}", family.name);
        }
        for row in &family.rows {
            rows += 1;
            if !row.passed() {
                let _ = writeln!(faults, "{}: {row:?}", family.name);
            }
            if !docs.contains(&format!("| {} |", row.case)) {
                let _ = writeln!(faults, "docs/stability.md lacks {}", row.case);
            }
        }
    }
    assert!(faults.is_empty(), "\n{faults}");
    assert!(families.len() == 10 && rows > 200, "{rows} rows");
    assert!(!docs.contains("FAILED"));
}
