//! What do whole runs of the program cost, in processor seconds, and what do they bring for each?
//!
//! `pipelines/performance/stages.csv` holds what the last release took on one machine: compare on that machine, idle,
//! or run both programs. `--update` writes the file anew.

use serde_json::Value;
use std::path::{Path, PathBuf};
use std::process::{Command, Stdio};

/// One run of the program.
struct Job {
    name: &'static str,
    arguments: Vec<String>,
    /// What it brings, in words, and how many.
    unit: &'static str,
    count: fn(&Path) -> Result<f64, String>,
}

/// Prints a row for each job: median processor seconds, what they bring a core second, and the ratio of its cost to
/// that in the file.
pub(crate) fn run(arguments: &[String]) -> Result<(), String> {
    let usage = "stages [--program DJINN] [--rounds N] [--update]";
    let (mut program, mut n_rounds, mut update) = (PathBuf::from(env!("CARGO_BIN_EXE_djinn")), 3, false);
    let mut rest = arguments.iter();
    while let Some(name) = rest.next() {
        match (name.as_str(), rest.len()) {
            ("--update", _) => update = true,
            ("--program", 1..) => program = rest.next().ok_or(usage)?.into(),
            ("--rounds", 1..) => {
                n_rounds = rest.next().and_then(|n| n.parse().ok()).filter(|n| *n > 0).ok_or(usage)?;
            }
            _ => return Err(format!("{name}: {usage}")),
        }
    }
    let root = Path::new(env!("CARGO_MANIFEST_DIR"));
    let table = root.join("pipelines/performance/stages.csv");
    let before = fs_err::read_to_string(&table).unwrap_or_default();
    let mut rows = "run,core_s,brings,per_core_s\n".to_owned();
    println!("{:<10} {:>8} {:>12} {:>30} {:>8}", "run", "core s", "per core s", "of", "to file");
    let scratch = tempfile::tempdir().map_err(|error| error.to_string())?;
    // The drive reads the quickstart's corpus.
    for job in jobs(root, scratch.path()) {
        let (mut seconds, mut count) = (Vec::new(), 0.0);
        for _ in 0..n_rounds {
            let output = scratch.path().join(job.name);
            let _ = fs_err::remove_dir_all(&output);
            seconds.push(core_s(&program, &job.arguments)?);
            count = (job.count)(&output).map_err(|error| format!("{}: {error}", job.name))?;
        }
        seconds.sort_by(f64::total_cmp);
        let median = seconds[seconds.len() / 2];
        let was = before.lines().find_map(|row| row.strip_prefix(job.name)?.strip_prefix(',')?.split(',').next());
        let ratio = was.and_then(|s| s.parse::<f64>().ok()).map_or_else(String::new, |s| format!("{:.2}", median / s));
        println!("{:<10} {median:>8.2} {:>12.3} {:>30} {ratio:>8}", job.name, count / median, job.unit);
        rows += &format!("{},{median:.2},{} {},{:.3}\n", job.name, count, job.unit, count / median);
    }
    if update {
        fs_err::write(&table, rows).map_err(|error| error.to_string())?;
    }
    Ok(())
}

fn jobs(root: &Path, scratch: &Path) -> Vec<Job> {
    let text = |path: PathBuf| path.display().to_string();
    let run = |name: &'static str, config: &str, more: &[&str]| {
        let mut arguments = vec!["run".to_owned(), text(root.join("pipelines").join(config))];
        arguments.extend(["--output".to_owned(), text(scratch.join(name))]);
        arguments.extend(more.iter().map(|&argument| argument.to_owned()));
        arguments
    };
    let corpus = text(scratch.join("quickstart/quickstart/main/corpus"));
    let drive = ["drive", corpus.as_str(), "--ego", "idm", "--limit", "100", "--out"].map(str::to_owned);
    let ingest = ["--stage", "ingest", "--set", "ingest.window_stride=1"];
    vec![
        Job {
            name: "ingest",
            arguments: run("ingest", "quickstart.toml", &ingest),
            unit: "scenes",
            count: |output| number(&output.join("quickstart/main/scenes/manifest.json"), "n_scenes"),
        },
        Job {
            name: "train",
            arguments: run("train", "performance/training.toml", &[]),
            unit: "steps",
            count: |_| Ok(200.0),
        },
        Job {
            name: "quickstart",
            arguments: run("quickstart", "quickstart.toml", &[]),
            unit: "accepted",
            count: |output| number(&output.join("quickstart/main/metrics.json"), "n_accepted"),
        },
        Job {
            name: "requests",
            arguments: run("requests", "performance/requests.toml", &[]),
            unit: "accepted",
            count: |output| number(&output.join("requests/main/metrics.json"), "n_accepted"),
        },
        Job {
            name: "drive",
            arguments: drive.into_iter().chain([text(scratch.join("drive"))]).collect(),
            unit: "scenarios driven for 8 s",
            count: |_| Ok(100.0),
        },
    ]
}

fn number(path: &Path, key: &str) -> Result<f64, String> {
    let bytes = fs_err::read(path).map_err(|error| error.to_string())?;
    let value: Value = serde_json::from_slice(&bytes).map_err(|error| format!("{}: {error}", path.display()))?;
    value[key].as_f64().ok_or_else(|| format!("{}: no number {key}", path.display()))
}

/// Processor seconds of a run of the program that succeeds.
fn core_s(program: &Path, arguments: &[String]) -> Result<f64, String> {
    let before_s = children_s()?;
    let run = Command::new(program).args(arguments).stdout(Stdio::null()).stderr(Stdio::piped()).output();
    let output = run.map_err(|error| format!("{}: {error}", program.display()))?;
    if !output.status.success() {
        return Err(format!(
            "{} ended with {}:\n{}",
            arguments.join(" "),
            output.status,
            String::from_utf8_lossy(&output.stderr)
        ));
    }
    Ok(children_s()? - before_s)
}

/// Processor seconds of all children that have ended: fields 16 and 17 of `/proc/self/stat`, hundredths of seconds.
fn children_s() -> Result<f64, String> {
    let stat = fs_err::read_to_string("/proc/self/stat").map_err(|error| error.to_string())?;
    // The name in parentheses may hold spaces; behind it is field 3.
    let fields: Vec<&str> = stat.rsplit(')').next().unwrap_or_default().split_whitespace().collect();
    let ticks = |idx: usize| fields.get(idx - 3).and_then(|field| field.parse::<f64>().ok());
    ticks(16)
        .zip(ticks(17))
        .map(|(user, system)| (user + system) * 0.01)
        .ok_or_else(|| format!("/proc/self/stat: {stat}"))
}
