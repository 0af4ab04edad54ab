//! Is every setting that cannot work refused before anything runs, by its key, its value and what was expected?
//!
//! Ranges and names are tested as the schema states them (`settings/ranges.rs`); anything else gets its lines in
//! `settings/refused.txt`.

mod ranges;

use crate::support::{SMALL_PIPELINE, Workspace};
use djinn::pipeline::config::parse;
use ranges::{Case, cases};
use rayon::prelude::*;

/// Settings, and what the message must contain.
type Row<'a> = (Vec<&'a str>, Vec<&'a str>);

/// The rows of `settings/refused.txt`.
fn rows(text: &str) -> Vec<Row<'_>> {
    let mut rows: Vec<Row<'_>> = Vec::new();
    for line in text.lines().filter(|line| !line.is_empty() && !line.starts_with('#')) {
        match (line.strip_prefix("    "), rows.last_mut()) {
            (Some(words), Some(row)) => row.1.push(words),
            (_, Some(row)) if row.1.is_empty() => row.0.push(line),
            _ => rows.push((vec![line], Vec::new())),
        }
    }
    rows
}

/// Dry runs with these settings end with 1 and say these words, in one line that names no type of the program.
fn expect_refusals(rows: &[Row<'_>]) {
    let workspace = Workspace::new();
    let check = |(settings, words): &Row<'_>| {
        let set = settings.iter().flat_map(|setting| ["--set", setting]);
        let outcome = workspace.run("out", &["--dry-run"].into_iter().chain(set).collect::<Vec<_>>());
        let found = &outcome.stderr;
        let is_told = words.iter().all(|word| found.contains(*word));
        let leaks =
            ["usize", "f64", "untagged", "Some(", "panicked", "\u{1b}"].iter().find(|text| found.contains(**text));
        match outcome.code == 1 && is_told && leaks.is_none() && outcome.stdout.is_empty() {
            true => None,
            false => Some(format!("{settings:?}\n  wanted {words:?}\n  exit code {}: {found}", outcome.code)),
        }
    };
    let wrong: Vec<String> = rows.par_iter().filter_map(check).collect();
    assert!(wrong.is_empty(), "{} of {} settings:\n{}", wrong.len(), rows.len(), wrong.join("\n"));
    assert!(!workspace.path("out").exists());
}

/// The message that refuses a pipeline with such a setting, in words that name no type of the program.
fn refusal(more: &[String]) -> Option<String> {
    let error = parse(None, SMALL_PIPELINE, more).err()?.to_string();
    assert!(!["usize", "f64", "untagged", "Some("].iter().any(|text| error.contains(text)), "{more:?}: {error}");
    Some(error)
}

#[test]
fn every_stated_bound_is_kept_and_named() {
    let schema = include_str!("../../schemas/config.schema.json");
    let cases = cases(&serde_json::from_str(schema).unwrap());
    // A seed beyond the numbers of TOML switches no check off.
    let seed = "run.seed=9223372036854775808".to_owned();
    let check = |case: &Case| -> Vec<String> {
        let mut wrong = Vec::new();
        let mut expected = None;
        for setting in &case.beyond {
            let error = refusal(&[seed.clone(), setting.clone()]).unwrap_or_default();
            let is_nan = setting.contains("nan");
            if !error.contains(&case.said) || !is_nan && !case.words.iter().all(|word| error.contains(word)) {
                wrong.push(format!("{setting}: {error}"));
            }
            expected = expected.or(error.split_once(", expected ").map(|(_, range)| range.to_owned()));
        }
        for (setting, end) in &case.ends {
            let range = format!("{} is {end}, expected {}", case.key, expected.as_deref().unwrap_or_default());
            let error = refusal(std::slice::from_ref(setting)).filter(|error| error.contains(&range));
            wrong.extend(error.map(|error| format!("{setting}: {error}")));
        }
        wrong
    };
    let wrong: Vec<String> = cases.par_iter().flat_map_iter(check).collect();
    assert!(wrong.is_empty(), "{} settings of {} numbers:\n{}", wrong.len(), cases.len(), wrong.join("\n"));
}

#[test]
fn what_cannot_work_is_refused_in_words() {
    expect_refusals(&rows(include_str!("settings/refused.txt")));
}

#[cfg(not(feature = "cloud"))]
#[test]
fn object_stores_need_their_feature() {
    expect_refusals(&rows(
        "ingest.inputs=[\"s3://bucket/x.zip\"]
    ingest.inputs.0 is s3://bucket/x.zip
    built without object stores
    --features cloud
run.output=gs://bucket/runs
    run.output is gs://bucket/runs
    built without object stores",
    ));
}

#[test]
fn names_that_no_file_can_have_are_refused() {
    let long = "n".repeat(201);
    let sweep = format!("generate.sweeps.1.name={long}");
    let name = format!("run.name={long}");
    for (args, key) in [
        (vec!["--set", &sweep], "generate.sweeps.1.name"),
        (vec!["--set", &name], "the name of a run"),
        (vec!["--run", &long], "the name of a run"),
    ] {
        let told = Workspace::new().run("out", &[&["--dry-run"], args.as_slice()].concat()).expect(1).stderr;
        assert!(told.contains(&format!("{key} has 201 bytes, expected at most 200")), "{told}");
    }
}

#[test]
fn more_threads_than_any_machine_has_are_refused() {
    for n_threads in ["1025", "100000", "18446744073709551615", "-1"] {
        let threads = format!("--threads={n_threads}");
        let told = Workspace::new().run("out", &["--dry-run", &threads]).expect(1).stderr;
        assert!(told.contains("--threads") && told.contains(n_threads), "{told}");
    }
}

#[test]
fn a_number_of_the_file_is_refused_where_it_stands() {
    let text = SMALL_PIPELINE.replace("kind = \"heun\", n_steps = 2", "kind = \"heun\", n_steps = 0");
    let error = parse(Some("p.toml".as_ref()), &text, &["run.seed=4".to_owned()]).unwrap_err().to_string();
    assert!(error.starts_with("p.toml:34:38: "), "{error}");
    assert!(error.ends_with("generate.sampler.n_steps is 0, expected 1 to 10000"), "{error}");
}
