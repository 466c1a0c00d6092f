//! Progress on stderr: a bar on a terminal, lines otherwise.

use indicatif::{MultiProgress, ProgressBar, ProgressStyle};
use std::io::Write;
use std::sync::atomic::{AtomicU64, Ordering};
use std::sync::{Mutex, PoisonError};
use std::time::{Duration, Instant};

/// Time between two lines about a task.
const INTERVAL: Duration = Duration::from_secs(2);

/// How progress is shown.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum ProgressMode {
    /// Nothing.
    #[default]
    None,
    /// One line when a task starts, every few seconds, and when it ends.
    Plain,
    /// A bar with rate and time left.
    Bar,
    /// One JSON object a line, for the same events as `Plain`.
    Json,
}

/// Makes tasks that report how far they are.
#[derive(Debug, Default)]
pub struct Progress {
    mode: ProgressMode,
    bars: Option<MultiProgress>,
    warnings: Mutex<Vec<String>>,
}

/// A piece of work with a known total; finished when dropped.
#[derive(Debug)]
pub struct Task {
    mode: ProgressMode,
    name: &'static str,
    unit: &'static str,
    total: u64,
    done: AtomicU64,
    started: Instant,
    /// Milliseconds from the start to the next line.
    next_line_millis: AtomicU64,
    bar: Option<ProgressBar>,
}

impl Progress {
    /// Progress in the given mode.
    #[must_use]
    pub fn new(mode: ProgressMode) -> Self {
        Self {
            mode,
            bars: (mode == ProgressMode::Bar).then(MultiProgress::new),
            ..Self::default()
        }
    }

    /// Starts a task of `total` units (0 for unknown); may be used from many threads.
    #[must_use]
    pub fn task(&self, name: &'static str, total: u64, unit: &'static str) -> Task {
        let bar = self.bars.as_ref().map(|bars| {
            let bar = bars.add(ProgressBar::new(total));
            if total == 0 {
                bar.set_length(u64::MAX);
            }
            bar.set_style(style(total > 0, unit));
            bar.set_prefix(name);
            bar.enable_steady_tick(Duration::from_millis(200));
            bar
        });
        let task = Task {
            mode: self.mode,
            name,
            unit,
            total,
            done: AtomicU64::new(0),
            started: Instant::now(),
            next_line_millis: AtomicU64::new(millis(INTERVAL)),
            bar,
        };
        task.line(Event::Start, 0, 0.0);
        task
    }

    /// Says something that is not progress; nothing in mode `None`.
    pub fn say(&self, message: &str) {
        if self.mode != ProgressMode::None {
            self.print("message", message, message);
        }
    }

    /// Warns, in every mode.
    pub fn warn(&self, message: &str) {
        self.print("warning", message, &format!("warning: {message}"));
        let mut warnings = self.warnings.lock().unwrap_or_else(PoisonError::into_inner);
        warnings.push(message.into());
    }

    /// What was warned of so far.
    #[must_use]
    pub fn warnings(&self) -> Vec<String> {
        let warnings = self.warnings.lock().unwrap_or_else(PoisonError::into_inner);
        warnings.clone()
    }

    fn print(&self, event: &str, message: &str, line: &str) {
        match (&self.bars, self.mode) {
            (Some(bars), _) if !bars.is_hidden() => {
                let _ = bars.println(line);
            }
            (_, ProgressMode::Json) => {
                stderr_line(&serde_json::json!({"event": event, "message": message}).to_string())
            }
            _ => stderr_line(line),
        }
    }
}

#[derive(Clone, Copy, PartialEq, Eq)]
enum Event {
    Start,
    Progress,
    End,
}

impl Task {
    /// `units` more are done. Cheap, but meant for a row or a page and not for every sample.
    pub fn add(&self, units: u64) {
        if let Some(bar) = &self.bar {
            bar.inc(units);
            return;
        }
        if self.mode == ProgressMode::None {
            return;
        }
        let done = self.done.fetch_add(units, Ordering::Relaxed) + units;
        let elapsed = self.started.elapsed();
        let due = self.next_line_millis.load(Ordering::Relaxed);
        if millis(elapsed) < due {
            return;
        }
        // Of the threads that see the time has come one prints.
        let next = millis(elapsed + INTERVAL);
        let order = Ordering::Relaxed;
        if self
            .next_line_millis
            .compare_exchange(due, next, order, order)
            .is_ok()
        {
            self.line(Event::Progress, done, elapsed.as_secs_f64());
        }
    }

    fn line(&self, event: Event, done: u64, secs: f64) {
        match self.mode {
            ProgressMode::None | ProgressMode::Bar => {}
            ProgressMode::Plain => stderr_line(&self.plain(event, done, secs)),
            ProgressMode::Json => stderr_line(&self.json(event, done, secs)),
        }
    }

    fn plain(&self, event: Event, done: u64, secs: f64) -> String {
        let (name, unit, total) = (self.name, self.unit, self.total);
        let rate = rate(done, secs);
        let speed = rate.map_or(String::new(), |r| format!(", {} {unit}/s", scaled(r)));
        match event {
            Event::Start if total > 0 => format!("{name}: {total} {unit}"),
            Event::Start => format!("{name}: started"),
            Event::Progress if total > 0 => {
                let percent = 100.0 * done as f64 / total as f64;
                let left = rate.map_or(String::new(), |r| {
                    format!(", {} left", duration(total.saturating_sub(done) as f64 / r))
                });
                format!("{name}: {done}/{total} {unit} ({percent:.0} %){speed}{left}")
            }
            Event::Progress => format!("{name}: {done} {unit}{speed}"),
            Event::End if done < total => {
                format!(
                    "{name}: stopped at {done}/{total} {unit} after {}",
                    duration(secs)
                )
            }
            Event::End => format!("{name}: {done} {unit} in {}{speed}", duration(secs)),
        }
    }

