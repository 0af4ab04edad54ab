//! From files and a mapping to scenes.

use super::*;
use crate::geometry::{Vec2, angle_difference};
use crate::ingest::test_data::scenes as read;
use crate::scene::{AgentClass, Scene, Track};
use std::collections::BTreeMap;
use std::path::Path;

mod damaged;
mod doubts;
mod formats;
mod motion;

fn config(folder: &Path, mapping: &str) -> IngestConfig {
    let table = toml::from_str(mapping).unwrap_or_else(|error| panic!("{error}: {mapping}"));
    IngestConfig {
        table: Some(table),
        maps: crate::ingest::MapsConfig::None,
        ..IngestConfig::new(Dataset::Table, vec![folder.to_owned()])
    }
}

/// The reasons of all rejects, with their first examples.
fn rejects(folder: &Path, mapping: &str) -> String {
    match read(&config(folder, mapping)) {
        Ok((_, report)) => format!("{:?}", report.rejects),
        Err(error) => error.to_string(),
    }
}

/// A folder with this file, all of it in the train split.
fn file(name: &str, text: &str) -> tempfile::TempDir {
    let folder = tempfile::tempdir().unwrap();
    fs_err::create_dir(folder.path().join("train")).unwrap();
    fs_err::write(folder.path().join("train").join(name), text).unwrap();
    folder
}

/// A car that drives along x at 10 m/s for `n` rows at 10 Hz, as `row` writes it: frame, time in s, x in m.
fn drive(header: &str, n: usize, row: impl Fn(usize, f64, f64) -> String) -> String {
    (0..n).fold(header.to_owned(), |text, i| text + "\n" + &row(i, i as f64 / 10.0, i as f64))
}

const PLAIN: &str = "columns = { track = 'id', x = 'x', y = 'y', time = 't' }";

fn plain(n: usize) -> String {
    drive("id,t,x,y", n, |_, t, x| format!("7,{t},{x},2"))
}

#[test]
fn tables_are_read_as_the_reader_of_their_format_reads_them() {
    let folder = Path::new("tests/fixtures/recordings/interaction_v1_1");
    let own = IngestConfig::new(Dataset::Interaction, vec![folder.to_owned()]);
    let mapping = "
        files = 'vehicle_tracks_*.csv'
        time_unit_s = 0.001
        place = 'FIX_Intersection'
        columns = { track = 'track_id', x = 'x', y = 'y', time = 'timestamp_ms', heading = 'psi_rad',
                    length = 'length', width = 'width', class = 'agent_type' }
        classes = { car = 'vehicle' }";
    let table = IngestConfig { maps: own.maps, ..config(folder, mapping) };
    let [(own, _), (table, _)] = [own, table].map(|config| read(&config).unwrap());
    // Scenes have other names, so other egos are drawn.
    let vehicles = |scene: &Scene| -> BTreeMap<String, Track> {
        let vehicles = scene.tracks.iter().filter(|track| track.class.is_motorized()).cloned();
        let in_world =
            |track: Track| Track { trajectory: track.trajectory.into_frame(&scene.world_from_scene), ..track };
        vehicles.map(|track| (track.id.0.clone(), in_world(track))).collect()
    };
    let mut n_compared = 0;
    for scene in &table {
        assert!(!scene.lanes.lanes().is_empty());
        let frame = scene.id.0.rsplit_once('@').unwrap().1;
        let is_same = |own: &&Scene| own.id.0.ends_with(&format!("@{frame}")) && own.source.split == scene.source.split;
        let own = vehicles(own.iter().find(is_same).unwrap_or_else(|| panic!("{}", scene.id)));
        for (id, track) in vehicles(scene) {
            let own = &own[&id];
            assert_eq!((track.class, track.extent), (own.class, own.extent));
            let mut is_known_before = false;
            for (state, own) in track.trajectory.entries().iter().zip(own.trajectory.entries()) {
                assert_eq!(state.is_some(), own.is_some(), "{} {id}", scene.id);
                let Some((state, own)) = state.zip(*own) else { continue };
                assert!(state.position.distance(own.position) < 1e-9, "{} {id}: {state:?} {own:?}", scene.id);
                // The velocity of a first state may be recorded.
                let is_same = (state.velocity - own.velocity).norm() < 1e-9;
                assert!(is_same || !is_known_before, "{} {id}: {state:?} {own:?}", scene.id);
                is_known_before = true;
                assert!(angle_difference(state.heading_rad, own.heading_rad).abs() < 1e-9);
                n_compared += 1;
            }
        }
    }
    assert!(table.len() > 2 && n_compared > 500, "{} scenes, {n_compared} states", table.len());
}

