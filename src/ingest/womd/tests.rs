//! What is read of records, whole and damaged ones; `scripts/check_womd.py` compares whole files with the dataset's own
//! reading.

use super::messages::{
    BoundarySegment, Crosswalk, DynamicMapState, FeatureData, LaneCenter, LaneNeighbor, MapFeature, MapPoint,
    ObjectState, RequiredPrediction, RoadSide, Scenario, StopSign, Track, TrafficSignalLaneState,
};
use super::tfrecord::{Records, framed, masked_crc};
use super::*;
use crate::geometry::{Polyline, Vec2};
use crate::ingest::MapsConfig;
use crate::ingest::test_data::{scenes, test_data};
use crate::scene::{Lane, LaneAttributes, LaneId, Scene};

fn read(bytes: &[u8]) -> Vec<(u64, Result<String, &'static str>)> {
    let text = |content: Vec<u8>| String::from_utf8_lossy(&content).into_owned();
    let mut bytes = bytes;
    Records::new(&mut bytes).map(|(at, record)| (at, record.map(text).map_err(|(reason, _)| reason))).collect()
}

#[test]
fn damage_costs_one_record() {
    // CRC-32C of "123456789" is 0xe3069283.
    assert_eq!(masked_crc(b"123456789"), 0xc78a_b0e5);
    let whole: Vec<u8> = ["one", "two", "three"].iter().flat_map(|text| framed(text.as_bytes())).collect();
    let all = |second| [(0, Ok("one".to_owned())), (19, second), (38, Ok("three".to_owned()))];
    assert_eq!(read(&whole), all(Ok("two".to_owned())));
    let flipped = |at: usize| {
        let mut bytes = whole.clone();
        bytes[at] ^= 1;
        read(&bytes)
    };
    // In a content, its checksum, a length, and the checksum of that.
    for at in [19 + 12, 19 + 15, 19, 19 + 8] {
        assert_eq!(flipped(at), all(Err("damaged_record")), "{at}");
    }
    for n_bytes in [39, 49, 52, 57] {
        assert_eq!(read(&whole[..n_bytes])[2..], [(38, Err("damaged_record"))], "{n_bytes}");
    }
    let length = (1_u64 << 40).to_le_bytes();
    let endless = [whole.as_slice(), &length, &masked_crc(&length).to_le_bytes(), b"more"].concat();
    assert_eq!(read(&endless)[3..], [(59, Err("too_large"))]);
    assert_eq!(read(b"<html>no TFRecord</html>"), [(0, Err("damaged_record"))]);
    assert_eq!(read(b""), []);
}

#[test]
fn splits_and_sets_are_named_as_in_the_dataset() {
    for (path, expected) in [
        ("scenario/training/training.tfrecord-00000-of-01000", Some((Split::Train, ""))),
        ("training_20s.tfrecord-00999-of-01000", Some((Split::Train, "20s"))),
        (
            "uncompressed_scenario_validation_interactive_validation_interactive.tfrecord-00000-of-00150",
            Some((Split::Val, "interactive")),
        ),
        ("uncompressed_scenario_testing_testing.tfrecord-00001-of-00150", Some((Split::Test, ""))),
        ("validation_interactive/part.tfrecord", Some((Split::Val, "interactive"))),
        ("untraining/training_day.tfrecord", None),
    ] {
        assert_eq!(set_of(path), expected, "{path}");
    }
}

