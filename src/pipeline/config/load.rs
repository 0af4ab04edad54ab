//! How does a TOML file, with the overrides of the command line, become a typed configuration, and which error does the
//! user read if it cannot?
//!
//! The file is parsed into a tree that knows the place of every value, the overrides are applied to the tree, and the
//! tree is deserialized once; so both kinds of mistakes are reported by the same code, each with its place.

use super::kinds::check_kinds;
use super::{Override, PipelineConfig, paths};
use crate::settings::{Issue, Unreadable};
use serde::Deserialize;
use std::fmt;
use std::ops::Range;
use std::path::{Path, PathBuf};
use toml::Spanned;
use toml::de::{DeTable, DeValue};

/// A configuration that cannot be used, with the place of the mistake.
#[derive(Debug, thiserror::Error)]
#[error("{place}{message}")]
pub struct ConfigError {
    /// Where the mistake is.
    pub place: ConfigPlace,
    /// The mistake.
    pub message: String,
    /// The name the user probably meant, if one is close.
    pub suggestion: Option<String>,
}

/// Where a mistake in a configuration is.
#[derive(Debug, Clone, PartialEq, Eq)]
pub enum ConfigPlace {
    /// A place in the file, with the line and column (both from 1) and the line's text.
    File {
        /// The file.
        path: PathBuf,
        /// Line, column and text of the line, if known.
        at: Option<(usize, usize, String)>,
    },
    /// An override, as written.
    Override(String),
    /// Not in any single place.
    Nowhere,
}

impl fmt::Display for ConfigPlace {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::File { path, at: Some((line, column, text)) } => {
                write!(f, "{}:{line}:{column}: in `{}`: ", path.display(), text.trim())
            }
            Self::File { path, at: None } => write!(f, "{}: ", path.display()),
            Self::Override(text) => write!(f, "--set {text}: "),
            Self::Nowhere => Ok(()),
        }
    }
}

/// Parses `text`, the content of the file at `path`, and applies `overrides` (`key=value`) in order.
pub fn parse(path: Option<&Path>, text: &str, overrides: &[String]) -> Result<PipelineConfig, ConfigError> {
    let source = Source { path, text, overrides };
    let parsed_overrides = overrides
        .iter()
        .map(|written| Override::parse(written).map_err(|why| source.override_error(written, why)))
        .collect::<Result<Vec<_>, _>>()?;
    // An override with a mistake is found by leaving out later ones: values inside some enums have no place of their
    // own.
    let table = |n_overrides: usize| -> Result<Spanned<DeTable<'_>>, ConfigError> {
        let root = DeTable::parse(text).map_err(|error| source.error(&error))?;
        let span = root.span();
        let mut table = root.into_inner();
        if let Some(folder) = path.and_then(Path::parent) {
            paths::take_from(folder, &mut table);
        }
        for (idx, (parsed, written)) in parsed_overrides.iter().zip(overrides).enumerate().take(n_overrides) {
            parsed.apply(&mut table, &source.override_span(idx)).map_err(|why| source.override_error(written, why))?;
        }
        inherit_seed(&mut table);
        Ok(Spanned::new(span, table))
    };
    let read = |table| PipelineConfig::deserialize(toml::de::Deserializer::from(table));
    let whole = table(overrides.len())?;
    check_kinds(whole.get_ref()).map_err(|issue| source.issue(whole.get_ref(), &issue))?;
    match read(whole.clone()) {
        Ok(config) => match config.check() {
            Ok(()) => Ok(config),
            Err(issue) => Err(source.issue(whole.get_ref(), &issue)),
        },
        Err(error) => {
            let mut told = source.error(&error);
            for (n_earlier, written) in overrides.iter().enumerate() {
                let says_so = |table| read(table).is_err_and(|found| found.message() == error.message());
                if says_so(table(n_earlier)?) {
                    break;
                }
                if says_so(table(n_earlier + 1)?) {
                    told.place = ConfigPlace::Override(written.clone());
                    break;
                }
            }
            Err(told)
        }
    }
}

/// Passes the seed of the run to `[generate]` if that has none of its own.
fn inherit_seed(table: &mut DeTable<'_>) {
    let Some(seed) = table.get("run").and_then(|run| run.get_ref().get("seed")).cloned() else { return };
    if let Some(DeValue::Table(section)) = table.get_mut("generate").map(Spanned::get_mut) {
        section.entry(Spanned::new(seed.span(), "seed".into())).or_insert(seed);
    }
}

