//! Figures, not checks: `cargo test --release --test build_rate -- --ignored --nocapture`.

#![allow(clippy::print_stdout)]

use lvox::build::{self, Settings};
use lvox::formats::*;
use lvox::run::Job;
use std::sync::atomic::{AtomicBool, AtomicU64, Ordering};
use std::time::Instant;

struct Random(u64);

impl Random {
    fn unit(&mut self) -> f32 {
        self.0 = self.0.wrapping_add(0x9e37_79b9_7f4a_7c15);
        let mut z = self.0;
        z = (z ^ (z >> 30)).wrapping_mul(0xbf58_476d_1ce4_e5b9);
        z = (z ^ (z >> 27)).wrapping_mul(0x94d0_49bb_1331_11eb);
        ((z ^ (z >> 31)) >> 40) as f32 / (1u64 << 24) as f32
    }
}

/// A box with forty balls in it, radii and light varying from surface to surface and along them.
fn surfel(random: &mut Random, i: u64, n: u64) -> Surfel {
    let (a, b) = (random.unit() * 2.0 - 1.0, random.unit() * 2.0 - 1.0);
    let mut s = Surfel::default();
    // Runs of a few thousand from the same surface, as a bake makes them.
    let surface = i * 46 / n;
    let scale = 1.0 + 0.3 * (surface as f32 * 1.7).sin();
    s.area = 60.0 / n as f32 * scale;
    if surface < 6 {
        let axis = (surface % 3) as usize;
        let side = if surface < 3 { 1.0 } else { -1.0 };
        s.position[axis] = 2.0 * side;
        s.position[(axis + 1) % 3] = 2.0 * a;
        s.position[(axis + 2) % 3] = 2.0 * b;
        s.normal[axis] = -side;
    } else {
        let phi = a * std::f32::consts::PI;
        let r = (1.0 - b * b).sqrt();
        s.normal = [r * phi.cos(), r * phi.sin(), b];
        let k = (surface - 6) as f32;
        let centre = [(k * 0.7).sin(), (k * 1.3).cos(), (k * 2.1).sin()];
        s.position = std::array::from_fn(|i| 1.5 * centre[i] + 0.3 * s.normal[i]);
    }
    let light = 0.5 + 0.4 * (3.0 * s.position[0]).sin() * (2.0 * s.position[1]).cos();
    s.front = [
        light * 0.8,
        light * 0.6,
        light * (0.3 + 0.05 * random.unit()),
    ];
    s.radius = 1.7 * (s.area / std::f32::consts::PI).sqrt();
    if random.unit() < 0.05 {
        s.clips.count = 1;
        s.clips.edges[0] = ClipEdge {
            angle: random.unit() * 6.0,
            offset: random.unit(),
        };
    }
    s
}

/// Anonymous memory of the process, MiB; mapped files do not count.
fn memory() -> u64 {
    let status = std::fs::read_to_string("/proc/self/status").unwrap_or_default();
    let line = status.lines().find(|l| l.starts_with("RssAnon"));
    let kib = line.and_then(|l| l.split_whitespace().nth(1)?.parse::<u64>().ok());
    kib.unwrap_or(0) >> 10
}

#[test]
#[ignore = "takes long, and prints"]
fn rate() {
    let n: u64 = std::env::var("SURFELS").map_or(3_000_000, |s| s.parse().unwrap());
    let dir = tempfile::tempdir().unwrap();
    let (cloud, tree) = (dir.path().join("a.lvc"), dir.path().join("a.lvt"));
    let meta = CloudMeta {
        disk_overlap: 1.7,
        ..CloudMeta::default()
    };
    let mut random = Random(1);
    let mut writer = CloudWriter::create(&cloud, meta, true).unwrap();
    let mut write_secs = 0.0;
    for start in (0..n).step_by(65536) {
        let part: Vec<Surfel> = (start..(start + 65536).min(n))
            .map(|i| surfel(&mut random, i, n))
            .collect();
        let started = Instant::now();
        writer.push_surfels(&part).unwrap();
        write_secs += started.elapsed().as_secs_f64();
    }
    let summary = writer.finish().unwrap();
    let per = |bytes: u64| bytes as f64 / n as f64;
    let size = std::fs::metadata(&cloud).unwrap().len();
    println!(
        "cloud: {:.1} bytes per surfel, written at {:.2} M/s",
        per(size),
        n as f64 / write_secs / 1e6
    );
    for c in &summary.columns {
        println!(
            "  {:16} {:6.2} -> {:6.2}",
            c.name,
            per(c.raw_bytes),
            per(c.stored_bytes)
        );
    }
    let limits = match std::env::var("LIMIT_MIB") {
        Ok(mib) => vec![mib.parse::<u64>().unwrap() << 20],
        Err(_) => vec![4 << 30, 64 << 20],
    };
    for limit in limits {
        let job = Job {
            memory_limit: Some(limit),
            ..Job::default()
        };
        let (peak, done) = (AtomicU64::new(0), AtomicBool::new(false));
        let before = memory();
        let (outcome, secs) = std::thread::scope(|scope| {
            scope.spawn(|| {
                while !done.load(Ordering::Relaxed) {
                    peak.fetch_max(memory(), Ordering::Relaxed);
                    std::thread::sleep(std::time::Duration::from_millis(2));
                }
            });
            let started = Instant::now();
            let outcome = build::run(&cloud, &tree, &Settings::default(), true, &job).unwrap();
            let secs = started.elapsed().as_secs_f64();
            done.store(true, Ordering::Relaxed);
            (outcome, secs)
        });
        let summary = &outcome.summary;
        let size = std::fs::metadata(&tree).unwrap().len();
        println!(
            "limit {} MiB: {:.2} M/s, {:.2} CPU us each, {:.1} bytes per surfel, peak {} MiB ({before} before), spilled {} MB",
            limit >> 20,
            n as f64 / secs / 1e6,
            job.report.stages()[0].cpu_secs / n as f64 * 1e6,
            per(size),
            peak.load(Ordering::Relaxed),
            outcome.spilled_bytes / 1_000_000
        );
        if outcome.spilled_bytes > 0 {
            continue;
        }
        println!(
            "  {} pages, {:.3} nodes per surfel",
            summary.surfel_pages,
            summary.nodes as f64 / n as f64
        );
        let tree = Tree::open_path(&tree).unwrap();
        let mut raw: Vec<u32> = tree.surfel_blocks().iter().map(|b| b.raw_bytes).collect();
        raw.sort_unstable();
        println!(
            "  raw page bytes: 10 % {}, 50 % {}, 90 % {}",
            raw[raw.len() / 10],
            raw[raw.len() / 2],
            raw[raw.len() * 9 / 10]
        );
        for c in &summary.columns {
            println!(
                "  {:18} {:6.2} -> {:6.2}",
                c.name,
                per(c.raw_bytes),
                per(c.stored_bytes)
            );
        }
        for e in &summary.errors {
            println!("  {}: {:.3e} of {:.3e}", e.name, e.worst, e.bound);
        }
        let started = Instant::now();
        let pages = tree.surfel_pages().min(2000);
        for i in 0..pages {
            std::hint::black_box(tree.surfel_page(i).unwrap());
        }
        println!(
            "  a page decoded in {:.0} us",
            started.elapsed().as_secs_f64() / pages as f64 * 1e6
        );
    }
}
