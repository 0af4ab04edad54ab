//! Does a planner see and drive in the frame of the recording, wherever that lies? The corpus of the tests, turned by 2
//! radians and moved by kilometers.

use crate::drive::{CORPUS, MODEL, planned};
use crate::support::djinn;
use arrow::util::display::array_value_to_string;
use djinn::geometry::{Transform2, Vec2};
use djinn::scenario::ScenarioRecord;
use djinn::scene::{LaneGraph, LaneId, MapId};
use djinn::store::{CorpusNotes, CorpusReader, CorpusWriter, MapSource, Result};
use parquet::arrow::arrow_reader::ParquetRecordBatchReaderBuilder;
use serde_json::Value;
use std::collections::{BTreeMap, BTreeSet};
use std::path::Path;

fn turn() -> Transform2 {
    Transform2::from_pose(Vec2::new(7000.0, -3000.0), 2.0)
}

/// The maps of the corpus in the other frame.
struct Turned<'r>(&'r CorpusReader);

impl MapSource for Turned<'_> {
    fn map(&self, id: &MapId) -> Result<LaneGraph> {
        Ok(self.0.map(id)?.into_frame(&turn()))
    }

    fn lanes(&self, id: &MapId, lane_ids: &[LaneId]) -> Result<LaneGraph> {
        Ok(self.0.lanes(id, lane_ids)?.into_frame(&turn()))
    }
}

/// Writes the corpus in the other frame, and returns its accepted scenarios.
fn write_turned(dir: &Path) -> Vec<ScenarioRecord> {
    let reader = CorpusReader::open(&Path::new(env!("CARGO_MANIFEST_DIR")).join(CORPUS)).unwrap();
    let mut records: Vec<ScenarioRecord> = (0..reader.len()).map(|i| reader.scenario(i).unwrap()).collect();
    for record in &mut records {
        let scene = &mut record.scenario.scene;
        scene.world_from_scene = turn().compose(&scene.world_from_scene);
    }
    let turned = Turned(&reader);
    let mut writer = CorpusWriter::create(dir, &turned).unwrap();
    writer.write_scenarios(&records).unwrap();
    writer.finish(&CorpusNotes::default()).unwrap();
    records.retain(|record| record.assessment.as_ref().is_some_and(|assessment| assessment.accepted));
    records
}

type Row = BTreeMap<String, String>;

/// The rows of a table, by column, those of one driver.
fn rows(path: &Path, driver: &str) -> Vec<Row> {
    let (file, _) = fs_err::File::open(path).unwrap().into_parts();
    let mut found = Vec::new();
    for batch in ParquetRecordBatchReaderBuilder::try_new(file).unwrap().build().unwrap() {
        let batch = batch.unwrap();
        let names: Vec<String> = batch.schema_ref().fields().iter().map(|field| field.name().clone()).collect();
        found.extend((0..batch.num_rows()).map(|row| -> Row {
            let value = |i: usize| array_value_to_string(batch.column(i), row).unwrap();
            names.iter().enumerate().map(|(i, name)| (name.clone(), value(i))).collect()
        }));
    }
    found.retain(|row| row["driver"] == driver);
    found
}

fn number(row: &Row, column: &str) -> f64 {
    row[column].parse().unwrap()
}

/// Checks that rows are the same to the last digit, but for the driver.
fn assert_same_rows(mut one: Vec<Row>, mut other: Vec<Row>) {
    one.iter_mut().chain(&mut other).for_each(|row| _ = row.remove("driver"));
    assert!(!one.is_empty() && one.len() == other.len(), "{} and {} rows", one.len(), other.len());
    for (one, other) in one.iter().zip(&other) {
        assert_eq!(one, other);
    }
}