/// A car that drives along x at 10 m/s, as the one that records, and a lane with a line on its left.
fn scenario() -> Scenario {
    let state = |id: i32, step: i32| ObjectState {
        center_x: f64::from(step),
        center_y: 5.0,
        length: 4.0 + step as f32 / 100.0,
        width: 1.75,
        heading: 4.0 * std::f32::consts::PI,
        velocity_x: 10.0,
        velocity_y: 0.0,
        valid: step != 3 || id == 31,
    };
    let track = |id| Track { id, object_type: 1, states: (0..91).map(|step| state(id, step)).collect() };
    let line = |y: f64, xs: &[f64]| xs.iter().map(|x| MapPoint { x: *x, y }).collect::<Vec<_>>();
    let bound = BoundarySegment { lane_start_index: 1, lane_end_index: 3, boundary_feature_id: 7, boundary_type: 2 };
    let beside = |feature_id, self_end_index| LaneNeighbor {
        feature_id,
        self_start_index: 0,
        self_end_index,
        neighbor_start_index: 1,
        neighbor_end_index: 2,
    };
    let lane = |y, left_boundaries| LaneCenter {
        speed_limit_mph: 25.0,
        kind: 2,
        polyline: line(y, &[0.0, 10.0, 20.0, 90.0]),
        left_boundaries,
        left_neighbors: vec![beside(4, 1), beside(3, 2)],
        ..LaneCenter::default()
    };
    let feature = |id, feature_data| MapFeature { id, feature_data: Some(feature_data) };
    let light = |step| TrafficSignalLaneState { lane: 2, state: if step < 40 { 4 } else { 6 }, ..Default::default() };
    Scenario {
        timestamps_seconds: (0..91).map(|step| f64::from(step) / 10.0).collect(),
        tracks: vec![track(30), track(31), track(32)],
        objects_of_interest: vec![32],
        scenario_id: "abc".to_owned(),
        sdc_track_index: Some(1),
        dynamic_map_states: (0..91).map(|step| DynamicMapState { lane_states: vec![light(step)] }).collect(),
        map_features: vec![
            feature(2, FeatureData::Lane(Box::new(lane(5.0, vec![bound])))),
            feature(3, FeatureData::Lane(Box::new(lane(9.0, Vec::new())))),
            feature(7, FeatureData::RoadLine(RoadSide { kind: 2, polyline: line(6.5, &[-5.0, 95.0]) })),
            feature(8, FeatureData::StopSign(StopSign { lane: vec![3], position: None })),
            feature(9, FeatureData::Crosswalk(Crosswalk { polygon: corners(4) })),
        ],
        current_time_index: Some(10),
        tracks_to_predict: vec![RequiredPrediction { track_index: 0 }],
    }
}

/// Some corners of an area across the first lane alone, between two of its points.
fn corners(n: usize) -> Vec<MapPoint> {
    let all = [(40.0, 3.0), (44.5, 3.0), (44.5, 8.0), (40.0, 8.0)];
    all.into_iter().take(n).map(|(x, y)| MapPoint { x, y }).collect()
}

fn config() -> IngestConfig {
    IngestConfig::new(Dataset::Womd, vec!["x".into()])
}

fn parsed(scenario: &Scenario, split: Split, config: &IngestConfig) -> Result<RawScene, Reject> {
    let unit = RawUnit {
        file: "x.tfrecord".to_owned(),
        case_id: "record at byte 7".to_owned(),
        split: UnitSplit::All(split),
        bytes: scenario.encode_to_vec(),
        ..RawUnit::default()
    };
    Womd::new(config).expect("shorter than recorded").scene(&unit)
}

#[test]
fn tracks_have_states_sizes_and_roles() {
    let short = IngestConfig { n_history: Some(10), n_future: Some(30), ..config() };
    let scene = parsed(&scenario(), Split::Train, &short).expect("whole");
    let found = (scene.n_timesteps, scene.source.first_frame.as_str(), scene.id.0.as_str());
    assert_eq!(found, (40, "1", "womd/train//abc"));
    let roles: Vec<TrackRole> = scene.tracks.iter().map(|track| track.role).collect();
    assert_eq!(roles, [TrackRole::Scored, TrackRole::Recorder, TrackRole::Scored]);
    let track = &scene.tracks[0];
    let gaps: Vec<usize> = (0..40).filter(|timestep| !track.trajectory.is_valid(*timestep)).collect();
    assert_eq!((gaps, track.class), (vec![2], AgentClass::Vehicle), "from the second timestep on");
    // Of sizes, the one at present.
    assert!((track.extent.expect("recorded").length_m - 4.1).abs() < 1e-6);
    let state = track.trajectory.get(9).expect("the present");
    assert!(state.position == Vec2::new(10.0, 5.0) && state.heading_rad.abs() < 1e-6, "two turns are none");
    assert!(scene.own_map.is_some() && scene.findings.is_empty());
    let bare = parsed(&scenario(), Split::Train, &IngestConfig { maps: MapsConfig::None, ..short }).expect("whole");
    assert!(bare.own_map.is_none());
}