/// The parsed texts, for finding places.
struct Source<'a> {
    path: Option<&'a Path>,
    text: &'a str,
    overrides: &'a [String],
}

impl Source<'_> {
    /// A span beyond the end of the file, which stands for an override.
    fn override_span(&self, idx: usize) -> Range<usize> {
        let at = self.text.len() + 1 + idx;
        at..at
    }

    fn place(&self, span: Option<Range<usize>>) -> ConfigPlace {
        let start = span.as_ref().map(|span| span.start);
        let written = start.and_then(|start| start.checked_sub(self.text.len() + 1));
        if let Some(written) = written.and_then(|idx| self.overrides.get(idx)) {
            return ConfigPlace::Override(written.clone());
        }
        let Some(path) = self.path else { return ConfigPlace::Nowhere };
        // A span of the whole document means nothing, for instance if a key is missing.
        let known = span.filter(|span| *span != (0..0) && *span != (0..self.text.len()));
        let at = known.and_then(|span| {
            let before = self.text.get(..span.start)?;
            let line_start = before.rfind('\n').map_or(0, |newline| newline + 1);
            let line = self.text[line_start..].lines().next().unwrap_or_default();
            Some((before.matches('\n').count() + 1, before[line_start..].chars().count() + 1, line.to_owned()))
        });
        ConfigPlace::File { path: path.to_owned(), at }
    }

    fn error(&self, error: &toml::de::Error) -> ConfigError {
        let (message, suggestion) = explain(error.message());
        ConfigError { place: self.place(error.span()), message, suggestion }
    }

    /// The error for an invalid setting; `table` knows its place.
    fn issue(&self, table: &DeTable<'_>, issue: &Issue) -> ConfigError {
        let mut parts = issue.key.split('.');
        let mut found = parts.next().and_then(|part| table.get(part));
        for part in parts {
            found = found.and_then(|value| match value.get_ref() {
                DeValue::Table(table) => table.get(part),
                DeValue::Array(array) => array.get(part.parse::<usize>().ok()?),
                _ => None,
            });
        }
        let place = self.place(found.map(Spanned::span));
        ConfigError { place, message: issue.to_string(), suggestion: None }
    }

    fn override_error(&self, written: &str, why: Unreadable) -> ConfigError {
        ConfigError { place: ConfigPlace::Override(written.to_owned()), message: why.0, suggestion: None }
    }
}

/// Rewords serde's `unknown field`, and finds the known name that is nearest to the written one.
fn explain(message: &str) -> (String, Option<String>) {
    let message = in_the_terms_of_users(&message.trim().replace('\n', " "));
    let quoted: Vec<&str> = message.split('`').skip(1).step_by(2).collect();
    let what = ["unknown field", "unknown variant"].into_iter().find(|what| message.starts_with(what));
    let (Some(what), Some((wrong, known))) = (what, quoted.split_first()) else {
        return (message, None);
    };
    let suggestion = known
        .iter()
        .map(|name| (strsim::damerau_levenshtein(wrong, name), *name))
        .filter(|(distance, name)| *distance <= 1 + name.len().min(wrong.len()) / 3)
        .min_by_key(|(distance, _)| *distance)
        .map(|(_, name)| name.to_owned());
    let kind = if what == "unknown field" { "key" } else { "value" };
    let known = if known.is_empty() { "none".to_owned() } else { known.join(", ") };
    (format!("unknown {kind} `{wrong}`; known here: {known}"), suggestion)
}

/// Describes values in the terms of users instead of types of Rust and serde.
fn in_the_terms_of_users(message: &str) -> String {
    const EXPECTED: [(&str, &str); 7] = [
        ("usize", "a whole number of at least 0"),
        ("u64", "a whole number of at least 0"),
        ("u32", "a whole number of at least 0"),
        ("f64", "a number"),
        ("a sequence", "a list"),
        ("a map", "a table"),
        ("an array of length 2", "a list of two"),
    ];
    let Some((found, expected)) = message.split_once(", expected ") else { return message.to_owned() };
    let found = found.replace("sequence", "list").replace("map", "table").replace("floating point ", "");
    let found = found.replace(" as i128", "").replace(" as u128", "");
    if expected.starts_with("struct ") {
        return format!("{found}, expected a table");
    }
    if expected.starts_with("internally tagged enum") {
        return format!("{found}, expected a table with a `kind`");
    }
    let known = EXPECTED.iter().find(|(rust, _)| expected.starts_with(rust));
    let expected = known.map_or_else(|| expected.to_owned(), |(rust, words)| expected.replacen(rust, words, 1));
    format!("{found}, expected {expected}")
}

