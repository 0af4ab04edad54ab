//! Collects the comparable contents of two run folders.

use super::StageId;
use super::layout::{METRICS_SUMMARY, MINE_SUMMARY};
use super::stages::of_named_path;
use crate::engine::done_path;
use crate::engine::run_folder::{CONFIG_FILE, RUN_FILE, RunManifest};
use crate::engine::{Classify, Failure, Result};
use crate::evaluate::EvaluationSummary;
use crate::files::{Error, check_overlap, is_link, regular};
use crate::report::{ComparedRun, Comparison, Fact, PAGE_MARK, render_comparison};
use crate::store::{read_json, write_atomically};
use std::collections::BTreeMap;
use std::io::{Read, Write};
use std::path::{Path, PathBuf};

/// How much of a page is read to find its title.
const HEAD_BYTES: u64 = 1 << 20;

/// Writes a page that sets the runs in two folders side by side.
///
/// # Errors
/// When one of the folders is no run folder or holds files that cannot be read; errors of the file system.
pub fn write_comparison(a: &Path, b: &Path, page: &Path) -> Result<()> {
    let comparison = Comparison { a: read_run(a)?, b: read_run(b)? };
    check_page(a, b, page)?;
    let text = render_comparison(&comparison);
    if let Some(folder) = page.parent().filter(|folder| !folder.as_os_str().is_empty()) {
        fs_err::create_dir_all(folder).map_err(of_named_path)?;
    }
    write_atomically::<std::io::Error>(page, |file| file.write_all(text.as_bytes())).map_err(of_named_path)?;
    Ok(())
}

/// Refuses to write the page over a compared folder, or over a file that is not one of our pages.
fn check_page(a: &Path, b: &Path, page: &Path) -> Result<()> {
    check_overlap(page, [("run", a), ("run", b)])?;
    if is_link(page) {
        return Err(Error::Link { path: page.to_owned() }.into());
    }
    if page.symlink_metadata().is_err() {
        return Ok(());
    }
    // A device has no end, and a foreign file may be of any size.
    regular(page).map_err(Failure::input)?;
    let begins_as_ours = || -> std::io::Result<bool> {
        let mut head = Vec::new();
        fs_err::File::open(page)?.take(HEAD_BYTES).read_to_end(&mut head)?;
        Ok(String::from_utf8_lossy(&head).contains(&format!("{PAGE_MARK}</title>")))
    };
    if !begins_as_ours().unwrap_or(false) {
        let found = page.file_name().map(PathBuf::from).into_iter().collect();
        return Err(Error::Foreign { path: page.to_owned(), found }.into());
    }
    Ok(())
}

/// The comparable contents of the run in a folder; empty for stages that did not run.
fn read_run(root: &Path) -> Result<ComparedRun> {
    let has_stages = StageId::ALL.into_iter().any(|stage| done_path(root, stage.kind()).is_file());
    let manifest = root.join(RUN_FILE);
    if !manifest.exists() && !has_stages {
        let what = if root.is_dir() {
            "is not a run folder: it has neither run.json nor a finished stage"
        } else {
            "is no folder"
        };
        return Err(Failure::input_message(format_args!("{} {what}", root.display())).with_hint(
            "pass the folders of two runs, such as output/quickstart/main; `djinn run` prints the folder of its \
             results",
        ));
    }
    let mut run = ComparedRun { name: root.display().to_string(), ..ComparedRun::default() };
    if manifest.exists() {
        let manifest: RunManifest = read_json(&manifest).blame_input()?;
        run.facts = vec![
            Fact::new("Pipeline", manifest.pipeline),
            Fact::new("Seed", manifest.seed),
            Fact::new("Written by", format!("djinn {}", manifest.djinn_version)),
            Fact::new("Computed on", manifest.device),
        ];
    }
    let config = root.join(CONFIG_FILE);
    if config.exists() {
        let text = fs_err::read_to_string(&config).map_err(Failure::input)?;
        let table: toml::Table = text
            .parse()
            .map_err(|error| Failure::input(error).context(format!("failed to read {}", config.display())))?;
        flatten("", &toml::Value::Table(table), &mut run.settings);
    }
    let mined = root.join(MINE_SUMMARY);
    if mined.exists() {
        run.mining = Some(read_json(&mined).blame_input()?);
    }
    let metrics = root.join(METRICS_SUMMARY);
    if metrics.exists() {
        let summary: EvaluationSummary = read_json(&metrics).blame_input()?;
        run.facts.push(Fact::new("Scenarios", summary.n_scenarios));
        run.facts.push(Fact::new("Verified, and not in the recording", summary.n_new));
        run.evaluation = summary;
    }
    Ok(run)
}

