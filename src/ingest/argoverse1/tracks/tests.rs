//! Argoverse 1 tracks: what is read, and what is rejected for which reason?

use super::*;
use crate::ingest::UnitSplit;
use crate::ingest::source::Horizon;
use crate::scene::RecordedPosition;
use std::fmt::Write;

/// Fifty timesteps of an AGENT that drives east at 10 m/s, the AV behind it, and a vehicle that stands.
pub(in crate::ingest) fn csv_text(n_timesteps: usize) -> String {
    let mut text = String::from("TIMESTAMP,TRACK_ID,OBJECT_TYPE,X,Y,CITY_NAME\n");
    for timestep in 0..n_timesteps {
        let time = 315_000_000.0 + 0.1 * timestep as f64;
        let x = 1000.0 + timestep as f64;
        writeln!(text, "{time:.1},av,AV,{:.1},2000.0,PIT", x - 20.0).expect("strings grow");
        writeln!(text, "{time:.1},agent,AGENT,{x:.1},2000.0,PIT").expect("strings grow");
        writeln!(text, "{time:.1},parked,OTHERS,1030.0,2003.5,PIT").expect("strings grow");
    }
    text
}

pub(in crate::ingest) fn unit(text: &str, split: Split) -> RawUnit {
    RawUnit {
        file: "train/data/7.csv".to_owned(),
        split: UnitSplit::All(split),
        case_id: "7".to_owned(),
        bytes: text.as_bytes().to_vec(),
        first_line: 1,
        ..RawUnit::default()
    }
}

fn parse_train(text: &str) -> Result<RawScene, Reject> {
    parse(&unit(text, Split::Train), RECORDED, false)
}

/// The reason and the `file:line` of the reject for `text`.
fn reject(text: &str) -> (&'static str, String) {
    let reject = parse_train(text).expect_err("the text is malformed");
    let place = reject.detail.split(": ").next().unwrap_or_default().to_owned();
    (reject.reason, place)
}

#[test]
fn a_file_becomes_a_scene() {
    let scene = parse_train(&csv_text(50)).expect("well formed");
    assert_eq!(scene.id.0, "argoverse1/train/PIT/7");
    assert_eq!(scene.map_id.0, "argoverse1/PIT");
    assert_eq!((scene.n_timesteps, scene.n_history), (50, 20));
    assert_eq!(scene.source.first_frame, "315000000");
    let roles: Vec<TrackRole> = scene.tracks.iter().map(|track| track.role).collect();
    assert_eq!(roles, [TrackRole::Recorder, TrackRole::Focal, TrackRole::Context]);
    let state = scene.tracks[1].trajectory.get(19).expect("tracked");
    assert_eq!(state.position, Vec2::new(1019.0, 2000.0));
    assert!(state.velocity.distance(Vec2::new(10.0, 0.0)) < 1e-5 && state.heading_rad == 0.0);
    assert_eq!(scene.heading_gaps, [HeadingGap { track_idx: 2, until_timestep: 50, never_moves: None }]);
}

#[test]
fn tracks_are_smoothed_and_what_was_recorded_is_kept() {
    let scene = parse(&unit(&csv_text(50), Split::Train), Horizon { n_history: 5, n_future: 10 }, true).expect("whole");
    assert_eq!((scene.n_timesteps, scene.n_history), (15, 5));
    let agent = &scene.tracks[1].trajectory;
    let state = agent.get(4).expect("tracked");
    assert!(state.position.distance(Vec2::new(1019.0, 2000.0)) < 0.05, "{state:?}");
    assert!(state.velocity.distance(Vec2::new(10.0, 0.0)) < 0.1 && state.heading_rad.abs() < 1e-9, "{state:?}");
    let derivation = agent.derivation().expect("nothing but positions is recorded");
    assert_eq!((derivation.recorded.len(), derivation.held_headings.as_slice()), (50, &[false; 15][..]));
    assert_eq!(derivation.recorded[19], RecordedPosition { time_s: 0.0, position: Vec2::new(1019.0, 2000.0) });
    assert_eq!(scene.heading_gaps, [HeadingGap { track_idx: 2, until_timestep: 35, never_moves: None }]);
    let test = parse(&unit(&csv_text(20), Split::Test), RECORDED, true).expect("a test file");
    assert_eq!((test.n_timesteps, test.tracks[1].trajectory.n_valid()), (20, 20));
}

#[test]
fn byte_order_mark_and_line_ends_do_not_matter() {
    let plain = parse_train(&csv_text(50)).expect("well formed");
    let text = format!("\u{feff}{}", csv_text(50).replace('\n', "\r\n"));
    let dressed = parse_train(text.trim_end()).expect("well formed");
    assert_eq!(plain.tracks, dressed.tracks);
}

