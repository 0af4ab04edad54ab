//! Which files are bundled with the program, and where does `djinn init` put them?
//!
//! Pipelines name files by their paths from `pipelines/`. In a new folder, these files are below the pipeline.

use std::borrow::Cow;

/// A pipeline, by its name.
macro_rules! pipeline {
    ($name:literal) => {
        ($name, include_str!(concat!(env!("CARGO_MANIFEST_DIR"), "/pipelines/", $name, ".toml")))
    };
}

/// The pipelines and their text; the first one is the default. Everything that they read, except a user's recordings,
/// is in [`FILES`].
pub(super) static PIPELINES: [(&str, &str); 9] = [
    pipeline!("quickstart"),
    pipeline!("cut_in_corpus"),
    pipeline!("cut_in_request"),
    pipeline!("collision_request"),
    pipeline!("planner_request"),
    pipeline!("lane_changes_argoverse1"),
    pipeline!("cut_ins_womd"),
    pipeline!("recorded_validity"),
    pipeline!("scene_transformer"),
];

/// A file that pipelines read.
struct Bundled {
    /// Its path in the repository.
    source: &'static str,
    /// Its path in a new folder.
    name: &'static str,
    content: &'static [u8],
}

macro_rules! bundled {
    ($source:literal as $name:literal) => {
        Bundled {
            source: $source,
            name: $name,
            content: include_bytes!(concat!(env!("CARGO_MANIFEST_DIR"), "/", $source)),
        }
    };
}

static FILES: [Bundled; 3] = [
    bundled!("tests/fixtures/recordings/interaction/FIX-multi-v1_2.zip" as "recordings/FIX-multi-v1_2.zip"),
    bundled!("pipelines/models/geometric.safetensors" as "models/geometric.safetensors"),
    bundled!("pipelines/models/geometric_two_steps.safetensors" as "models/geometric_two_steps.safetensors"),
];

/// The files of a folder in which the pipeline with this name runs, with their content; the pipeline itself comes
/// first. Empty if there is no such pipeline.
pub(super) fn folder_of(pipeline: &str) -> Vec<(String, Cow<'static, [u8]>)> {
    let Some((name, text)) = PIPELINES.iter().find(|(name, _)| *name == pipeline) else { return Vec::new() };
    let mut text = text.replace("djinn run pipelines/", "djinn run ");
    let mut read = Vec::new();
    for file in &FILES {
        let from_pipelines = file.source.strip_prefix("pipelines/").map(str::to_owned);
        let there = format!("\"{}\"", from_pipelines.unwrap_or_else(|| format!("../{}", file.source)));
        let here = format!("\"{}\"", file.name);
        if text.contains(&there) {
            text = text.replace(&there, &here);
            read.push((file.name.to_owned(), Cow::Borrowed(file.content)));
        }
    }
    [vec![(format!("{name}.toml"), Cow::Owned(text.into_bytes()))], read].concat()
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Nothing but a user's recordings may be missing.
    #[test]
    fn folders_hold_what_their_pipelines_name() {
        for (pipeline, _) in PIPELINES {
            let files = folder_of(pipeline);
            let text = String::from_utf8(files[0].1.to_vec()).unwrap();
            let settings: String = text.lines().filter(|line| !line.starts_with('#')).collect();
            for path in settings.split('"').skip(1).step_by(2).filter(|value| value.contains('/')) {
                let is_license = path.starts_with("MIT");
                assert!(is_license || files.iter().any(|(name, _)| name == path), "{pipeline} names {path}");
            }
            assert!(!text.contains("run pipelines/"), "{pipeline}");
        }
        assert!(folder_of("no_such_pipeline").is_empty());
    }
}
