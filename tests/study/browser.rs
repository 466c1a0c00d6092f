//! What a browser shows of a report.

use super::*;

/// Counts what a browser sees of a report, once all of it is loaded.
const PROBE: &str = r#"<script>
addEventListener("load", () => {
  const all = q => [...document.querySelectorAll(q)];
  const shown = e => { const r = e.getBoundingClientRect(); return r.width > 40 && r.height > 8; };
  let collisions = [];
  for (const svg of all("svg")) {
    const texts = [...svg.querySelectorAll("text")].filter(t => t.textContent.trim());
    const boxes = texts.map(t => t.getBoundingClientRect());
    for (let i = 0; i < boxes.length; i++) for (let j = 0; j < i; j++) {
      const [a, b] = [boxes[i], boxes[j]];
      if (Math.min(a.right, b.right) - Math.max(a.left, b.left) > 1
          && Math.min(a.bottom, b.bottom) - Math.max(a.top, b.top) > 3)
        collisions.push(texts[i].textContent.trim() + " on " + texts[j].textContent.trim());
    }
  }
  const images = all("img");
  document.body.setAttribute("data-found", [
    "images " + images.length,
    "loaded " + images.filter(i => i.complete && i.naturalWidth > 0 && shown(i)).length,
    "heat " + all(".pair img:nth-child(2)").length,
    "plots " + all("svg").filter(shown).length,
    "rows " + all("tr").filter(shown).length,
    "collisions " + collisions.length + ": " + collisions.join(", "),
  ].join("; "));
});
</script>"#;

#[test]
fn a_browser_shows_all_of_the_report() {
    let names = ["chromium", "chromium-browser", "google-chrome"];
    let starts = |name: &&str| Command::new(name).arg("--version").output().is_ok();
    let Some(browser) = names.into_iter().find(starts) else {
        support::skip::skip(&format!("needs a browser: one of {}", names.join(", ")));
        return;
    };
    let dir = tempfile::tempdir().unwrap();
    let folder = dir.path().join("study");
    let output = study(&folder, &["--rounds", "1"]);
    assert!(output.status.success(), "{}", text(&output.stderr));
    let report = fs::read_to_string(folder.join("report.html")).unwrap();
    let page = dir.path().join("probed.html");
    fs::write(&page, report.replace("</body>", &format!("{PROBE}</body>"))).unwrap();
    let child = browse(browser, &page, dir.path());
    let dom = wait(child, Duration::from_secs(120));
    let found = dom
        .split("data-found=\"")
        .nth(1)
        .and_then(|rest| rest.split('"').next());
    let found = found.unwrap_or_else(|| panic!("the report did not load: {dom:.2000}"));
    // The reference, 3 of Monte Carlo and both bases; all but the reference with a heat map.
    let parts: Vec<&str> = found.split("; ").collect();
    assert_eq!(
        parts[..4],
        ["images 11", "loaded 11", "heat 5", "plots 6"],
        "{found}"
    );
    let rows: usize = parts[4].strip_prefix("rows ").unwrap().parse().unwrap();
    // How many are in front of all others depends on times.
    assert!(rows > 12, "{found}");
    assert_eq!(parts[5], "collisions 0: ", "{found}");
}

fn browse(name: &str, page: &Path, dir: &Path) -> Child {
    Command::new(name)
        .args([
            "--headless",
            "--no-sandbox",
            "--disable-gpu",
            "--disable-quic",
            "--no-first-run",
        ])
        .args([
            "--disable-background-networking",
            "--disable-component-update",
            "--disable-sync",
        ])
        .arg(format!("--user-data-dir={}", dir.join("profile").display()))
        .args(["--window-size=1200,3000", "--dump-dom"])
        .arg(format!("file://{}", page.display()))
        .stdout(Stdio::piped())
        .stderr(Stdio::null())
        .spawn()
        .unwrap()
}

/// What a child prints; it is killed if it takes too long.
fn wait(mut child: Child, limit: Duration) -> String {
    let mut stdout = child.stdout.take().unwrap();
    let reader =
        std::thread::spawn(move || std::io::read_to_string(&mut stdout).unwrap_or_default());
    let started = Instant::now();
    while child.try_wait().unwrap().is_none() {
        if started.elapsed() > limit {
            child.kill().unwrap();
            panic!("the browser took more than {limit:?}");
        }
        std::thread::sleep(Duration::from_millis(20));
    }
    reader.join().unwrap()
}
