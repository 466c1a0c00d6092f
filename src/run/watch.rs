//! What memory the process has while it works, read from the system again and again.

use std::sync::{Condvar, Mutex, MutexGuard, PoisonError};
use std::time::{Duration, Instant};

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

    /// The same, sooner: shared memory that is of no file counts as mapped.
    fn soon() -> Option<Self> {
        let pages = std::fs::read_to_string("/proc/self/statm").ok()?;
        let mut pages = pages.split(' ').skip(1).map(str::parse::<u64>);
        let mut bytes = || pages.next()?.ok()?.checked_mul(Self::page());
        let (all, mapped) = (bytes()?, bytes()?);
        Some(Self {
            anonymous: all.saturating_sub(mapped),
            mapped,
        })
    }

    /// Bytes of a page of memory.
    fn page() -> u64 {
        #[cfg(unix)]
        {
            rustix::param::page_size() as u64
        }
        #[cfg(not(unix))]
        4096
    }

    /// Both together.
    #[must_use]
    pub fn all(self) -> u64 {
        self.anonymous + self.mapped
    }

    /// The share of a memory limit that mapped files have in memory, whatever else there is; more
    /// of them is given back where the limit is near.
    pub(super) const MAPPED_SHARE: u64 = 8;
    /// Bytes of the program itself that are mapped.
    const PROGRAM: u64 = 12 << 20;

    /// Whether a process is so near to a limit that it should give back what it has mapped.
    pub(super) fn is_near(self, limit: u64) -> bool {
        self.all() > limit - limit / 32 && self.mapped > Self::PROGRAM + limit / 64
    }

    /// Bytes that are not given back as a process comes near to a limit.
    pub(crate) fn kept(self, limit: u64) -> u64 {
        self.anonymous + (self.mapped).min(Self::PROGRAM + limit / Self::MAPPED_SHARE)
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
/// Between those of who looks often: a thread may map a gigabyte in a second.
const OFTEN: Duration = Duration::from_millis(2);

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
/// look, and `often`, if it is there, of more. Returns the most that was seen, with what was there
/// before and behind the work; `None` where the system does not tell.
pub fn watched<T>(
    seen: impl Fn(Resident) + Sync,
    often: Option<impl Fn(Resident) + Sync>,
    work: impl FnOnce() -> T,
) -> (T, Option<Peak>) {
    let Some(first) = Resident::now() else {
        return (work(), None);
    };
    let (is_over, ended) = (Mutex::new(false), Condvar::new());
    let (is_over, ended, seen, often) = (&is_over, &ended, &seen, &often);
    std::thread::scope(|scope| {
        let watch = move || {
            let mut peak = Peak::default().with(first);
            let mut over = lock(is_over);
            let every = often.as_ref().map_or(EVERY, |_| OFTEN);
            let mut last = Instant::now();
            while !*over {
                let waited = ended.wait_timeout(over, every);
                over = waited.unwrap_or_else(PoisonError::into_inner).0;
                if let Some((often, now)) = often.as_ref().zip(Resident::soon()) {
                    peak.resident_bytes = peak.resident_bytes.max(now.all());
                    often(now);
                }
                if last.elapsed() + OFTEN / 2 < EVERY {
                    continue;
                }
                last = Instant::now();
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
        let (sum, peak) = watched(look, None::<fn(Resident)>, || {
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
