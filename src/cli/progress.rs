//! Progress on stderr: a bar on a terminal, lines otherwise.

use super::output::with_options;
use crate::run::{Observer, Progress, TaskObserver};
use indicatif::{MultiProgress, ProgressBar, ProgressState, ProgressStyle};
use std::io::{IsTerminal, Write};
use std::sync::atomic::{AtomicU64, Ordering};
use std::time::{Duration, Instant};

/// Time between two lines about a task.
const INTERVAL: Duration = Duration::from_secs(2);

/// How progress is shown, as typed.
#[derive(Clone, Copy, Debug, PartialEq, Eq, clap::ValueEnum)]
pub enum Mode {
    /// A bar on a terminal and plain lines elsewhere
    Auto,
    /// One line when a task starts, every two seconds, and when it ends
    Plain,
    /// One JSON object a line, for the same events
    Json,
    /// Lines that agents of Open Job Description read: openjd_progress, openjd_status
    Openjd,
    /// Lines with a time and "% done", of which OpenCue tells what is left
    Opencue,
    /// Only warnings and errors
    None,
}

impl Mode {
    /// Progress that is shown so.
    pub fn progress(self) -> Progress {
        match self {
            Self::Auto if std::io::stderr().is_terminal() => Progress::new(Bars::default()),
            Self::Auto | Self::Plain => Progress::new(Lines::Plain),
            Self::Json => Progress::new(Lines::Json),
            Self::Openjd => Progress::new(Lines::Openjd),
            Self::Opencue => Progress::new(Lines::Opencue),
            Self::None => Progress::new(WarningsOnly),
        }
    }
}

/// Shows no progress and no messages.
struct WarningsOnly;

impl Observer for WarningsOnly {
    fn task(&self, _: &'static str, _: u64, _: &'static str) -> Box<dyn TaskObserver> {
        Box::new(Self)
    }

    fn message(&self, _: &str) {}

    fn warning(&self, text: &str) {
        stderr_line(&format!("warning: {}", with_options(text)));
    }
}

impl TaskObserver for WarningsOnly {
    fn add(&self, _: u64) {}
}

/// A bar for each task, with rate and time left.
#[derive(Default)]
struct Bars(MultiProgress);

struct Bar {
    bar: ProgressBar,
    total: u64,
}

impl Bars {
    fn begin(&self, name: &'static str, total: u64, unit: &str) -> Bar {
        let length = if total == 0 { u64::MAX } else { total };
        let bar = self.0.add(ProgressBar::new(length));
        bar.set_style(style(total > 0, unit));
        bar.set_prefix(name);
        bar.enable_steady_tick(Duration::from_millis(200));
        Bar { bar, total }
    }

    fn print(&self, line: &str) {
        if self.0.is_hidden() {
            stderr_line(line);
        } else {
            let _ = self.0.println(line);
        }
    }
}

impl Observer for Bars {
    fn task(&self, name: &'static str, total: u64, unit: &'static str) -> Box<dyn TaskObserver> {
        Box::new(self.begin(name, total, unit))
    }

    fn message(&self, text: &str) {
        self.print(text);
    }

    fn warning(&self, text: &str) {
        self.print(&format!("warning: {}", with_options(text)));
    }
}

impl TaskObserver for Bar {
    fn add(&self, units: u64) {
        self.bar.inc(units);
    }
}

impl Drop for Bar {
    fn drop(&mut self) {
        // What was reached stays on the screen.
        if self.bar.position() >= self.total {
            self.bar.finish();
        } else {
            self.bar.abandon();
        }
    }
}

/// A line for each event.
#[derive(Clone, Copy)]
enum Lines {
    Plain,
    Json,
    Openjd,
    Opencue,
}

#[derive(Clone, Copy, PartialEq, Eq)]
enum Event {
    Start,
    Progress,
    End,
}

struct TaskLines {
    lines: Lines,
    name: &'static str,
    unit: &'static str,
    total: u64,
    done: AtomicU64,
    started: Instant,
    /// Milliseconds from the start to the next line.
    next_line_millis: AtomicU64,
}

impl Lines {
    fn begin(self, name: &'static str, total: u64, unit: &'static str) -> TaskLines {
        TaskLines {
            lines: self,
            name,
            unit,
            total,
            done: AtomicU64::new(0),
            started: Instant::now(),
            next_line_millis: AtomicU64::new(millis(INTERVAL)),
        }
    }

    fn print(self, event: &str, message: &str, plain: &str) {
        match self {
            Self::Plain | Self::Openjd | Self::Opencue => stderr_line(plain),
            Self::Json => {
                stderr_line(&serde_json::json!({"event": event, "message": message}).to_string());
            }
        }
    }
}

impl Observer for Lines {
    fn task(&self, name: &'static str, total: u64, unit: &'static str) -> Box<dyn TaskObserver> {
        let task = self.begin(name, total, unit);
        task.print(Event::Start, 0, 0.0);
        Box::new(task)
    }

