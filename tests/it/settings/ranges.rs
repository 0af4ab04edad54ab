//! Every bound that `schemas/config.schema.json` states, as settings beyond it and at it.

use serde_json::Value as Schema;
use std::collections::BTreeSet;

/// A bounded number, or a choice among names, and settings of it.
#[derive(Debug, PartialEq)]
pub(super) struct Case {
    /// Its key, as messages name it.
    pub(super) key: String,
    /// Settings that are refused.
    pub(super) beyond: Vec<String>,
    /// Values at the ends of the range, which are not: `key is VALUE` must not be said of them.
    pub(super) ends: Vec<(String, String)>,
    /// The words common to every refusal, that of NaN included.
    pub(super) said: String,
    /// The expectation that refusals name: the bounds, or the names.
    pub(super) words: Vec<String>,
}

pub(super) fn cases(root: &Schema) -> Vec<Case> {
    let mut cases = Vec::new();
    Walk { root, seen: BTreeSet::new(), cases: &mut cases }.visit(root, &Place::default(), &mut Vec::new());
    cases
}

/// Where a value stands: `before` + value + `after` is a setting.
#[derive(Default, Clone)]
struct Place {
    key: String,
    before: String,
    after: String,
    /// The entries that the table needs beside those of its kind.
    with: String,
}

impl Place {
    fn setting(&self, value: &str) -> String {
        format!("{}{value}{}", self.before, self.after)
    }

    /// An entry of the table here, which is written out with `others`, or exists already.
    fn entry(&self, name: &str, others: Option<&str>) -> Self {
        let key = if self.key.is_empty() { name.to_owned() } else { format!("{}.{name}", self.key) };
        match others {
            None => Self { before: format!("{key}="), key, ..Self::default() },
            Some(others) => Self {
                before: format!("{}{{ {others}{name} = ", self.before),
                after: format!(" }}{}", self.after),
                with: String::new(),
                key,
            },
        }
    }
}

struct Walk<'a> {
    root: &'a Schema,
    /// The definitions that have all their cases; where one is used again, one setting of each will do.
    seen: BTreeSet<&'a str>,
    cases: &'a mut Vec<Case>,
}

impl<'a> Walk<'a> {
    fn visit(&mut self, schema: &'a Schema, place: &Place, above: &mut Vec<&'a str>) {
        if let Some(name) = schema["$ref"].as_str() {
            if !above.contains(&name) {
                let (is_new, before) = (self.seen.insert(name), self.cases.len());
                above.push(name);
                self.visit(self.referred(name), place, above);
                above.pop();
                let repeated = self.cases[before..].iter_mut().filter(|_| !is_new);
                repeated.for_each(|case| (case.beyond.truncate(1), case.ends.clear()).1);
            }
            return;
        }
        self.cases.extend(case(schema, place));
        for part in list(&schema["allOf"]).chain(list(&schema["oneOf"])).chain(list(&schema["anyOf"])) {
            let with = place.with.clone() + &self.needed(schema, "");
            self.visit(part, &Place { with, ..place.clone() }, above);
        }
        if schema["items"].is_object() {
            let n = schema["minItems"].as_u64().unwrap_or(1).max(1) as usize;
            let more = format!(", {}", self.sample(&schema["items"])).repeat(n - 1);
            let item = Place {
                key: format!("{}.0", place.key),
                before: format!("{}[", place.before),
                after: format!("{more}]{}", place.after),
                with: String::new(),
            };
            self.visit(&schema["items"], &item, above);
        }
        for (name, property) in schema["properties"].as_object().into_iter().flatten() {
            let is_written_out = place.before.contains(['[', '{']) || !schema["required"].is_null();
            let others = is_written_out.then(|| place.with.clone() + &self.required(schema, name));
            self.visit(property, &place.entry(name, others.as_deref()), above);
        }
    }

