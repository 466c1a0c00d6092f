//! What memory the machine has for us, and lists that say so where they do not get theirs.

use super::size;
use crate::{Error, Result};
use std::cell::Cell;
use std::fmt::Display;
use std::fs;
use std::path::Path;

const SMALL: u64 = 16 << 20;

/// Refuses what takes more memory than there is, before it is begun. `least` is what is surely held
/// at one time; where the system does not tell what it has, nothing is refused.
///
/// # Errors
/// [`crate::Kind::Failed`] with both sizes: another machine may have it.
pub fn check(what: impl Display, least: u64) -> Result<()> {
    // Every machine has that, and asking takes a while.
    if least < SMALL {
        return Ok(());
    }
    check_in(what, least, available())
}

fn check_in(what: impl Display, least: u64, available: Option<u64>) -> Result<()> {
    match available {
        Some(available) if least > available => Err(Error::failed(format!(
            "{what} needs {} of memory, the machine has {}",
            size::format(least),
            size::format(available)
        ))
        .hint("use a machine or a job with more memory")),
        _ => Ok(()),
    }
}

thread_local! {
    /// Whether this thread asks for memory and hears it if there is none.
    static IS_HEARD: Cell<bool> = const { Cell::new(false) };
}

/// Asks for memory by something like `try_reserve`. The program's allocator takes a refusal for the
/// end everywhere else, as it cannot see who asks.
pub fn heard<T>(ask: impl FnOnce() -> T) -> T {
    let before = IS_HEARD.replace(true);
    let answer = ask();
    IS_HEARD.set(before);
    answer
}

/// Whether a refusal of memory is heard where this thread is.
#[cfg(feature = "cli")]
pub fn is_refusal_heard() -> bool {
    IS_HEARD.get()
}

/// Gives memory that was freed back to the system, where the C library keeps it for what comes
/// next.
pub fn give_back_freed() {
    #[cfg(all(target_os = "linux", target_env = "gnu"))]
    // SAFETY: the allocator locks what it looks at, and gives away nothing that is in use.
    #[allow(unsafe_code)]
    unsafe {
        libc::malloc_trim(0);
    }
}

/// Has the C library keep no more freed memory than a small part of a limit, and ask the system for
/// no more at a time. Before threads are started.
#[cfg(feature = "cli")]
pub fn keep_less_of_freed(limit: u64) {
    #[cfg(all(target_os = "linux", target_env = "gnu"))]
    {
        let bytes = (limit / 64).clamp(128 << 10, 32 << 20) as libc::c_int;
        // SAFETY: these set numbers that the allocator reads. Where one is refused all goes on as
        // before.
        #[allow(unsafe_code)]
        unsafe {
            libc::mallopt(libc::M_TOP_PAD, bytes / 2);
            libc::mallopt(libc::M_TRIM_THRESHOLD, bytes);
        }
    }
    #[cfg(not(all(target_os = "linux", target_env = "gnu")))]
    let _ = limit;
}

/// Bytes that the program takes with so many threads before it does anything, its own file among
/// them, and for stacks and buffers that they fill, about.
#[cfg(feature = "cli")]
pub fn of_process(threads: usize) -> u64 {
    const PROGRAM: u64 = 16 << 20;
    const THREAD: u64 = 3 << 20;
    PROGRAM + threads as u64 * THREAD
}

/// An empty list with room for `count` values.
///
/// # Errors
/// [`crate::Kind::Failed`] if the system does not give it; `what` needs it.
pub fn room<T>(what: impl Display, count: usize) -> Result<Vec<T>> {
    let mut list = Vec::new();
    heard(|| list.try_reserve_exact(count)).map_err(|_| refused::<T>(what, count))?;
    Ok(list)
}

/// All values of an iterator that knows how many it has; as [`room`].
///
/// # Errors
/// As [`room`].
pub fn listed<T>(what: impl Display, values: impl ExactSizeIterator<Item = T>) -> Result<Vec<T>> {
    let mut list = room(what, values.len())?;
    list.extend(values);
    Ok(list)
}

/// Makes room for `more` values behind those of a list whose end nobody knows yet: where it has to
/// move, for as many again as it has.
///
/// # Errors
/// As [`room`].
pub fn grow<T>(what: impl Display, list: &mut Vec<T>, more: usize) -> Result<()> {
    if list.capacity() - list.len() >= more {
        return Ok(());
    }
    let count = list.len().saturating_add(more);
    heard(|| list.try_reserve(more)).map_err(|_| refused::<T>(what, count))
}

/// The error of a list of `count` values that the system has no room for.
pub fn refused<T>(what: impl Display, count: usize) -> Error {
    let bytes = (count as u64).saturating_mul(size_of::<T>() as u64);
    Error::failed(format!(
        "{what} needs {} of memory, which the system does not give",
        size::format(bytes)
    ))
    .hint("use a machine or a job with more memory")
}

/// `count` times the same value; as [`room`].
///
/// # Errors
/// As [`room`].
pub fn filled<T: Clone>(what: impl Display, value: T, count: usize) -> Result<Vec<T>> {
    let mut list = room(what, count)?;
    list.resize(count, value);
    Ok(list)
}

/// Bytes that this process may still get, swapped out or not: of the machine, of its control
/// groups, and of its own limit on addresses. Rather too much than too little.
pub fn available() -> Option<u64> {
    let read = |path: &str| fs::read_to_string(path).ok();
    let swap = |info: &str| kib(info, "SwapFree:").unwrap_or(0);
    let status = read("/proc/self/status")?;
    let info = read("/proc/meminfo")?;
    let machine = machine_memory(&info).map(|free| free + swap(&info));
    let held = kib(&status, "RssAnon:").unwrap_or(0);
    let group = read("/proc/self/cgroup").and_then(|groups| group_limit(&groups));
    let group = group.map(|limit| limit.saturating_add(swap(&info)).saturating_sub(held));
    let addresses = free_addresses(&status);
    [machine, group, addresses].into_iter().flatten().min()
}