#[test]
fn sizes_and_classes_may_be_in_a_table_of_tracks() {
    let folder = file("01_tracks.csv", &drive("id,frame,x,y", 40, |i, _, x| format!("7,{i},{x},0\n8,{i},{x},5")));
    let mapping = "
        files = '*_tracks.csv'
        track_files = '*_tracksMeta.csv'
        frame_rate_hz = 10
        columns = { track = 'id', x = 'x', y = 'y', frame = 'frame', length = 'l', width = 'w', class = 'class' }
        classes = { Car = 'vehicle', Bike = 'cyclist' }";
    assert!(rejects(folder.path(), mapping).contains("01_tracksMeta.csv is not among the inputs"));
    let meta = |text: &str| fs_err::write(folder.path().join("train/01_tracksMeta.csv"), text).unwrap();
    meta("id,l,w,class\n8,1.8,0.6,Bike\n7,4.5,1.8,Car\n");
    let (scenes, _) = read(&config(folder.path(), mapping)).unwrap();
    let of = |track: &Track| (track.id.0.clone(), track.class, track.extent.unwrap().length_m);
    let found = scenes[0].tracks.iter().map(of).collect::<Vec<_>>();
    assert_eq!(found, [("7".to_owned(), AgentClass::Vehicle, 4.5), ("8".to_owned(), AgentClass::Cyclist, 1.8)]);
    // Who is not in it is left out and named.
    meta("id,l,w,class\n7,4.5,1.8,Car\n");
    let (scenes, report) = read(&config(folder.path(), mapping)).unwrap();
    let missing = &report.warnings["agents_missing_in_their_table"];
    assert!(scenes[0].tracks.len() == 1 && missing.count == 1, "{missing:?}");
    assert!(missing.examples[0].contains("01_tracksMeta.csv: no row for track 8"), "{missing:?}");
}

#[test]
fn a_file_may_have_several_recordings_and_places() {
    let text = drive("id,t,x,y,run,where", 80, |_, t, x| format!("1,{t},{x},0,a,North\n1,{t},{x},0,b,South"));
    let folder = file("all.csv", &text);
    let mapping = "columns = { track = 'id', x = 'x', y = 'y', time = 't', recording = 'run', place = 'where' }";
    let (scenes, _) = read(&config(folder.path(), mapping)).unwrap();
    let mut ids: Vec<&str> = scenes.iter().map(|scene| &scene.id.0["table/train/".len()..]).collect();
    ids.sort_unstable();
    assert_eq!(ids, ["North/train-all:a@0", "North/train-all:a@40", "South/train-all:b@0", "South/train-all:b@40"]);
    let without = "columns = { track = 'id', x = 'x', y = 'y', time = 't', place = 'where' }";
    assert_eq!(read(&config(folder.path(), without)).unwrap().0.len(), 4);
    // A recording that cannot be read does not affect the others.
    let other = drive("id,t,x,y,run,where", 80, |_, t, x| format!("1,{t},{x},0,a,North\n1,{t},{},0,b,South", 1e3 * x));
    fs_err::write(folder.path().join("train/all.csv"), other).unwrap();
    let (scenes, report) = read(&config(folder.path(), mapping)).unwrap();
    assert_eq!((scenes.len(), report.rejects["implausible_positions"].count), (2, 1));
    let mixed = text.replace(",a,North", ",a,X").replace(",b,South", ",b,X").replace(",0,b", ",9,b");
    fs_err::write(folder.path().join("train/all.csv"), mixed).unwrap();
    assert!(rejects(folder.path(), without).contains("all.csv, line 3: track 1 is at two positions at one time"));
}

