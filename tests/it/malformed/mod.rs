//! Are recordings, maps and mappings that are not what they should be refused or counted, in words that lead to the
//! fault and to what to do about it?
//!
//! Each case is a good input (`inputs`) with one change (`cases.txt`). Whoever finds another one adds it there.

mod cases;
mod inputs;

use crate::support::{Outcome, command};
use cases::{Case, Edit, Then, Which, cases, made, text};
use inputs::Input;
use rayon::prelude::*;
use std::path::Path;
use std::process::Stdio;
use std::time::{Duration, Instant};

/// Nothing takes as long.
const MAX_TIME: Duration = Duration::from_secs(60);

#[test]
fn good_inputs_are_read_without_a_word() {
    for input in Input::ALL {
        let outcome = ingest(&input.files(), input);
        assert!(outcome.code == 0 && outcome.stderr.is_empty(), "{input:?}: {outcome:?}");
    }
}

#[test]
fn what_is_malformed_is_said_with_its_place_and_what_to_do() {
    let cases = cases();
    let say = |case: &Case| {
        let faults = faults(case);
        (!faults.is_empty()).then(|| format!("{:?}: {}\n{}", case.input, case.name, faults.join("\n")))
    };
    let wrong: Vec<String> = cases.par_iter().filter_map(say).collect();
    assert!(wrong.is_empty(), "{} of {} are wrong:\n{}", wrong.len(), cases.len(), wrong.join("\n"));
}

/// What is wrong with what the program makes of a case.
fn faults(case: &Case) -> Vec<String> {
    let mut files = case.input.files();
    edit(&mut files, case);
    let mut faults = Vec::new();
    let mut check = |files: &inputs::Files, code: i32, which: &str| {
        let outcome = ingest(files, case.input);
        let said = &outcome.stderr;
        let missing: Vec<&&str> = case.says.iter().filter(|part| !said.contains(**part)).collect();
        if outcome.code != code || !missing.is_empty() {
            faults.push(format!(
                "  {which}: code {}, expected {code}; not said: {missing:?}; said:\n{said}",
                outcome.code
            ));
        }
    };
    match case.then {
        Then::Ends => check(&files, 1, "alone"),
        Then::GoesOn => check(&files, 0, "alone"),
        Then::Rejected => {
            check(&files, 1, "alone");
            for (from, to) in case.input.second() {
                let mut good = case.input.files()[*from].clone();
                if matches!(case.input, Input::Pair) && *from == inputs::CSV {
                    // Equal content is one recording.
                    good = cases::text(&good).replace("\n7,5.9,59,", "\n7,5.9,59.01,").into_bytes();
                }
                files.insert((*to).to_owned(), good);
            }
            check(&files, 0, "beside a good one");
        }
    }
    faults
}

fn edit(files: &mut inputs::Files, case: &Case) {
    let Case { name, .. } = case;
    for edit in &case.edits {
        let file = files.get_mut(case.file).unwrap_or_else(|| panic!("{name}: {} is not there", case.file));
        match edit {
            Edit::Whole(text) => *file = text.clone().into_bytes(),
            Edit::Cut(n) => file.truncate(file.len() * n / 100),
            Edit::Made => *file = made(name, file),
            Edit::Replace(which, from, to) => {
                let mut text = text(file);
                assert!(text.contains(from), "{name}: {from} is not in {}", case.file);
                match which {
                    Which::First => text = text.replacen(from, to, 1),
                    Which::All => text = text.replace(from, to),
                    Which::Last => {
                        let at = text.rfind(from).unwrap();
                        text.replace_range(at..at + from.len(), to);
                    }
                }
                *file = text.into_bytes();
            }
            Edit::Gone => drop(files.remove(case.file)),
        }
    }
}

fn ingest(files: &inputs::Files, input: Input) -> Outcome {
    let folder = tempfile::tempdir().unwrap();
    for (name, bytes) in files {
        let path = folder.path().join(name);
        fs_err::create_dir_all(path.parent().unwrap()).unwrap();
        fs_err::write(path, bytes).unwrap();
    }
    let path = |name: &str| folder.path().join(name).to_str().unwrap().to_owned();
    let (recordings, config, out) = (path("recordings"), path("p.toml"), path("out"));
    let mut args = vec!["ingest", &recordings, "--output", &out, "--quiet", "--threads", "1"];
    if Path::new(&config).exists() {
        args.extend(["--config", &config]);
    }
    args.extend(input.args());
    let (said, written) = (folder.path().join("stderr"), fs_err::File::create(folder.path().join("stderr")).unwrap());
    let mut command = command(&args);
    let mut child = command.stdout(Stdio::null()).stderr(written.into_parts().0).spawn().unwrap();
    let began = Instant::now();
    while child.try_wait().unwrap().is_none() && began.elapsed() < MAX_TIME {
        std::thread::sleep(Duration::from_millis(2));
    }
    // One that has ended cannot be killed.
    let _ = child.kill();
    let code = child.wait().unwrap().code().unwrap_or(-1);
    Outcome { code, stdout: String::new(), stderr: fs_err::read_to_string(said).unwrap() }
}
