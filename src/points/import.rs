//! Surfels that others baked → cloud.

use super::file::PointFile;
use super::receivers::{MAX_COORDINATE, unit};
use super::rows::Rows;
use super::{CHUNK_BYTES, MAX_CHUNK};
use crate::formats::{CloudMeta, CloudSummary, CloudWriter, Overwrite, Surfel};
use crate::run::{Budget, Job};
use crate::scene::load::colors::linear_from_srgb;
use crate::scene::load::ply::header::Scalar;
use crate::{Error, Result};
use glam::DVec3;
use std::f64::consts::PI;
use std::fs::File;
use std::path::Path;

/// How surfels are made of points.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct ImportSettings {
    /// Disk radius over that of a disk of the surfel's area, where points have one of both.
    pub overlap: f32,
}

impl Default for ImportSettings {
    /// As a bake draws disks.
    fn default() -> Self {
        Self { overlap: 1.8 }
    }
}

/// Where the radiance of points stands, first choice first.
const RADIANCE: [[&str; 3]; 3] = [
    ["radiance_r", "radiance_g", "radiance_b"],
    ["r", "g", "b"],
    ["red", "green", "blue"],
];

/// The radiance of a point.
struct Radiance {
    columns: [usize; 3],
    names: [&'static str; 3],
    /// Whether it is written as 0 to 255 by the sRGB curve.
    is_srgb: bool,
}

/// The columns that surfels are made of.
struct Plan<'a> {
    points: &'a PointFile,
    position: [usize; 3],
    normal: [usize; 3],
    radius: Option<usize>,
    area: Option<usize>,
    radiance: Radiance,
    overlap: f64,
}

/// A point, before it is in scene space.
struct Sample {
    position: DVec3,
    surfel: Surfel,
}

/// Makes a cloud of points with normals, `radius` or `area`, and radiance. What the cloud says of
/// its scene is that it was imported, and from which bytes.
///
/// # Errors
/// An overlap out of range, points without what surfels need, a point whose numbers are none, an
/// output that cannot be written, or a stop on request; then no file is left.
pub fn import(
    points: &PointFile,
    output: &Path,
    settings: &ImportSettings,
    overwrite: Overwrite,
    job: &Job,
) -> Result<CloudSummary> {
    let overlap = settings.overlap;
    if !(0.1..=10.0).contains(&overlap) {
        return Err(Error::input(format!(
            "`overlap` must be 0.1 to 10, found {overlap}"
        )));
    }
    let plan = Plan::of(points, overlap.into()).map_err(|e| e.at(points.path.display()))?;
    if plan.radiance.is_srgb {
        job.progress.warn(&format!(
            "{}: `{}`, `{}` and `{}` are bytes: taken as sRGB, with 255 for a radiance of 1",
            points.path.display(),
            plan.radiance.names[0],
            plan.radiance.names[1],
            plan.radiance.names[2],
        ));
        job.heed_warnings()?;
    }
    let budget = Budget::default()
        .with("the program and its threads", job.process_bytes)
        .with("points", 2 * CHUNK_BYTES);
    budget.within("importing", job.memory_limit, "raise `memory_limit`")?;
    job.hold(&budget);
    job.stage("import", |counts| {
        let (mut least, mut most) = (DVec3::INFINITY, DVec3::NEG_INFINITY);
        plan.each(job, |samples| {
            for sample in samples {
                least = least.min(sample.position);
                most = most.max(sample.position);
            }
            Ok(())
        })?;
        // Near the origin single precision is finest.
        let origin = 0.5 * (least + most);
        let meta = CloudMeta {
            scene_hash: digest(&points.path)?,
            scene_name: "imported".into(),
            world_from_scene: origin.to_array(),
            volumes: Vec::new(),
            settings: vec![
                ("imported".into(), points.count.to_string()),
                ("overlap".into(), overlap.to_string()),
            ],
            disk_overlap: match (plan.radius, plan.area) {
                (Some(_), Some(_)) => 0.0,
                _ => overlap,
            },
        };
        let mut writer = CloudWriter::create(output, meta, overwrite)?;
        let task = job.progress.task("import", points.count, "surfels");
        plan.each(job, |samples| {
            let surfels: Vec<Surfel> = samples
                .iter()
                .map(|sample| Surfel {
                    position: (sample.position - origin).as_vec3().to_array(),
                    ..sample.surfel
                })
                .collect();
            writer.push_surfels(&surfels)?;
            task.add(surfels.len() as u64);
            Ok(())
        })?;
        let summary = writer.finish()?;
        counts.insert("surfels".into(), summary.sums.surfels as f64);
        Ok(summary)
    })
}

/// Identity of the bytes of a file.
fn digest(path: &Path) -> Result<[u8; 32]> {
    let mut hasher = blake3::Hasher::new();
    let read = File::open(path).and_then(|file| hasher.update_reader(file).map(drop));
    read.map_err(|e| Error::io("read", path, &e))?;
    Ok(hasher.finalize().into())
}

