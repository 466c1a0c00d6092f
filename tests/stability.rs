//! The cases of `lvox stability`, with the heavy ones made lighter.

use lvox::internals::stability::{self, Effort};
use lvox::run::Job;
use lvox::scene::Scene;
use std::fmt::Write;

/// The families in their order, and how many rows each has.
const ROWS: &[(&str, usize)] = &[
    ("Transmittance", 109),
    ("Steps and sheets", 70),
    ("Furnace", 70),
    ("Single scattering", 36),
    ("Phase functions", 74),
    ("Form factors", 73),
    ("Invariance", 96),
    ("Degenerate input", 27),
    ("Extremes", 18),
    ("Precision", 21),
    ("Properties", 19),
];

#[test]
fn every_case_is_within_its_limit_and_none_is_lost() {
    let scene = Scene::demo().unwrap();
    let families = stability::run(&scene, Effort::Brief, &Job::default()).unwrap();
    let mut faults = String::new();
    for family in &families {
        for row in &family.rows {
            if !row.passed() {
                let _ = writeln!(faults, "{}: {row:?}", family.name);
            }
        }
    }
    assert!(faults.is_empty(), "\n{faults}");
    let found: Vec<_> = families.iter().map(|f| (f.name, f.rows.len())).collect();
    assert_eq!(found, ROWS);
}
