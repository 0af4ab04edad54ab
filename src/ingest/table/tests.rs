//! From files and a mapping to scenes.

use super::*;
use crate::geometry::{Vec2, angle_difference};
use crate::ingest::{IngestReport, ingest};
use crate::progress::Silent;
use crate::scene::{AgentClass, Scene, Track};
use std::collections::BTreeMap;
use std::path::Path;

fn config(folder: &Path, mapping: &str) -> IngestConfig {
    let table = toml::from_str(mapping).unwrap_or_else(|error| panic!("{error}: {mapping}"));
    IngestConfig {
        table: Some(table),
        maps: crate::ingest::MapsConfig::None,
        ..IngestConfig::new(Dataset::Table, vec![folder.to_owned()])
    }
}

fn read(config: &IngestConfig) -> Result<(Vec<Scene>, IngestReport), Error> {
    let mut scenes = Vec::new();
    let report = ingest(config, None, &Silent, &mut |batch| {
        scenes.extend(batch.scenes);
        Ok(())
    })?;
    Ok((scenes, report))
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
fn mappings_that_come_along_read_their_formats() {
    // A car 4 m long and 2 m wide whose center drives along y = -3 at 10 m/s, in the columns of each dataset.
    let epoch_ms = 1_118_846_980_200.0;
    let ft = |m: f64| m / 0.3048;
    type Row<'a> = Box<dyn Fn(usize, f64, f64) -> String + 'a>;
    // Mapping, file, header, rows, table of tracks, place.
    type Case<'a> = (&'a str, &'a str, &'a str, Row<'a>, Option<(&'a str, &'a str)>, &'a str);
    let cases: [Case<'_>; 4] = [
        (
            "highd",
            "01_tracks.csv",
            "frame,id,x,y,width,height,xVelocity,yVelocity",
            Box::new(|i, _, x| format!("{},5,{},{},4.0,2.0,10,0", 1.0 + 2.5 * i as f64, x - 2.0, 3.0 - 1.0)),
            Some(("01_tracksMeta.csv", "id,width,height,initialFrame,finalFrame,class\n5,4.0,2.0,1,90,Truck\n")),
            "highD",
        ),
        (
            "ind",
            "18_tracks.csv",
            "recordingId,trackId,frame,trackLifetime,xCenter,yCenter,heading,width,length",
            Box::new(|i, _, x| format!("18,5,{},0,{x},-3,360,2.0,4.0", 2.5 * i as f64)),
            Some(("18_tracksMeta.csv", "recordingId,trackId,width,length,class\n18,5,2.0,4.0,car\n")),
            "inD",
        ),
        (
            "ngsim",
            "NGSIM.csv",
            "Vehicle_ID,Frame_ID,Global_Time,Local_X,Local_Y,v_length,v_Width,v_Class,Location",
            Box::new(|i, t, x| {
                let (time, x, y) = (epoch_ms + 1e3 * t, ft(x + 2.0), ft(-3.0));
                format!("5,{i},{time},{x},{y},{},{},2,us-101", ft(4.0), ft(2.0))
            }),
            None,
            "us-101",
        ),
        (
            "sumo_fcd",
            "traffic.csv",
            "timestep_time;vehicle_id;vehicle_x;vehicle_y;vehicle_angle;vehicle_type;person_id",
            Box::new(|_, t, x| format!("{t};5;{};-3;90;car;\n{t};;;;;;walker", x + 2.3)),
            None,
            "train-traffic",
        ),
    ];
    for (name, recording, header, row, of_tracks, place) in cases {
        let folder = file(recording, &drive(header, 40, row));
        if let Some((name, text)) = of_tracks {
            fs_err::write(folder.path().join("train").join(name), text).unwrap();
        }
        let text = fs_err::read_to_string(format!("configs/{name}.toml")).unwrap();
        let sections: BTreeMap<String, IngestConfig> = toml::from_str(&text).unwrap();
        let config = IngestConfig { inputs: vec![folder.path().to_owned()], ..sections["ingest"].clone() };
        let (scenes, _) = read(&config).unwrap_or_else(|error| panic!("{name}: {error}"));
        let (scene, ego) = (&scenes[0], scenes[0].ego());
        assert_eq!((scene.source.place.as_str(), ego.class, scene.tracks.len()), (place, AgentClass::Vehicle, 1));
        assert_eq!(ego.trajectory.n_valid(), 40, "{name}");
        for (i, state) in ego.trajectory.valid() {
            let at = scene.world_from_scene.point(state.position);
            assert!(at.distance(Vec2::new(i as f64, -3.0)) < 1e-6, "{name} {i}: {at:?}");
            assert!((state.velocity.norm() - 10.0).abs() < 1e-6 && state.heading_rad.abs() < 1e-9, "{name}: {state:?}");
        }
    }
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
    assert!(rejects(folder.path(), mapping).contains("01_tracksMeta.csv is not in the same folder"));
    let meta = |text: &str| fs_err::write(folder.path().join("train/01_tracksMeta.csv"), text).unwrap();
    meta("id,l,w,class\n8,1.8,0.6,Bike\n7,4.5,1.8,Car\n");
    let (scenes, _) = read(&config(folder.path(), mapping)).unwrap();
    let of = |track: &Track| (track.id.0.clone(), track.class, track.extent.unwrap().length_m);
    assert_eq!(
        scenes[0].tracks.iter().map(of).collect::<Vec<_>>(),
        [("7".to_owned(), AgentClass::Vehicle, 4.5), ("8".to_owned(), AgentClass::Cyclist, 1.8)]
    );
    for (text, expected) in [
        ("id,l,w,class\n7,4.5,1.8,Car\n", "01_tracksMeta.csv: no row for track 8"),
        ("id,l,w,class\n7,4.5,1.8,Car\n8,3,1,Tram\n", "01_tracksMeta.csv, line 3: column class is \\\"Tram\\\""),
        ("id,l,class\n7,4.5,Car\n8,3,Car\n", "01_tracks.csv: no column w; the table has id, frame, x, y"),
    ] {
        meta(text);
        let rejects = rejects(folder.path(), mapping);
        assert!(rejects.contains(expected) || rejects.contains(&expected.replace("\\\"", "\"")), "{rejects}");
    }
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
    let odd = text.replace("1,1,10,0,b,South", "1,1,,0,b,South");
    fs_err::write(folder.path().join("train/all.csv"), odd).unwrap();
    let (scenes, report) = read(&config(folder.path(), mapping)).unwrap();
    assert_eq!((scenes.len(), report.rejects["non_finite"].count), (2, 1));
    let mixed = text.replace(",a,North", ",a,X").replace(",b,South", ",b,X").replace(",0,b", ",9,b");
    fs_err::write(folder.path().join("train/all.csv"), mixed).unwrap();
    assert!(rejects(folder.path(), without).contains("all.csv, line 3: track 1 is at two positions at one time"));
}

