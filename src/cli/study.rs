//! `lvox study`

use super::files::Files;
use super::options::{Context, Memory, Seed, Temporary};
use super::parse;
use super::plan::{Plan, Planning};
use super::scene_input::{Reading, SceneInput};
use crate::lab::study::others::{Noise, PeerImage};
use crate::lab::study::{self, Settings};
use crate::shade::Quality;
use crate::{Result, shade};
use std::path::PathBuf;

/// Measure error against run time of Monte Carlo, traditional and extended point-based rendering on
/// a scene
///
/// Vary one setting at a time around the defaults, let the methods take turns, compare each image
/// with one converged reference, and write study.json, study.csv, table.md, plots and report.html.
/// What is measured is kept after each run: the same command of the same build goes on after a
/// stop, one with more --rounds or more values of a sweep adds to what is there; --force begins
/// anew. With other --threads all times are taken anew, and those there are kept apart.
#[derive(Debug, clap::Args)]
pub struct Args {
    /// Read this scene: .toml, .gltf or .glb
    #[arg(value_name = "SCENE", required_unless_present = "demo")]
    scene: Option<PathBuf>,

    /// Use the scene that is built in: coloured walls, a torus, smoke
    #[arg(long, conflicts_with = "scene")]
    demo: bool,

    #[command(flatten)]
    reading: Reading,

    /// Write everything into this folder
    #[arg(short, long, value_name = "DIR")]
    output: PathBuf,

    /// Compare with this converged image [default: render one]
    #[arg(long, value_name = "FILE")]
    reference: Option<PathBuf>,

    /// Render that with this many samples per pixel [default: 1024, quick: 128]
    #[arg(long, value_name = "N", conflicts_with = "reference")]
    reference_spp: Option<u32>,

    /// Take this as the noise of the reference: a relMSE, or a second image of other samples and as
    /// many, from which the reference is twice that away [default: what its variance tells]
    #[arg(long, value_name = "RELMSE|FILE", value_parser = parse::noise)]
    reference_noise: Option<Noise>,

    /// Plot an image of another renderer, an .exr or .npy of the same pixels, over the CPU seconds
    /// that it took; any number, those of one name as one curve
    #[arg(long, value_name = "NAME=IMAGE,SECONDS", value_parser = parse::peer)]
    peer: Vec<PeerImage>,

    /// Plot the points of this table, which has the columns name, seconds and relmse; any number
    #[arg(long, value_name = "FILE.csv")]
    peers: Vec<PathBuf>,

    /// Few and short runs at a width of 240, to see that all works
    #[arg(long)]
    quick: bool,

    /// Only Monte Carlo and the base settings: no sweeps
    #[arg(long, conflicts_with_all = ["block_voxels", "samples", "max_solid_angle"])]
    base_only: bool,

    /// Run on a cloud like the paper's as well: 2.5 million surfels, and lvoxels of this many
    /// voxels a side, 4 if none is given
    #[arg(long, value_name = "N", num_args = 0..=1, default_missing_value = "4")]
    paper_cloud: Option<u8>,

    /// Make light of media beforehand, as lvox scatter does; its time counts with that of building
    #[arg(long)]
    scatter: bool,