    fn message(&self, text: &str) {
        self.print("message", text, text);
    }

    fn warning(&self, text: &str) {
        let text = with_options(text);
        self.print("warning", &text, &format!("warning: {text}"));
    }
}

impl TaskObserver for TaskLines {
    fn add(&self, units: u64) {
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
            self.print(Event::Progress, done, elapsed.as_secs_f64());
        }
    }
}

impl Drop for TaskLines {
    fn drop(&mut self) {
        let done = *self.done.get_mut();
        self.print(Event::End, done, self.started.elapsed().as_secs_f64());
    }
}

impl TaskLines {
    fn print(&self, event: Event, done: u64, secs: f64) {
        stderr_line(&match self.lines {
            Lines::Plain => self.plain(event, done, secs),
            Lines::Json => self.json(event, done, secs),
            Lines::Openjd => self.openjd(event, done),
            Lines::Opencue => self.opencue(done, secs),
        });
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

    /// How much is done, in per cent; nothing of what has no known end.
    fn percent(&self, done: u64) -> f64 {
        match self.total {
            0 => 0.0,
            total => 100.0 * (done.min(total) as f64 / total as f64),
        }
    }

    fn openjd(&self, event: Event, done: u64) -> String {
        match event {
            Event::Start => format!("openjd_status: {}", self.name),
            Event::Progress | Event::End => format!("openjd_progress: {:.1}", self.percent(done)),
        }
    }

    fn opencue(&self, done: u64, secs: f64) -> String {
        let secs = secs as u64;
        let (hours, minutes, secs) = (secs / 3600, secs / 60 % 60, secs % 60);
        let percent = self.percent(done);
        format!(
            "{hours:02}:{minutes:02}:{secs:02} {percent:3.0}% done - {}",
            self.name
        )
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

fn style(known_total: bool, unit: &str) -> ProgressStyle {
    let template = if known_total {
        format!(
            "{{prefix:>8}} [{{wide_bar:.cyan/blue}}] {{human_pos}}/{{human_len}} {unit} \
             {{rate}} {{eta}} left"
        )
    } else {
        format!("{{prefix:>8}} {{spinner}} {{human_pos}} {unit} {{rate}} {{elapsed}}")
    };
    ProgressStyle::with_template(&template)
        .unwrap_or_else(|_| ProgressStyle::default_bar())
        .with_key(
            "rate",
            |state: &ProgressState, out: &mut dyn std::fmt::Write| {
                let _ = write!(out, "{}/s", scaled(state.per_sec()));
            },
        )
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

    fn task(total: u64) -> TaskLines {
        Lines::Json.begin("bake", total, "points")
    }

    #[test]
    fn plain_lines_say_how_far_and_how_long() {
        let whole = task(4_000_000);
        assert_eq!(whole.plain(Event::Start, 0, 0.0), "bake: 4000000 points");
        assert_eq!(
            whole.plain(Event::Progress, 1_000_000, 2.0),
            "bake: 1000000/4000000 points (25 %), 500.0 k points/s, 6.0 s left"
        );
        assert_eq!(
            whole.plain(Event::End, 4_000_000, 100.0),
            "bake: 4000000 points in 1 min 40 s, 40.0 k points/s"
        );
        assert_eq!(
            whole.plain(Event::End, 5, 7300.0),
            "bake: stopped at 5/4000000 points after 2 h 1 min"
        );
        assert_eq!(
            task(0).plain(Event::Progress, 30, 2.0),
            "bake: 30 points, 15 points/s"
        );
    }

    #[test]
    fn schedulers_read_how_much_is_done() {
        let whole = task(8);
        assert_eq!(whole.openjd(Event::Start, 0), "openjd_status: bake");
        assert_eq!(whole.openjd(Event::Progress, 3), "openjd_progress: 37.5");
        assert_eq!(whole.opencue(4, 3723.5), "01:02:03  50% done - bake");
        assert_eq!(task(0).openjd(Event::End, 9), "openjd_progress: 0.0");
    }

    #[test]
    fn json_lines_parse() {
        let line = task(10).json(Event::Progress, 4, 0.12345);
        let json: serde_json::Value = serde_json::from_str(&line).unwrap();
        assert_eq!(json["task"], "bake");
        assert_eq!(json["done"], 4);
        assert_eq!(json["secs"], 0.123);
        let line = task(0).json(Event::Start, 0, 0.0);
        assert!(line.contains("\"total\":null"));
    }

    #[test]
    fn counting_is_exact_across_threads() {
        let task = task(8000);
        std::thread::scope(|scope| {
            for _ in 0..8 {
                scope.spawn(|| (0..1000).for_each(|_| task.add(1)));
            }
        });
        assert_eq!(task.done.load(Ordering::Relaxed), 8000);
    }

    #[test]
    fn bars_count_without_a_terminal() {
        let bars = Bars::default();
        for total in [0, 3] {
            let task = bars.begin("bar", total, "points");
            task.add(3);
            assert_eq!(task.bar.position(), 3);
        }
    }
}