#[test]
fn lanes_have_sides_neighbors_and_controls() {
    let graph = |scenario: &Scenario| parsed(scenario, Split::Train, &config()).expect("whole").own_map.expect("lanes");
    let read = graph(&scenario());
    let lane = |id| read.get(LaneId(id)).expect("a lane");
    let line = |points: &[(f64, f64)]| Polyline(points.iter().map(|(x, y)| Vec2::new(*x, *y)).collect());
    // Beyond the line that the map names, and on the other side, half of 3.8 m is assumed.
    let [left, right] = [[6.9, 6.5, 6.5, 6.5], [3.1; 4]]
        .map(|ys| line(&std::array::from_fn::<_, 4, _>(|i| ([0.0, 10.0, 20.0, 90.0][i], ys[i]))));
    let Lane { left: own_left, right: own_right, attributes, left_neighbor, .. } = lane(2);
    let off_m = |a: &Polyline, b: &Polyline| a.0.iter().zip(&b.0).map(|(a, b)| a.distance(*b)).fold(0.0, f64::max);
    assert!(off_m(own_left, &left).max(off_m(own_right, &right)) < 1e-9, "{own_left:?} {own_right:?}");
    assert_eq!(*left_neighbor, Some(LaneId(3)), "the one that is there for longest");
    let tags: Vec<(&str, &str)> = attributes.tags.iter().map(|(key, value)| (key.as_str(), value.as_str())).collect();
    let expected = [
        ("boundaries", "assumed:3.8_m_wide at 5 of 8 points"),
        ("crosswalk:9", "40,3 44.5,3 44.5,8 40,8"),
        ("left_boundaries", "7:1-3/solid_single_white"),
        ("left_neighbors", "4:0-1/1-2;3:0-2/1-2"),
        ("speed_limit_mps", "11.176"),
        ("traffic_light", "stop:0-39;go:40-90"),
    ];
    assert_eq!(tags, expected);
    let seen = (attributes.kind.as_str(), attributes.is_intersection, lane(3).attributes.is_intersection);
    assert_eq!(seen, ("surface_street", false, true));
    assert!(attributes.has_traffic_control && lane(3).attributes.has_traffic_control);
    assert_eq!(lane(3).attributes.tags["stop_signs"], "8");
    assert!(!lane(3).attributes.tags.contains_key("crosswalk:9"));
    // What is no area is left out and named.
    let mut pointless = scenario();
    pointless.map_features[4].feature_data = Some(FeatureData::Crosswalk(Crosswalk { polygon: corners(2) }));
    let found = parsed(&pointless, Split::Train, &config()).expect("whole");
    assert_eq!(found.findings[0].detail, "x.tfrecord: record at byte 7: crosswalk 9 is left out");
    // A line that doubles back is none to be bounded by; the lane stays.
    let mut folded = scenario();
    let Some(FeatureData::RoadLine(side)) = &mut folded.map_features[2].feature_data else { panic!("a line") };
    side.polyline = [(5.0, 6.5), (95.0, 6.0), (5.0, 5.5)].map(|(x, y)| MapPoint { x, y }).to_vec();
    assert_eq!(graph(&folded).lanes().len(), 2);
}

