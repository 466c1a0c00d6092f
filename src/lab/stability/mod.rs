//! Closed forms, extremes and invariances: each case compares lvox with what is known beforehand,
//! or with a stated limit.
//!
//! `lvox stability` prints the table; the tests run the same functions.
//!
//! A scene enters (kernels are compared with double precision on it), a [`Family`] of [`Row`]s
//! leaves for each kind of case.
//!
//! | file | what it does |
//! | --- | --- |
//! | `row` | one checked number with its limit, and the table of all |
//! | `workbench` | the whole pipeline on scenes made in memory |
//! | `field` | exact integrals of a grid in f64 |
//! | `transmittance`, `single_scattering`, `furnace` | media with closed forms or quadratures |
//! | `phase` | phase functions by themselves, and media that have one |
//! | `contrast` | media with steep steps, sheets, single voxels |
//! | `form_factors` | light between plates and disks, and of suns |
//! | `invariance`, `extremes`, `degenerate` | scenes moved, scaled, huge, empty, crowded |
//! | `precision` | the kernels in f32 beside the same in f64 |
//! | `properties` | what holds for any input, tried on many |

mod contrast;
mod degenerate;
mod extremes;
mod field;
mod form_factors;
mod furnace;
mod invariance;
mod phase;
mod precision;
mod properties;
pub mod row;
mod single_scattering;
mod transmittance;
mod workbench;

pub use row::{Family, Row, markdown};

use crate::Result;
use crate::math::sampling;
use crate::run::Job;
use crate::scene::{Scene, Volume};
use glam::Vec3;
use workbench::Workbench;

/// How much of the heavy cases is done.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Effort {
    /// A tenth or less, for tests.
    Brief,
    /// All.
    Full,
}

/// Runs the cases of one family.
type Cases = fn(&Workbench, &Scene, Effort) -> Result<Vec<Row>>;

