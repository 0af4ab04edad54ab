//! A value as YAML in block style. Texts that YAML could read as anything else get JSON quotes.

use serde_json::Value;
use std::fmt::Write;

/// The value as a document.
pub(super) fn document(value: &Value) -> String {
    let mut text = String::new();
    block(value, 0, &mut text);
    text
}

/// Writes a value whose lines are indented by `indent`. The first line continues the current line.
fn block(value: &Value, indent: usize, text: &mut String) {
    let begin = |i: usize, text: &mut String| text.push_str(&" ".repeat(if i == 0 { 0 } else { indent }));
    match value {
        Value::Object(entries) if !entries.is_empty() => {
            for (i, (key, entry)) in entries.iter().enumerate() {
                begin(i, text);
                let _ = write!(text, "{}:", scalar(&Value::String(key.clone())));
                match is_leaf(entry) {
                    true => text.push(' '),
                    false => {
                        let _ = write!(text, "\n{}", " ".repeat(indent + 2));
                    }
                }
                block(entry, indent + 2, text);
            }
        }
        Value::Array(items) if !items.is_empty() => {
            for (i, item) in items.iter().enumerate() {
                begin(i, text);
                text.push_str("- ");
                block(item, indent + 2, text);
            }
        }
        leaf => {
            let _ = writeln!(text, "{}", scalar(leaf));
        }
    }
}

fn is_leaf(value: &Value) -> bool {
    match value {
        Value::Object(entries) => entries.is_empty(),
        Value::Array(items) => items.is_empty(),
        _ => true,
    }
}

/// Numbers, empty lists and the like are written as in JSON, and so are texts that might not be plain.
fn scalar(value: &Value) -> String {
    const SPECIAL: [&str; 9] = ["true", "false", "null", "yes", "no", "on", "off", "y", "n"];
    match value {
        Value::String(text) if is_plain(text) && !SPECIAL.contains(&text.to_lowercase().as_str()) => text.clone(),
        other => other.to_string(),
    }
}

fn is_plain(text: &str) -> bool {
    let begins = text.starts_with(|c: char| c.is_ascii_alphabetic() || c == '/');
    begins && text.chars().all(|c| c.is_ascii_alphanumeric() || "-_./".contains(c))
}

#[cfg(test)]
mod tests {
    use super::*;
    use serde_json::json;

    #[test]
    fn values_are_written_in_blocks_and_doubtful_texts_in_quotes() {
        let value = json!({"kind": "Job", "list": [{"a": 1, "b": ["x", ["y2"]]}, {}, []], "text": ["no", "1", "a: b", "$(X)/3", "", "caf\u{e9}\n"]});
        let expected = "kind: Job\nlist:\n  - a: 1\n    b:\n      - x\n      - - y2\n  - {}\n  - []\ntext:\n  - \"no\"\n  - \"1\"\n  \
            - \"a: b\"\n  - \"$(X)/3\"\n  - \"\"\n  - \"caf\u{e9}\\n\"\n";
        assert_eq!(document(&value), expected);
    }
}