impl<'a> Plan<'a> {
    fn of(points: &'a PointFile, overlap: f64) -> Result<Self> {
        if points.count == 0 {
            return Err(Error::input("expected surfels, found no points"));
        }
        let three = |names| points.triple(names);
        let normal = three(["nx", "ny", "nz"])?.ok_or_else(|| {
            Error::input("expected surfels with normals (`nx`, `ny`, `nz`), found none")
        })?;
        let (radius, area) = (points.column("radius"), points.column("area"));
        if radius.or(area).is_none() {
            return Err(Error::input(
                "expected surfels with `radius` or `area`, found neither",
            ));
        }
        Ok(Self {
            points,
            position: three(["x", "y", "z"])?.ok_or_else(|| Error::input("expected `x`"))?,
            normal,
            radius,
            area,
            radiance: Radiance::of(points)?,
            overlap,
        })
    }

    /// Gives all points to `take`, some at a time.
    fn each(&self, job: &Job, mut take: impl FnMut(&[Sample]) -> Result<()>) -> Result<()> {
        let columns = self.points.columns.len();
        let bytes = columns * size_of::<f64>() + self.points.row_bytes();
        let bytes = bytes + size_of::<Sample>() + size_of::<Surfel>();
        let chunk = (CHUNK_BYTES as usize / bytes).clamp(1, MAX_CHUNK);
        let mut rows = Rows::open(self.points, 0)?;
        let mut first = 0;
        while first < self.points.count {
            job.cancel.check()?;
            let count = (chunk as u64).min(self.points.count - first) as usize;
            let values = rows.read(count)?;
            let samples = values.chunks_exact(columns).zip(first..);
            let samples =
                samples.map(|(row, point)| self.sample(row).map_err(|e| self.points.at(point, e)));
            take(&samples.collect::<Result<Vec<_>>>()?)?;
            first += count as u64;
        }
        Ok(())
    }

    fn sample(&self, row: &[f64]) -> Result<Sample> {
        let three = |columns: [usize; 3]| columns.map(|c| row[c]);
        let position = three(self.position);
        if !position.iter().all(|v| v.abs() <= MAX_COORDINATE) {
            return Err(Error::input(format!(
                "expected a position within 1e15 of the origin, found {position:?}"
            )));
        }
        let normal = three(self.normal);
        let normal = unit(normal.into()).ok_or_else(|| {
            Error::input(format!("expected a normal of a length, found {normal:?}"))
        })?;
        let size = |name: &str, column: Option<usize>| {
            let Some(value) = column.map(|c| row[c]) else {
                return Ok(None);
            };
            // As it is stored.
            let is_one = (value as f32).is_normal() && value > 0.0;
            match is_one {
                true => Ok(Some(value)),
                false => Err(Error::input(format!(
                    "expected a `{name}` above 0, found {value}"
                ))),
            }
        };
        let (radius, area) = (size("radius", self.radius)?, size("area", self.area)?);
        let (radius, area) = match (radius, area) {
            (Some(radius), Some(area)) => (radius, area),
            (Some(radius), None) => (self.overlap * radius, PI * radius * radius),
            (None, area) => {
                let area = area.unwrap_or(0.0);
                (self.overlap * (area / PI).sqrt(), area)
            }
        };
        let (radius, area) = (radius as f32, area as f32);
        if !(radius.is_normal() && area.is_normal()) {
            return Err(Error::input(format!(
                "expected a disk that 32-bit floats hold, \
                 found a radius of {radius:e} and an area of {area:e}"
            )));
        }
        Ok(Sample {
            position: position.into(),
            surfel: Surfel {
                normal: normal.to_array(),
                radius,
                area,
                front: self.radiance.at(row)?,
                ..Surfel::default()
            },
        })
    }
}

impl Radiance {
    fn of(points: &PointFile) -> Result<Self> {
        for names in RADIANCE {
            let Some(columns) = points.triple(names)? else {
                continue;
            };
            let of_type =
                |is: fn(Scalar) -> bool| columns.iter().all(|&c| is(points.columns[c].scalar));
            let is_srgb = of_type(|s| s == Scalar::U8);
            if !is_srgb && !of_type(|s| matches!(s, Scalar::F32 | Scalar::F64)) {
                return Err(Error::input(format!(
                    "expected `{}`, `{}` and `{}` as floats or bytes, found other numbers",
                    names[0], names[1], names[2]
                )));
            }
            return Ok(Self {
                columns,
                names,
                is_srgb,
            });
        }
        Err(Error::input(
            "expected surfels with radiance (`r`, `g`, `b` or `red`, `green`, `blue`), found none",
        ))
    }

    fn at(&self, row: &[f64]) -> Result<[f32; 3]> {
        let found = self.columns.map(|c| row[c] as f32);
        if self.is_srgb {
            return Ok(found.map(|c| linear_from_srgb(c / 255.0)));
        }
        match found.iter().all(|c| (0.0..f32::INFINITY).contains(c)) {
            // Without the sign of zero.
            true => Ok(found.map(f32::abs)),
            false => Err(Error::input(format!(
                "expected a radiance of 0 or more, found {found:?}"
            ))),
        }
    }
}
