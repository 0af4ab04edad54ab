//! OpenLABEL 1.0: tags by which databases find scenarios.

mod assessment;

use super::selection::is_accepted;
use super::{Error, ExportOutcome, Exporter, Item, Result, Written};
use crate::behavior::{self, BehaviorEvent, EventLabel};
use crate::scene::Scene;
use crate::store::{unit_of_name, write_json_atomically};
use serde_json::{Value, json};
use std::path::{Path, PathBuf};

pub(super) const NOTES: &str = "<id>.json: OpenLABEL 1.0.0 tags, valid against its schema: what was asked for, what \
    was found, who has which role, parameters of events, what was judged (decision, criticality, failed checks, each \
    number with its unit), provenance. Types of tags are defined in ontology.json, which lies beside them; where \
    ASAM's own ontology has a tag for the behavior, that is there, too. No states: use another format for them.";

/// The file with the definitions of our tags.
const ONTOLOGY_FILE: &str = "ontology.json";
/// ASAM's ontology of scenario tags.
const ASAM_ONTOLOGY: &str = "https://openlabel.asam.net/V1-0-0/ontologies/openlabel_ontology_scenario_tags.ttl";
/// The numbers of the ontologies in the files.
const OURS: &str = "0";
const ASAMS: &str = "1";

/// Writes a file for each scenario.
pub(super) struct OpenLabel {
    dir: PathBuf,
}

impl OpenLabel {
    pub(super) fn new(dir: &Path) -> Self {
        Self { dir: dir.to_owned() }
    }
}

impl Exporter for OpenLabel {
    fn add(&mut self, item: &Item<'_>) -> Result<ExportOutcome> {
        let scene = item.scene();
        let file = format!("{}.json", item.stem);
        write_json_atomically(&self.dir.join(&file), &document(item)?)?;
        let tracks = scene.tracks.iter().map(|track| Ok(track.id.0.clone())).collect();
        Ok(ExportOutcome::Written(Written {
            file,
            name: item.stem.clone(),
            first_timestep: 0,
            tracks,
            assumed: Vec::new(),
        }))
    }

    fn finish(self: Box<Self>) -> Result<()> {
        write_json_atomically(&self.dir.join(ONTOLOGY_FILE), &ontology()).map_err(Error::from)?;
        Ok(())
    }
}

fn document(item: &Item<'_>) -> Result<Value> {
    let record = item.record;
    let positive = record.events.iter().filter(|event| event.label == EventLabel::Positive);
    let mut tags = vec![scenario_tag(item), provenance_tag(item)];
    if let Some(judged) = &record.assessment {
        tags.extend(assessment::tags(item.scene(), judged)?);
    }
    for event in positive {
        tags.push(event_tag(item.scene(), event));
        tags.extend(asam_type(&event.behavior).map(|kind| json!({ "type": kind, "ontology_uid": ASAMS })));
    }
    let tags: serde_json::Map<String, Value> =
        tags.into_iter().enumerate().map(|(uid, tag)| (uid.to_string(), tag)).collect();
    Ok(json!({ "openlabel": {
        "metadata": {
            "schema_version": "1.0.0",
            "name": record.scenario.id,
            "annotator": "djinn",
            "comment": format!("Generated from recordings. {}", item.terms),
        },
        "ontologies": {
            OURS: { "uri": ONTOLOGY_FILE },
            ASAMS: { "uri": ASAM_ONTOLOGY },
        },
        "tags": tags,
    } }))
}

fn scenario_tag(item: &Item<'_>) -> Value {
    let (record, scene) = (item.record, item.scene());
    let mut text = vec![
        value("scenario_id", &record.scenario.id),
        value("dataset", scene.source.dataset.name()),
        value("place", &scene.source.place),
        value("split", scene.source.split.name()),
        value("ego", &item.ego().id.0),
    ];
    text.extend(record.requested_behavior.iter().map(|behavior| value("requested_behavior", behavior)));
    tag(
        "scenario",
        &json!({
            "text": text,
            "boolean": [
                value("verified", record.verified), value("accepted", is_accepted(record)),
                value("recorded_event", record.recorded_event)
            ],
            "num": [
                quantity("duration_s", rounded(scene.n_timesteps.saturating_sub(1) as f64 * scene.dt_s), "s"),
                quantity("present_s", rounded(scene.current_timestep() as f64 * scene.dt_s), "s"),
                value("n_agents", scene.tracks.iter().filter(|track| track.trajectory.n_valid() > 0).count()),
            ],
        }),
    )
}

