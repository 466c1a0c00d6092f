//! The allocator of the program: the system's, and one line where it has nothing to give.

use super::{Line, end};
use crate::run::memory::is_refusal_heard;
use std::alloc::{GlobalAlloc, Layout, System};
use std::fmt::Write;

/// The system's allocator. Where it refuses, the program ends with one line and exit code 1, as
/// nearly no code in Rust asks whether memory came: the standard library would abort. What does
/// ask, and has a better line, says so by `run::memory::heard`.
#[derive(Debug)]
pub struct Allocator;

#[cold]
#[inline(never)]
fn refused(bytes: usize) {
    if is_refusal_heard() {
        return;
    }
    let mut line = Line::new();
    // Numbers are formatted without memory.
    let _ = write!(
        line,
        "error: not enough memory: the system does not give {bytes} more bytes; raise the limit \
         (ulimit -v, the memory of the job), lower --memory-limit, or take fewer --threads"
    );
    end(line);
}

#[inline]
fn heeded(memory: *mut u8, bytes: usize) -> *mut u8 {
    if memory.is_null() {
        refused(bytes);
    }
    memory
}

// SAFETY: everything is the system allocator's, which keeps the contract; results are passed on as
// they are, and `refused` allocates nothing and does not unwind.
#[allow(unsafe_code)]
unsafe impl GlobalAlloc for Allocator {
    // SAFETY: the caller keeps the contract of the trait.
    #[inline]
    unsafe fn alloc(&self, layout: Layout) -> *mut u8 {
        // SAFETY: as the caller promises.
        heeded(unsafe { System.alloc(layout) }, layout.size())
    }

    // SAFETY: the caller keeps the contract of the trait.
    #[inline]
    unsafe fn alloc_zeroed(&self, layout: Layout) -> *mut u8 {
        // SAFETY: as the caller promises.
        heeded(unsafe { System.alloc_zeroed(layout) }, layout.size())
    }

    // SAFETY: the caller keeps the contract of the trait.
    #[inline]
    unsafe fn realloc(&self, memory: *mut u8, layout: Layout, bytes: usize) -> *mut u8 {
        // SAFETY: as the caller promises.
        heeded(unsafe { System.realloc(memory, layout, bytes) }, bytes)
    }

    // SAFETY: the caller keeps the contract of the trait.
    #[inline]
    unsafe fn dealloc(&self, memory: *mut u8, layout: Layout) {
        // SAFETY: as the caller promises.
        unsafe { System.dealloc(memory, layout) }
    }
}
