//! Changes to files, and what may come of them.

use crate::support::random::Random;
use std::alloc::{GlobalAlloc, Layout, System};
use std::panic::{self, AssertUnwindSafe};
use std::path::{Path, PathBuf};
use std::sync::atomic::{AtomicU64, AtomicUsize, Ordering::Relaxed};
use std::sync::{Arc, Mutex, PoisonError};
use std::time::{Duration, Instant};
use std::{env, fs, process, thread};

/// The system's memory, counted.
struct Counted;

static LIVE: AtomicUsize = AtomicUsize::new(0);
static PEAK: AtomicUsize = AtomicUsize::new(0);

fn taken(bytes: usize) {
    let live = LIVE.fetch_add(bytes, Relaxed) + bytes;
    PEAK.fetch_max(live, Relaxed);
}

// SAFETY: each call goes on to the system's allocator as it came.
unsafe impl GlobalAlloc for Counted {
    // SAFETY: the caller keeps the contract of the trait.
    unsafe fn alloc(&self, layout: Layout) -> *mut u8 {
        taken(layout.size());
        // SAFETY: as the caller promised.
        unsafe { System.alloc(layout) }
    }

    // SAFETY: the caller keeps the contract of the trait.
    unsafe fn alloc_zeroed(&self, layout: Layout) -> *mut u8 {
        taken(layout.size());
        // SAFETY: as the caller promised.
        unsafe { System.alloc_zeroed(layout) }
    }

    // SAFETY: the caller keeps the contract of the trait.
    unsafe fn realloc(&self, block: *mut u8, layout: Layout, size: usize) -> *mut u8 {
        taken(size);
        LIVE.fetch_sub(layout.size(), Relaxed);
        // SAFETY: as the caller promised.
        unsafe { System.realloc(block, layout, size) }
    }

    // SAFETY: the caller keeps the contract of the trait.
    unsafe fn dealloc(&self, block: *mut u8, layout: Layout) {
        LIVE.fetch_sub(layout.size(), Relaxed);
        // SAFETY: as the caller promised.
        unsafe { System.dealloc(block, layout) }
    }
}

#[global_allocator]
static ALLOCATOR: Counted = Counted;

/// Bytes that a closure held at most beyond what was held before it.
pub fn peak_of<T>(run: impl FnOnce() -> T) -> (T, usize) {
    let before = LIVE.load(Relaxed);
    PEAK.store(before, Relaxed);
    let result = run();
    (result, PEAK.load(Relaxed).saturating_sub(before))
}

/// A whole number from the environment.
fn number(name: &str) -> Option<u64> {
    let value = env::var(name).ok()?;
    Some(
        value
            .parse()
            .unwrap_or_else(|_| panic!("{name} is no number: {value}")),
    )
}

/// Most time of a case, before it counts as slow and before it counts as endless.
const SLOW: Duration = Duration::from_secs(5);
const ENDLESS: Duration = Duration::from_secs(60);

/// One test at a time: memory is counted for all of the process.
pub static ALONE: Mutex<()> = Mutex::new(());

/// A reader to be tried with damaged files.
pub struct Target<'a> {
    pub name: &'a str,
    /// Cases that run if the environment does not say how many.
    pub cases: u64,
    /// Most bytes of memory that a case may take.
    pub memory: usize,
    /// Whole files, of which cases are made.
    pub corpus: Vec<Vec<u8>>,
}

/// The last panic: where, and its message.
static PANIC: Mutex<String> = Mutex::new(String::new());

/// A folder of its own for a target, which stays if the process ends early.
pub fn folder(name: &str) -> PathBuf {
    let folder = Path::new(env!("CARGO_TARGET_TMPDIR"))
        .join("fuzz")
        .join(name);
    let _ = fs::remove_dir_all(&folder);
    fs::create_dir_all(&folder).unwrap();
    folder
}