fn provenance_tag(item: &Item<'_>) -> Value {
    let record = item.record;
    let provenance = &record.scenario.provenance;
    tag(
        "provenance",
        &json!({
            "text": [
                value("scene_id", &provenance.scene_id.0),
                value("sweep", &record.sweep),
                value("observation", &provenance.observation),
                value("guidance", &provenance.guidance.kind),
                value("sampler", &provenance.sampler),
                value("checkpoint", &provenance.checkpoint),
                // Readers of JSON round numbers beyond 2^53.
                value("seed", provenance.seed.to_string()),
            ],
            "num": [
                value("guidance_strength", provenance.guidance.level.strength),
                value("guidance_weight", provenance.guidance.level.weight),
                value("sample_idx", provenance.sample_idx),
            ],
        }),
    )
}

/// An event: its roles are texts with the ids of tracks, and times count from the scenario's start.
fn event_tag(scene: &Scene, event: &BehaviorEvent) -> Value {
    let time_s = |timestep: usize| rounded(timestep as f64 * scene.dt_s);
    let roles = event.roles.iter().map(|(role, track)| value(&format!("role_{role}"), &track.0));
    let parameters = event.parameters.iter().map(|(name, number)| quantity(name, *number, unit_of_name(name)));
    let times = [("start_s", event.start_timestep), ("end_s", event.end_timestep)]
        .map(|(name, timestep)| quantity(name, time_s(timestep), "s"));
    let (text, num): (Vec<Value>, Vec<Value>) = (roles.collect(), times.into_iter().chain(parameters).collect());
    tag(&event.behavior, &json!({ "text": text, "num": num }))
}

fn tag(kind: &str, data: &Value) -> Value {
    json!({ "type": kind, "ontology_uid": OURS, "tag_data": data })
}

fn value(name: &str, value: impl serde::Serialize) -> Value {
    json!({ "name": name, "type": "value", "val": value })
}

/// A number with its unit, for which OpenLABEL has only an attribute.
fn quantity(name: &str, number: f64, unit: &str) -> Value {
    let mut quantity = value(name, number);
    quantity["attributes"] = json!({ "text": [value("unit", unit)] });
    quantity
}

/// Rounds away the last digits of a product of decimals.
fn rounded(value: f64) -> f64 {
    (value * 1e6).round() / 1e6
}

/// The tag of ASAM's ontology for a behavior, if it has one.
fn asam_type(behavior: &str) -> Option<&'static str> {
    match behavior {
        "cut_in" => Some("MotionCutIn"),
        "left_turn" => Some("MotionTurnLeft"),
        "right_turn" => Some("MotionTurnRight"),
        "hard_brake" => Some("MotionDecelerate"),
        _ => None,
    }
}

