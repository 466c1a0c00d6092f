//! A job as one command a line.

use super::plan::{Plan, Step, shell};
use crate::{Error, Result};

/// The commands of a job, or of one step of it.
///
/// # Errors
/// A step that the job does not have.
pub fn text(plan: &Plan, step: Option<Step>) -> Result<String> {
    let steps = plan.steps();
    if let Some(step) = step
        && !steps.contains(&step)
    {
        let names: Vec<_> = steps.iter().map(|step| step.name()).collect();
        return Err(Error::input(format!(
            "expected a step of the job, found --step {}",
            step.name()
        ))
        .hint(format!("its steps are {}", names.join(", "))));
    }
    let mut text = String::new();
    for &step in steps.iter().filter(|s| step.is_none_or(|step| step == **s)) {
        for task in plan.tasks(step, None) {
            text += &shell(&plan.commands(step, &task))?;
            text.push('\n');
        }
    }
    Ok(text)
}