#[test]
fn mappings_that_cannot_work_are_refused_with_their_key() {
    let folder = file("a.csv", &plain(60));
    let columns = |more: &str| format!("columns = {{ track = 'id', x = 'x', y = 'y'{more} }}");
    for (mapping, expected) in [
        (columns(""), "ingest.table.columns: has neither time nor frame"),
        (columns(", time = 't', frame = 'f'"), "ingest.table.columns: has both time and frame"),
        (columns(", frame = 'f'"), "ingest.table.frame_rate_hz: is missing"),
        (format!("frame_rate_hz = 10\n{PLAIN}"), "ingest.table.frame_rate_hz: is of columns.frame"),
        (columns(", time = 't', length = 'l'"), "ingest.table.columns: has only one of length and width"),
        (format!("position = 'corner'\n{PLAIN}"), "ingest.table.position: is corner"),
        (columns(", time = 't', class = 'c'"), "ingest.table.classes: and columns.class belong together"),
        (format!("files = '*/*.csv'\n{PLAIN}"), "ingest.table.files: is the name of a file"),
        (format!("files = 'a'\ntrack_files = 'a'\n{PLAIN}"), "ingest.table.track_files: is the same"),
        (format!("max_gap_s = -1\n{PLAIN}"), "ingest.table.max_gap_s"),
        (columns(", time = 'when'"), "a.csv: no column when; the table has id, t, x, y"),
    ] {
        let found = rejects(folder.path(), &mapping);
        assert!(found.contains(expected), "{mapping}: {found}");
    }
    let none = IngestConfig { table: None, ..config(folder.path(), PLAIN) };
    assert!(read(&none).unwrap_err().to_string().starts_with("ingest.table: is missing"));
    let other = IngestConfig { dataset: Dataset::Interaction, ..config(folder.path(), PLAIN) };
    assert!(read(&other).unwrap_err().to_string().starts_with("ingest.table: is for dataset"));
}