/// The definitions of our tags.
fn ontology() -> Value {
    let behaviors: serde_json::Map<String, Value> = behavior::ALL
        .iter()
        .map(|entry| {
            let roles: Vec<String> = entry.roles.iter().map(|role| format!("role_{role}")).collect();
            (entry.id.to_owned(), json!({ "definition": entry.description, "text": roles }))
        })
        .collect();
    let mut ontology = json!({
        "name": "djinn scenario tags",
        "version": 2,
        "tags": {
            "scenario": {
                "definition": "A generated scenario.",
                "data": {
                    "scenario_id": "Its id in the corpus.",
                    "dataset": "The dataset of the recording that it continues.",
                    "place": "City or location, as the dataset names it.",
                    "split": "Part of the dataset: train, val, test or unsplit.",
                    "ego": "The track of the vehicle to which the requested event happens, unless the export was asked \
                            for another one.",
                    "requested_behavior": "The requested behavior.",
                    "verified": "Whether that behavior was found with the requested roles.",
                    "accepted": "Whether it is verified, valid and no near-duplicate of another.",
                    "recorded_event": "Whether the recording already showed it.",
                    "duration_s": "From the first timestep to the last, seconds.",
                    "present_s": "The last observed timestep, seconds after the first; what follows is generated.",
                    "n_agents": "Road users.",
                },
            },
            "provenance": {
                "definition": "The provenance of the scenario.",
                "data": {
                    "scene_id": "The recorded scene.",
                    "sweep": "The sweep that it belongs to.",
                    "observation": "Which states were observed.",
                    "guidance": "The guidance of the samples.",
                    "guidance_strength": "How strongly; 0 without guidance.",
                    "guidance_weight": "Weight of classifier-free guidance; 0 without.",
                    "sampler": "Sampler and number of steps.",
                    "checkpoint": "Fingerprint of the model.",
                    "seed": "The run's seed.",
                    "sample_idx": "Index among the samples of its scene and guidance.",
                },
            },
        },
        "behaviors": {
            "definition": "A tag of a behavior's name is an event that was found: start_s and end_s count from the \
                           first timestep; role_<role> is the id of the track in that role; further numbers are \
                           parameters; each has its unit as an attribute, too.",
            "tags": behaviors,
        },
    });
    for (kind, definition) in assessment::definitions() {
        ontology["tags"][kind] = definition;
    }
    ontology
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::export::testing::{self, add_all, read};

    #[test]
    fn tags_say_what_was_asked_for_and_found() {
        let dir = tempfile::tempdir().unwrap();
        let outcomes = add_all(Box::new(OpenLabel::new(dir.path())), &[testing::scene()]);
        assert_eq!(outcomes[0].as_ref().unwrap().file, "0a1b0.json");
        let document: Value = serde_json::from_str(&read(dir.path(), "0a1b0.json")).unwrap();
        let content = &document["openlabel"];
        assert_eq!(content["metadata"]["schema_version"], "1.0.0");
        assert_eq!(content["ontologies"]["0"]["uri"], ONTOLOGY_FILE);
        let tags = content["tags"].as_object().unwrap();
        assert_eq!(tags.len(), 4);
        let data = |uid: &str, kind: &str, name: &str| -> Value {
            let list = tags[uid]["tag_data"][kind].as_array().unwrap();
            list.iter().find(|entry| entry["name"] == name).unwrap()["val"].clone()
        };
        assert_eq!((data("0", "text", "scenario_id"), data("0", "boolean", "verified")), (json!("0a1b0"), json!(true)));
        // Twelve timesteps at 10 Hz, the fourth of which is the present.
        assert_eq!((data("0", "num", "duration_s"), data("0", "num", "present_s")), (json!(1.1), json!(0.3)));
        assert_eq!((data("1", "text", "seed"), data("1", "num", "sample_idx")), (json!("7"), json!(2)));
        assert_eq!((&tags["2"]["type"], &tags["3"]["type"]), (&json!("cut_in"), &json!("MotionCutIn")));
        assert_eq!((&tags["2"]["ontology_uid"], &tags["3"]["ontology_uid"]), (&json!("0"), &json!("1")));
        assert_eq!((data("2", "text", "role_other"), data("2", "text", "role_ego")), (json!("2"), json!("1")));
        assert_eq!((data("2", "num", "start_s"), data("2", "num", "gap_m")), (json!(0.4), json!(5.25)));
    }

    #[test]
    fn the_ontology_defines_every_tag_and_value() {
        let dir = tempfile::tempdir().unwrap();
        let mut record = testing::record(&testing::scene());
        record.assessment = Some(assessment::tests::judgment());
        let mut exporter = Box::new(OpenLabel::new(dir.path()));
        exporter
            .add(&Item { record: &record, number: 1, stem: "0a1b0".to_owned(), ego_idx: 0, terms: "none" })
            .unwrap();
        exporter.finish().unwrap();
        let ontology: Value = serde_json::from_str(&read(dir.path(), ONTOLOGY_FILE)).unwrap();
        let document: Value = serde_json::from_str(&read(dir.path(), "0a1b0.json")).unwrap();
        assert_eq!(document["openlabel"]["tags"].as_object().unwrap().len(), 6, "with the judgment and a failed check");
        for uid in ["0", "1", "2", "3"] {
            let tag = &document["openlabel"]["tags"][uid];
            let defined = &ontology["tags"][tag["type"].as_str().unwrap()]["data"];
            for (_, entries) in tag["tag_data"].as_object().unwrap() {
                for entry in entries.as_array().unwrap() {
                    assert!(defined[entry["name"].as_str().unwrap()].is_string(), "{entry} is not defined");
                }
            }
        }
        assert_eq!(ontology["behaviors"]["tags"].as_object().unwrap().len(), behavior::ALL.len());
        assert_eq!(ontology["behaviors"]["tags"]["cut_in"]["text"].as_array().unwrap().len(), 2);
    }
}
