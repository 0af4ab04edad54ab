//! Argoverse 2: do rows and maps meet the expectations of the dataset's readers, and does our own reader read them
//! back?

use super::*;
use crate::export::testing::{self, add_all, assert_same_states, read};
use crate::geometry::Transform2;
use crate::ingest::{IngestBatch, IngestConfig, ingest};
use crate::progress::Silent;
use crate::scene::testing::{Drive, scene as straight_scene, without_states};
use crate::scene::{Dataset, Extent, Scene, TrackId, Trajectory};
use arrow::array::{Array, AsArray};
use arrow::datatypes::{DataType, Float64Type, Int64Type};
use parquet::arrow::arrow_reader::ParquetRecordBatchReaderBuilder;

fn written(scene: &Scene) -> (tempfile::TempDir, Written) {
    let dir = tempfile::tempdir().unwrap();
    let mut outcomes = add_all(Box::new(Argoverse2::new(dir.path())), std::slice::from_ref(scene));
    (dir, outcomes.remove(0).unwrap())
}

fn table(path: &Path) -> RecordBatch {
    let (file, _) = fs_err::File::open(path).unwrap().into_parts();
    let mut reader = ParquetRecordBatchReaderBuilder::try_new(file).unwrap().build().unwrap();
    reader.next().unwrap().unwrap()
}

#[test]
fn rows_have_the_columns_and_values_of_the_dataset() {
    let mut scene = testing::scene();
    scene.source.place = "austin".to_owned();
    let (dir, outcome) = written(&scene);
    assert_eq!((outcome.file.as_str(), outcome.name.as_str()), ("train/0a1b0", "0a1b0"));
    let table = table(&dir.path().join("train/0a1b0/scenario_0a1b0.parquet"));
    let schema = table.schema();
    let types: Vec<(&str, &DataType)> = schema.fields().iter().map(|f| (f.name().as_str(), f.data_type())).collect();
    let (text, int, float) = (&DataType::Utf8, &DataType::Int64, &DataType::Float64);
    let expected = [
        ("observed", &DataType::Boolean),
        ("track_id", text),
        ("object_type", text),
        ("object_category", int),
        ("timestep", int),
        ("position_x", float),
        ("position_y", float),
        ("heading", float),
        ("velocity_x", float),
        ("velocity_y", float),
        ("scenario_id", text),
        ("start_timestamp", float),
        ("end_timestamp", float),
        ("num_timestamps", int),
        ("focal_track_id", text),
        ("city", text),
    ];
    assert_eq!(types, expected);
    assert_eq!(table.num_rows(), 12 + 11 + 11);
    let text = |name: &str, row: usize| table.column_by_name(name).unwrap().as_string::<i32>().value(row).to_owned();
    let int = |name: &str, row: usize| table.column_by_name(name).unwrap().as_primitive::<Int64Type>().value(row);
    let float = |name: &str, row: usize| table.column_by_name(name).unwrap().as_primitive::<Float64Type>().value(row);
    let observed = table.column_by_name("observed").unwrap().as_boolean();
    // The ego at its fourth timestep, the present.
    assert_eq!((text("track_id", 3).as_str(), text("object_type", 3).as_str()), ("1", "vehicle"));
    assert_eq!((int("object_category", 3), int("timestep", 3)), (3, 3));
    assert!((float("position_x", 3) - 1000.0).abs() < 1e-9 && (float("position_y", 3) - 2003.0).abs() < 1e-9);
    assert!((float("heading", 3) - std::f64::consts::FRAC_PI_2).abs() < 1e-9);
    assert!(float("velocity_x", 3).abs() < 1e-9 && (float("velocity_y", 3) - 10.0).abs() < 1e-9);
    assert!(observed.value(3) && !observed.value(4));
    // Track 2 takes part in the event; the pedestrian does not, and has no row at timestep 2.
    assert_eq!((text("track_id", 12).as_str(), int("timestep", 12), int("object_category", 12)), ("2", 1, 2));
    assert_eq!((text("object_type", 23).as_str(), int("object_category", 23)), ("pedestrian", 1));
    assert_eq!((int("timestep", 24), int("timestep", 25)), (1, 3));
    assert_eq!((text("focal_track_id", 30), text("city", 30)), ("1".to_owned(), "austin".to_owned()));
    assert_eq!((int("num_timestamps", 0), float("end_timestamp", 0)), (12, 1.1e9));
    for column in table.columns() {
        assert_eq!(column.null_count(), 0);
    }
}