#[test]
fn quoted_cells_are_read() {
    let quoted: String = csv_text(50).lines().map(|line| format!("\"{}\"\n", line.replace(',', "\",\""))).collect();
    let plain = parse_train(&csv_text(50)).expect("well formed");
    assert_eq!(parse_train(&quoted).expect("well formed").tracks, plain.tracks);
    let comma = parse_train(&quoted.replace("1000.0", "1000,0")).expect_err("a decimal comma");
    assert!(comma.detail.ends_with(":3: X is `1000,0`, expected a number"), "{}", comma.detail);
    let named = parse_train(&quoted.replace("parked", "par,ked")).expect_err("a comma in a name");
    assert!(named.detail.ends_with(":4: TRACK_ID is `par,ked`, expected a name without commas"), "{}", named.detail);
}

#[test]
fn columns_are_found_by_name() {
    let text: String = csv_text(50)
        .lines()
        .map(|line| {
            let f: Vec<&str> = line.split(',').collect();
            format!("{},{},extra,{},{},{},{}\n", f[5], f[3], f[4], f[0], f[2], f[1])
        })
        .collect();
    let found = parse_train(&text).expect("well formed").tracks;
    assert_eq!(found, parse_train(&csv_text(50)).expect("well formed").tracks);
}

#[test]
fn shorter_horizons_keep_the_present() {
    let horizon = Horizon { n_history: 5, n_future: 10 };
    let scene = parse(&unit(&csv_text(50), Split::Train), horizon, false).expect("well formed");
    assert_eq!((scene.n_timesteps, scene.n_history), (15, 5));
    assert_eq!(scene.tracks[1].trajectory.get(4).expect("tracked").position, Vec2::new(1019.0, 2000.0));
    assert_eq!(scene.source.first_frame, "315000001.5");
    assert_eq!(scene.heading_gaps[0].until_timestep, 35);
}

#[test]
fn only_test_files_may_end_at_the_present() {
    let scene = parse(&unit(&csv_text(20), Split::Test), RECORDED, false).expect("a test file");
    assert_eq!((scene.n_timesteps, scene.n_history), (20, 20));
    assert_eq!(reject(&csv_text(20)).0, "wrong_timestamp_count");
    assert_eq!(reject(&csv_text(49)).0, "wrong_timestamp_count");
    assert_eq!(reject(&csv_text(0)).0, "no_agent_track");
}

#[test]
fn malformed_rows_are_rejected_with_their_line() {
    let text = csv_text(50);
    let at_line_3 = |from: &str, to: &str| {
        let mut lines: Vec<String> = text.lines().map(str::to_owned).collect();
        lines[2] = lines[2].replace(from, to);
        lines.join("\n")
    };
    let place = || "train/data/7.csv:3".to_owned();
    assert_eq!(reject(&at_line_3(",PIT", "")), ("malformed_row", place()));
    assert_eq!(reject(&at_line_3("2000.0", "two")), ("malformed_row", place()));
    assert_eq!(reject(&at_line_3("2000.0", "")), ("malformed_row", place()));
    assert_eq!(reject(&at_line_3("PIT", "MIA")), ("malformed_row", place()));
    assert_eq!(reject(&at_line_3("2000.0", "NaN")), ("non_finite", place()));
    assert_eq!(reject(&at_line_3("2000.0", "1e999")), ("non_finite", place()));
    assert_eq!(reject(&at_line_3("agent", "av")), ("duplicate_frame", place()));
    assert_eq!(reject(&at_line_3("agent", "\"agent")).0, "several_agent_tracks");
    let twice = text.replace(",av,", ",7,").replace(",parked,", ",007,");
    assert_eq!(reject(&twice).0, "ambiguous_id");
    let truncated = &text[..text.len() - 20];
    assert_eq!(reject(truncated), ("malformed_row", "train/data/7.csv:151".to_owned()));
}

#[test]
fn bad_headers_are_rejected() {
    let text = csv_text(50);
    for bad in [text.replace(',', ";"), text.replace("OBJECT_TYPE", "TYPE"), String::new(), "\0\u{1}\u{2}".to_owned()] {
        assert_eq!(reject(&bad), ("bad_header", "train/data/7.csv:1".to_owned()));
    }
    let reject = parse_train(&text.replace(',', "\t")).expect_err("wrong delimiter");
    assert!(reject.detail.contains("expected comma-separated TIMESTAMP,TRACK_ID"), "{}", reject.detail);
}

#[test]
fn one_agent_is_expected() {
    assert_eq!(reject(&csv_text(50).replace("AGENT", "OTHERS")).0, "no_agent_track");
    assert_eq!(reject(&csv_text(50).replace("OTHERS", "AGENT")).0, "several_agent_tracks");
}
