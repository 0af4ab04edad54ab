//! From files to scenes, on small tables that are written here.

mod damaged;

use super::*;
use crate::ingest::archive::visit_entries;
use crate::ingest::test_data::test_data;
use crate::ingest::{RawScene, Reject};
use crate::scene::{AgentClass, Split, TrackRole};
use std::ops::ControlFlow;
use std::path::Path;

const V1_2: &str = "case_id,track_id,frame_id,timestamp_ms,agent_type,x,y,vx,vy,psi_rad,length,width\n";
const V1_1: &str = "track_id,frame_id,timestamp_ms,agent_type,x,y,vx,vy,psi_rad,length,width\n";
const V1_1_PEDESTRIANS: &str = "track_id,frame_id,timestamp_ms,agent_type,x,y,vx,vy\n";

/// A car that drives along x at 10 m/s in the frames `frames`; `case` is the case id and comma, or empty.
fn car(case: &str, track: u32, frames: std::ops::RangeInclusive<u32>) -> String {
    frames.map(|f| format!("{case}{track},{f},{}00,car,{f},2,10,0,0,4.5,1.8\n", f)).collect()
}

fn config(root: &Path) -> IngestConfig {
    IngestConfig::new(Dataset::Interaction, vec![root.to_owned()])
}

/// The units that the files of `config.inputs` are cut into.
fn read_units(config: &IngestConfig) -> Result<Vec<Result<RawUnit, Reject>>, Error> {
    let source = Interaction::new(config);
    let mut reader = source.unit_reader();
    let mut units = Vec::new();
    let mut emit = |unit| {
        units.push(unit);
        ControlFlow::Continue(())
    };
    loop {
        visit_entries(&config.inputs, &|path| source.is_recording(path), &mut |entry, bytes| {
            reader.read(entry, bytes, &mut emit)
        })?;
        if !reader.next_pass() {
            break;
        }
    }
    let _ = reader.finish(&mut emit)?;
    drop(reader);
    Ok(units)
}

fn parse(source: &Interaction<'_>, unit: RawUnit) -> Vec<Result<RawScene, Reject>> {
    source.parse(unit).into_iter().map(|scene| scene()).collect()
}

fn read_scenes(config: &IngestConfig) -> Vec<Result<RawScene, Reject>> {
    let source = Interaction::new(config);
    let units = read_units(config).unwrap();
    units
        .into_iter()
        .flat_map(|unit| unit.map_or_else(|reject| vec![Err(reject)], |unit| parse(&source, unit)))
        .collect()
}

/// The scenes of these files, each `(path, content)`.
fn scenes_of(files: &[(&str, &str)]) -> Vec<Result<RawScene, Reject>> {
    let folder = folder_of(files);
    read_scenes(&config(folder.path()))
}

fn folder_of(files: &[(&str, &str)]) -> tempfile::TempDir {
    let folder = tempfile::tempdir().unwrap();
    for (name, text) in files {
        let path = folder.path().join(name);
        fs_err::create_dir_all(path.parent().unwrap()).unwrap();
        fs_err::write(path, text).unwrap();
    }
    folder
}

fn outcomes(scenes: &[Result<RawScene, Reject>]) -> Vec<&str> {
    scenes.iter().map(|scene| scene.as_ref().map_or_else(|reject| reject.reason, |scene| scene.id.0.as_str())).collect()
}