#[test]
fn positions_in_degrees_are_meters_from_an_origin() {
    const MAPPING: &str = "
        heading = 'compass_degrees'
        origin = { latitude_deg = 49.0, longitude_deg = 8.4 }
        columns = { track = 'id', x = 'lon', y = 'lat', time = 't', heading = 'course' }";
    let text = |lat: f64, lon: f64| {
        drive("id,t,lon,lat,course", 60, |i, t, _| format!("7,{t},{lon},{:.8},0", lat + 9e-6 * i as f64))
    };
    let folder = file("a.csv", &text(49.003_456, 8.424_276));
    let (scenes, _) = read(&config(folder.path(), MAPPING)).unwrap();
    let scene = &scenes[0];
    // The length of a degree of the meridian there, by its series, in the scale of the zone: 111,209.8 m * 0.9996217.
    for (_, state) in scene.tracks[0].trajectory.valid().skip(1) {
        assert!((state.velocity.norm() - 9e-5 * 111_167.7).abs() < 2e-3, "{state:?}");
        // Headings are turned by the convergence at the origin, which is 0.024 degrees of longitude away.
        assert!(angle_difference(state.heading_rad, state.velocity.angle()).abs() < 4e-4, "{state:?}");
    }
    let first = scene.world_from_scene.point(scene.tracks[0].trajectory.get(0).unwrap().position);
    assert!((first.y - 0.003_456 * 111_167.7).abs() < 20.0 && (first.x - 1775.0).abs() < 5.0, "{first:?}");
    for (lat, lon) in [(8.4, 49.0), (49.0, 11.4)] {
        let folder = file("a.csv", &text(lat, lon));
        let found = rejects(folder.path(), MAPPING);
        assert!(found.contains("out_of_range"), "{found}");
        assert!(found.contains("is lon the longitude and lat the latitude"), "{found}");
    }
}

#[test]
fn a_table_needs_a_mapping() {
    let folder = file("a.csv", &plain(60));
    let none = IngestConfig { table: None, ..config(folder.path(), PLAIN) };
    assert!(read(&none).unwrap_err().to_string().starts_with("ingest.table: is missing"));
}

#[test]
fn times_and_places_far_from_zero_are_read_as_they_are() {
    for begun_s in [0.0, -5e4, 99_000.0, 320_000.0, 999_990.0, 1_118_846_980.2] {
        for origin in [Vec2::ZERO, Vec2::new(563_048.7, 5_780_028.1), Vec2::new(-1.3e7, 9_990_000.0)] {
            let row = |_, t: f64, x: f64| format!("7,{:.1},{:.4},{:.4}", begun_s + t, origin.x + x, origin.y);
            // Where every frame has a row, no gap needs to be filled.
            let mapping = format!("max_gap_s = 0.05\n{PLAIN}");
            let (scenes, report) = read(&config(file("a.csv", &drive("id,t,x,y", 60, row)).path(), &mapping)).unwrap();
            assert_eq!((scenes.len(), report.warnings.len()), (1, 0), "{begun_s} {origin:?}");
            let scene = &scenes[0];
            for (i, state) in scene.ego().trajectory.valid() {
                let at = scene.world_from_scene.point(state.position);
                assert!(at.distance(origin + Vec2::new(i as f64, 0.0)) < 1e-4, "{begun_s} {origin:?}: {at:?}");
                assert!((state.velocity.x - 10.0).abs() < 1e-3, "{begun_s} {origin:?}: {state:?}");
            }
        }
    }
}

