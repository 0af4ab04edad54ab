//! Is every setting that cannot work refused before anything runs, by its key, its value and what was expected?
//!
//! A new setting gets its row: with a range in `settings/ranges.rs`, anything else in `settings/refused.rs` or, if it is of
//! sampling or requests, in `settings/refused_generation.rs`.

mod ranges;
mod refused;
mod refused_generation;

use crate::support::{SMALL_PIPELINE, Workspace};
use djinn::pipeline::config::parse;
use ranges::{BEYOND_RANGES, NOT_NAN, WITHIN_RANGES};
use refused::REFUSED;
use refused_generation::REFUSED_GENERATION;

/// Dry runs with these settings end with 1 and say these words, in one line that names no type of the program.
fn expect_refusals(rows: &[(Vec<String>, Vec<String>)]) {
    let workspace = Workspace::new();
    let check = |(settings, words): &(Vec<String>, Vec<String>)| {
        let set = settings.iter().flat_map(|setting| ["--set", setting]);
        let outcome = workspace.run("out", &["--dry-run"].into_iter().chain(set).collect::<Vec<_>>());
        let found = &outcome.stderr;
        let is_told = words.iter().all(|word| found.contains(word));
        let leaks =
            ["usize", "f64", "untagged", "Some(", "panicked", "\u{1b}"].iter().find(|text| found.contains(**text));
        match outcome.code == 1 && is_told && leaks.is_none() && outcome.stdout.is_empty() {
            true => None,
            false => Some(format!("{settings:?}\n  wanted {words:?}\n  exit code {}: {found}", outcome.code)),
        }
    };
    let wrong: Vec<String> = std::thread::scope(|scope| {
        let parts: Vec<_> = rows
            .chunks(rows.len().div_ceil(4))
            .map(|part| scope.spawn(|| part.iter().filter_map(check).collect::<Vec<_>>()))
            .collect();
        parts.into_iter().flat_map(|part| part.join().unwrap()).collect()
    });
    assert!(wrong.is_empty(), "{} of {} settings:\n{}", wrong.len(), rows.len(), wrong.join("\n"));
    assert!(!workspace.path("out").exists());
}

#[test]
fn numbers_beyond_their_ranges_are_refused_with_the_range() {
    let beyond = BEYOND_RANGES.iter().flat_map(|(key, values, range)| {
        values
            .iter()
            .map(move |value| (vec![format!("{key}={value}")], vec![format!("{key} is "), format!("expected {range}")]))
    });
    let not_nan = NOT_NAN.iter().map(|key| (vec![format!("{key}=nan")], vec![format!("{key} is NaN")]));
    expect_refusals(&beyond.chain(not_nan).collect::<Vec<_>>());
}

#[test]
fn what_cannot_work_is_refused_in_words() {
    let owned = |texts: &[&str]| texts.iter().map(|text| (*text).to_owned()).collect();
    expect_refusals(
        &REFUSED
            .iter()
            .chain(REFUSED_GENERATION)
            .map(|(settings, words)| (owned(settings), owned(words)))
            .collect::<Vec<_>>(),
    );
}

#[test]
fn the_ends_of_ranges_work() {
    for setting in WITHIN_RANGES {
        let outcome = parse(None, SMALL_PIPELINE, &[(*setting).to_owned()]);
        assert!(outcome.is_ok(), "{setting}: {}", outcome.unwrap_err());
    }
}

#[test]
fn a_seed_beyond_the_numbers_of_toml_switches_no_check_off() {
    for seed in ["run.seed=9223372036854775808", "run.seed=18446744073709551615"] {
        for (key, values, range) in BEYOND_RANGES {
            for value in *values {
                let settings = [seed.to_owned(), format!("{key}={value}")];
                let error = parse(None, SMALL_PIPELINE, &settings).unwrap_err().to_string();
                assert!(error.contains(&format!("{key} is ")) && error.contains(range), "{settings:?}: {error}");
            }
        }
        for key in NOT_NAN {
            let error = parse(None, SMALL_PIPELINE, &[seed.to_owned(), format!("{key}=nan")]).unwrap_err().to_string();
            assert!(error.contains(&format!("{key} is NaN")), "{error}");
        }
    }
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
    assert!(error.starts_with("p.toml:38:38: "), "{error}");
    assert!(error.ends_with("generate.sampler.n_steps is 0, expected 1 to 10000"), "{error}");
}