#[cfg(test)]
mod tests {
    use super::*;

    fn error(text: &str, overrides: &[&str]) -> ConfigError {
        let overrides: Vec<String> = overrides.iter().map(|text| (*text).to_owned()).collect();
        parse(Some(Path::new("p.toml")), text, &overrides).unwrap_err()
    }

    #[test]
    fn an_unknown_key_is_placed_and_the_nearest_known_one_named() {
        let error = error("[run]\nseed = 1\nthread = 2\n", &[]);
        assert_eq!(error.place, ConfigPlace::File { path: "p.toml".into(), at: Some((3, 1, "thread = 2".to_owned())) });
        assert_eq!(error.suggestion.as_deref(), Some("threads"));
        assert!(error.to_string().starts_with("p.toml:3:1: in `thread = 2`: unknown key `thread`; known here: name"));
    }

    #[test]
    fn an_unknown_section_is_found_too_and_wild_guesses_are_not_made() {
        assert_eq!(error("[ingset]\n", &[]).suggestion.as_deref(), Some("ingest"));
        assert_eq!(error("[weather]\n", &[]).suggestion, None);
    }

    #[test]
    fn a_wrong_type_and_broken_syntax_are_placed() {
        assert!(error("[run]\nseed = \"x\"\n", &[]).to_string().contains("p.toml:2:8"));
        assert!(error("[run\n", &[]).to_string().contains("p.toml:1:"));
        for (text, expected) in [
            ("[evaluate]\nvalidity = [1.0, 2.0]", "evaluate.validity is a list, expected a table"),
            ("[generate]\nsampler = [[]]", "generate.sampler is a list, expected a table"),
            ("[[generate.sweeps]]\nname = 'a'\nobjectives = [[1]]", "objectives.0 is a list, expected a table"),
            ("generate = 1", "invalid type: integer `1`, expected a table"),
            ("[mine]\nbehaviors = [3]", "invalid type: integer `3`, expected a table with a `kind`"),
            ("[run]\nseed = 18446744073709551616", "expected a whole number of at least 0"),
            ("[run]\nname = 2024-01-01", "run.name is the date 2024-01-01, and no setting is a date"),
            ("[ingest]\nplaces = [\"a\", 07:32:00]", "ingest.places.1 is the date 07:32:00, and"),
            ("[run]\nseed = -1", "expected a whole number of at least 0"),
        ] {
            let said = error(text, &[]).to_string();
            assert!(said.contains(expected) && !said.contains("128") && !said.contains("Config"), "{said}");
        }
    }

    #[test]
    fn a_mistake_in_an_override_is_told_from_one_in_the_file() {
        let wrong_key = error("[run]\nseed = 1\n", &["run.threads=2", "run.sead=3"]);
        assert_eq!(wrong_key.place, ConfigPlace::Override("run.sead=3".to_owned()));
        assert_eq!(wrong_key.suggestion.as_deref(), Some("seed"));
        let wrong_value = error("", &["run.seed=red"]);
        assert_eq!(wrong_value.place, ConfigPlace::Override("run.seed=red".to_owned()));
        assert!(error("", &["run.seed"]).to_string().contains("missing `=`"));
        assert!(error("[run]\nseed = 1\n", &["run.seed.x=1"]).message.contains("`seed` is a value"));
    }

    #[test]
    fn overrides_win_and_strings_need_no_quotes() {
        let overrides = ["run.seed=3".to_owned(), "run.name=night drive".to_owned(), "run.seed=4".to_owned()];
        let config = parse(None, "[run]\nseed = 1\nthreads = 2\n", &overrides).unwrap();
        assert_eq!((config.run.seed, config.run.threads, config.run.name.as_str()), (4, 2, "night drive"));
    }

    #[test]
    fn generation_inherits_the_seed_of_the_run() {
        let seed = |overrides: &[&str]| {
            let overrides: Vec<String> = overrides.iter().map(|text| (*text).to_owned()).collect();
            parse(None, "[run]\nseed = 7\n[generate]\n", &overrides).unwrap().generate.unwrap().seed
        };
        assert_eq!((seed(&[]), seed(&["run.seed=8"]), seed(&["generate.seed=9"])), (7, 8, 9));
    }
}