    /// Render images of this width, the height in proportion [default: that of the scene; quick:
    /// 240 without --reference]
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u32).range(8..=65536))]
    width: Option<u32>,

    /// Look through this camera of the scene [default: its first]
    #[arg(long, value_name = "NAME")]
    camera: Option<String>,

    /// Shade with these base settings
    #[arg(long, value_name = "PRESET", default_value = "good", value_parser = parse::one_of(&Quality::ALL))]
    quality: Quality,

    /// Count paths of at most this many segments in Monte Carlo, as in lvox reference; 3 is what a
    /// tree without bounces holds
    #[arg(long, value_name = "N", default_value_t = Settings::default().max_depth)]
    max_depth: u32,

    /// Samples per pixel of Monte Carlo runs [default: 1,4,16,64]
    #[arg(long, value_name = "N", value_delimiter = ',')]
    spp: Vec<u32>,

    /// Surfels of clouds, the last for the base settings [default: 31250,125000,500000]
    #[arg(long, value_name = "N", value_delimiter = ',')]
    surfels: Vec<u64>,

    /// Optical depths across lvoxels, the first for the base settings [default: 0.7,0.35,1.4,2.8]
    #[arg(long, value_name = "TAU", value_delimiter = ',')]
    block_depth: Vec<f32>,

    /// Voxels a side of lvoxels of one size, as in the paper, beside the base settings [default:
    /// 2,4,8]
    #[arg(long, value_name = "N", value_delimiter = ',')]
    block_voxels: Vec<u8>,

    /// Rays of gathers on surfaces [default: 8,16,64,128,256]
    #[arg(long, value_name = "N", value_delimiter = ',')]
    samples: Vec<u32>,

    /// Largest solid angles of nodes, steradians [default: 0.0025,0.005,0.01,0.04,0.08]
    #[arg(long, value_name = "SR", value_delimiter = ',')]
    max_solid_angle: Vec<f32>,

    /// Times that each run is timed [default: 3, quick: 1]
    #[arg(long, value_name = "N")]
    rounds: Option<u32>,

    /// Make each run by so many seeds, clouds and all, for error bars; the first alone is timed
    #[arg(long, value_name = "N", default_value_t = 1, value_parser = clap::value_parser!(u32).range(1..=1000))]
    seeds: u32,

    /// Time a run that takes longer than this only once, wall-clock seconds
    #[arg(long, value_name = "SECS", default_value_t = Settings::default().long_secs)]
    long: f64,

    #[command(flatten)]
    pub memory: Memory,

    #[command(flatten)]
    pub temporary: Temporary,

    #[command(flatten)]
    seed: Seed,

    #[command(flatten)]
    planning: Planning,
}

impl Args {
    /// What it reads and writes.
    pub fn files(&self) -> Files {
        let mut files = Files::default();
        for (what, path) in [("scene", &self.scene), ("reference", &self.reference)] {
            files = path
                .iter()
                .fold(files, |files, path| files.reads(what, path));
        }
        if let Some(Noise::Image(path)) = &self.reference_noise {
            files = files.reads("--reference-noise", path);
        }
        for path in self.peers.iter().chain(self.peer.iter().map(|p| &p.path)) {
            files = files.reads("--peer", path);
        }
        let written = study::written(&self.output, self.reference.is_none());
        written
            .iter()
            .fold(files, |files, path| files.writes("--output", path))
    }

    pub fn run(self, context: &Context) -> Result<()> {
        let (files, planning) = (self.files(), self.planning);
        let scene = SceneInput::new(self.scene, self.demo, self.reading);
        let preset = if self.quick {
            Settings::quick()
        } else {
            Settings::default()
        };
        let width = match (self.quick, &self.reference) {
            (true, None) => self.width.or(Some(240)),
            _ => self.width,
        };
        let settings = Settings {
            camera: self.camera,
            max_depth: self.max_depth,
            spp: given(self.spp, preset.spp),
            surfels: given(self.surfels, preset.surfels),
            block_depth: given(self.block_depth, preset.block_depth),
            block_voxels: given(self.block_voxels, preset.block_voxels),
            samples: given(self.samples, preset.samples),
            max_solid_angle: given(self.max_solid_angle, preset.max_solid_angle),
            paper_cloud: self.paper_cloud,
            scatter: self.scatter,
            shade: shade::Settings::of(self.quality),
            rounds: self.rounds.unwrap_or(preset.rounds),
            long_secs: self.long,
            reference: self.reference,
            reference_noise: self.reference_noise,
            seeds: self.seeds,
            peer_images: self.peer,
            peer_tables: self.peers,
            reference_spp: self.reference_spp.unwrap_or(preset.reference_spp),
            seed: self.seed.seed,
        };
        let settings = if self.base_only {
            settings.base_only()
        } else {
            settings
        };
        settings.check()?;
        let mut scene = scene.load(context)?;
        if let Some(width) = width {
            let film = &mut scene.film;
            let height = f64::from(film.height) * f64::from(width) / f64::from(film.width);
            (film.width, film.height) = (width, height.round().max(1.0) as u32);
        }
        if planning.plan {
            let work = study::work(&scene, &settings);
            let held = study::check_memory(&scene, &settings, &context.job)?;
            let plan = Plan::of(&files, held).with_scene(&scene);
            let plan = work
                .into_iter()
                .fold(plan, |plan, (what, n)| plan.with(what, n));
            return plan.print(planning);
        }
        study::run(
            &scene,
            &settings,
            &self.output,
            context.start(),
            &context.job,
        )?;
        let report = self.output.join("report.html");
        context
            .job
            .progress
            .say(&format!("see {}", report.display()));
        Ok(())
    }
}

fn given<T>(values: Vec<T>, preset: Vec<T>) -> Vec<T> {
    if values.is_empty() { preset } else { values }
}
