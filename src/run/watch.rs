//! What memory the process has while it works, read from the system again and again.

use std::sync::{Condvar, Mutex, MutexGuard, PoisonError};
use std::time::Duration;

/// Memory of the process that is in the machine's.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, serde::Serialize)]
pub struct Resident {
    /// Bytes that are of no file: all that was allocated and used.
    pub anonymous: u64,
    /// Bytes of files that are mapped, the program itself among them.
    pub mapped: u64,
}

impl Resident {
    /// What the system says now; `None` where it does not tell.
    #[must_use]
    pub fn now() -> Option<Self> {
        let status = std::fs::read_to_string("/proc/self/status").ok()?;
        let bytes = |name: &str| super::memory::kib(&status, name);
        Some(Self {
            anonymous: bytes("RssAnon:")? + bytes("RssShmem:")?,
            mapped: bytes("RssFile:")?,
        })
    }

    /// Both together.
    #[must_use]
    pub fn all(self) -> u64 {
        self.anonymous + self.mapped
    }
}

/// The most that was seen of a process's memory, each figure for itself.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, serde::Serialize)]
pub struct Peak {
    /// Anonymous bytes.
    pub anonymous_bytes: u64,
    /// Bytes of mapped files.
    pub mapped_bytes: u64,
    /// Both at one time.
    pub resident_bytes: u64,
}

impl Peak {
    /// This, and what is seen now.
    #[must_use]
    pub fn with(self, now: Resident) -> Self {
        Self {
            anonymous_bytes: self.anonymous_bytes.max(now.anonymous),
            mapped_bytes: self.mapped_bytes.max(now.mapped),
            resident_bytes: self.resident_bytes.max(now.all()),
        }
    }
}

/// Between two looks at the system.
const EVERY: Duration = Duration::from_millis(10);

/// Tells the watching thread to end when the work does, by a panic, too.
struct End<'a>(&'a Mutex<bool>, &'a Condvar);

impl Drop for End<'_> {
    fn drop(&mut self) {
        *lock(self.0) = true;
        self.1.notify_all();
    }
}

fn lock(is_over: &Mutex<bool>) -> MutexGuard<'_, bool> {
    is_over.lock().unwrap_or_else(PoisonError::into_inner)
}

/// Does some work while another thread looks what memory the process has: `seen` hears of each
/// look. Returns the most that was seen, with what was there before and behind the work; `None`
/// where the system does not tell.
pub fn watched<T>(seen: impl Fn(Resident) + Sync, work: impl FnOnce() -> T) -> (T, Option<Peak>) {
    let Some(first) = Resident::now() else {
        return (work(), None);
    };
    let (is_over, ended) = (Mutex::new(false), Condvar::new());
    let (is_over, ended, seen) = (&is_over, &ended, &seen);
    std::thread::scope(|scope| {
        let watch = move || {
            let mut peak = Peak::default().with(first);
            let mut over = lock(is_over);
            while !*over {
                let waited = ended.wait_timeout(over, EVERY);
                over = waited.unwrap_or_else(PoisonError::into_inner).0;
                if let Some(now) = Resident::now() {
                    peak = peak.with(now);
                    seen(now);
                }
            }
            Resident::now().map_or(peak, |now| peak.with(now))
        };
        let builder = std::thread::Builder::new().stack_size(128 << 10);
        // Where no thread can be had, the work is done all the same.
        let watch = builder.spawn_scoped(scope, watch).ok();
        let end = End(is_over, ended);
        let result = work();
        drop(end);
        let peak = watch.and_then(|w| w.join().ok());
        (result, peak)
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[cfg(target_os = "linux")]
    #[test]
    fn what_is_held_for_a_while_is_seen() {
        const BYTES: usize = 48 << 20;
        let looks = std::sync::atomic::AtomicU32::new(0);
        let before = Resident::now().unwrap();
        let look = |_| {
            looks.fetch_add(1, std::sync::atomic::Ordering::Relaxed);
        };
        let (sum, peak) = watched(look, || {
            let ballast = std::hint::black_box(vec![1_u8; BYTES]);
            std::thread::sleep(5 * EVERY);
            ballast.len()
        });
        assert_eq!(sum, BYTES);
        let peak = peak.unwrap();
        assert!(
            peak.anonymous_bytes >= (BYTES as u64 / 10) * 9,
            "{peak:?} {before:?}"
        );
        assert!(peak.resident_bytes >= peak.anonymous_bytes);
        assert!(looks.into_inner() > 1);
    }
}
