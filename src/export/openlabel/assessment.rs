//! The tags of a scenario's assessment: acceptance, criticality, failed validity checks.
//!
//! Names, units and definitions are those of the columns of the scenario table, so that tags agree with the corpus.

use super::{quantity, rounded, tag, value};
use crate::metrics::Check;
use crate::scenario::Assessment;
use crate::scene::Scene;
use crate::store::{Result, assessment_columns, assessment_fields};
use arrow::array::{Array, AsArray};
use arrow::datatypes::{DataType, Field, Float64Type};
use serde_json::{Map, Value, json};

/// The tag of the assessment, and one for each failed validity check. Values that are not defined for the scenario are
/// left out.
///
/// # Errors
/// [`crate::store::Error::Invalid`] when the assessment cannot be a row of the scenario table.
pub(super) fn tags(scene: &Scene, judged: &Assessment) -> Result<Vec<Value>> {
    let (mut text, mut flags, mut numbers) = (Vec::new(), Vec::new(), Vec::new());
    for (field, array) in assessment_columns(judged)?.iter().filter(|(_, array)| array.is_valid(0)) {
        let name = field.name();
        match field.data_type() {
            DataType::Utf8 => text.push(value(name, array.as_string::<i32>().value(0))),
            DataType::Boolean => flags.push(value(name, array.as_boolean().value(0))),
            DataType::Float64 => {
                let number = array.as_primitive::<Float64Type>().value(0);
                numbers.push(quantity(name, rounded(number), metadata(field, "unit")));
            }
            // Failed checks have tags of their own.
            _ => {}
        }
    }
    let whole = tag("assessment", &json!({ "text": text, "boolean": flags, "num": numbers }));
    let violations = judged.violations.iter().map(|violation| {
        let unit = violation.check.unit();
        tag(
            "violation",
            &json!({
                "text": [value("check", violation.check.name()), value("track", &violation.track.0)],
                "num": [
                    quantity("time_s", rounded(violation.timestep as f64 * scene.dt_s), "s"),
                    quantity("value", rounded(violation.value), unit),
                    quantity("limit", rounded(violation.limit), unit),
                ],
            }),
        )
    });
    Ok(std::iter::once(whole).chain(violations).collect())
}

/// The definitions of these tags.
pub(super) fn definitions() -> Map<String, Value> {
    let fields = assessment_fields();
    let own = fields.iter().filter(|field| !field.data_type().is_nested());
    let data: Map<String, Value> =
        own.map(|field| (field.name().clone(), Value::from(metadata(field, "description")))).collect();
    let checks: Map<String, Value> =
        Check::ALL.into_iter().map(|check| (check.name().to_owned(), Value::from(check.description()))).collect();
    let assessment = json!({
        "definition": "Judgments of the scenario, independent of what guided it; undefined ones are left out. The \
                       attribute unit of a number names its unit, 1 for shares and ratios.",
        "data": data,
    });
    let violation = json!({
        "definition": "A validity check that the scenario fails, at its worst place. A scenario without such a tag is \
                       valid.",
        "data": {
            "check": "Which check.",
            "track": "The road user at fault; for a collision, the first of the two.",
            "time_s": "When, seconds after the first timestep.",
            "value": "The value, in the unit of the check.",
            "limit": "What is allowed.",
        },
        "checks": checks,
    });
    Map::from_iter([("assessment".to_owned(), assessment), ("violation".to_owned(), violation)])
}

/// The `unit` or the `description` of a column; empty if there is none.
fn metadata<'f>(field: &'f Field, key: &str) -> &'f str {
    field.metadata().get(key).map_or("", |text| text.as_str())
}

#[cfg(test)]
pub(super) mod tests {
    use super::*;
    use crate::export::testing;
    use crate::metrics::{CarefulJudgment, PairCriticality, SceneCriticality, Violation};

    /// A judgment with every part except the time headway.
    pub(in crate::export::openlabel) fn judgment() -> Assessment {
        let pair = PairCriticality {
            min_ttc_s: Some(1.25),
            tet_s: 0.4,
            tit_s2: 0.05,
            max_drac_mps2: 3.5,
            min_headway_s: None,
            pet_s: Some(0.7),
            min_distance_m: 2.125,
        };
        let careful = CarefulJudgment {
            preventable: true,
            braking_from_s: Some(0.2),
            margin_s: None,
            intrusion_ttc_s: Some(2.5),
            avoidance_required: Some(true),
        };
        Assessment {
            accepted: false,
            violations: vec![Violation {
                check: Check::Jerk,
                track: "2".into(),
                timestep: 7,
                value: 31.25,
                limit: 25.0,
            }],
            plausibility: Some(0.96875),
            recorded_likeness: Some(0.4375),
            pair: Some(pair),
            scene: Some(SceneCriticality { min_ttc_s: Some(1.0), max_drac_mps2: 4.0, min_distance_m: 1.5 }),
            careful: Some(careful),
            ending: None,
            explanation: None,
            nearest_recorded_event: Some(0.5),
            nearest_scenario_m: Some(0.125),
            near_duplicate_of: Some("0a1b9".to_owned()),
            rate: None,
        }
    }

    #[test]
    fn figures_have_units_and_what_is_not_defined_is_left_out() {
        let tags = tags(&testing::scene(), &judgment()).unwrap();
        let found = tags.iter().map(|tag| tag["type"].as_str().unwrap()).collect::<Vec<_>>();
        assert_eq!(found, ["assessment", "violation"]);
        let entry = |tag: usize, kind: &str, name: &str| -> Option<Value> {
            tags[tag]["tag_data"][kind].as_array().unwrap().iter().find(|entry| entry["name"] == name).cloned()
        };
        let with_unit = |name: &str, number: f64, unit: &str| {
            json!({ "name": name, "type": "value", "val": number,
                "attributes": { "text": [{ "name": "unit", "type": "value", "val": unit }] } })
        };
        for (name, number, unit) in [
            ("pair_min_ttc_s", 1.25, "s"),
            ("pair_max_drac_mps2", 3.5, "m/s^2"),
            ("scene_min_distance_m", 1.5, "m"),
            ("pair_tit_s2", 0.05, "s^2"),
            ("plausibility", 0.968_75, "1"),
            ("recorded_likeness", 0.4375, "1"),
        ] {
            assert_eq!(entry(0, "num", name).unwrap(), with_unit(name, number, unit));
        }
        assert_eq!(entry(0, "num", "pair_min_headway_s"), None);
        assert_eq!(entry(0, "boolean", "accepted").unwrap()["val"], false);
        assert_eq!(entry(0, "boolean", "valid").unwrap()["val"], false);
        assert_eq!(entry(0, "boolean", "preventable").unwrap()["val"], true);
        assert_eq!(entry(0, "text", "near_duplicate_of").unwrap()["val"], "0a1b9");
        // Jerk at the eighth of timesteps at 10 Hz.
        assert_eq!(entry(1, "num", "time_s").unwrap(), with_unit("time_s", 0.7, "s"));
        assert_eq!(entry(1, "num", "value").unwrap(), with_unit("value", 31.25, "m/s^3"));
        assert_eq!(entry(1, "text", "check").unwrap()["val"], "jerk");
    }
}