#[test]
fn a_planner_that_answers_with_the_scenario_drives_like_the_log_in_any_frame() {
    let dir = tempfile::tempdir().unwrap();
    let at = |name: &str| dir.path().join(name);
    let [corpus, known, seen] = ["corpus", "known.json", "seen.json"].map(at);
    let records = write_turned(&corpus);
    let state = |record: &ScenarioRecord, timestep: usize| {
        let scene = &record.scenario.scene;
        let ego = record.subject_idx().unwrap();
        let state = scene.state(ego, timestep).unwrap().transformed(&scene.world_from_scene);
        [state.position.x, state.position.y, state.heading_rad]
    };
    let states: BTreeMap<&str, Vec<[f64; 3]>> = records
        .iter()
        .map(|record| {
            let n_timesteps = record.scenario.scene.n_timesteps;
            (record.scenario.id.as_str(), (0..n_timesteps).map(|timestep| state(record, timestep)).collect())
        })
        .collect();
    fs_err::write(&known, serde_json::to_vec(&states).unwrap()).unwrap();
    let code = format!(
        "import json\nfrom djinn.drive import serve\nknown = json.load(open('{}'))\nseen = open('{}', 'a')\n\
         def act(observation, hello):\n    id, first = hello['scenario_id'], observation['timestep'] + 1\n    \
         print(json.dumps([id, observation]), file=seen, flush=True)\n    \
         return {{'trajectory': known[id][first:first + 5]}}\nserve(act)\n",
        known.display(),
        seen.display()
    );
    fs_err::write(at("p.py"), code).unwrap();
    let planner = format!("PYTHONPATH=scripts python3 {}", at("p.py").display());
    for (name, ego) in [("planner", planner.as_str()), ("log", "log")] {
        let (out, corpus) = (at(name), corpus.to_str().unwrap());
        // One process, so that what it has seen is in order.
        let args = ["drive", corpus, "--ego", ego, "--model", MODEL, "--horizon-s", "3", "--threads", "1"];
        djinn(&[&args[..], &["--out", out.to_str().unwrap()]].concat()).expect(0);
    }
    let driven = ["planner", "log"].map(|name| rows(&at(name).join("driven.parquet"), name));
    // The others of the event may be planned anew for an ego that answers, which the log does not.
    let planned_alike: BTreeSet<&String> = {
        let planned = |driven: &[Row]| -> BTreeMap<String, Vec<[String; 3]>> {
            let mut by_scenario: BTreeMap<String, Vec<[String; 3]>> = BTreeMap::new();
            for row in driven.iter().filter(|row| row["moved_by"] == "plan") {
                by_scenario
                    .entry(row["scenario_id"].clone())
                    .or_default()
                    .push(["timestep", "x_m", "y_m"].map(|column| row[column].clone()));
            }
            by_scenario
        };
        let [own, log] = [&driven[0], &driven[1]].map(|driven| planned(driven));
        driven[0].iter().map(|row| &row["scenario_id"]).filter(|id| own.get(*id) == log.get(*id)).collect()
    };
    assert!(planned_alike.len() >= 2, "{planned_alike:?}");
    let alike = |rows: &[Row]| rows.iter().filter(|row| planned_alike.contains(&row["scenario_id"])).cloned().collect();
    assert_same_rows(alike(&driven[0]), alike(&driven[1]));
    let [own, log] = ["planner", "log"].map(|name| rows(&at(name).join("drives.parquet"), name));
    assert_same_rows(alike(&own), alike(&log));

    check_observations(&records, &fs_err::read_to_string(&seen).unwrap(), &driven[0]);
    check_plans(&records, &driven[1]);
}

/// Checks that what a planner has seen is what was driven, no sooner and no later.
fn check_observations(records: &[ScenarioRecord], seen: &str, driven: &[Row]) {
    let key = |row: &Row| (row["scenario_id"].clone(), row["track_id"].clone(), row["timestep"].parse().unwrap());
    let by_state: BTreeMap<(String, String, usize), &Row> = driven.iter().map(|row| (key(row), row)).collect();
    let turned = |record: &ScenarioRecord| record.scenario.scene.world_from_scene.rotation_rad();
    let turns: BTreeMap<&str, f64> =
        records.iter().map(|record| (record.scenario.id.as_str(), turned(record))).collect();
    let (mut last, mut fastest_mps) = (None, 0.0_f64);
    for line in seen.lines() {
        let (id, observation): (String, Value) = serde_json::from_str(line).unwrap();
        let now = observation["timestep"].as_u64().unwrap() as usize;
        let first = last.take().filter(|(before, _)| *before == id).map_or(0, |(_, now)| now + 1);
        assert!(now == 9 || now == first + 4, "{first} to {now}");
        let agents = observation["agents"].as_array().unwrap();
        let ids: BTreeSet<&str> = agents.iter().map(|agent| agent["id"].as_str().unwrap()).collect();
        let there = by_state.keys().filter(|(scenario, _, timestep)| *scenario == id && *timestep == now);
        assert_eq!(ids, there.map(|(_, track, _)| track.as_str()).collect());
        for agent in agents {
            let states = agent["states"].as_array().unwrap();
            assert_eq!(states.len(), now + 1 - first);
            for (timestep, state) in (first..).zip(states) {
                let row = by_state.get(&(id.clone(), agent["id"].as_str().unwrap().to_owned(), timestep));
                assert_eq!(row.is_none(), state.is_null());
                let Some(row) = row else { continue };
                let [x, y, heading, vx, vy]: [f64; 5] = serde_json::from_value(state.clone()).unwrap();
                let told = [x, y, heading];
                let wanted = ["world_x_m", "world_y_m", "world_heading_rad"].map(|column| number(row, column));
                let is_near = told.iter().zip(wanted).all(|(told, wanted)| (told - wanted).abs() < 1e-6);
                assert!(is_near, "{told:?}, expected {wanted:?}");
                // The velocities of the table know the next state, too.
                let velocity = Vec2::new(number(row, "vx_mps"), number(row, "vy_mps")).rotated(turns[id.as_str()]);
                assert!(velocity.distance(Vec2::new(vx, vy)) < 1.0, "{vx}, {vy}, expected {velocity:?}");
                fastest_mps = fastest_mps.max(velocity.norm());
            }
        }
        last = Some((id, now));
    }
    assert!(fastest_mps > 5.0 && last.is_some());
}