#[test]
fn what_cannot_be_read_is_named() {
    type Change = fn(&mut Scenario);
    let cases: [(Change, Split, &str); 14] = [
        (|of| of.current_time_index = None, Split::Val, "wrong_timestamp_count"),
        (|of| of.current_time_index = Some(91), Split::Val, "wrong_timestamp_count"),
        (|of| of.current_time_index = Some(9), Split::Val, "wrong_timestamp_count"),
        (|of| of.timestamps_seconds.truncate(90), Split::Val, "wrong_timestamp_count"),
        (|of| of.tracks.iter_mut().for_each(|track| track.states.truncate(11)), Split::Val, "wrong_timestamp_count"),
        (|of| of.tracks.iter_mut().for_each(|track| track.states.truncate(11)), Split::Test, ""),
        (|of| of.timestamps_seconds[50] += 0.07, Split::Val, "uneven_times"),
        (|of| of.scenario_id.clear(), Split::Val, "not_a_scenario"),
        (|of| of.tracks[1].states.truncate(40), Split::Val, ""),
        (|of| of.sdc_track_index = None, Split::Val, "no_recorder"),
        (|of| of.sdc_track_index = Some(-1), Split::Val, "no_recorder"),
        (|of| of.sdc_track_index = Some(999), Split::Val, "no_recorder"),
        (|of| of.tracks[1].object_type = 2, Split::Val, "no_recorder"),
        (|of| of.tracks[1].states[10].valid = false, Split::Val, "no_recorder"),
    ];
    for (i, (change, split, expected)) in cases.into_iter().enumerate() {
        let mut scenario = scenario();
        change(&mut scenario);
        let found = parsed(&scenario, split, &config());
        let reason = found.as_ref().map_or_else(|reject| reject.reason, |_| "");
        assert_eq!(reason, expected, "{i}");
        assert!(found.is_ok_and(|scene| scene.tracks.len() == 3) || !expected.is_empty(), "{i}");
    }
    let mut doubtful = scenario();
    doubtful.tracks[0].states[4].center_x = f64::NAN;
    doubtful.tracks[2].id = 31;
    let Some(FeatureData::Lane(lane)) = &mut doubtful.map_features[0].feature_data else { panic!("a lane") };
    lane.polyline[1].y = f64::INFINITY;
    let scene = parsed(&doubtful, Split::Val, &config()).expect("most of it is sound");
    let found: Vec<&str> = scene.findings.iter().map(|finding| finding.what).collect();
    assert_eq!(found, ["states_left_out", "tracks_of_repeated_ids", "broken_lanes"]);
    assert!(scene.findings.iter().all(|finding| finding.detail.starts_with("x.tfrecord: record at byte 7: ")));
    let mut odd = scenario();
    odd.timestamps_seconds[50] += 0.03;
    odd.tracks[0].states[10].length = 4000.0;
    odd.tracks[1].states.truncate(50);
    odd.dynamic_map_states[0].lane_states[0].lane = 77;
    let Some(FeatureData::Lane(lane)) = &mut odd.map_features[0].feature_data else { panic!("a lane") };
    (lane.left_neighbors[1].neighbor_start_index, lane.left_boundaries[0].lane_end_index) = (-5, 4);
    let scene = parsed(&odd, Split::Val, &config()).expect("its recorder is there");
    let prefix = "x.tfrecord: record at byte 7: ";
    let found: Vec<_> = scene.findings.iter().map(|of| (of.what, of.n, of.detail.trim_start_matches(prefix))).collect();
    let beside = |what: &str| format!("lane 2: {what} is beside points that are not there");
    let expected = [
        ("sizes_left_out", 1, "track 30 at timestep 10 is 4000 by 1.75 m, expected 0.001 to 1000 m"),
        ("recorders_absent_at_times", 1, "the recorder is there at 50 of 91 timesteps"),
        ("uneven_times", 1, "timestep 50 is 5.030 s after the first, expected 10 Hz; taken as that"),
        ("indices_out_of_range", 2, &format!("{}; {}", beside("neighbor 3"), beside("boundary 7"))),
        ("lights_of_unknown_lanes", 1, "lane 77"),
    ];
    assert_eq!(found, expected);
    assert!((scene.tracks[0].extent.expect("the size before").length_m - 4.09).abs() < 1e-6);
    let lanes = scene.own_map.expect("lanes");
    let Lane { left_neighbor, attributes, .. } = lanes.get(LaneId(2)).expect("a lane");
    let seen = (*left_neighbor, attributes.tags["left_neighbors"].as_str());
    assert_eq!(seen, (None, "4:0-1/1-2"), "lane 4 is not there");
    assert_eq!(attributes.tags[LaneAttributes::LIGHT], "stop:1-39;go:40-90");
    let mut short = scenario();
    short.timestamps_seconds.truncate(61);
    let detail = parsed(&short, Split::Val, &config()).expect_err("too short").detail;
    assert!(detail.ends_with("set ingest.n_history and ingest.n_future for shorter scenes"), "{detail}");
    let unit = RawUnit { bytes: vec![0x0a, 1, 0], case_id: "record at byte 0".to_owned(), ..RawUnit::default() };
    let reject = Womd::new(&config()).expect("defaults").scene(&unit).expect_err("no scenario");
    assert_eq!(reject.detail, ": record at byte 0: is a tf.Example; the files of `scenario` are read");
    let longer = IngestConfig { n_future: Some(81), ..config() };
    assert!(Womd::new(&longer).err().expect("too long").to_string().starts_with("ingest.n_future: is 81, but womd"));
}

#[test]
fn folders_of_shards_are_read() {
    let (scenes, report) =
        scenes(&IngestConfig::new(Dataset::Womd, vec!["tests/fixtures/recordings/womd".into()])).expect("whole");
    let by: Vec<(&str, u64)> = report.scenes_by.iter().map(|(key, n)| (key.as_str(), *n)).collect();
    assert_eq!((by, report.n_rejects()), (vec![("test/none", 1), ("train/none", 2), ("val/none", 1)], 0));
    assert_eq!(scenes.iter().map(|scene| scene.n_timesteps).collect::<Vec<_>>(), [11, 91, 91, 91]);
    assert!(scenes.iter().all(|scene| scene.ego().role == TrackRole::Recorder && scene.lanes.lanes().len() > 30));
    assert!(report.warnings.is_empty(), "{:?}", report.warnings);
}

#[test]
fn the_two_public_scenarios_are_read() {
    let Some(path) = test_data("samples/womd") else { return };
    let (scenes, report) = scenes(&IngestConfig::new(Dataset::Womd, vec![path])).expect("whole");
    assert_eq!(report.rejects.keys().collect::<Vec<_>>(), ["not_a_scenario"], "the tf.Example");
    let counts = |scene: &Scene| (scene.tracks.len(), scene.ego().id.0.clone(), scene.lanes.lanes().len());
    // 83 and 257 tracks, of which 50 and 84 are there at present, and 198 and 114 lanes, one of them a point.
    let expected = [(50, "2406".to_owned(), 197), (64, "2893".to_owned(), 114)];
    assert_eq!(scenes.iter().map(counts).collect::<Vec<_>>(), expected);
}
