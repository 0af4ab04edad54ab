//! Who moves the ego of an export?

use serde::{Deserialize, Serialize};

/// The motion of the ego in formats for simulation.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum EgoMotion {
    /// It moves as in the scenario, like all agents.
    Replayed,
    /// It moves as in the scenario up to the present; then a driving function moves it.
    Free,
}

#[cfg(test)]
mod tests {
    use crate::behavior::{self, Subject};
    use crate::export::testing::{self, Node, read, womd_scenes};
    use crate::export::{ExportFormat, Item};
    use crate::scenario::{EgoChoice, ScenarioRecord};
    use crate::scene::testing::{Drive, scene};
    use arrow::array::AsArray;
    use parquet::arrow::arrow_reader::ParquetRecordBatchReaderBuilder;
    use std::path::Path;

    /// Track `2` follows track `1`; the window was cut out around track `3`, which has nothing to do with it. The event
    /// of `behavior` happens to track `2`.
    fn record(behavior: &behavior::BehaviorEntry) -> ScenarioRecord {
        let template = testing::scene();
        let drives = [(20.0, 0.0, 5.0), (0.0, 0.0, 10.0), (0.0, 30.0, 8.0), (60.0, 0.0, 5.0)];
        let mut scene = scene(&drives.map(|(x, y, speed_mps)| Drive::straight(x, y, 0.0, speed_mps)));
        (scene.lanes, scene.world_from_scene, scene.ego_idx) = (template.lanes, template.world_from_scene, 2);
        let mut record = testing::record(&scene);
        let mut others = ["1", "4"].into_iter();
        let track = |(i, role): (usize, &&str)| {
            let is_subject = match behavior.subject {
                Subject::Role(subject) => *role == subject,
                Subject::WhoComesUpon => i == 1,
                Subject::WhoMeetsIt => false,
            };
            ((*role).to_owned(), if is_subject { "2" } else { others.next().unwrap() }.into())
        };
        let roles = behavior.roles.iter().enumerate().map(track).collect();
        record.requested_behavior = Some(behavior.id.to_owned());
        let event = &mut record.events[0];
        (event.behavior, event.roles, event.start_timestep) = (behavior.id.to_owned(), roles, 0);
        record
    }

    /// The track that a file of this format marks as the ego.
    fn marked(format: ExportFormat, dir: &Path, file: &str) -> String {
        let rows = |path: &str| -> Vec<Vec<String>> {
            read(dir, path).lines().map(|line| line.split(',').map(str::to_owned).collect()).collect()
        };
        match format {
            ExportFormat::Interaction => {
                let mut ids: Vec<String> =
                    rows(file).into_iter().filter(|row| row[13] == "1").map(|row| row[1].clone()).collect();
                ids.dedup();
                ids.concat()
            }
            ExportFormat::Argoverse2 => {
                let (table, _) = fs_err::File::open(dir.join(file).join("scenario_0a1b.parquet")).unwrap().into_parts();
                let mut batches = ParquetRecordBatchReaderBuilder::try_new(table).unwrap().build().unwrap();
                let batch = batches.next().unwrap().unwrap();
                batch["focal_track_id"].as_string::<i32>().value(0).to_owned()
            }
            ExportFormat::Womd => womd_scenes(&dir.join(file), [4, 8])[0].ego().id.0.clone(),
            ExportFormat::CommonRoad => {
                let root = Node::parse(&read(dir, file));
                let initial = root.at("planningProblem").at("initialState").at("position").at("point");
                let ids: Vec<&str> = root.all("dynamicObstacle").iter().map(|node| node.attr("id")).collect();
                // Two lanelets come first; at 10 m/s to the north track 2 is 3 m from its start at present.
                assert_eq!(ids, ["3", "5", "6"]);
                format!("{}", 2 + usize::from((initial.number("x"), initial.number("y")) != (1000.0, 2003.0)))
            }
            ExportFormat::OpenScenario => {
                let root = Node::parse(&read(dir, file));
                let ego = root.at("Entities").all("ScenarioObject")[0];
                assert_eq!(ego.attr("name"), "Ego");
                ego.at("Vehicle").at("Properties").all("Property")[0].attr("value").to_owned()
            }
            ExportFormat::OpenLabel => {
                let document: serde_json::Value = serde_json::from_str(&read(dir, file)).unwrap();
                let text = document["openlabel"]["tags"]["0"]["tag_data"]["text"].as_array().unwrap().clone();
                text.iter().find(|entry| entry["name"] == "ego").unwrap()["val"].as_str().unwrap().to_owned()
            }
        }
    }

    #[test]
    fn every_format_marks_the_subject_of_every_behavior() {
        for behavior in behavior::ALL {
            let record = record(behavior);
            let (ego_idx, is_for_want) = EgoChoice::Event.of(&record).unwrap();
            assert_eq!((ego_idx, is_for_want), (1, false), "{}", behavior.id);
            for format in ExportFormat::ALL {
                let dir = tempfile::tempdir().unwrap();
                let mut exporter = format.begin(dir.path(), format.usual_ego());
                let item =
                    Item { record: &record, number: 1, stem: record.scenario.id.clone(), ego_idx, terms: "none" };
                let crate::export::ExportOutcome::Written(written) = exporter.add(&item).unwrap() else {
                    panic!("{} cannot hold {}", format.name(), behavior.id)
                };
                exporter.finish().unwrap();
                assert_eq!(marked(format, dir.path(), &written.file), "2", "{}: {}", format.name(), behavior.id);
                let is_free = written.tracks[1] == Err("ego_is_free");
                assert_eq!(is_free, format == ExportFormat::CommonRoad, "{}", behavior.id);
            }
        }
    }

    #[test]
    fn what_has_no_event_falls_back_to_the_center_and_says_so() {
        let mut record = record(behavior::BehaviorEntry::of("cut_in").unwrap());
        let found = |record: &ScenarioRecord, name: &str| EgoChoice::from_name(name).of(record);
        assert_eq!(found(&record, "scene"), Some((2, false)));
        assert_eq!(found(&record, "4"), Some((3, false)));
        assert_eq!(found(&record, "nobody"), None);
        record.verified = false;
        assert_eq!(found(&record, "event"), Some((2, true)));
    }
}
