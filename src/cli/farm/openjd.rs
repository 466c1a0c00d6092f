//! A job as a template of Open Job Description.

use super::plan::{Axis, Plan, Step, Task, shell};
use crate::{Error, Result};
use serde_json::{Value, json};

/// What the script of a task is given beside itself, as words of its own: text of a parameter
/// within the script would be read as shell, quotes in it included.
const ARGUMENTS: [&str; 2] = ["{{Param.Folder}}", "{{Param.Lvox}}"];
/// How a script begins.
const START: &str = "set -e\ncd \"$1\"\nlvox=$2\n";

/// The template, as JSON.
///
/// # Errors
/// A word that no shell can be told.
pub fn text(plan: &Plan) -> Result<String> {
    let steps = plan.steps();
    let of_steps = |i: usize| step(plan, steps[i], i.checked_sub(1).map(|before| steps[before]));
    let steps: Vec<Value> = (0..steps.len()).map(of_steps).collect::<Result<_>>()?;
    let mut parameters = vec![
        json!({
            "name": "Lvox", "type": "STRING", "default": plan.program,
            "description": "The program, as the machines of the farm call it",
        }),
        json!({
            "name": "Folder", "type": "PATH", "objectType": "DIRECTORY", "dataFlow": "INOUT", "default": ".",
            "description": "The folder that names of files are relative to, \
                            which all machines share",
        }),
    ];
    if let Some(frames) = &plan.frames {
        parameters.push(json!({
            "name": "Frames", "type": "STRING", "default": frames.to_string().replace('x', ":"),
            "description": "Numbers of frames",
        }));
    }
    let mut template = json!({
        "specificationVersion": "jobtemplate-2023-09",
        "name": plan.name.chars().filter(|c| !c.is_control()).take(64).collect::<String>(),
        "parameterDefinitions": parameters,
        "steps": steps,
    });
    if plan
        .steps()
        .iter()
        .any(|s| plan.axes(*s).contains(&Axis::Chunk))
    {
        template["extensions"] = json!(["TASK_CHUNKING"]);
    }
    let text = serde_json::to_string_pretty(&template)
        .map_err(|e| Error::failed(format!("cannot encode the template: {e}")))?;
    Ok(text + "\n")
}

fn title(step: Step) -> String {
    let name = step.name();
    name[..1].to_uppercase() + &name[1..]
}

fn step(plan: &Plan, step: Step, before: Option<Step>) -> Result<Value> {
    let axes = plan.axes(step);
    let last = |axis: Axis| plan.values(axis).len().saturating_sub(1);
    let definition = |axis: &Axis| match axis {
        Axis::Frame => json!({"name": "Frame", "type": "INT", "range": "{{Param.Frames}}"}),
        Axis::Chunk => json!({
            "name": "Frame", "type": "CHUNK[INT]", "range": "{{Param.Frames}}",
            "chunks": {"defaultTaskCount": plan.chunk, "rangeConstraint": "NONCONTIGUOUS"},
        }),
        Axis::Part => json!({"name": "Part", "type": "INT", "range": format!("0-{}", last(*axis))}),
        Axis::Camera => json!({"name": "Camera", "type": "STRING", "range": plan.values(*axis)}),
        Axis::Tile => json!({"name": "Tile", "type": "INT", "range": format!("0-{}", last(*axis))}),
    };
    let has = |axis: Axis| axes.contains(&axis);
    let place = |is_there: bool, name: &str| match is_there {
        true => format!("{{{{Task.Param.{name}}}}}"),
        false => String::new(),
    };
    let task = Task {
        frames: place(has(Axis::Frame) || has(Axis::Chunk), "Frame"),
        part: place(has(Axis::Part), "Part"),
        camera: place(has(Axis::Camera), "Camera"),
        tile: place(has(Axis::Tile), "Tile"),
    };
    let mut script = START.to_owned();
    for command in plan.commands(step, &task) {
        script += &match command.split_first() {
            Some((program, rest)) if *program == plan.program => {
                format!("\"$lvox\" {}", shell(&[rest.to_vec()])?)
            }
            _ => shell(&[command])?,
        };
        script.push('\n');
    }
    let arguments = ["{{Task.File.Run}}"].into_iter().chain(ARGUMENTS);
    let mut value = json!({
        "name": title(step),
        "script": {
            "actions": {"onRun": {"command": "bash", "args": arguments.collect::<Vec<_>>()}},
            "embeddedFiles": [{"name": "Run", "type": "TEXT", "data": script}],
        },
    });
    if !axes.is_empty() {
        let definitions: Vec<Value> = axes.iter().map(definition).collect();
        value["parameterSpace"] = json!({"taskParameterDefinitions": definitions});
    }
    if let Some(before) = before {
        value["dependencies"] = json!([{"dependsOn": title(before)}]);
    }
    Ok(value)
}
