//! Relative paths in a pipeline are relative to its file: it means the same wherever djinn is started.

use crate::cloud::ObjectUrl;
use std::path::{Component, Path, PathBuf};
use toml::Spanned;
use toml::de::{DeTable, DeValue};

/// The settings that are paths: the section, and the last key.
const KEYS: [(&str, &str); 7] = [
    ("run", "output"),
    ("ingest", "inputs"),
    ("ingest", "map_inputs"),
    ("train", "checkpoint"),
    ("train", "start_from"),
    ("train", "scenes"),
    ("generate", "prior"),
];

/// Makes the paths of a table that was read from a file in `folder` relative to the current directory.
pub(super) fn take_from(folder: &Path, table: &mut DeTable<'_>) {
    for (section, value) in table.iter_mut() {
        let keys: Vec<&str> = KEYS.iter().filter(|(of, _)| *of == section.get_ref()).map(|(_, key)| *key).collect();
        walk(folder, &keys, false, value);
    }
}

fn walk(folder: &Path, keys: &[&str], is_path: bool, value: &mut Spanned<DeValue<'_>>) {
    match value.get_mut() {
        DeValue::String(path) if is_path => {
            if let Some(there) = within(folder, Path::new(path.as_ref())) {
                *path = there.into();
            }
        }
        DeValue::Array(items) => items.iter_mut().for_each(|item| walk(folder, keys, is_path, item)),
        DeValue::Table(table) => {
            for (key, value) in table.iter_mut() {
                let is_path = keys.contains(&key.get_ref().as_ref());
                walk(folder, keys, is_path, value);
            }
        }
        _ => {}
    }
}

/// A path that is relative to the folder, from the current directory; `None` if it stays as it is.
fn within(folder: &Path, path: &Path) -> Option<String> {
    if path.as_os_str().is_empty() || path.is_absolute() || !matches!(ObjectUrl::of(path), Ok(None)) {
        return None;
    }
    let mut there = PathBuf::new();
    for part in folder.join(path).components() {
        let is_named = matches!(there.components().next_back(), Some(Component::Normal(_)));
        match part {
            Component::CurDir => {}
            // Behind a link, `..` is not where the link is.
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
