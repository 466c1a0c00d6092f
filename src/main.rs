//! The `lvox` program: reads the command line, runs one verb, prints at most one error.

mod processor;

use std::process::ExitCode;

#[global_allocator]
static ALLOCATOR: lvox::cli::Allocator = lvox::cli::Allocator;

fn main() -> ExitCode {
    processor::check();
    #[cfg(all(target_os = "linux", target_env = "gnu"))]
    {
        take_memory_in_large_pieces();
        fail_where_a_file_may_not_grow();
    }
    lvox::cli::main()
}

/// Has the C library ask the system for 16 MiB of addresses at a time where it would ask for a few
/// pages and stop the other threads each time, and keep freed memory of up to 32 MiB for what comes
/// next: blocks of a frame each take some MiB, and pages that are new to a process cost as much as
/// filling them. What is not used takes no memory.
#[cfg(all(target_os = "linux", target_env = "gnu"))]
fn take_memory_in_large_pieces() {
    // SAFETY: these set numbers that the allocator reads, while this is the only thread. Where one
    // is refused all goes on as before.
    #[allow(unsafe_code)]
    unsafe {
        libc::mallopt(libc::M_TOP_PAD, 16 << 20);
        libc::mallopt(libc::M_MMAP_THRESHOLD, 32 << 20);
        libc::mallopt(libc::M_TRIM_THRESHOLD, 32 << 20);
    }
}

/// Has a write beyond `ulimit -f` fail, as on a full disk, in place of a signal that ends the
/// program without a word.
#[cfg(all(target_os = "linux", target_env = "gnu"))]
fn fail_where_a_file_may_not_grow() {
    // SAFETY: the signal is ignored, so no code of ours runs in a handler, and this is the only
    // thread.
    #[allow(unsafe_code)]
    unsafe {
        libc::signal(libc::SIGXFSZ, libc::SIG_IGN);
    }
}