#[test]
fn maps_hold_the_lanes_in_the_recordings_frame() {
    let (dir, outcome) = written(&testing::scene());
    assert_eq!(outcome.assumed, [("nominal_lane_width", 0), ("lane_without_extent", 0)]);
    let map: Value = serde_json::from_str(&read(dir.path(), "train/0a1b0/log_map_archive_0a1b0.json")).unwrap();
    let lane = &map["lane_segments"]["-5"];
    assert_eq!((lane["id"].as_i64(), &lane["successors"]), (Some(-5), &json!([7])));
    assert_eq!((lane["lane_type"].as_str(), lane["left_lane_mark_type"].as_str()), (Some("VEHICLE"), Some("UNKNOWN")));
    // The left boundary of a lane to the north, 2 m from its middle, lies in the west.
    let expected = json!([{ "x": 998.0, "y": 2000.0, "z": 0.0 }, { "x": 998.0, "y": 2040.0, "z": 0.0 }]);
    assert_eq!(lane["left_lane_boundary"], expected);
    assert_eq!(lane["right_neighbor_id"], Value::Null);
    // All the way around: up the left boundary, down the right one.
    let area = &map["drivable_areas"]["-5"];
    let corner = |i: usize| (area["area_boundary"][i]["x"].as_f64(), area["area_boundary"][i]["y"].as_f64());
    let at = |x: f64, y: f64| (Some(x), Some(y));
    assert_eq!(area["id"].as_i64(), Some(-5));
    let corners = [at(998.0, 2000.0), at(998.0, 2040.0), at(1002.0, 2040.0), at(1002.0, 2000.0)];
    assert_eq!([0, 1, 2, 3].map(corner), corners);
    assert_eq!(map["drivable_areas"].as_object().unwrap().len(), 2);
    assert_eq!(&map["pedestrian_crossings"], &json!({}));
}

/// A scene as long as the dataset's: 110 timesteps, 50 of them observed.
fn long_scene() -> Scene {
    let drives = [Drive::straight(0.0, 0.0, 0.0, 10.0), Drive::straight(-20.0, 3.0, 0.3, 8.0)];
    let mut scene = straight_scene(&drives);
    (scene.n_timesteps, scene.n_history) = (110, 50);
    scene.world_from_scene = Transform2::from_pose(Vec2::new(-436.5, 1311.25), 1.1);
    for (track, drive) in scene.tracks.iter_mut().zip(drives) {
        let velocity = Vec2::from_angle(drive.heading_rad) * drive.speed_mps;
        let state = |timestep: usize| State {
            position: Vec2::new(drive.x, drive.y) + velocity * (0.1 * (timestep as f64 - 49.0)),
            heading_rad: drive.heading_rad,
            velocity,
        };
        track.trajectory = Trajectory::new((0..110).map(|timestep| Some(state(timestep))).collect());
        track.extent = None::<Extent>;
    }
    without_states(scene, 1, |timestep| timestep < 5 || timestep == 60)
}

#[test]
fn our_own_reader_finds_the_same_states_and_lanes() {
    let mut scene = long_scene();
    scene.lanes = testing::scene().lanes;
    scene.source.place = "austin".to_owned();
    let (dir, _) = written(&scene);
    let config = IngestConfig::new(Dataset::Argoverse2, vec![dir.path().to_owned()]);
    let mut found = Vec::new();
    let mut maps = Vec::new();
    let collected = &mut |batch: IngestBatch| {
        found.extend(batch.scenes);
        maps.extend(batch.maps);
        Ok(())
    };
    ingest(&config, None, &Silent, collected).unwrap();
    let read = &found[0];
    assert_eq!((found.len(), read.source.case_id.as_str(), read.ego().id.0.as_str()), (1, "0a1b0", "1"));
    assert_eq!((read.n_timesteps, read.n_history, read.source.place.as_str()), (110, 50, "austin"));
    for id in ["1", "2"].map(TrackId::from) {
        let [own, again] = [&scene, read].map(|scene| (scene, scene.track_idx(&id).unwrap()));
        assert_same_states(own, again, 0, [1e-9; 2]);
    }
    let lanes = scene.lanes.transformed(&scene.world_from_scene);
    assert_eq!(maps.len(), 1);
    for (ours, theirs) in lanes.lanes().iter().zip(maps[0].1.lanes()) {
        let seen = (ours.id, &ours.successors, &ours.predecessors);
        assert_eq!(seen, (theirs.id, &theirs.successors, &theirs.predecessors));
        for (a, b) in ours.left.0.iter().zip(&theirs.left.0).chain(ours.centerline.0.iter().zip(&theirs.centerline.0)) {
            assert!(a.distance(*b) < 2e-6);
        }
    }
}