#[test]
fn a_case_is_a_scene() {
    let pedestrian = "1.0,P2,10,1000,pedestrian/bicycle,5,6,0,-1,,,\n";
    let text = [V1_2, &car("1.0,", 7, 1..=40), &car("1.0,", 9, 5..=12), pedestrian, &car("2.0,", 7, 3..=40)].concat();
    let scenes = scenes_of(&[("train/SIM_A_train.csv", &text)]);
    assert_eq!(outcomes(&scenes), ["interaction/train/SIM_A/1", "interaction/train/SIM_A/2"]);
    let scene = scenes[0].as_ref().unwrap();
    assert_eq!((scene.n_history, scene.n_timesteps, scene.dt_s), (10, 40, 0.1));
    assert_eq!(scene.map_id.0, "interaction/SIM_A");
    let source = &scene.source;
    assert_eq!((source.version.as_str(), source.split, source.place.as_str()), ("v1.2", Split::Train, "SIM_A"));
    let found = (source.file.as_str(), source.case_id.as_str(), source.first_frame.as_str());
    assert_eq!(found, ("train/SIM_A_train.csv", "1.0", "1"));

    let [first, late, pedestrian] = scene.tracks.as_slice() else { panic!("three tracks") };
    assert_eq!((first.id.0.as_str(), first.class, first.role), ("7", AgentClass::Vehicle, TrackRole::Context));
    assert_eq!(first.extent.unwrap().length_m, 4.5);
    assert_eq!(first.trajectory.n_valid(), 40);
    let state = first.trajectory.get(9).unwrap();
    assert_eq!((state.position.x, state.position.y, state.velocity.x), (10.0, 2.0, 10.0));
    assert_eq!(late.trajectory.valid().map(|(timestep, _)| timestep).collect::<Vec<_>>(), (4..12).collect::<Vec<_>>());
    assert_eq!((pedestrian.class, pedestrian.extent), (AgentClass::PedestrianOrCyclist, None));
    assert!((pedestrian.trajectory.get(9).unwrap().heading_rad + std::f64::consts::FRAC_PI_2).abs() < 1e-12);
    // A case without an agent in its first frames still begins at frame 1.
    assert!(scenes[1].as_ref().unwrap().tracks[0].trajectory.get(2).is_some());
}

#[test]
fn test_cases_have_their_history_and_marks() {
    let header = V1_2.replace('\n', ",track_to_predict,interesting_agent\n");
    let marked = |track, marks: &str| car("1.0,", track, 1..=10).replace('\n', &format!(",{marks}\n"));
    let text = [&header, &marked(1, "1.0,1.0"), &marked(2, "1.0,0.0"), marked(3, "0.0,0.0").as_str()].concat();
    let files = [("test_multi-agent/SIM_A_obs.csv", text.as_str()), ("test_single-agent/SIM_A_obs.csv", text.as_str())];
    let scenes = scenes_of(&files);
    assert_eq!(outcomes(&scenes), ["interaction/test/SIM_A/1", "interaction/test/SIM_A/single-agent:1"]);
    let scene = scenes[0].as_ref().unwrap();
    assert_eq!((scene.n_history, scene.n_timesteps), (10, 10));
    let roles: Vec<TrackRole> = scene.tracks.iter().map(|track| track.role).collect();
    assert_eq!(roles, [TrackRole::Focal, TrackRole::Scored, TrackRole::Context]);
}

#[test]
fn the_present_of_a_case_is_fixed() {
    let folder = folder_of(&[("SIM_A_val.csv", &[V1_2, &car("1.0,", 7, 1..=40)].concat())]);
    let shorter = IngestConfig { n_history: Some(4), n_future: Some(6), ..config(folder.path()) };
    let scenes = read_scenes(&shorter);
    let scene = scenes[0].as_ref().unwrap();
    assert_eq!((scene.n_history, scene.n_timesteps, scene.source.first_frame.as_str()), (4, 10, "7"));
    assert_eq!(scene.tracks[0].trajectory.get(3).unwrap().position.x, 10.0);
    let longer = IngestConfig { n_future: Some(31), ..config(folder.path()) };
    assert!(read_units(&longer).unwrap_err().to_string().contains("n_future"));
}

#[test]
fn recordings_are_cut_into_windows_and_divided_by_time() {
    // 200 frames: windows begin at 1, 41, 81, 121 and 161; val begins at 141.
    let vehicles = [V1_1, &car("", 1, 1..=200), &car("", 2, 50..=70)].concat();
    let pedestrians = [V1_1_PEDESTRIANS, "P1,90,9000,pedestrian/bicycle,0,0,1,1\n"].concat();
    let folder = folder_of(&[
        ("recorded_trackfiles/SIM_A/vehicle_tracks_003.csv", &vehicles),
        ("recorded_trackfiles/SIM_A/pedestrian_tracks_003.csv", &pedestrians),
    ]);
    let config = IngestConfig { holdout_share: 0.3, ..config(folder.path()) };
    let scenes = read_scenes(&config);
    let expected = [
        "interaction/train/SIM_A/003@1",
        "interaction/train/SIM_A/003@41",
        "interaction/train/SIM_A/003@81",
        "window_across_holdout",
        "interaction/val/SIM_A/003@161",
    ];
    assert_eq!(outcomes(&scenes), expected);
    let tracks = |index: usize| -> Vec<&str> {
        scenes[index].as_ref().unwrap().tracks.iter().map(|track| track.id.0.as_str()).collect()
    };
    assert_eq!((tracks(0), tracks(1), tracks(2), tracks(4)), (vec!["1"], vec!["1", "2"], vec!["1", "P1"], vec!["1"]));
    let source = &scenes[1].as_ref().unwrap().source;
    assert_eq!((source.version.as_str(), source.case_id.as_str(), source.first_frame.as_str()), ("v1.1", "003", "41"));

    // Any stride; the windows before the cut are train, those after it val.
    let config = IngestConfig { window_stride: 7, holdout_share: 0.5, ..config };
    let scenes = read_scenes(&config);
    let n_windows = scenes.iter().filter(|scene| scene.is_ok()).count();
    assert_eq!((scenes.len(), n_windows), ((200 - 40) / 7 + 1, 9 + 8));
}

