//! The peak of memory, which the system counts for a whole process: the one test of its process.
#![cfg(target_os = "linux")]

use lvox::internals::usage::{peak_memory_bytes, with_peak_memory};

#[test]
fn the_peak_of_a_part_is_not_that_of_what_went_before() {
    let fill = |bytes: usize| {
        let mut ballast = vec![0_u8; bytes];
        ballast.iter_mut().step_by(4096).for_each(|b| *b = 1);
        std::hint::black_box(ballast).len()
    };
    let (_, large) = with_peak_memory(|| fill(256 << 20));
    let (_, small) = with_peak_memory(|| fill(1 << 20));
    assert!(peak_memory_bytes().unwrap() >= 256 << 20);
    // Sandboxes may forbid to count anew; then there has to be no number rather than a wrong one.
    if std::fs::write("/proc/self/clear_refs", "5").is_ok() {
        let (large, small) = (large.unwrap(), small.unwrap());
        assert!(large >= 256 << 20 && small < 128 << 20, "{small} {large}");
    } else {
        assert_eq!((large, small), (None, None));
    }
}
