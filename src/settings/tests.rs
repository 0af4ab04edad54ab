//! Are settings beyond their ranges found where they are, and others left alone?

use super::*;
use serde::Serialize;
use std::collections::BTreeMap;

#[derive(Serialize, schemars::JsonSchema)]
struct Section {
    #[schemars(range(min = 1, max = 10))]
    count: Option<usize>,
    #[schemars(extend("exclusiveMinimum" = 0))]
    scale: f64,
    /// Without a range.
    free: f64,
    #[schemars(range(min = 2, max = 64), extend("multipleOf" = 2))]
    even: usize,
    kinds: Vec<Kind>,
    named: BTreeMap<String, Either>,
    /// Without a range, as seeds are.
    seed: u64,
    choice: Choice,
}

/// A name or a list, of which the first is itself one of several.
#[derive(Serialize, schemars::JsonSchema)]
#[serde(untagged)]
enum Choice {
    Name(Name),
    List(Vec<Volume>),
}

#[derive(Serialize, schemars::JsonSchema)]
#[serde(rename_all = "snake_case")]
enum Name {
    /// One.
    First,
    /// Another.
    Second,
}

#[derive(Serialize, schemars::JsonSchema)]
#[serde(tag = "kind", rename_all = "snake_case")]
enum Kind {
    Loud(Volume),
    Soft(Volume2),
    Silent,
}

#[derive(Serialize, schemars::JsonSchema)]
struct Volume {
    #[schemars(range(min = 5.0))]
    level: f64,
}

#[derive(Serialize, schemars::JsonSchema)]
struct Volume2 {
    #[schemars(range(min = 0.0), extend("exclusiveMaximum" = 1))]
    level: f64,
}

#[derive(Serialize, schemars::JsonSchema)]
#[serde(untagged)]
enum Either {
    Number(f64),
    Inner(Volume),
}

fn section() -> Section {
    let named = [("a".to_owned(), Either::Inner(Volume { level: 9.0 }))];
    Section {
        count: None,
        scale: 1.0,
        free: f64::INFINITY,
        even: 4,
        kinds: vec![Kind::Silent, Kind::Soft(Volume2 { level: 0.5 })],
        named: named.into(),
        seed: 1,
        choice: Choice::Name(Name::First),
    }
}

#[test]
fn numbers_within_their_ranges_pass() {
    assert_eq!(check_ranges(&section()), Ok(()));
    assert_eq!(check_ranges(&Section { count: Some(10), ..section() }), Ok(()));
    assert_eq!(check_ranges(&Section { seed: u64::MAX, choice: Choice::Name(Name::Second), ..section() }), Ok(()));
}

#[test]
fn what_is_beyond_is_told_by_its_place_value_and_range() {
    let named = |either| BTreeMap::from([("a".to_owned(), either)]);
    for (wrong, expected) in [
        (Section { count: Some(0), ..section() }, "count is 0, expected 1 to 10"),
        (Section { count: Some(11), ..section() }, "count is 11, expected 1 to 10"),
        (Section { count: Some(usize::MAX), ..section() }, "count is 18446744073709551615, expected 1 to 10"),
        (Section { seed: u64::MAX, scale: f64::NAN, ..section() }, "scale is NaN, expected a number"),
        (Section { seed: 1 << 63, even: 5, ..section() }, "even is 5, expected 2 to 64, a multiple of 2"),
        (
            Section { choice: Choice::List(vec![Volume { level: 1.0 }]), ..section() },
            "choice.0.level is 1, expected a number of at least 5",
        ),
        (Section { scale: 0.0, ..section() }, "scale is 0, expected a positive number"),
        (Section { scale: -1e-300, ..section() }, "scale is -1e-300, expected a positive number"),
        (Section { scale: f64::INFINITY, ..section() }, "scale is inf, expected a positive number"),
        (Section { scale: f64::NAN, ..section() }, "scale is NaN, expected a number"),
        (Section { free: f64::NAN, ..section() }, "free is NaN, expected a number"),
        (Section { even: 5, ..section() }, "even is 5, expected 2 to 64, a multiple of 2"),
        (
            Section { kinds: vec![Kind::Silent, Kind::Soft(Volume2 { level: 1.0 })], ..section() },
            "kinds.1.level is 1, expected 0 up to below 1",
        ),
        (
            Section { kinds: vec![Kind::Loud(Volume { level: 1.0 })], ..section() },
            "kinds.0.level is 1, expected a number of at least 5",
        ),
        (
            Section { named: named(Either::Inner(Volume { level: 0.5 })), ..section() },
            "named.a.level is 0.5, expected a number of at least 5",
        ),
        (Section { named: named(Either::Number(f64::NAN)), ..section() }, "named.a is NaN, expected a number"),
    ] {
        assert_eq!(check_ranges(&wrong).unwrap_err().to_string(), expected);
    }
}

#[test]
fn settings_that_do_not_go_together_are_told() {
    assert_eq!(ascending(("low", 1.0), ("high", 1.0)), Ok(()));
    let upside_down = ascending(("low", 2.0), ("high", 1.0)).unwrap_err().within("section");
    assert_eq!(upside_down.to_string(), "section.low is 2, expected at most high, which is 1");
    assert!(ascending(("low", f64::NAN), ("high", 1.0)).is_err());
    assert_eq!(distinct("list", &[1.0, 2.0]), Ok(()));
    assert_eq!(distinct("list", &["a", "b", "a"]).unwrap_err().to_string(), "list.2 is a, which is already listed");
    assert_eq!(printable_name("name", "night drive"), Ok(()));
    assert_eq!(printable_name("name", &"ä".repeat(100)), Ok(()));
    let long = printable_name("name", &"ä".repeat(101)).unwrap_err().to_string();
    assert_eq!(long, "name has 202 bytes, expected at most 200");
    assert!(printable_name("name", "").is_err() && printable("title", "").is_ok());
    let escaped = printable_name("name", "a\u{1b}[31m").unwrap_err().to_string();
    assert!(escaped.contains("\\u{1b}") && !escaped.contains('\u{1b}'), "{escaped}");
}
