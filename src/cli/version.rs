//! What this program is, for reports of faults.

use crate::formats::VERSION;
use crate::run::memory;
use std::sync::LazyLock;

/// The number of the version, the commit, what it was built for, and what it runs on.
pub static LONG: LazyLock<String> = LazyLock::new(|| {
    let commit = match env!("LVOX_COMMIT") {
        "" => "unknown",
        known => known,
    };
    let threads = std::thread::available_parallelism().map_or(1, usize::from);
    let memory = memory::available().map_or_else(String::new, |bytes| {
        format!(
            ", {:.1} GiB of memory that is free",
            bytes as f64 / f64::from(1 << 30)
        )
    });
    format!(
        "{}\ncommit {commit}\nbuilt for {}, {}\nruns on {threads} threads{memory}{}\n\
         reads and writes clouds, trees, scattered light and packed scenes of format {VERSION}",
        env!("CARGO_PKG_VERSION"),
        env!("LVOX_TARGET"),
        built_for(),
        features(),
    )
});

/// The least processor that runs it.
fn built_for() -> &'static str {
    match () {
        () if cfg!(not(target_arch = "x86_64")) => "any processor of it",
        () if cfg!(all(target_feature = "avx2", target_feature = "fma")) => {
            "x86-64-v3 (AVX2, FMA, BMI2)"
        }
        () => "any x86-64",
    }
}

/// What this processor has of what makes kernels faster.
fn features() -> String {
    #[cfg(target_arch = "x86_64")]
    {
        let has = [
            ("SSE4.2", is_x86_feature_detected!("sse4.2")),
            ("AVX2", is_x86_feature_detected!("avx2")),
            ("FMA", is_x86_feature_detected!("fma")),
            ("AVX-512", is_x86_feature_detected!("avx512f")),
        ];
        let names: Vec<&str> = has.iter().filter(|h| h.1).map(|h| h.0).collect();
        format!(", with {}", names.join(", "))
    }
    #[cfg(not(target_arch = "x86_64"))]
    String::new()
}
