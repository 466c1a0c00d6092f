//! The runs of a study in rounds in which methods take turns, and by further seeds.

use super::Files;
use super::measure::Bench;
use super::plan::{How, Variant};
use super::record::{Errors, Making, Run, Study};
use super::target::{Others, render_reference};
use crate::image::{Picture, heat, png, tone};
use crate::lab::reference::Start;
use crate::run::Job;
use crate::{Error, Result};
use std::fs;

/// Measures what is not there yet.
///
/// # Errors
/// Whatever rendering and writing can give, or a stop on request.
pub fn measure_all(
    study: &mut Study,
    variants: &[Variant],
    mut others: Others,
    bench: &Bench,
    files: &Files,
    start: Start,
    job: &Job,
) -> Result<()> {
    let settings = bench.settings;
    let target = match others.reference.take() {
        Some(target) => target,
        None => render_reference(bench, files, start, job)?,
    };
    study.reference = target.about;
    let target = target.picture;
    others.judge(study, &target, bench)?;
    png::write(
        &files.image("reference"),
        &tone::map(&target, study.reference.exposure),
    )?;
    let total = variants.len() as u64 * u64::from(settings.rounds);
    let task = job.progress.task("study", total, "runs");
    for round in 1..=settings.rounds {
        for variant in variants {
            let at = study.runs.iter().position(|r| r.name == variant.name);
            let rounds = at.map_or(&[][..], |i| &study.runs[i].rounds);
            let long = rounds.iter().any(|t| t.wall_secs > settings.long_secs);
            if rounds.len() < round as usize && !long {
                job.cancel.check()?;
                measure(study, variant, round, &target, bench, files)?;
                study.write(&files.json())?;
            }
            task.add(1);
        }
    }
    drop(task);
    measure_seeds(study, variants, &target, bench, files, job)
}

/// All runs by further seeds, which are judged and not timed. Their trees are kept while a seed is
/// measured.
fn measure_seeds(
    study: &mut Study,
    variants: &[Variant],
    target: &Picture,
    bench: &Bench,
    files: &Files,
    job: &Job,
) -> Result<()> {
    let total = variants.len() as u64 * u64::from(bench.settings.seeds - 1);
    if total == 0 {
        return Ok(());
    }
    let task = job.progress.task("seeds", total, "runs");
    for settings in bench.settings.of_further_seeds() {
        let trees = files.trees_of_seed();
        let remove = || match trees.is_dir() {
            true => fs::remove_dir_all(&trees).map_err(|e| Error::io("remove", &trees, &e)),
            false => Ok(()),
        };
        remove()?;
        fs::create_dir_all(&trees).map_err(|e| Error::io("create", &trees, &e))?;
        let bench = Bench::new(bench.scene, &settings, trees.clone(), job);
        for variant in settings.variants(study.has_media) {
            job.cancel.check()?;
            task.add(1);
            let Some(at) = study.runs.iter().position(|r| r.name == variant.name) else {
                continue;
            };
            if study.runs[at].seeds.contains_key(&settings.seed) {
                continue;
            }
            if let How::Points(points) = &variant.how
                && !bench.has_tree(&points.cloud())
            {
                bench.prepare(points)?;
            }
            let (picture, ..) = bench.render(&variant)?;
            let (errors, _) = bench.judge(&picture, target, study.reference.exposure)?;
            study.runs[at].seeds.insert(settings.seed, errors);
            study.write(&files.json())?;
        }
        remove()?;
    }
    Ok(())
}

/// One run of one round.
fn measure(
    study: &mut Study,
    variant: &Variant,
    round: u32,
    target: &Picture,
    bench: &Bench,
    files: &Files,
) -> Result<()> {
    let mut cloud_name = None;
    if let How::Points(points) = &variant.how {
        let name = points.cloud();
        let at = study.clouds.iter().position(|c| c.name == name);
        let rounds = at.map_or(&[][..], |i| &study.clouds[i].rounds);
        let long_secs = bench.settings.long_secs;
        let long = |m: &Making| m.bake.wall_secs + m.build.wall_secs > long_secs;
        let is_due = rounds.len() < round as usize && !rounds.iter().any(long);
        if is_due || !bench.has_tree(&name) {
            let cloud = bench.prepare(points)?;
            match at {
                None => study.clouds.push(cloud),
                Some(i) => cloud
                    .rounds
                    .into_iter()
                    .for_each(|m| study.clouds[i].add(m)),
            }
        }
        cloud_name = Some(name);
    }
    let (picture, timing, peak) = bench.render(variant)?;
    if let Some(run) = study.runs.iter_mut().find(|r| r.name == variant.name) {
        run.add(timing, peak);
        return Ok(());
    }
    let errors = match study.errors_of(&variant.name) {
        Some(known) => known,
        None => judge(study, variant, &picture, target, bench, files)?,
    };
    study.runs.push(Run {
        name: variant.name.clone(),
        key: variant.key(bench.settings),
        method: variant.method,
        sweep: variant.sweep,
        values: variant.values(),
        cloud: cloud_name,
        rounds: vec![timing],
        peak_memory_bytes: peak,
        errors,
        seeds: study.seeds_of(&variant.name),
    });
    Ok(())
}

/// Compares the image of a run with the reference, and keeps both for the report.
fn judge(
    study: &Study,
    variant: &Variant,
    picture: &Picture,
    target: &Picture,
    bench: &Bench,
    files: &Files,
) -> Result<Errors> {
    let exposure = study.reference.exposure;
    let (errors, comparison) = bench.judge(picture, target, exposure)?;
    png::write(&files.image(&variant.name), &tone::map(picture, exposure))?;
    png::write(
        &files.heat(&variant.name),
        &heat::map(&comparison.error_map, picture.width),
    )?;
    Ok(errors)
}
