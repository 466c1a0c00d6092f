//! What the process has taken from the machine so far.

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

/// Largest resident size in bytes; `None` where the system does not tell.
#[must_use]
pub fn peak_memory_bytes() -> Option<u64> {
    let status = std::fs::read_to_string("/proc/self/status").ok()?;
    let line = status.lines().find_map(|l| l.strip_prefix("VmHWM:"))?;
    let kib: u64 = line.trim().strip_suffix("kB")?.trim().parse().ok()?;
    kib.checked_mul(1024)
}

#[cfg(test)]
mod tests {
    use super::*;

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