#[test]
fn each_unit_and_axis_has_a_value_that_only_the_right_reading_gives() {
    // A car, 4 m long, that drives at 5 m/s along 30 degrees from x, from (2, 1); written in each way, and read back.
    let (heading, begin) = (30.0_f64, Vec2::new(2.0, 1.0));
    let along = Vec2::from_angle(heading.to_radians());
    type Write = fn(f64, Vec2, f64) -> [f64; 4];
    let cases: [(&str, Write); 9] = [
        ("", |t, at, deg| [t, at.x, at.y, deg.to_radians()]),
        ("heading = 'degrees'", |t, at, deg| [t, at.x, at.y, deg]),
        ("heading = 'degrees'", |t, at, deg| [t, at.x, at.y, deg - 360.0]),
        // East is 90 degrees on a compass, and north 0.
        ("heading = 'compass_degrees'", |t, at, deg| [t, at.x, at.y, 90.0 - deg]),
        // In an image y points down, and angles from x toward y turn the other way.
        ("y_points_down = true\nheading = 'degrees'", |t, at, deg| [t, at.x, -at.y, -deg]),
        ("y_points_down = true", |t, at, deg| [t, at.x, -at.y, -deg.to_radians()]),
        ("length_unit_m = 0.3048", |t, at, deg| [t, at.x / 0.3048, at.y / 0.3048, deg.to_radians()]),
        ("time_unit_s = 0.001", |t, at, deg| [1e3 * t, at.x, at.y, deg.to_radians()]),
        ("frame_rate_hz = 25\ncolumns.frame = 't'", |t, at, deg| [25.0 * t, at.x, at.y, deg.to_radians()]),
    ];
    for (mapping, write) in cases {
        // Where the car is when its front or rear is at `at`, and when the corner of a box along x is.
        for (position, shift, deg) in [
            ("center", Vec2::ZERO, heading),
            ("front", along * 2.0, heading),
            ("rear", along * -2.0, heading),
            ("corner", Vec2::new(-2.0, -0.9), 0.0),
        ] {
            let is_down = mapping.contains("down");
            let is_corner = position == "corner";
            let along = if is_corner { Vec2::new(1.0, 0.0) } else { along };
            // The corner with the least y in the image is the upper one.
            let shift = if is_corner && is_down { Vec2::new(-2.0, 0.9) } else { shift };
            let unit_m = if mapping.contains("length_unit_m") { 0.3048 } else { 1.0 };
            let row = |i: usize, _: f64, _: f64| {
                let t = i as f64 * 0.04;
                let [t, x, y, h] = write(t, begin + along * (5.0 * t) + shift, deg);
                format!("7,{t},{x},{y},{h},{},{}", 4.0 / unit_m, 1.8 / unit_m)
            };
            let time = if mapping.contains("columns.frame") { "" } else { "columns.time = 't'" };
            let mapping = format!(
                "position = '{position}'\ncolumns.track = 'id'\ncolumns.x = 'x'\ncolumns.y = 'y'\n{time}
                 columns.heading = 'h'\ncolumns.length = 'l'\ncolumns.width = 'w'\n{mapping}"
            );
            let folder = file("a.csv", &drive("id,t,x,y,h,l,w", 101, row));
            let (scenes, report) =
                read(&config(folder.path(), &mapping)).unwrap_or_else(|error| panic!("{mapping}: {error}"));
            assert!(report.warnings.is_empty(), "{mapping}: {:?}", report.warnings);
            let (scene, ego) = (&scenes[0], scenes[0].ego());
            assert_eq!(ego.trajectory.n_valid(), 40, "{mapping}");
            assert!((ego.extent.unwrap().length_m - 4.0).abs() < 1e-9, "{mapping}");
            for (i, state) in ego.trajectory.valid() {
                let state = state.transformed(&scene.world_from_scene);
                let at = begin + along * (0.5 * i as f64);
                assert!(state.position.distance(at) < 1e-6, "{mapping} {i}: {:?}, expected {at:?}", state.position);
                let off_rad = angle_difference(state.heading_rad, deg.to_radians());
                assert!(off_rad.abs() < 1e-9, "{mapping} {i}: {}", state.heading_rad);
                assert!(state.velocity.distance(along * 5.0) < 1e-6, "{mapping} {i}: {:?}", state.velocity);
            }
        }
    }
}