    fn json(&self, event: Event, done: u64, secs: f64) -> String {
        let event = match event {
            Event::Start => "start",
            Event::Progress => "progress",
            Event::End => "end",
        };
        serde_json::json!({
            "event": event,
            "task": self.name,
            "done": done,
            "total": (self.total > 0).then_some(self.total),
            "unit": self.unit,
            "secs": (secs * 1e3).round() / 1e3,
        })
        .to_string()
    }
}

impl Drop for Task {
    fn drop(&mut self) {
        if let Some(bar) = &self.bar {
            // What was reached stays on the screen.
            if bar.position() >= self.total {
                bar.finish();
            } else {
                bar.abandon();
            }
        }
        let done = *self.done.get_mut();
        self.line(Event::End, done, self.started.elapsed().as_secs_f64());
    }
}

fn style(known_total: bool, unit: &str) -> ProgressStyle {
    let template = if known_total {
        format!(
            "{{prefix:>8}} [{{wide_bar:.cyan/blue}}] {{human_pos}}/{{human_len}} {unit} {{per_sec}} {{eta}} left"
        )
    } else {
        format!("{{prefix:>8}} {{spinner}} {{human_pos}} {unit} {{per_sec}} {{elapsed}}")
    };
    ProgressStyle::with_template(&template)
        .unwrap_or_else(|_| ProgressStyle::default_bar())
        .progress_chars("=> ")
}

/// Units a second, once there is something to go by.
fn rate(done: u64, secs: f64) -> Option<f64> {
    (done > 0 && secs > 0.0).then(|| done as f64 / secs)
}

fn scaled(value: f64) -> String {
    let units = [(1e9, " G"), (1e6, " M"), (1e3, " k")];
    match units.iter().find(|(size, _)| value >= *size) {
        Some((size, name)) => format!("{:.1}{name}", value / size),
        None if value >= 10.0 => format!("{value:.0}"),
        None => format!("{value:.2}"),
    }
}

fn duration(secs: f64) -> String {
    if secs < 10.0 {
        return format!("{secs:.1} s");
    }
    let whole = secs.round() as u64;
    match (whole / 3600, whole / 60 % 60, whole % 60) {
        (0, 0, s) => format!("{s} s"),
        (0, m, s) => format!("{m} min {s} s"),
        (h, m, _) => format!("{h} h {m} min"),
    }
}

fn millis(duration: Duration) -> u64 {
    u64::try_from(duration.as_millis()).unwrap_or(u64::MAX)
}

/// A closed stderr is no reason to stop.
fn stderr_line(line: &str) {
    let _ = writeln!(std::io::stderr().lock(), "{line}");
}

#[cfg(test)]
mod tests {
    use super::*;

    fn quiet(total: u64) -> Task {
        Progress::default().task("bake", total, "points")
    }

    #[test]
    fn plain_lines_say_how_far_and_how_long() {
        let task = quiet(4_000_000);
        assert_eq!(task.plain(Event::Start, 0, 0.0), "bake: 4000000 points");
        assert_eq!(
            task.plain(Event::Progress, 1_000_000, 2.0),
            "bake: 1000000/4000000 points (25 %), 500.0 k points/s, 6.0 s left"
        );
        assert_eq!(
            task.plain(Event::End, 4_000_000, 100.0),
            "bake: 4000000 points in 1 min 40 s, 40.0 k points/s"
        );
        assert_eq!(
            task.plain(Event::End, 5, 7300.0),
            "bake: stopped at 5/4000000 points after 2 h 1 min"
        );
        assert_eq!(
            quiet(0).plain(Event::Progress, 30, 2.0),
            "bake: 30 points, 15 points/s"
        );
    }

    #[test]
    fn json_lines_parse() {
        let line = quiet(10).json(Event::Progress, 4, 0.12345);
        let json: serde_json::Value = serde_json::from_str(&line).unwrap();
        assert_eq!(json["task"], "bake");
        assert_eq!(json["done"], 4);
        assert_eq!(json["secs"], 0.123);
        let line = quiet(0).json(Event::Start, 0, 0.0);
        assert!(line.contains("\"total\":null"));
    }

    #[test]
    fn counting_is_exact_across_threads() {
        let progress = Progress::new(ProgressMode::Json);
        let task = progress.task("count", 8000, "units");
        std::thread::scope(|scope| {
            for _ in 0..8 {
                scope.spawn(|| (0..1000).for_each(|_| task.add(1)));
            }
        });
        assert_eq!(task.done.load(Ordering::Relaxed), 8000);
    }

    #[test]
    fn bars_count_without_a_terminal() {
        let progress = Progress::new(ProgressMode::Bar);
        for total in [0, 3] {
            let task = progress.task("bar", total, "points");
            task.add(3);
            assert_eq!(task.bar.as_ref().map(ProgressBar::position), Some(3));
        }
    }
}