/// Every value by its path. Tables in an array are identified by their names, if they have any, so that adding a sweep
/// does not change the paths of others.
fn flatten(path: &str, value: &toml::Value, settings: &mut BTreeMap<String, String>) {
    let below = |key: &str| if path.is_empty() { key.to_owned() } else { format!("{path}.{key}") };
    match value {
        toml::Value::Table(table) => {
            for (key, value) in table {
                flatten(&below(key), value, settings);
            }
        }
        toml::Value::Array(items) if items.iter().any(toml::Value::is_table) => {
            for (idx, item) in items.iter().enumerate() {
                let name = ["name", "kind"].iter().find_map(|key| item.get(key)?.as_str());
                flatten(&below(name.unwrap_or(&idx.to_string())), item, settings);
            }
        }
        plain => _ = settings.insert(path.to_owned(), plain.to_string()),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn settings_go_by_their_paths_and_sweeps_by_their_names() {
        let text = "[run]\nseed = 3\n[[generate.sweeps]]\nname = \"b\"\nstrengths = [0.0, 2.0]\n[[mine.behaviors]]\n\
                    kind = \"cut_in\"\nx = 1\n";
        let mut settings = BTreeMap::new();
        flatten("", &toml::Value::Table(text.parse().unwrap()), &mut settings);
        let expected = [
            ("generate.sweeps.b.name", "\"b\""),
            ("generate.sweeps.b.strengths", "[0.0, 2.0]"),
            ("mine.behaviors.cut_in.kind", "\"cut_in\""),
            ("mine.behaviors.cut_in.x", "1"),
            ("run.seed", "3"),
        ];
        assert_eq!(settings, expected.map(|(key, value)| (key.to_owned(), value.to_owned())).into());
    }

    #[cfg(unix)]
    #[test]
    fn devices_and_files_of_others_are_no_pages() {
        let folder = tempfile::tempdir().unwrap();
        let [a, b, page] = ["a", "b", "page.html"].map(|name| folder.path().join(name));
        check_page(&a, &b, &page).unwrap();
        let why = format!("{:#}", check_page(&a, &b, Path::new("/dev/full")).unwrap_err().error);
        assert!(why.contains("/dev/full is neither a file nor a folder"), "{why}");
        fs_err::write(&page, "<title>mine</title>").unwrap();
        assert!(check_page(&a, &b, &page).is_err());
        fs_err::write(&page, format!("<title>two runs{PAGE_MARK}</title>")).unwrap();
        check_page(&a, &b, &page).unwrap();
    }

    #[test]
    fn what_is_no_run_is_refused_with_advice() {
        let folder = tempfile::tempdir().unwrap();
        for (path, what) in
            [(folder.path().to_owned(), "is not a run folder"), (folder.path().join("missing"), "is no folder")]
        {
            let failure = write_comparison(&path, &path, &folder.path().join("page.html")).unwrap_err();
            assert_eq!(failure.blame, crate::engine::Blame::Input);
            assert!(failure.error.to_string().contains(what) && failure.hint.is_some(), "{failure:?}");
        }
        assert!(!folder.path().join("page.html").exists());
    }
}