    fn referred(&self, name: &str) -> &'a Schema {
        self.root.pointer(name.trim_start_matches('#')).unwrap()
    }

    /// The entries that a table must have, but for `name`.
    fn required(&self, schema: &Schema, name: &str) -> String {
        let own = self.needed(schema, name);
        // A table with entries of its own that is one of several otherwise.
        let one = list(&schema["oneOf"]).next().filter(|_| !schema["properties"].is_null());
        own + &one.map(|one| self.required(one, name)).unwrap_or_default()
    }

    /// The keys that it must have, whatever its kind.
    fn needed(&self, schema: &Schema, name: &str) -> String {
        let needed = list(&schema["required"]).filter_map(Schema::as_str).filter(|other| *other != name);
        needed.map(|other| format!("{other} = {}, ", self.sample(&schema["properties"][other]))).collect()
    }

    /// A value that the schema allows.
    fn sample(&self, schema: &Schema) -> String {
        if let Some(name) = schema["$ref"].as_str() {
            return self.sample(self.referred(name));
        }
        if let Some(first) = list(&schema["oneOf"]).chain(list(&schema["anyOf"])).next() {
            return self.sample(first);
        }
        if let Some(text) = schema["const"].as_str().or(schema["enum"][0].as_str()) {
            return format!("{text:?}");
        }
        let least = schema["minimum"].as_f64().unwrap_or_default().max(1.0);
        match schema["type"].as_str() {
            Some("object") => format!("{{ {} }}", self.required(schema, "").trim_end_matches(", ")),
            Some("array") => "[]".to_owned(),
            Some("integer") => format!("{least}"),
            Some("number") => format!("{:?}", schema["maximum"].as_f64().unwrap_or(least).min(least)),
            Some("boolean") => "true".to_owned(),
            _ => "\"x\"".to_owned(),
        }
    }
}

fn list(schema: &Schema) -> impl Iterator<Item = &Schema> {
    schema.as_array().into_iter().flatten()
}

/// The settings of a number with bounds, or of one of several names.
fn case(schema: &Schema, place: &Place) -> Option<Case> {
    let names: Vec<String> = list(&schema["oneOf"]).filter_map(|one| Some(one["const"].as_str()?.to_owned())).collect();
    if !names.is_empty() && names.len() == list(&schema["oneOf"]).count() {
        let beyond = vec![place.setting("\"nonsense\"")];
        let said = "unknown value `nonsense`".to_owned();
        return Some(Case { key: place.key.clone(), beyond, ends: Vec::new(), said, words: names });
    }
    let bound = |name: &str| schema[name].as_f64();
    let (low, above) = (bound("minimum"), bound("exclusiveMinimum"));
    let (high, below, divisor) = (bound("maximum"), bound("exclusiveMaximum"), bound("multipleOf"));
    let bounds: Vec<f64> = [low, above, high, below].into_iter().flatten().collect();
    if bounds.is_empty() {
        return None;
    }
    let is_of_type = |name: &str| schema["type"] == name || list(&schema["type"]).any(|one| one == name);
    let is_whole = is_of_type("integer");
    let step = if is_whole { 1.0 } else { 0.5 };
    let written = |value: f64| if is_whole { format!("{value}") } else { format!("{value:?}") };
    let beyond =
        [low.map(|low| low - step), above, high.map(|high| high + step), below, divisor.and(low.map(|low| low + 1.0))];
    // Numbers below 0 are none of those that count.
    let beyond = beyond.into_iter().flatten().filter(|value| !is_whole || *value >= 0.0).map(written);
    let others: &[&str] = match schema["format"].as_str() {
        Some("uint" | "uint64") if high.is_some() => &["9223372036854775808", "18446744073709551615"],
        _ if is_whole => &[],
        _ => &["inf", "nan"],
    };
    // Words say "a positive number" for one beyond 0.
    let words = bounds.iter().filter(|bound| **bound != 0.0).map(f64::to_string).collect();
    Some(Case {
        key: place.key.clone(),
        beyond: beyond
            .chain(others.iter().map(|other| (*other).to_owned()))
            .map(|value| place.setting(&value))
            .collect(),
        said: format!("{} is ", place.key),
        ends: [low, high].into_iter().flatten().map(|end| (place.setting(&written(end)), end.to_string())).collect(),
        words,
    })
}