/// Checks that agents of the event are said to follow the plan as long as they have the scenario's states.
fn check_plans(records: &[ScenarioRecord], driven: &[Row]) {
    let mut n_planned = 0;
    for row in driven {
        let record = records.iter().find(|record| record.scenario.id == row["scenario_id"]).unwrap();
        let (scene, timestep) = (&record.scenario.scene, row["timestep"].parse::<usize>().unwrap());
        let is_other = record.main_event().unwrap().roles.tracks().any(|track| track.0 == row["track_id"])
            && row["is_center"] == "false";
        let is_driver = timestep >= scene.n_history && row["is_center"] == "true";
        assert_eq!(row["moved_by"] == "driver", is_driver, "{row:?}");
        if timestep < scene.n_history || !is_other {
            assert_ne!(row["moved_by"], "plan");
            continue;
        }
        let idx = scene.tracks.iter().position(|track| track.id.0 == row["track_id"]).unwrap();
        let planned = scene.state(idx, timestep).map(|state| state.position);
        if planned.is_some_and(|at| at.distance(Vec2::new(number(row, "x_m"), number(row, "y_m"))) < 1e-6) {
            assert_eq!(row["moved_by"], "plan", "{row:?}");
            n_planned += 1;
        }
    }
    assert!(n_planned > 20, "{n_planned} planned");
}

#[test]
fn planned_states_of_the_scenario_are_scored_as_the_scenario_in_any_frame() {
    let dir = tempfile::tempdir().unwrap();
    let [corpus, file, out] = ["corpus", "planned.parquet", "out"].map(|name| dir.path().join(name));
    write_turned(&corpus);
    let score = |more: &[&str]| {
        let args = ["score", corpus.to_str().unwrap(), file.to_str().unwrap(), "--out", out.to_str().unwrap()];
        djinn(&[&args, more].concat())
    };
    planned(&file, &corpus, 0, |state| state);
    score(&["--max-unjudged", "0"]).expect(0);
    let [own, scenario] = ["planner", "scenario"].map(|driver| rows(&out.join("drives.parquet"), driver));
    assert_same_rows(own, scenario);
    // What is written in another way is refused, and named.
    type Change = fn([f64; 4]) -> [f64; 4];
    let told: [(Change, &str); 4] = [
        (|[t, x, y, h]| [t, x, y, h.to_degrees()], "in degrees"),
        (|[t, x, y, h]| [t, x, y, h + 1.57], "is a turn by 1.5"),
        (|[t, x, y, h]| [t - 10.0, x, y, h], "they begin at 0, but timesteps count from the beginning of the past"),
        (|[t, x, y, h]| [t, x + 1e308, y, h], "no vehicle moves"),
    ];
    for (wrong, why) in told {
        planned(&file, &corpus, 0, wrong);
        fs_err::remove_dir_all(&out).ok();
        let refused = score(&[]).expect(1);
        assert!(refused.stderr.contains("none of the 4 plans can be driven"), "{refused:?}");
        assert!(refused.stderr.contains(why), "{refused:?}");
    }
    // One bad plan among good ones fails alone.
    let mut n_told = 0;
    planned(&file, &corpus, 0, |[t, x, y, h]| {
        n_told += 1;
        [t, x - if n_told == 25 { 60.0 } else { 0.0 }, y, h]
    });
    assert!(score(&[]).expect(0).stdout.contains("planner: 1 planner_failed, 3"));
    let own = rows(&out.join("drives.parquet"), "planner");
    assert!(own[0]["why"].contains("planned state at timestep 34: no vehicle moves 6"), "{:?}", own[0]);
}
