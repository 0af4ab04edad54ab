//! Relative paths in a pipeline are relative to its file: it means the same wherever djinn is started.

use crate::cloud::ObjectUrl;
use std::ops::Range;
use std::path::{Component, Path, PathBuf};
use toml::Spanned;
use toml::de::{DeTable, DeValue};

/// The settings that are paths: the section, and the last key.
const KEYS: [(&str, &str); 6] = [
    ("run", "output"),
    ("ingest", "inputs"),
    ("ingest", "map_inputs"),
    ("train", "checkpoint"),
    ("train", "start_from"),
    ("train", "scenes"),
];

/// Makes the paths of a table that was read from a file in `folder` relative to the current directory.
pub(super) fn take_from(folder: &Path, table: &mut DeTable<'_>) {
    each_path(table, &mut |value| {
        let there = value.get_ref().as_str().and_then(|path| within(folder, Path::new(path)));
        if let Some(there) = there {
            *value.get_mut() = DeValue::String(there.into());
        }
    });
}

/// A configuration with all paths except the output replaced; those without a replacement stay.
pub(super) fn replaced(config: String, other: impl Fn(&Path) -> Option<String>) -> String {
    let mut places: Vec<(Range<usize>, String)> = Vec::new();
    if let Ok(mut table) = DeTable::parse(&config) {
        table.get_mut().remove("run");
        each_path(table.get_mut(), &mut |value| {
            let other = value.get_ref().as_str().and_then(|path| other(Path::new(path)));
            places.extend(other.map(|path| (value.span(), toml::Value::String(path).to_string())));
        });
    }
    places.sort_by_key(|(span, _)| std::cmp::Reverse(span.start));
    places.into_iter().fold(config, |mut config, (span, path)| {
        config.replace_range(span, &path);
        config
    })
}

/// Calls `at` with every path of a table.
fn each_path<'a>(table: &mut DeTable<'a>, at: &mut dyn FnMut(&mut Spanned<DeValue<'a>>)) {
    for (section, value) in table.iter_mut() {
        let keys: Vec<&str> = KEYS.iter().filter(|(of, _)| *of == section.get_ref()).map(|(_, key)| *key).collect();
        walk(&keys, false, value, at);
    }
}

fn walk<'a>(
    keys: &[&str],
    is_path: bool,
    value: &mut Spanned<DeValue<'a>>,
    at: &mut dyn FnMut(&mut Spanned<DeValue<'a>>),
) {
    match value.get_mut() {
        DeValue::String(_) if is_path => at(value),
        DeValue::Array(items) => items.iter_mut().for_each(|item| walk(keys, is_path, item, at)),
        DeValue::Table(table) => {
            for (key, value) in table.iter_mut() {
                let is_path = keys.contains(&key.get_ref().as_ref());
                walk(keys, is_path, value, at);
            }
        }
        _ => {}
    }
}

fn is_relative(path: &Path) -> bool {
    !path.as_os_str().is_empty() && path.is_relative() && matches!(ObjectUrl::of(path), Ok(None))
}

/// A path relative to the current directory as seen from the folder; absolute if they have nothing in common; `None` if
/// it stays as it is.
pub(super) fn seen_from(folder: &Path, path: &Path) -> Option<String> {
    if !is_relative(path) {
        return None;
    }
    // Without links in them, so that `..` leads where it seems to.
    let mut there = fs_err::canonicalize(".").ok()?;
    let folder = there.join(folder);
    let folder = folder.ancestors().find_map(|known| {
        let below = folder.strip_prefix(known).ok()?;
        Some(fs_err::canonicalize(known).ok()?.join(below))
    })?;
    for part in path.components() {
        match part {
            Component::CurDir => {}
            Component::ParentDir if !there.is_symlink() => drop(there.pop()),
            part => there.push(part),
        }
    }
    let n_common = there.components().zip(folder.components()).take_while(|(a, b)| a == b).count();
    let is_at_root = !there.components().take(n_common).any(|part| matches!(part, Component::Normal(_)));
    if !is_at_root {
        let up = folder.components().skip(n_common).map(|_| Component::ParentDir);
        there = up.chain(there.components().skip(n_common)).collect();
    }
    there.into_os_string().into_string().ok()
}