#[test]
fn recordings_without_whole_or_filled_windows_say_so() {
    let short = [V1_1, &car("", 1, 1..=39)].concat();
    assert_eq!(outcomes(&scenes_of(&[("SIM_A/vehicle_tracks_000.csv", &short)])), ["recording_too_short"]);
    let gap = [V1_1, &car("", 1, 1..=40), &car("", 2, 81..=120)].concat();
    let scenes = scenes_of(&[("train/SIM_A/vehicle_tracks_000.csv", &gap)]);
    assert_eq!(outcomes(&scenes), ["interaction/train/SIM_A/000@1", "empty_window", "interaction/train/SIM_A/000@81"]);
    let far = [V1_1, &car("", 1, 1..=1), "2,2000000,200000000,car,0,0,0,0,0,4,2\n"].concat();
    assert_eq!(outcomes(&scenes_of(&[("SIM_A/vehicle_tracks_000.csv", &far)])), ["frame_out_of_range"]);
    let empty = scenes_of(&[("SIM_A/vehicle_tracks_000.csv", V1_1), ("SIM_A_val.csv", V1_2)]);
    assert_eq!(outcomes(&empty), ["no_rows"; 2]);
}

#[test]
fn windows_style_files_are_the_same() {
    let text = [V1_2, &car("1.0,", 7, 1..=40), &car("2.0,", 7, 1..=40)].concat();
    let crlf = format!("\u{feff}{}", text.trim_end().replace('\n', "\r\n"));
    let [plain, windows] = [&text, &crlf].map(|text| scenes_of(&[("SIM_A_val.csv", text)]));
    assert_eq!(plain.len(), 2);
    for (plain, windows) in plain.iter().zip(&windows) {
        assert_eq!(plain.as_ref().unwrap().tracks, windows.as_ref().unwrap().tracks);
    }
    let text = [V1_1, &car("", 7, 1..=40)].concat();
    let crlf = format!("\u{feff}{}", text.trim_end().replace('\n', "\r\n"));
    let [plain, windows] = [&text, &crlf].map(|text| scenes_of(&[("val/SIM_A/vehicle_tracks_000.csv", text)]));
    assert_eq!(plain[0].as_ref().unwrap().tracks, windows[0].as_ref().unwrap().tracks);
}

#[test]
fn cases_whose_rows_are_not_together_are_rejected() {
    let by_case: String =
        (1..=3).flat_map(|case| (7..=9).map(move |track| car(&format!("{case}.0,"), track, 1..=40))).collect();
    let by_track: String =
        (7..=9).flat_map(|track| (1..=3).map(move |case| car(&format!("{case}.0,"), track, 1..=40))).collect();
    let [by_case, by_track] =
        [&by_case, &by_track].map(|rows| scenes_of(&[("SIM_A_val.csv", &[V1_2, rows.as_str()].concat())]));
    assert!(by_case.len() == 3 && by_case.iter().all(Result::is_ok));
    assert_eq!(outcomes(&by_track), ["case_not_contiguous"; 3]);
}