/// Bytes that this process's limit on addresses leaves; `None` for no limit.
fn free_addresses(status: &str) -> Option<u64> {
    let limits = fs::read_to_string("/proc/self/limits").ok()?;
    let mapped = kib(status, "VmSize:").unwrap_or(0);
    Some(address_limit(&limits)?.saturating_sub(mapped))
}

/// Whether there are addresses for the stacks of so many threads. Started without, some of them
/// start, find no place for their signals, and panic.
#[cfg(feature = "cli")]
pub fn have_stacks(threads: usize) -> bool {
    /// That of a thread of the standard library.
    const STACK: u64 = 2 << 20;
    let status = fs::read_to_string("/proc/self/status").ok();
    let free = status.and_then(|status| free_addresses(&status));
    free.is_none_or(|free| threads as u64 * STACK <= free)
}

/// Bytes of the machine's memory that are free or could be freed: an eighth more than the kernel,
/// which is careful, counts as available, but no more than there is.
fn machine_memory(info: &str) -> Option<u64> {
    let available = kib(info, "MemAvailable:")?;
    Some((available + available / 8).min(kib(info, "MemTotal:")?))
}

/// Bytes on a line such as `MemAvailable:   1024 kB`.
pub(super) fn kib(text: &str, name: &str) -> Option<u64> {
    let line = text.lines().find_map(|l| l.strip_prefix(name))?;
    let kib: u64 = line.trim().strip_suffix("kB")?.trim().parse().ok()?;
    kib.checked_mul(1024)
}

/// The soft limit on addresses; `None` for no limit.
fn address_limit(limits: &str) -> Option<u64> {
    let line = limits
        .lines()
        .find_map(|l| l.strip_prefix("Max address space"))?;
    line.split_whitespace().next()?.parse().ok()
}

/// The least limit of the control groups that a process is in, by the lines of its `cgroup` file.
fn group_limit(groups: &str) -> Option<u64> {
    let limits = groups.lines().filter_map(|line| {
        let mut parts = line.splitn(3, ':').skip(1);
        let (kind, group) = (parts.next()?, parts.next()?);
        let (root, name) = match kind {
            "" => ("/sys/fs/cgroup", "memory.max"),
            _ if kind.split(',').any(|k| k == "memory") => {
                ("/sys/fs/cgroup/memory", "memory.limit_in_bytes")
            }
            _ => return None,
        };
        // A group is bound by those that it is in. Inside a container paths may be those of the
        // host.
        let above = Path::new(group.trim_start_matches('/')).ancestors();
        let limits = above.filter_map(|group| {
            let text = fs::read_to_string(Path::new(root).join(group).join(name)).ok()?;
            text.trim().parse().ok()
        });
        limits.min()
    });
    limits.min()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_does_not_fit_says_what_there_is() {
        check_in("x", 4096, None).unwrap();
        check_in("x", 4096, Some(4096)).unwrap();
        let error = check_in("shading 9 pixels", 4096, Some(1)).unwrap_err();
        assert_eq!(error.kind(), crate::Kind::Failed);
        assert_eq!(
            error.to_string(),
            "shading 9 pixels needs 4.00 KiB of memory, the machine has 1 B"
        );
        assert!(error.hint_text().is_some());
    }

    #[test]
    fn a_list_that_is_too_long_is_an_error() {
        assert_eq!(filled("x", 7_u8, 3).unwrap(), [7; 3]);
        let error = room::<u64>("the frame", usize::MAX / 16).unwrap_err();
        assert_eq!(error.kind(), crate::Kind::Failed);
        let message = error.to_string();
        assert!(
            message.starts_with("the frame needs 8388608 TiB"),
            "{message}"
        );
        assert_eq!(listed("x", 3..5_u8).unwrap(), [3, 4]);
        listed("x", (0..usize::MAX / 16).map(|i| i as u64)).unwrap_err();
        let mut list = vec![7_u64];
        grow("x", &mut list, 1).unwrap();
        assert!(list.capacity() > 1);
        let error = grow("the mesh", &mut list, usize::MAX / 16 - 1).unwrap_err();
        assert_eq!(error.to_string(), message.replace("frame", "mesh"));
        assert_eq!(list, [7]);
    }

    #[test]
    fn what_linux_tells_is_read() {
        let info = "MemTotal:  24 kB\nMemAvailable:       16 kB\nSwapFree: x kB\n";
        assert_eq!(kib(info, "MemAvailable:"), Some(16384));
        assert_eq!(kib(info, "SwapFree:"), None);
        assert_eq!(machine_memory(info), Some(18432));
        let empty = "MemTotal:  24 kB\nMemAvailable:       23 kB\n";
        assert_eq!(machine_memory(empty), Some(24576));
        let limit = |soft: &str| {
            address_limit(&format!(
                "Limit  Soft Limit  Hard Limit  Units\nMax address space  {soft}  unlimited  bytes\n"
            ))
        };
        assert_eq!(limit("3000"), Some(3000));
        assert_eq!(limit("unlimited"), None);
        assert_eq!(group_limit("5:cpu:/\n"), None);
    }

    #[cfg(target_os = "linux")]
    #[test]
    fn a_machine_has_memory_but_not_without_end() {
        let available = available().unwrap();
        assert!((1 << 20..1 << 50).contains(&available), "{available}");
        check("a test", 1).unwrap();
        check("a test", u64::MAX).unwrap_err();
    }
}
