//! Whether the processor runs what the program was compiled for: x86-64-v3, unless built otherwise.
//!
//! This goes before all else. `is_x86_feature_detected!` is of no use: where a feature is compiled
//! in, it says yes without looking.

/// Ends the program, with one line, where the processor would end it without a word.
pub fn check() {
    #[cfg(all(target_os = "linux", target_arch = "x86_64", target_feature = "avx2"))]
    if !x86::is_v3() {
        x86::refuse();
    }
}

#[cfg(all(target_os = "linux", target_arch = "x86_64", target_feature = "avx2"))]
mod x86 {
    use core::arch::x86_64::{__cpuid, __cpuid_count, _xgetbv};

    /// FMA, CMPXCHG16B, SSE4.2, MOVBE, POPCNT, OSXSAVE, AVX, F16C of leaf 1.
    const LEAF_1: u32 =
        1 << 12 | 1 << 13 | 1 << 20 | 1 << 22 | 1 << 23 | 1 << 27 | 1 << 28 | 1 << 29;
    /// BMI1, AVX2, BMI2 of leaf 7.
    const LEAF_7: u32 = 1 << 3 | 1 << 5 | 1 << 8;
    /// LZCNT of the first leaf of AMD's.
    const LEAF_AMD: u32 = 1 << 5;
    /// Registers that the system keeps for each process: those of SSE and of AVX.
    const KEPT: u64 = 0b110;

    /// Whether all is there that x86-64-v3 has, and the system lets programs use it.
    pub fn is_v3() -> bool {
        const AMD: u32 = 0x8000_0000;
        // SAFETY: every processor of this architecture has `cpuid`, and tells which leaves it has.
        // `xgetbv` is there where the processor says that the system has turned it on, OSXSAVE.
        #[allow(unsafe_code, unused_unsafe)]
        unsafe {
            let has_leaves = __cpuid(0).eax >= 7 && __cpuid(AMD).eax > AMD;
            has_leaves
                && __cpuid(1).ecx & LEAF_1 == LEAF_1
                && __cpuid_count(7, 0).ebx & LEAF_7 == LEAF_7
                && __cpuid(AMD | 1).ecx & LEAF_AMD == LEAF_AMD
                && _xgetbv(0) & KEPT == KEPT
        }
    }

    /// Says so without any code that was compiled for such processors, and ends.
    #[cold]
    pub fn refuse() -> ! {
        const WORDS: &[u8] =
            b"error: this program was built for x86-64-v3: processors with AVX2, FMA and BMI2, \
              which this one lacks\n\
              hint: build it with `RUSTFLAGS=` (empty); results are the same\n";
        // SAFETY: these are calls of the system, and the bytes are there for good.
        #[allow(unsafe_code)]
        unsafe {
            libc::write(2, WORDS.as_ptr().cast(), WORDS.len());
            libc::_exit(2);
        }
    }
}
