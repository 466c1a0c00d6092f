//! Frames to files of the kind that their names tell.

use super::exr::{self, Precision};
use super::frame::EXPOSURE;
use super::{Exposure, Frame, ImageKind, npy, png};
use crate::Result;
use crate::run::Job;
use std::path::Path;

/// Writes a frame as the name of the file asks for: OpenEXR of this precision, an array of NumPy, or
/// a PNG with the exposure that is given, or that of the scene's film if the frame tells it, or 1.
/// Pixels that are not finite are a warning.
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
    if let Some(found) = frame.not_finite() {
        job.progress.warn(&format!("{}: {found}", output.display()));
    }
    job.heed_warnings()?;
    match kind {
        ImageKind::Exr => exr::write(output, frame, precision),
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
