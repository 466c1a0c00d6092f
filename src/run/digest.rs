//! The digest of the program that runs.

use std::fs::File;
use std::sync::OnceLock;

/// A digest of the executable that runs: times and images of different builds have different ones.
/// Where the system does not tell which file runs, it is a digest of the version alone.
#[must_use]
pub fn of_program() -> [u8; 32] {
    static DIGEST: OnceLock<[u8; 32]> = OnceLock::new();
    *DIGEST.get_or_init(|| {
        let mut hasher = blake3::Hasher::new();
        let read = std::env::current_exe()
            .and_then(File::open)
            .and_then(|file| hasher.update_reader(file).map(drop));
        if read.is_err() {
            hasher.reset().update(env!("CARGO_PKG_VERSION").as_bytes());
        }
        *hasher.finalize().as_bytes()
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn it_is_that_of_the_running_file() {
        let bytes = std::fs::read(std::env::current_exe().unwrap()).unwrap();
        assert_eq!(of_program(), *blake3::hash(&bytes).as_bytes());
    }
}
