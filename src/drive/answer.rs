//! Reads what a planner sends, and names what is wrong with it in the words of the protocol.

use super::protocol::{Action, FromPlanner, Peek};
use crate::simulate::plain;
use serde::de::{Deserialize, Deserializer, MapAccess, Visitor};
use serde_json::Value;
use std::fmt;

/// The keys of each message beside its type.
const KEYS: [(&str, &[&str]); 2] =
    [("action", &["trajectory", "acceleration_mps2", "curvature_1pm"]), ("peek", &["n"])];

/// A JSON object with its keys as they are written, equal ones included.
struct Object(Vec<(String, Value)>);

impl<'de> Deserialize<'de> for Object {
    fn deserialize<D: Deserializer<'de>>(deserializer: D) -> Result<Self, D::Error> {
        struct Entries;
        impl<'de> Visitor<'de> for Entries {
            type Value = Object;

            fn expecting(&self, formatter: &mut fmt::Formatter<'_>) -> fmt::Result {
                formatter.write_str("a JSON object")
            }

            fn visit_map<A: MapAccess<'de>>(self, mut map: A) -> Result<Object, A::Error> {
                let mut entries = Vec::new();
                while let Some(entry) = map.next_entry()? {
                    entries.push(entry);
                }
                Ok(Object(entries))
            }
        }
        deserializer.deserialize_map(Entries)
    }
}

/// The message on a line of a planner.
///
/// # Errors
/// What is wrong with it, in words that follow "it".
pub(super) fn read(line: &str) -> Result<FromPlanner, String> {
    let Object(entries) = serde_json::from_str(line).map_err(|error| match error.is_data() {
        true => "it is no JSON object".to_owned(),
        false => error.to_string(),
    })?;
    let mut keys: Vec<&str> = entries.iter().map(|(key, _)| key.as_str()).collect();
    keys.sort_unstable();
    if let Some(pair) = keys.windows(2).find(|pair| pair[0] == pair[1]) {
        return Err(format!("{} is there twice", pair[0]));
    }
    // As in many languages, null is as good as nothing.
    let value = |name: &str| entries.iter().find(|(key, value)| key == name && !value.is_null()).map(|entry| &entry.1);
    let kind = value("type").ok_or("type is missing, expected \"action\" or \"peek\"")?;
    let known = KEYS.iter().find(|(name, _)| kind == name);
    let (_, known) = known.ok_or_else(|| format!("type is {}, expected \"action\" or \"peek\"", shown(kind)))?;
    if let Some(key) = keys.iter().find(|key| **key != "type" && !known.contains(key)) {
        let near = known.iter().min_by_key(|known| strsim::damerau_levenshtein(key, known));
        let alike = near.filter(|near| near.starts_with(key) || strsim::damerau_levenshtein(key, near) <= 4);
        let near = alike.map_or_else(String::new, |near| format!("; did you mean {near}?"));
        return Err(format!("{key} is no key of {}, expected {}{near}", shown(kind), known.join(", ")));
    }
    if kind == "peek" {
        let n = value("n").ok_or("n is missing, expected how many futures")?;
        let n = n.as_u64().and_then(|n| usize::try_from(n).ok());
        return n.map(|n| FromPlanner::Peek(Peek { n })).ok_or_else(|| "n is no whole number from 1 on".to_owned());
    }
    let number = |name: &str| value(name).map(|value| finite(value, name)).transpose();
    let trajectory = value("trajectory").map(points).transpose()?;
    let (acceleration_mps2, curvature_1pm) = (number("acceleration_mps2")?, number("curvature_1pm")?);
    Ok(FromPlanner::Action(Action { trajectory, acceleration_mps2, curvature_1pm }))
}

fn points(value: &Value) -> Result<Vec<[f64; 3]>, String> {
    const EXPECTED: &str = "expected [[x, y, heading], …]";
    let points = value.as_array().ok_or_else(|| format!("trajectory is {}, {EXPECTED}", shown(value)))?;
    let point = |(i, point): (usize, &Value)| {
        let name = format!("point {i} of the trajectory");
        let numbers = point.as_array().and_then(|numbers| <&[Value; 3]>::try_from(numbers.as_slice()).ok());
        let [x, y, heading] = numbers.ok_or_else(|| format!("{name} is {}, {EXPECTED}", shown(point)))?;
        Ok([finite(x, &name)?, finite(y, &name)?, finite(heading, &name)?])
    };
    points.iter().enumerate().map(point).collect()
}

fn finite(value: &Value, name: &str) -> Result<f64, String> {
    let number = value.as_f64().filter(|number| number.is_finite());
    number.ok_or_else(|| format!("{name} has {}, expected a number", shown(value)))
}

fn shown(value: &Value) -> String {
    let text = value.as_f64().map_or_else(|| value.to_string(), plain);
    if text.chars().count() > 60 { text.chars().take(60).chain(['…']).collect() } else { text }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_is_wrong_is_named_in_the_words_of_the_protocol() {
        let action = |more: &str| read(&format!("{{\"type\": \"action\", {more}}}"));
        let FromPlanner::Action(found) = action("\"acceleration_mps2\": 1, \"curvature_1pm\": null").unwrap() else {
            panic!("no action")
        };
        assert_eq!(found, Action { acceleration_mps2: Some(1.0), ..Action::default() });
        assert!(matches!(read("{\"n\": 3, \"type\": \"peek\"}"), Ok(FromPlanner::Peek(Peek { n: 3 }))));
        for (more, why) in [
            ("\"curvature\": 0.05", "curvature is no key of \"action\""),
            ("\"curvature\": 0.05", "; did you mean curvature_1pm?"),
            ("\"acceleration\": 0.05", "; did you mean acceleration_mps2?"),
            ("\"trajectry\": []", "; did you mean trajectory?"),
            ("\"steer\": 1", "expected trajectory, acceleration_mps2, curvature_1pm"),
            ("\"acceleration_mps2\": 1, \"acceleration_mps2\": 2", "acceleration_mps2 is there twice"),
            ("\"acceleration_mps2\": \"1\"", "acceleration_mps2 has \"1\", expected a number"),
            ("\"trajectory\": [[1, 2]]", "point 0 of the trajectory is [1,2], expected [[x, y, heading], …]"),
            ("\"trajectory\": [[1, 2, 3], [1, true, 3]]", "point 1 of the trajectory has true"),
            ("\"trajectory\": 1e300", "trajectory is 1.000e300,"),
        ] {
            let found = action(more).unwrap_err();
            assert!(found.contains(why), "{found}");
        }
        assert!(!action("\"steer\": 1").unwrap_err().contains("did you mean"));
        for (line, why) in [
            ("[1]", "no JSON object"),
            ("{}", "type is missing"),
            ("{\"type\": \"go\"}", "type is \"go\", expected \"action\" or \"peek\""),
            ("{\"type\": \"peek\", \"n\": -1}", "n is no whole number"),
            ("{\"type\": \"action\", \"acceleration_mps2\": NaN}", "line 1 column"),
        ] {
            let found = read(line).unwrap_err();
            assert!(found.contains(why), "{found}");
        }
    }
}
