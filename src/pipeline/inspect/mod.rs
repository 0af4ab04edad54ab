//! Describes files and folders that djinn wrote.
//!
//! Each kind of file has a describer; the first one that recognizes the path describes it. Descriptions are ordered
//! names and values, which the command line turns into text or JSON.

mod checkpoint;
mod events;
mod folders;
mod requests;

use crate::engine::{Failure, Result};
use crate::files::regular;
use serde_json::{Map, Value};
use std::path::Path;

/// A description.
#[derive(Debug, Clone, PartialEq)]
pub struct Description {
    /// The kind of thing at the path, such as `scene store`.
    pub kind: &'static str,
    /// Names and values, the most important first.
    pub entries: Vec<(String, Value)>,
}

/// Describes `path` if it is of its kind.
type Describer = fn(&Path) -> Result<Option<Description>>;

/// Every describer, in the order in which they are tried.
const DESCRIBERS: [Describer; 7] = [
    folders::run,
    folders::scenes,
    folders::samples,
    folders::corpus,
    folders::model,
    checkpoint::describe,
    events::describe,
];

/// Describes the content of the file or folder at `path`.
///
/// # Errors
/// When nothing is there, when djinn did not write it, or when it is damaged.
pub fn inspect(path: &Path) -> Result<Description> {
    regular(path).map_err(Failure::input)?;
    for describe in DESCRIBERS {
        if let Some(description) = describe(path)? {
            return Ok(description);
        }
    }
    Err(Failure::input_message(format_args!("{} is nothing that can be inspected", path.display())).with_hint(
        "known: run folders, scene stores, event tables, checkpoints, samples and corpora; SQL and jq read the rest",
    ))
}

impl Description {
    fn new(kind: &'static str) -> Self {
        Self { kind, entries: Vec::new() }
    }

    fn with(mut self, name: &str, value: impl Into<Value>) -> Self {
        self.entries.push((name.to_owned(), value.into()));
        self
    }

    /// Adds a value of any type that can be written as JSON.
    fn with_json(self, name: &str, value: &impl serde::Serialize) -> Result<Self> {
        Ok(self.with(name, serde_json::to_value(value).map_err(anyhow::Error::from)?))
    }

    /// The description as one JSON object.
    pub fn json(&self) -> Value {
        let kind = ("kind".to_owned(), Value::from(self.kind));
        Value::Object(std::iter::once(kind).chain(self.entries.iter().cloned()).collect::<Map<_, _>>())
    }

    /// The description as indented text.
    pub fn text(&self) -> String {
        let mut text = format!("{}\n", self.kind);
        for (name, value) in &self.entries {
            write_value(&mut text, 1, name, value);
        }
        text
    }
}

/// From this depth on, entries that consist of single values take one line each: such entries come in great numbers.
const DEPTH_OF_LINES: usize = 4;

fn write_value(text: &mut String, depth: usize, name: &str, value: &Value) {
    let indent = "  ".repeat(depth);
    // A deeper name may be one of the data, such as a place, and stays as it is.
    let name = if depth == 1 { name.replace('_', " ") } else { one_line(name) };
    match value {
        Value::Null => {}
        Value::Object(object) if depth >= DEPTH_OF_LINES && object.values().all(is_single) => {
            let known = object.iter().filter(|(_, value)| !value.is_null());
            let entries: Vec<String> =
                known.map(|(name, value)| format!("{} {}", one_line(name), plain(value))).collect();
            text.push_str(&format!("{indent}{name}: {}\n", entries.join("; ")));
        }
        Value::Object(object) => {
            text.push_str(&format!("{indent}{name}\n"));
            object.iter().for_each(|(name, value)| write_value(text, depth + 1, name, value));
        }
        Value::Array(items) if !items.iter().all(is_single) => {
            text.push_str(&format!("{indent}{name}\n"));
            for (idx, item) in items.iter().enumerate() {
                write_value(text, depth + 1, &format!("{}", idx + 1), item);
            }
        }
        Value::Array(items) => {
            let items: Vec<String> = items.iter().map(plain).collect();
            // Sentences have commas of their own.
            if items.iter().any(|item| item.contains(", ")) {
                text.push_str(&format!("{indent}{name}\n"));
                items.iter().for_each(|item| text.push_str(&format!("{indent}  {item}\n")));
            } else {
                text.push_str(&format!("{indent}{name}: {}\n", items.join(", ")));
            }
        }
        value => text.push_str(&format!("{indent}{name}: {}\n", plain(value))),
    }
}

fn is_single(value: &Value) -> bool {
    !value.is_object() && !value.is_array()
}

fn plain(value: &Value) -> String {
    value.as_str().map_or_else(|| value.to_string(), one_line)
}

/// A text from elsewhere, such as a place, on one line, so that its line breaks cannot imitate lines of ours.
fn one_line(text: &str) -> String {
    text.replace('\n', "\\n").replace('\t', "\\t")
}

#[cfg(test)]
mod tests {
    use super::*;
    use serde_json::json;

    #[test]
    fn text_is_indented_and_leaves_out_what_is_unknown() {
        let description = Description::new("thing")
            .with("n_scenes", 3)
            .with("name", "a b")
            .with("unknown", Value::Null)
            .with("counts", json!({ "train": 2, "val": 1 }))
            .with("list", json!([1, 2]))
            .with("warnings", json!(["short, at one", "long, at two"]))
            .with("stages", json!([{ "id": "x" }]));
        assert_eq!(
            description.text(),
            "thing\n  n scenes: 3\n  name: a b\n  counts\n    train: 2\n    val: 1\n  list: 1, 2\n  warnings\n    \
             short, at one\n    long, at two\n  stages\n    1\n      id: x\n"
        );
        assert_eq!(description.json()["kind"], "thing");
    }

    #[test]
    fn foreign_files_are_the_users_mistake() {
        let folder = tempfile::tempdir().unwrap();
        fs_err::write(folder.path().join("x.txt"), "hello").unwrap();
        for path in [folder.path().to_owned(), folder.path().join("x.txt"), folder.path().join("missing")] {
            assert_eq!(inspect(&path).unwrap_err().blame, crate::engine::Blame::Input);
        }
    }
}