#[test]
fn damaged_tables_are_rejects_and_oddities_are_counted() {
    let whole = plain(60);
    for (text, expected) in [
        (whole.replace("7,1.2,", "7,,"), "a.csv, line 14: column t is blank or NaN, expected a number"),
        (whole.replace("7,1.2,12,2", "7,1.2,12"), "a.csv: line 14: 3 cells, expected 4"),
        ("id,t,x,y\n".to_owned(), "a.csv: the table has no rows"),
        (String::new(), "a.csv: is empty"),
        (plain(20), "a.csv: 20 frames, a scene has 40"),
        (drive("id,t,x,y", 60, |_, t, x| format!("7,{},{x},2", 1e3 * t)), "rows of track 7 are 100.000 s apart"),
        ("\u{0}\u{1}\u{2}".to_owned(), "a.csv: no column id"),
        ("PAR1 and nothing else".to_owned(), "a.csv: "),
    ] {
        let found = rejects(file("a.csv", &text).path(), PLAIN);
        assert!(found.contains(expected), "{expected}: {found}");
    }
    let odd = whole.replace("7,3,30,2\n", "7,3,30,2\n7,3,30,2\n,3,1,1\n").replace("7,2,20,2\n7,2.1,21,2\n", "");
    let (scenes, report) = read(&config(file("a.csv", &odd).path(), PLAIN)).unwrap();
    assert_eq!(scenes[0].ego().trajectory.n_valid(), 40);
    let warnings: Vec<String> = report.warnings().collect();
    let warned = |what: &str| warnings.iter().any(|warning| warning.contains(what));
    assert!(warned("1 gaps filled") && warned("1 rows repeated") && warned("1 rows without track"), "{warnings:?}");
}

#[test]
fn types_of_agents_are_mapped_or_named() {
    let rows = |_, t: f64, x: f64| format!("{t};car0;{x};-3;90;car\n{t};ped0;{};5;90;DEFAULT_PEDTYPE", 30.0 - 0.1 * x);
    let header = "timestep_time;vehicle_id;vehicle_x;vehicle_y;vehicle_angle;vehicle_type";
    let folder = file("traffic.csv", &drive(header, 40, rows));
    let text = fs_err::read_to_string("configs/sumo_fcd.toml").unwrap();
    let sections: BTreeMap<String, IngestConfig> = toml::from_str(&text).unwrap();
    let mapped = IngestConfig { inputs: vec![folder.path().to_owned()], ..sections["ingest"].clone() };
    let (scenes, report) = read(&mapped).unwrap();
    let classes: Vec<AgentClass> = scenes[0].tracks.iter().map(|track| track.class).collect();
    assert_eq!(classes, [AgentClass::Vehicle, AgentClass::Pedestrian]);
    assert!(!report.warnings.contains_key("columns_of_types_not_mapped"));
    let columns = "columns = { track = 'vehicle_id', x = 'vehicle_x', y = 'vehicle_y', time = 'timestep_time' }";
    let (_, report) = read(&config(folder.path(), columns)).unwrap();
    let said = &report.warnings["columns_of_types_not_mapped"].examples[0];
    let expected = "column vehicle_type (car, DEFAULT_PEDTYPE) is not mapped, and everybody is of class vehicle";
    assert!(said.contains(expected) && said.contains("ingest.table.columns.class"), "{said}");
}
