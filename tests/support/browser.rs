//! Pages in a real browser, without a window.

use std::path::Path;
use std::process::{Command, Stdio};
use std::time::{Duration, Instant};

/// A browser of this machine; without one the test is skipped.
pub fn find() -> Option<&'static str> {
    let names = ["chromium", "chromium-browser", "google-chrome"];
    let starts = |name: &&str| Command::new(name).arg("--version").output().is_ok();
    let found = names.into_iter().find(starts);
    if found.is_none() {
        super::skip::skip(&format!("needs a browser: one of {}", names.join(", ")));
    }
    found
}

/// The page as its scripts leave it, with WebGL in software. `address` is a path with what may
/// follow it; `dir` is for the browser's own files.
pub fn dom(browser: &str, address: &str, dir: &Path) -> String {
    let mut child = Command::new(browser)
        .args([
            "--headless",
            "--no-sandbox",
            "--disable-quic",
            "--no-first-run",
        ])
        // There is no other way to software since Chrome 144, and `--disable-gpu` takes it away.
        .args([
            "--use-gl=angle",
            "--use-angle=swiftshader",
            "--enable-unsafe-swiftshader",
        ])
        .args([
            "--disable-background-networking",
            "--disable-component-update",
            "--disable-sync",
        ])
        .arg(format!("--user-data-dir={}", dir.join("profile").display()))
        .args([
            "--window-size=800,600",
            "--virtual-time-budget=20000",
            "--dump-dom",
        ])
        .arg(format!("file://{address}"))
        .stdout(Stdio::piped())
        .stderr(Stdio::null())
        .spawn()
        .unwrap();
    let mut stdout = child.stdout.take().unwrap();
    let reader =
        std::thread::spawn(move || std::io::read_to_string(&mut stdout).unwrap_or_default());
    let started = Instant::now();
    while child.try_wait().unwrap().is_none() {
        if started.elapsed() > Duration::from_secs(240) {
            child.kill().unwrap();
            panic!("the browser took more than four minutes");
        }
        std::thread::sleep(Duration::from_millis(20));
    }
    reader.join().unwrap()
}