/// Name, note and cases of all families, in the order of the table.
const FAMILIES: &[(&str, &str, Cases)] = &[
    (
        "Transmittance",
        "Homogeneous slabs and spheres. \"Cells\" are the grid that camera and shadow rays walk, \
         \"lvoxels\" what gathers pass.\n\
         Transmittance is good to 1e-5 wherever it is above 1e-30: where a ray enters and leaves \
         is found in double\n\
         precision. What a medium itself scatters behind a transmittance of 1e-4 is left out. A \
         sphere of voxels is not a\n\
         sphere, and its lvoxels average over up to 8 voxels: the rows say by how much.",
        |bench, _, _| transmittance::rows(bench),
    ),
    (
        "Steps and sheets",
        "Cells are compared with exact integration in f64 of the same trilinear field; their limit \
         is the rounding of a coordinate\n\
         times the extinction there. Lvoxels are constant over a voxel at least, so they hide what \
         passes within half a voxel of\n\
         a step; their row is the error of the mean transmittance of 400 rays. Emitted and \
         transmitted light add up to 1 on each\n\
         ray, so nothing rings.",
        |bench, _, _| contrast::rows(bench),
    ),
    (
        "Furnace",
        "Radiance 1 from everywhere, around a medium of this depth. lvox follows light through two \
         scatterings, so that is what a\n\
         walk in f64 is asked for. Up to a depth of 0.1 all pixels are 1 to within what is \
         scattered more often. Between depths\n\
         of 1 and 10 (0.6 to a voxel) light is interpolated, and right to 5 %. In deeper cells it \
         falls within a fraction of a\n\
         voxel, and is found on the ray: direct light at points of it, light scattered twice at \
         one point along each of some\n\
         directions from there. What is left is noise. No pixel ever gains energy. With all \
         bounces a room is the sum of a\n\
         geometric series, and a medium right to some percent up to a depth of 10; in deeper cells \
         the camera finds two\n\
         scatterings alone.",
        |bench, _, _| furnace::rows(bench),
    ),
    (
        "Single scattering",
        "A point light and a sphere of voxels of radius R, one pixel whose ray passes the middle \
         at 0.22 R, against quadrature over\n\
         the same voxels. The inverse square is integrated in closed form along the ray and only \
         the share that arrives is\n\
         interpolated, exponentially where it differs, so thin media are right to 1e-3 as near as \
         coordinates tell. Near the light\n\
         the share is that of the ray's own points. What is left is the spacing of 0.7 optical \
         depths between vertices at a rim\n\
         that is lit from behind. Slabs under a sun say what surfaces gather: an lvoxel deeper \
         than 0.7 holds the light that rays\n\
         from outside see, as a mean over the faces that are not buried; so a sheet of one such \
         voxel sends as much from its dark\n\
         side as from its lit one. A thinner lvoxel holds the light at its centroid: too little by \
         up to 8 % at 0.6.",
        |bench, _, _| single_scattering::rows(bench),
    ),
    (
        "Phase functions",
        "Integral and moments of their own values; a ball under a sun, seen at angles from \
         straight on to straight back, against\n\
         quadrature over the same voxels; what surfaces gather of it; and white furnaces of \
         radiance 1 against a walk with two\n\
         scatterings, of which forward lobes leave little. The\n\
         sun's light is weighed on the ray itself, so thin media are right to 1e-3 at any angle. \
         An lvoxel knows of a phase\n\
         function its mean cosine alone: of two lobes surfaces get one.",
        |bench, _, _| phase::rows(bench),
    ),
    (
        "Form factors",
        "Closed forms of lights (triangles), and gathers from disks. Triangles smaller than a \
         tenth of their distance are\n\
         integrated by points, because the sum over their edges cancels. A receiver exactly on an \
         edge has no closed form; it\n\
         gets something between nothing and half. Gathers have the sampling error of their rays, \
         and disks reach over the\n\
         border of what they stand for.",
        |bench, _, _| form_factors::rows(bench),
    ),
    (
        "Invariance",
        "A room with an emitter, a sun of 2 degrees and uneven smoke, changed as a whole; its \
         picture is changed back and compared with\n\
         the first. Moved and scaled pictures differ by rays that fall on the other side of an \
         edge. Turned ones have other\n\
         tangents, so their noise is another. Light from 1e-30 to 1e30 leaves the rounding of \
         stored radiance.",
        |bench, _, _| invariance::rows(bench),
    ),
    (
        "Degenerate input",
        "Rays against needles are watertight and areas are sums in f64, so what is left is the \
         noise of other samples. Of doubled and\n\
         opposite faces the first is seen. Many surfels on one spot cost a look at each only where \
         no node may stand for them.\n\
         Volumes that overlap have a lattice of in-scattered light each, \
         at the spacing of their own density.",
        |bench, _, effort| degenerate::rows(bench, effort),
    ),
    (
        "Extremes",
        "A small scene beside something huge, and light and size at the ends of their ranges \
         together: what has no part in the\n\
         picture does not change it.",
        |bench, _, _| extremes::rows(bench),
    ),
    (
        "Precision",
        "The f32 kernels against the same arithmetic in f64 by brute force, over rays into a baked \
         scene: the distribution of the\n\
         relative difference. Where disks of one plane overlap, rounding decides which of them is \
         met; the place is the same.\n\
         Aggregates are summed in f64.",
        precision::rows,
    ),
    (
        "Properties",
        "What must hold for any input, tried on many from a fixed seed; \
         a count is of those that break the rule.",
        properties::rows,
    ),
];

/// Runs all cases; kernels are compared with double precision on `scene`.
///
/// # Errors
/// A temporary folder that cannot be written, a volume that cannot be read, or a stop on request. A
/// case that fails is no error: its row says so.
pub fn run(scene: &Scene, effort: Effort, job: &Job) -> Result<Vec<Family>> {
    scene.volumes.iter().try_for_each(Volume::ready)?;
    let task = job
        .progress
        .task("stability", FAMILIES.len() as u64, "families");
    FAMILIES
        .iter()
        .map(|&(name, note, cases)| {
            let bench = Workbench::new(job)?;
            bench.cancel().check()?;
            let rows = job.stage(name, |_| cases(&bench, scene, effort))?;
            task.add(1);
            Ok(Family { name, note, rows })
        })
        .collect()
}

/// Numbers from a seed and an index.
fn random(seed: u64, index: u64) -> f32 {
    sampling::unit(sampling::hash(&[seed, index]))
}

/// Rays from a sphere of radius `from` around the origin to points of the ball of radius `to`.
fn rays(count: u64, from: f32, to: f32) -> impl Iterator<Item = (Vec3, Vec3)> {
    (0..count).map(move |i| {
        let origin = from * sampling::sphere(sampling::r2(i, [0.1; 2]));
        let target = to * random(17, i) * sampling::sphere(sampling::r2(i, [0.6; 2]));
        (origin, (target - origin).normalize())
    })
}
