//! What the process has taken from the machine so far.

use super::size;
use crate::{Error, Result};
use std::path::Path;
use std::sync::atomic::{AtomicU64, Ordering};

/// CPU seconds of all threads; 0 where the system does not tell.
#[must_use]
pub fn cpu_secs() -> f64 {
    #[cfg(unix)]
    {
        let time = rustix::time::clock_gettime(rustix::time::ClockId::ProcessCPUTime);
        time.tv_sec as f64 + time.tv_nsec as f64 * 1e-9
    }
    #[cfg(not(unix))]
    0.0
}

/// Bytes that may still be written to the disk of a folder; `None` where the system does not tell.
#[must_use]
pub fn free_disk_bytes(folder: &Path) -> Option<u64> {
    #[cfg(unix)]
    {
        let disk = rustix::fs::statvfs(folder).ok()?;
        disk.f_bavail.checked_mul(disk.f_frsize)
    }
    #[cfg(not(unix))]
    {
        let _ = folder;
        None
    }
}

/// Refuses to write what the disk of a folder cannot hold: not even much less than `bytes`, which
/// are about what `what` takes.
///
/// # Errors
/// [`crate::Kind::Failed`] with both sizes, and `advice`.
pub fn check_room(what: &str, folder: &Path, bytes: u64, advice: &str) -> Result<()> {
    /// Of what is about true.
    const SURE_SHARE: f64 = 0.8;
    match free_disk_bytes(folder) {
        Some(free) if (free as f64) < bytes as f64 * SURE_SHARE => Err(Error::failed(format!(
            "{what} in {}: expected room for about {}, found {}",
            folder.display(),
            size::format(bytes),
            size::format(free)
        ))
        .hint(advice)),
        _ => Ok(()),
    }
}

/// The folder that a file is in.
#[must_use]
pub fn folder_of(file: &Path) -> &Path {
    let folder = file.parent().filter(|p| !p.as_os_str().is_empty());
    folder.unwrap_or(Path::new("."))
}

/// The largest resident size that was known when it was last counted anew.
static EARLIER_PEAK: AtomicU64 = AtomicU64::new(0);

/// Largest resident size in bytes; `None` where the system does not tell.
#[must_use]
pub fn peak_memory_bytes() -> Option<u64> {
    Some(peak_so_far()?.max(EARLIER_PEAK.load(Ordering::Relaxed)))
}

/// Runs something and tells the largest resident size of the process while it ran, with all that
/// was there before; `None` where the system does not tell. Runs at the same time mix their peaks.
pub fn with_peak_memory<T>(run: impl FnOnce() -> T) -> (T, Option<u64>) {
    EARLIER_PEAK.fetch_max(peak_so_far().unwrap_or(0), Ordering::Relaxed);
    // Linux counts its peak anew after this; proc(5).
    let is_anew = std::fs::write("/proc/self/clear_refs", "5").is_ok();
    let result = run();
    (result, peak_so_far().filter(|_| is_anew))
}

fn peak_so_far() -> Option<u64> {
    let status = std::fs::read_to_string("/proc/self/status").ok()?;
    let line = status.lines().find_map(|l| l.strip_prefix("VmHWM:"))?;
    let kib: u64 = line.trim().strip_suffix("kB")?.trim().parse().ok()?;
    kib.checked_mul(1024)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[cfg(unix)]
    #[test]
    fn what_no_disk_holds_is_refused() {
        let folder = tempfile::tempdir().unwrap();
        let file = folder.path().join("a.lvc");
        assert_eq!(folder_of(&file), folder.path());
        assert_eq!(folder_of(Path::new("a.lvc")), Path::new("."));
        let check = |bytes| check_room("the cloud", folder.path(), bytes, "write elsewhere");
        check(1).unwrap();
        let error = check(1 << 60).unwrap_err();
        assert_eq!(error.kind(), crate::Kind::Failed);
        let text = error.to_string();
        assert!(
            text.contains("expected room for about 1048576 TiB"),
            "{text}"
        );
        assert_eq!(error.hint_text(), Some("write elsewhere"));
    }

    #[cfg(target_os = "linux")]
    #[test]
    fn work_shows() {
        let before = cpu_secs();
        let mut ballast = vec![1u8; 8 << 20];
        while cpu_secs() - before < 0.005 {
            std::hint::black_box(&mut ballast)
                .iter_mut()
                .for_each(|b| *b ^= 1);
        }
        std::hint::black_box(&ballast);
        assert!(peak_memory_bytes().unwrap() >= 8 << 20);
    }
}
