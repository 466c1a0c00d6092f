//! What stages took, told on stderr.

use super::options::Context;

/// Says what the last stage of a frame took, and what it took with those before it that are named;
/// nothing of stages that did not run.
pub fn say(context: &Context, last: &str, before: &[&str]) {
    let job = &context.job;
    let stages = job.report.stages().split_off(context.first_stage);
    let secs = |name: &str| {
        let of_name = stages.iter().filter(|s| s.stage == name);
        of_name.map(|s| s.cpu_secs).reduce(|a, b| a + b)
    };
    let Some(own) = secs(last) else { return };
    let found: Vec<(&str, f64)> = before
        .iter()
        .filter_map(|name| Some((*name, secs(name)?)))
        .collect();
    let mut text = format!("{last} {own:.1} CPU s");
    if let Some(((last, _), rest)) = found.split_last() {
        let rest: Vec<&str> = rest.iter().map(|f| f.0).collect();
        let names = match &rest[..] {
            [] => (*last).to_owned(),
            _ => format!("{} and {last}", rest.join(", ")),
        };
        let total = own + found.iter().map(|f| f.1).sum::<f64>();
        text += &format!("; with {names} {total:.1}");
    }
    job.progress.say(&text);
}
