//! The tags of a scenario's assessment: acceptance, criticality, failed validity checks.
//!
//! Names, units and definitions are those of the columns of the scenario table, so that tags agree with the corpus.

use super::{quantity, rounded, tag, value};
use crate::metrics::Check;
use crate::scenario::Assessment;
use crate::scene::Scene;
use crate::store::TableSchema;
use serde_json::{Map, Value, json};

/// A number of an assessment, under the name of its column.
type Number = (&'static str, fn(&Assessment) -> Option<f64>);
/// A truth value of an assessment, under the name of its column.
type Flag = (&'static str, fn(&Assessment) -> Option<bool>);

const NUMBERS: [Number; 25] = [
    ("plausibility", |judged| judged.plausibility),
    ("recorded_likeness", |judged| judged.recorded_likeness),
    ("pair_min_ttc_s", |judged| judged.pair?.min_ttc_s),
    ("pair_tet_s", |judged| Some(judged.pair?.tet_s)),
    ("pair_tit_s2", |judged| Some(judged.pair?.tit_s2)),
    ("pair_max_drac_mps2", |judged| Some(judged.pair?.max_drac_mps2)),
    ("pair_min_headway_s", |judged| judged.pair?.min_headway_s),
    ("pair_pet_s", |judged| judged.pair?.pet_s),
    ("pair_min_distance_m", |judged| Some(judged.pair?.min_distance_m)),
    ("scene_min_ttc_s", |judged| judged.scene?.min_ttc_s),
    ("scene_max_drac_mps2", |judged| Some(judged.scene?.max_drac_mps2)),
    ("scene_min_distance_m", |judged| Some(judged.scene?.min_distance_m)),
    ("careful_braking_from_s", |judged| judged.careful?.braking_from_s),
    ("careful_margin_s", |judged| judged.careful?.margin_s),
    ("intrusion_ttc_s", |judged| judged.careful?.intrusion_ttc_s),
    ("end_contact_s", |judged| judged.ending?.contact_s),
    ("end_required_deceleration_mps2", |judged| Some(judged.ending?.required_deceleration_mps2)),
    ("end_remaining_mps", |judged| judged.ending?.remaining_mps),
    ("mistake_s", |judged| judged.explanation?.mistake_s),
    ("nearest_recorded_event", |judged| judged.nearest_recorded_event),
    ("nearest_scenario_m", |judged| judged.nearest_scenario_m),
    ("rate_per_1000_km", |judged| judged.rate?.per_1000_km),
    ("rate_per_hour", |judged| judged.rate?.per_hour),
    ("rate_low", |judged| Some(judged.rate?.interval?.low)),
    ("rate_high", |judged| Some(judged.rate?.interval?.high)),
];

const FLAGS: [Flag; 5] = [
    ("accepted", |judged| Some(judged.accepted)),
    ("valid", |judged| Some(judged.is_valid())),
    ("preventable", |judged| Some(judged.careful?.preventable)),
    ("avoidance_required", |judged| judged.careful?.avoidance_required),
    ("subject_reacts", |judged| Some(judged.ending?.subject_reacts)),
];

const NEAR_DUPLICATE_OF: &str = "near_duplicate_of";
const RATE_SOURCE: &str = "rate_source";
const CAUSE: &str = "cause";

/// The tag of the assessment, and one for each failed validity check. Values that are not defined for the scenario are
/// left out.
pub(super) fn tags(scene: &Scene, judged: &Assessment) -> Vec<Value> {
    let columns = AssessmentColumns::new();
    let number =
        |(name, of): &Number| of(judged).map(|number| quantity(name, rounded(number), &columns.of(name, "unit")));
    let flag = |(name, of): &Flag| of(judged).map(|flag| value(name, flag));
    let near = judged.near_duplicate_of.as_ref().map(|id| value(NEAR_DUPLICATE_OF, id));
    let cause = judged.explanation.map(|explanation| value(CAUSE, explanation.cause.id()));
    let text = near.into_iter().chain(cause).chain(judged.rate.map(|rate| value(RATE_SOURCE, rate.source.name())));
    let whole = tag(
        "assessment",
        &json!({
            "text": text.collect::<Vec<_>>(),
            "boolean": FLAGS.iter().filter_map(flag).collect::<Vec<_>>(),
            "num": NUMBERS.iter().filter_map(number).collect::<Vec<_>>(),
        }),
    );
    let violations = judged.violations.iter().map(|violation| {
        let unit = violation.check.unit();
        tag(
            "violation",
            &json!({
                "text": [value("check", violation.check.id()), value("track", &violation.track.0)],
                "num": [
                    quantity("time_s", rounded(violation.timestep as f64 * scene.dt_s), "s"),
                    quantity("value", rounded(violation.value), unit),
                    quantity("limit", rounded(violation.limit), unit),
                ],
            }),
        )
    });
    std::iter::once(whole).chain(violations).collect()
}

/// The definitions of these tags.
pub(super) fn definitions() -> Map<String, Value> {
    let columns = AssessmentColumns::new();
    let names = FLAGS.iter().map(|(name, _)| *name).chain(NUMBERS.iter().map(|(name, _)| *name));
    let data: Map<String, Value> = names
        .chain([NEAR_DUPLICATE_OF, RATE_SOURCE])
        .map(|name| (name.to_owned(), Value::from(columns.of(name, "description"))))
        .collect();
    let checks: Map<String, Value> =
        Check::ALL.into_iter().map(|check| (check.id().to_owned(), Value::from(check.description()))).collect();
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

/// The metadata of the scenario table's columns.
struct AssessmentColumns(Option<TableSchema>);

impl AssessmentColumns {
    fn new() -> Self {
        Self(TableSchema::all().into_iter().find(|table| table.name == "scenario"))
    }

    /// The `unit` or the `description` of a column; empty if there is none.
    fn of(&self, name: &str, key: &str) -> String {
        let field = self.0.iter().flat_map(|table| &table.fields).find(|field| field.name() == name);
        field.and_then(|field| field.metadata().get(key).cloned()).unwrap_or_default()
    }
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
        let tags = tags(&testing::scene(), &judgment());
        assert_eq!(
            tags.iter().map(|tag| tag["type"].as_str().unwrap()).collect::<Vec<_>>(),
            ["assessment", "violation"]
        );
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

    #[test]
    fn every_figure_is_a_column_with_unit_and_description() {
        let columns = AssessmentColumns::new();
        for name in NUMBERS.iter().map(|(name, _)| *name) {
            assert!(!["", "none"].contains(&columns.of(name, "unit").as_str()), "{name} has no unit");
        }
        let definitions = definitions();
        for (name, definition) in definitions["assessment"]["data"].as_object().unwrap() {
            assert!(definition.as_str().unwrap().len() > 10, "{name} has no definition");
        }
    }
}