/// A path relative to the folder as seen from the current directory; `None` if it stays as it is.
fn within(folder: &Path, path: &Path) -> Option<String> {
    if !is_relative(path) {
        return None;
    }
    let mut there = PathBuf::new();
    for part in folder.join(path).components() {
        let is_named = matches!(there.components().next_back(), Some(Component::Normal(_)));
        match part {
            Component::CurDir => {}
            // Behind a link, `..` is not the folder of the link.
            Component::ParentDir if is_named && !there.is_symlink() => drop(there.pop()),
            part => there.push(part),
        }
    }
    if there.as_os_str().is_empty() {
        there.push(".");
    }
    there.into_os_string().into_string().ok()
}

#[cfg(test)]
mod tests {
    use crate::pipeline::config::parse;
    use std::path::Path;

    #[test]
    fn a_saved_configuration_names_the_same_files_from_where_it_lies() {
        let inputs = ["r.zip", "../x/r", "/abs", "a/../b", "."];
        let text = format!("[run]\nname = 'p'\n[ingest]\ndataset = 'argoverse1'\ninputs = {inputs:?}\n");
        let config = parse(None, &text, &[]).unwrap();
        let here = fs_err::canonicalize(".").unwrap();
        let name = here.file_name().unwrap().to_str().unwrap();
        let saved = |root: &Path| config.saved_in(root).unwrap().parse::<toml::Table>().unwrap();
        let of = |saved: &toml::Table| {
            let inputs = saved["ingest"]["inputs"].as_array().unwrap();
            inputs.iter().map(|path| path.as_str().unwrap().to_owned()).collect::<Vec<_>>()
        };
        // Neither the folder nor the inputs exist.
        let beside = saved(Path::new("output/p/main"));
        assert_eq!(of(&beside), ["../../../r.zip", "../../../../x/r", "/abs", "../../../b", "../../.."]);
        assert_eq!(beside["run"]["output"].as_str(), Some("../.."));
        let above = of(&saved(Path::new("../other")));
        assert_eq!(above[..2], [format!("../{name}/r.zip"), "../x/r".to_owned()]);
        // Nothing in common but the root.
        let elsewhere = of(&saved(Path::new("/nowhere")));
        assert_eq!(Path::new(&elsewhere[0]), here.join("r.zip"));
    }

    #[test]
    fn paths_are_relative_to_the_file_and_those_of_overrides_to_the_current_directory() {
        let text = "[run]\nname = 'a/b'\noutput = 'o'\n\
                    [ingest]\ndataset = 'argoverse1'\ninputs = ['r.zip', '../x/./r', '/abs', '..']\nplaces = ['MIA']\n\
                    [train.denoiser]\ncheckpoint = '../models/m'\ndata = [{ scenes = 's' }]\n";
        let read = |file: &str, overrides: &[&str]| {
            let overrides: Vec<String> = overrides.iter().map(|text| (*text).to_owned()).collect();
            let config = parse(Some(Path::new(file)), text, &overrides).unwrap();
            let (ingest, denoiser) = (config.ingest.unwrap(), config.train.denoiser.unwrap());
            let inputs: Vec<String> = ingest.inputs.iter().map(|path| path.display().to_string()).collect();
            let of_model = [denoiser.checkpoint.unwrap(), denoiser.data[0].scenes.clone()];
            assert_eq!((config.run.name.as_str(), &ingest.places[0][..]), ("a/b", "MIA"));
            (config.run.output.display().to_string(), inputs.join(" "), of_model.map(|path| path.display().to_string()))
        };
        let owned = |output: &str, inputs: &str, of_model: [&str; 2]| {
            (output.to_owned(), inputs.to_owned(), of_model.map(str::to_owned))
        };
        assert_eq!(read("p.toml", &[]), owned("o", "r.zip ../x/r /abs ..", ["../models/m", "s"]));
        let there = owned("jobs/o", "jobs/r.zip x/r /abs .", ["models/m", "jobs/s"]);
        assert_eq!(read("jobs/p.toml", &[]), there);
        let overridden = read("jobs/p.toml", &["ingest.inputs=['q.zip']", "run.output=out"]);
        assert_eq!(overridden, owned("out", "q.zip", ["models/m", "jobs/s"]));
    }
}
