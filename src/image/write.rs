//! Frames to files of the kind that their names tell.

use super::exr::{self, Precision};
use super::frame::EXPOSURE;
use super::{Exposure, Frame, ImageKind, npy, png};
use crate::Result;
use crate::run::Job;
use std::path::Path;

/// Writes a frame as the name of the file asks for: OpenEXR of this precision, an array of NumPy,
/// or a PNG with the exposure that is given, or that of the scene's film if the frame tells it, or
/// 1. Samples that 16-bit floats do not hold are a warning.
///
/// # Errors
/// A name of no kind of image, and what writing can give.
pub fn write(
    output: &Path,
    frame: &Frame,
    precision: Precision,
    exposure: Option<Exposure>,
    job: &Job,
) -> Result<()> {
    let kind = ImageKind::named(output)?;
    match kind {
        ImageKind::Exr => {
            warn_of_clamped(output, frame, precision, job);
            job.heed_warnings()?;
            exr::write(output, frame, precision)
        }
        ImageKind::Npy => {
            job.progress.say(&npy::told(output, frame));
            npy::write(output, frame)
        }
        ImageKind::Png => {
            let noted = frame.attributes.get(EXPOSURE).and_then(|e| e.parse().ok());
            let exposure = exposure.unwrap_or(Exposure::Fixed(noted.unwrap_or(1.0)));
            png::write_exposed(output, frame, exposure, &job.progress)
        }
    }
}

/// Says what halves could not hold.
fn warn_of_clamped(output: &Path, frame: &Frame, precision: Precision, job: &Job) {
    let clamped = exr::clamped(frame, precision);
    if clamped.samples > 0 {
        job.progress.warn(&format!(
            "{}: {} samples in {} channels ({}) are beyond 65504, the largest 16-bit float, and \
             are stored as that; use --float to keep them",
            output.display(),
            clamped.samples,
            clamped.channels.len(),
            clamped.channels.join(", ")
        ));
    }
}
