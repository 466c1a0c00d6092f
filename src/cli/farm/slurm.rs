//! A job as a script that submits job arrays to Slurm.

use super::plan::{Axis, Plan, Step, Words, shell};
use crate::run::Frames;
use crate::{Error, Result};
use std::fmt::Write;

/// What comes before the tasks: `submit NAME AFTER KIND` takes commands from its input, one a line,
/// and prints the numbers of the arrays that run them.
const SUBMIT: &str = r#"command -v sbatch >/dev/null || { echo "error: expected sbatch, found none: run this where Slurm is" >&2; exit 2; }
mkdir -p "$folder/tasks"
limit=$(scontrol show config | sed -n 's/^MaxArraySize *= *//p')
limit=$((${limit:-1001} - 1))

# One task of an array: a line of a file, three times at most; of wrong input a retry is in vain.
cat >"$folder/tasks/run" <<'RUN'
#!/bin/bash
trap 'stopped=1' TERM
line=$(sed -n "$((SLURM_ARRAY_TASK_ID + $2 + 1))p" "$1")
for try in 1 2 3; do
    bash -c "$line" && exit 0
    code=$?
    [ $code -ne 2 ] && [ -z "${stopped:-}" ] || exit $code
done
exit $code
RUN

# submit NAME AFTER KIND <COMMANDS: prints the numbers of the arrays that run them, after those of AFTER.
submit() {
    local file=$folder/tasks/$1 kind=$3 before count first last id ids=() after=()
    read -ra before <<<"$2"
    cat >"$file"
    count=$(wc -l <"$file")
    for ((first = 0; first < count; first += limit)); do
        last=$((count - first > limit ? limit : count - first))
        case $kind in
            aftercorr) after=(--dependency=aftercorr:"${before[${#ids[@]}]}") ;;
            afterok) after=(--dependency=afterok"$(printf ':%s' "${before[@]}")") ;;
        esac
        id=$(sbatch --parsable --requeue --kill-on-invalid-dep=yes --job-name="lvox-$1" \
            --array="0-$((last - 1))" --output="$file.%a.log" "${after[@]}" "${options[@]}" \
            "$folder/tasks/run" "$file" "$first")
        ids+=("${id%%;*}")
    done
    echo "${ids[*]}"
}
"#;

/// The script.
///
/// # Errors
/// A word that no shell can be told.
pub fn text(plan: &Plan, sbatch: &Words) -> Result<String> {
    let mut options = sbatch.0.clone();
    options.extend(plan.threads.map(|n| format!("--cpus-per-task={n}")));
    // A tenth more, for files that are mapped.
    let mib = |bytes: u64| (bytes + bytes / 10).div_ceil(1 << 20);
    options.extend(plan.memory.map(|bytes| format!("--mem={}M", mib(bytes))));
    let quoted = |words: &[String]| shell(&[words.to_vec()]);
    let mut text = format!(
        "#!/bin/bash\n# Submits the frames of {:?} to Slurm: bash THIS-FILE, in the folder that \
         names are relative to.\n\
         set -euo pipefail\nfolder={}\noptions=({})\n{SUBMIT}\n",
        plan.name,
        quoted(std::slice::from_ref(&plan.folder))?,
        quoted(&options)?,
    );
    let frames = (plan.frames.as_ref()).filter(|_| plan.has_own_files);
    let is_one = |step: &Step| plan.axes(*step) == [Axis::Frame];
    match frames {
        // Each task waits for that of its own frame alone.
        Some(_) if plan.steps().iter().all(is_one) => chain(plan, None, "aftercorr", &mut text)?,
        Some(frames) => {
            for frame in frames.numbers() {
                chain(plan, Some(*frame), "afterok", &mut text)?;
            }
        }
        None => chain(plan, None, "afterok", &mut text)?,
    }
    text += "echo \"submitted: $ids\"\n";
    Ok(text)
}

/// One step after the other, of all frames or of one.
fn chain(plan: &Plan, frame: Option<i32>, kind: &str, text: &mut String) -> Result<()> {
    let of_frame = frame.map(|frame| Frames::one(frame).to_string());
    let mut kind_of_step = "none";
    for &step in plan.steps() {
        let mut lines = String::new();
        for task in plan.tasks(step, of_frame.as_deref()) {
            lines += &shell(&plan.commands(step, &task))?;
            lines.push('\n');
        }
        let name = match &of_frame {
            Some(frame) => format!("{}.{frame}", step.name()),
            None => step.name().to_owned(),
        };
        const END: &str = "LVOX_TASKS";
        if lines.lines().any(|line| line == END) {
            return Err(Error::input(format!("a command is {END}")));
        }
        let before = if kind_of_step == "none" {
            "''"
        } else {
            "\"$ids\""
        };
        let _ = writeln!(
            text,
            "ids=$(submit {name} {before} {kind_of_step} <<'{END}'\n{lines}{END}\n)"
        );
        kind_of_step = kind;
    }
    Ok(())
}