#[test]
fn quoted_tables_are_those_without_quotes() {
    let table = [V1_2, &car("1.0,", 7, 1..=40), &car("2.0,", 7, 1..=40)].concat();
    let recording = [V1_1, &car("", 7, 1..=40)].concat();
    for (name, text) in [("SIM_A_val.csv", table), ("train/SIM_A/vehicle_tracks_000.csv", recording)] {
        let all: String = text.lines().map(|line| format!("\"{}\"\r\n", line.replace(',', "\",\""))).collect();
        let some = text.replace("car", "\"car\"");
        let noted: String = text.lines().map(|line| format!("{line},\"left, then right\"\n")).collect();
        let plain = scenes_of(&[(name, &text)]);
        for quoted in [all, some, noted.replacen("\"left, then right\"", "note", 1)] {
            let scenes = scenes_of(&[(name, &quoted)]);
            assert_eq!(outcomes(&scenes), outcomes(&plain));
            for (scene, plain) in scenes.iter().zip(&plain) {
                assert_eq!(scene.as_ref().unwrap().tracks, plain.as_ref().unwrap().tracks);
            }
        }
    }
    let open = [V1_2, &car("1.0,", 7, 1..=40), &car("2.0,", 7, 1..=40).replacen("car", "\"car", 1)].concat();
    let scenes = scenes_of(&[("SIM_A_val.csv", &open)]);
    assert_eq!(outcomes(&scenes), ["interaction/val/SIM_A/1", "unknown_agent_type"]);
}

#[test]
fn recordings_of_one_place_are_told_apart_by_their_files() {
    let table = [V1_1, &car("", 1, 1..=40)].concat();
    let scenes = scenes_of(&[("SIM_A_train.csv", &table), ("SIM_A_val.csv", &table)]);
    let expected = ["interaction/train/SIM_A/SIM_A_train@1", "interaction/val/SIM_A/SIM_A_val@1"];
    assert_eq!(outcomes(&scenes), expected);
}

#[test]
fn only_what_is_asked_for_is_read() {
    let table = [V1_2, &car("1.0,", 7, 1..=40)].concat();
    let folder = folder_of(&[
        ("train/SIM_A_train.csv", &table),
        ("val/SIM_A_val.csv", &table),
        ("val/SIM_B_val.csv", &table),
        ("maps/SIM_A.osm", ""),
    ]);
    let config = IngestConfig { splits: vec![Split::Val], places: vec!["SIM_B".to_owned()], ..config(folder.path()) };
    assert_eq!(outcomes(&read_scenes(&config)), ["interaction/val/SIM_B/1"]);
    let source = Interaction::new(&config);
    assert!(source.map_at("maps/SIM_B.osm_xy").is_some() && source.map_at("maps/SIM_A.osm").is_none());
    assert_eq!(source.map_of("x/SIM_B_val.csv"), Some(map_id(Dataset::Interaction, "SIM_B")));
    assert_eq!(source.map_of("vehicle_tracks_000.csv"), None);
    assert_eq!(source.map_of("SIM_B/vehicle_tracks_000.csv"), Some(map_id(Dataset::Interaction, "SIM_B")));
    assert_eq!(source.map_of("train/notes.csv"), None);
}

#[test]
fn a_recording_takes_twice_its_text_and_a_case_its_text() {
    let folder = tempfile::tempdir().unwrap();
    let config = config(folder.path());
    let source = Interaction::new(&config);
    for (name, header, case, factor) in
        [("recorded_trackfiles/X/vehicle_tracks_000.csv", V1_1, "", 2), ("val/X_val.csv", V1_2, "1.0,", 1)]
    {
        let path = folder.path().join(name);
        fs_err::create_dir_all(path.parent().unwrap()).unwrap();
        fs_err::write(&path, format!("{header}{}", car(case, 1, 1..=40))).unwrap();
        let units = read_units(&config).unwrap();
        fs_err::remove_file(&path).unwrap();
        let unit = units[0].as_ref().unwrap();
        assert!(unit.n_bytes() > 1000, "{name}");
        assert_eq!(source.n_bytes_parsed(unit), factor * unit.n_bytes(), "{name}");
    }
}

#[test]
fn the_toy_recording_of_the_interaction_authors_is_read() {
    let Some(samples) = test_data("samples/interaction_official") else { return };
    let config = IngestConfig { holdout_share: 0.0, n_future: Some(5), ..config(&samples) };
    let scenes = read_scenes(&config);
    // The second car comes at frame 31 and drives the other way.
    assert_eq!(outcomes(&scenes).len(), 3);
    let scene = scenes[1].as_ref().unwrap();
    let [first, second] = scene.tracks.as_slice() else { panic!("two cars") };
    let state = first.trajectory.get(0).unwrap();
    assert_eq!((state.position.x, state.position.y, state.heading_rad), (41.0, 2.5, 0.0));
    let state = second.trajectory.get(0).unwrap();
    assert_eq!((state.position.x, state.position.y, state.velocity.x), (90.0, 5.5, 10.0));
    assert!((state.heading_rad - std::f64::consts::PI).abs() < 1e-4);
}