impl Target<'_> {
    /// Tries cases: `change` makes one of a file of the corpus, and `attempt` reads it, which may
    /// fail, but by an error: it may not panic, take long or take much memory. It tells whether the
    /// file was read, or what else is wrong.
    ///
    /// # Panics
    /// At the end, if any case did what it may not; such files are kept.
    pub fn run(
        &self,
        mut change: impl FnMut(&mut Random, &[u8], &[Vec<u8>]) -> Vec<u8>,
        mut attempt: impl FnMut(&[u8]) -> Result<bool, String>,
    ) {
        let _alone = ALONE.lock().unwrap_or_else(PoisonError::into_inner);
        let cases = number("LVOX_FUZZ_CASES").unwrap_or(self.cases);
        let first = number("LVOX_FUZZ_FIRST").unwrap_or(0);
        let seed = number("LVOX_FUZZ_SEED").unwrap_or(1);
        let kept = folder(&format!("{}-found", self.name));
        for whole in &self.corpus {
            assert_eq!(attempt(whole), Ok(true), "{}: a whole file", self.name);
        }
        let watch = Watch::new(self.name);
        let hook = panic::take_hook();
        panic::set_hook(Box::new(|info| {
            let mut text = PANIC.lock().unwrap_or_else(PoisonError::into_inner);
            *text = info.to_string().replace('\n', " ");
        }));
        let (mut found, mut read) = (Vec::new(), 0);
        for case in first..first + cases {
            watch.0.store(case, Relaxed);
            let mut random = Random(seed << 40 ^ case);
            random.next();
            let whole = &self.corpus[random.below(self.corpus.len() as u64) as usize];
            let file = change(&mut random, whole, &self.corpus);
            let started = Instant::now();
            let (outcome, bytes) =
                peak_of(|| panic::catch_unwind(AssertUnwindSafe(|| attempt(&file))));
            let secs = started.elapsed();
            let wrong = match outcome {
                Err(_) => Some(PANIC.lock().unwrap_or_else(PoisonError::into_inner).clone()),
                Ok(Err(wrong)) => Some(wrong),
                Ok(Ok(_)) if secs > SLOW => Some(format!("{secs:.1?}")),
                Ok(Ok(_)) if bytes > self.memory => Some(format!("{} MiB", bytes >> 20)),
                Ok(Ok(is_read)) => {
                    read += u64::from(is_read);
                    None
                }
            };
            if let Some(wrong) = wrong {
                fs::write(kept.join(case.to_string()), &file).unwrap();
                found.push(format!("case {case}: {wrong}"));
            }
        }
        panic::set_hook(hook);
        eprintln!("{}: {read} of {cases} files are read", self.name);
        // Changes that no reader gets to see, or that none minds, try nothing.
        let is_useful = cases < 100 || (cases / 200..cases).contains(&read);
        assert!(is_useful, "{}: {read} of {cases} files are read", self.name);
        let count = found.len();
        found.truncate(20);
        assert!(
            found.is_empty(),
            "{}: {count} of {cases} cases (files in {}):\n{}",
            self.name,
            kept.display(),
            found.join("\n")
        );
    }
}

/// Ends the process if a case never ends.
struct Watch(Arc<AtomicU64>);

impl Watch {
    fn new(name: &str) -> Self {
        let case = Arc::new(AtomicU64::new(u64::MAX));
        let (watched, name) = (Arc::downgrade(&case), name.to_owned());
        thread::spawn(move || {
            let (mut last, mut since) = (u64::MAX, Instant::now());
            while let Some(case) = watched.upgrade() {
                let now = case.load(Relaxed);
                drop(case);
                if now != last {
                    (last, since) = (now, Instant::now());
                } else if since.elapsed() > ENDLESS && now != u64::MAX {
                    eprintln!("{name}: case {now} does not end");
                    process::abort();
                }
                thread::sleep(Duration::from_millis(500));
            }
        });
        Self(case)
    }
}

/// Numbers at the ends of ranges, and floats that are none.
const NUMBERS: [u32; 14] = [
    0,
    1,
    2,
    0x7f,
    0xff,
    0x7fff,
    0xffff,
    0x0001_0000,
    0x7fff_ffff,
    0x8000_0000,
    0xffff_ffff,
    0x7f80_0000,
    0x7fc0_0000,
    0x7f7f_ffff,
];

/// Words that text may have in place of others.
const WORDS: [&str; 20] = [
    "0",
    "-1",
    "1",
    "1e39",
    "-1e39",
    "1e-39",
    "nan",
    "inf",
    "-inf",
    "255",
    "65536",
    "4294967295",
    "9223372036854775807",
    "99999999999999999999",
    "\"",
    "[",
    "{",
    "\n",
    " ",
    "é",
];

/// Some changes, one after the other: bits, bytes, numbers, words, lines, and pieces that are lost,
/// doubled or from another file.
pub fn change(random: &mut Random, whole: &[u8], corpus: &[Vec<u8>]) -> Vec<u8> {
    let mut file = whole.to_vec();
    for _ in 0..=random.below(4) {
        let at = random.below(file.len() as u64 + 1) as usize;
        let most = 1 << random.below(8);
        let len = 1 + random.below(most) as usize;
        let end = (at + len).min(file.len());
        match random.below(10) {
            0 if at < file.len() => file[at] ^= 1 << random.below(8),
            1 if at < file.len() => file[at] = random.next() as u8,
            2 | 3 => {
                let number = NUMBERS[random.below(NUMBERS.len() as u64) as usize];
                let number = [number.to_le_bytes(), number.to_be_bytes()][random.below(2) as usize];
                let end = (at + 4).min(file.len());
                file[at..end].copy_from_slice(&number[..end - at]);
            }
            4 | 5 => {
                let is_part = |b: &u8| b.is_ascii_alphanumeric() || b".-+_".contains(b);
                let end = file[at..]
                    .iter()
                    .position(|b| !is_part(b))
                    .map_or(end, |n| at + n);
                let word = WORDS[random.below(WORDS.len() as u64) as usize];
                file.splice(at..end, word.bytes());
            }
            6 => drop(file.drain(at..end)),
            7 => {
                let piece = file[at..end].to_vec();
                file.splice(at..at, piece);
            }
            8 => {
                let other = &corpus[random.below(corpus.len() as u64) as usize];
                let from = random.below(other.len() as u64 + 1) as usize;
                let piece = &other[from..(from + len).min(other.len())];
                file.splice(at..end, piece.iter().copied());
            }
            _ if random.below(8) == 0 => file.truncate(at),
            _ => {}
        }
    }
    file
}
