//! From files and a mapping to scenes.

use super::*;
use crate::geometry::{Vec2, angle_difference};
use crate::ingest::{IngestReport, ingest};
use crate::progress::Silent;
use crate::scene::{AgentClass, Scene, Track};
use std::collections::BTreeMap;
use std::path::Path;

mod motion;

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
    let cases: [Case<'_>; 5] = [
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
            "timestep_time;vehicle_id;vehicle_x;vehicle_y;vehicle_angle;vehicle_type;",
            Box::new(|_, t, x| format!("{t};5;{};-3;90;car;\n{t};;;;;;", x + 2.3)),
            None,
            "train-traffic",
        ),
        (
            "i24_motion",
            "i24_1.csv",
            "id,t,x,y,length,width,class",
            Box::new(|_, t, x| {
                let (x, y, length, width) = (ft(x - 2.0), ft(-3.0), ft(4.0), ft(2.0));
                format!("5,{},{x},{y},{length},{width},4", 1e-3 * epoch_ms + t)
            }),
            None,
            "I-24",
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
        ("id,l,w,class\n9,4.5,1.8,Car\n", "01_tracksMeta.csv: no row for track 7; 2 of 2 agents cannot be used"),
        ("id,l,w,class\n7,4.5,1.8,Bus\n8,3,1,Tram\n", "01_tracksMeta.csv, line 2: column class is \\\"Bus\\\""),
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
        assert!(
            found.contains("out_of_range") && found.contains("is lon the longitude and lat the latitude"),
            "{found}"
        );
    }
}

#[test]
fn a_table_needs_a_mapping() {
    let folder = file("a.csv", &plain(60));
    let none = IngestConfig { table: None, ..config(folder.path(), PLAIN) };
    assert!(read(&none).unwrap_err().to_string().starts_with("ingest.table: is missing"));
}

#[test]
fn damaged_tables_are_rejects() {
    for (text, expected) in [
        (plain(60).replace(",2", ","), "a.csv: line 2: column y is blank or NaN, expected a number; 60 of 60 rows"),
        (
            drive("id,t,x,y", 60, |_, t, x| format!("7,{t},{},2", 1e3 * x)),
            "where no vehicle comes from the rows around",
        ),
        ("PAR1 and nothing else".to_owned(), "a.csv: "),
        // What was left out may explain why too little is left.
        (
            plain(42).replace("\n7,0,0,2", "\n7,0,,2").replace("\n7,0.1,1,2", "").replace("\n7,0.2,2,2", ""),
            "; 1 rows left out, the first: ",
        ),
    ] {
        let found = rejects(file("a.csv", &text).path(), PLAIN);
        assert!(found.contains(expected), "{expected}: {found}");
    }
}

#[test]
fn what_is_bad_costs_no_more_than_itself_and_is_counted() {
    // Four cars side by side.
    let row = |i: usize, t: f64, x: f64| {
        (1..=4).map(|id| format!("{id},{t},{x},{},4.5,1.8,car", 4 * id)).collect::<Vec<_>>().join("\n")
            + if i == 30 { "\n,3,9,9,,,\n-1,3,9,9,,,\n-1,3,99,9,,,nan" } else { "" }
    };
    let whole = drive("id,t,x,y,l,w,c", 100, row);
    let mapping = "
        columns = { track = 'id', x = 'x', y = 'y', time = 't', length = 'l', width = 'w', class = 'c' }
        classes = { car = 'vehicle' }";
    let of_agent = |id: usize, cell: &str, by: &str| {
        let own =
            |line: &str| if line.starts_with(&format!("{id},")) { line.replace(cell, by) } else { line.to_owned() };
        whole.lines().map(own).collect::<Vec<_>>().join("\n")
    };
    let is_kept = |text: &str, what: &str, n: u64, said: &str, n_states: [usize; 4]| {
        let folder = file("a.csv", text);
        let (scenes, report) = read(&config(folder.path(), mapping)).unwrap_or_else(|error| panic!("{what}: {error}"));
        assert_eq!(report.warnings["rows_without_track"].count, 3);
        if n > 0 {
            let found = report.warnings.get(what).unwrap_or_else(|| panic!("{what}: {:?}", report.warnings));
            assert!(found.count == n && found.examples[0].contains(said), "{found:?}");
        }
        let of = |id: usize| {
            let track = scenes[0].tracks.iter().find(|track| track.id.0 == id.to_string());
            track.map_or(0, |track| track.trajectory.n_valid())
        };
        assert_eq!([1, 2, 3, 4].map(of), n_states, "{what} {said}");
    };
    let all = [40; 4];
    is_kept(&whole, "", 0, "", all);
    for (from, to, what, said) in [
        ("2,1.2,12,8,", "2,1.2,,8,", "rows_left_out", "line 51: column x is blank or NaN"),
        ("2,1.2,12,8,4.5", "2,1.2,12,8,long", "rows_left_out", "line 51: column l is \"long\""),
        ("2,1.2,12,8,4.5,1.8,car", "2,1.2,12", "rows_left_out", "line 51: 3 cells, expected 7"),
        ("2,1.2,12,8,4.5,1.8,car", "\"2,1.2,12,8,4.5,1.8,car", "rows_left_out", "line 51: a quote"),
        ("2,1.2,12,8,", "2,1.2,1e300,8,", "rows_out_of_range", "line 51: column x is 1e300 m"),
        ("2,1.2,12,8,", "2,1e9,12,8,", "rows_out_of_range", "line 51: is 1000000000 s after the first row"),
        ("2,1.2,12,8,", "2,1.2,52,8,", "rows_out_of_place", "line 51: track 2 is at (52.0, 8.0) m"),
        ("2,1.2,12,8,4.5,", "2,1.2,12,8,-4.5,", "", ""),
    ] {
        assert!(whole.contains(from));
        is_kept(&whole.replacen(from, to, 1), what, u64::from(!what.is_empty()), said, all);
    }
    let at_once = whole.replacen("2,1.2,12,8,", "2,1.3,52,8,", 1);
    for (text, what, said) in [
        (of_agent(2, ",car", ",e-scooter"), "agents_of_unlisted_class", "line 3: column c is \"e-scooter\""),
        (of_agent(2, ",car", ","), "agents_of_unlisted_class", "line 3: column c is \"\""),
        (of_agent(2, ",car", ",nan"), "agents_of_unlisted_class", "line 3: column c is \"nan\""),
        (of_agent(2, ",4.5,1.8", ",-4.5,1.8"), "agents_with_bad_values", "line 3: track 2 is -4.5 by 1.8 m"),
        (at_once, "agents_at_two_places_at_one_time", "track 2 is at two positions at one time"),
    ] {
        is_kept(&text, what, 1, said, [40, 0, 40, 40]);
    }
    // An id of another car: after a gap by its size, and at once by its place.
    let later = |line: &str| {
        let time_s = |rest: &str| rest.split(',').next().and_then(|t| t.parse().ok()).unwrap_or(0.0);
        match line.strip_prefix("3,").map(|rest| (rest, time_s(rest))) {
            Some((_, 1.0..3.0)) => String::new(),
            Some((rest, 3.0..)) => format!("3,{}\n", rest.replace(",4.5,1.8", ",12,2.5")),
            _ => format!("{line}\n"),
        }
    };
    let passed_on: String = whole.lines().map(later).collect();
    is_kept(&passed_on, "ids_of_another_agent", 1, "track 3 goes on as 3#2: its size is another", [40, 40, 10, 40]);
    let (scenes, _) = read(&config(file("a.csv", &passed_on).path(), mapping)).unwrap();
    let length_of = |scene: &Scene, id: &str| {
        scene.tracks.iter().find(|track| track.id.0 == id).map(|track| track.extent.unwrap().length_m)
    };
    let lengths = [0, 1].map(|idx: usize| ["3", "3#2"].map(|id| length_of(&scenes[idx], id)));
    assert_eq!(lengths, [[Some(4.5), None], [None, Some(12.0)]], "of agents at present");
    let far = |i: usize, t: f64, x: f64| format!("1,{t},{x},0\n2,{t},{},9", if i < 5 { x } else { x + 90.0 });
    let folder = file("a.csv", &drive("id,t,x,y", 60, far));
    let (scenes, report) = read(&config(folder.path(), PLAIN)).unwrap();
    assert_eq!(report.warnings["ids_of_another_agent"].count, 1);
    let ids: Vec<&str> = scenes[0].tracks.iter().map(|track| track.id.0.as_str()).collect();
    assert_eq!(ids, ["1", "2#2"], "those at present");
}

#[test]
fn oddities_are_counted() {
    let odd = plain(60).replace("7,3,30,2\n", "7,3,30,2\n7,3,30,2\n,3,1,1\n").replace("7,2,20,2\n7,2.1,21,2\n", "");
    let (scenes, report) = read(&config(file("a.csv", &odd).path(), PLAIN)).unwrap();
    assert_eq!(scenes[0].ego().trajectory.n_valid(), 40);
    let warnings: Vec<String> = report.warnings().collect();
    let warned = |what: &str| warnings.iter().any(|warning| warning.contains(what));
    assert!(warned("1 gaps filled") && warned("1 rows repeated") && warned("1 rows without track"), "{warnings:?}");
}

#[test]
fn times_and_places_far_from_zero_are_read_as_they_are() {
    for begun_s in [0.0, -5e4, 99_000.0, 320_000.0, 999_990.0, 1_118_846_980.2] {
        for origin in [Vec2::ZERO, Vec2::new(563_048.7, 5_780_028.1), Vec2::new(-1.3e7, 9_990_000.0)] {
            let row = |_, t: f64, x: f64| format!("7,{:.1},{:.4},{:.4}", begun_s + t, origin.x + x, origin.y);
            let (scenes, report) = read(&config(file("a.csv", &drive("id,t,x,y", 60, row)).path(), PLAIN)).unwrap();
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

#[test]
fn people_may_be_in_columns_of_their_own() {
    // What SUMO's xml2csv.py makes of its XML, and what SUMO writes itself.
    let own = |_: usize, t: f64, x: f64| format!("{t};90;car0;{x};-3;car;;;;;\n{t};;;;;;0;ped0;5;{};walker", 0.1 * x);
    let same = |_: usize, t: f64, x: f64| format!("{t};90;car0;{x};-3;car\n{t};0;ped0;5;{};walker", 0.1 * x);
    let vehicles = "timestep_time;vehicle_angle;vehicle_id;vehicle_x;vehicle_y;vehicle_type";
    let persons = format!("{vehicles};person_angle;person_id;person_x;person_y;person_type");
    for text in [drive(&persons, 40, own), drive(vehicles, 40, same)] {
        let folder = file("traffic.csv", &text.replace("walker", "DEFAULT_PEDTYPE"));
        let text = fs_err::read_to_string("configs/sumo_fcd.toml").unwrap();
        let sections: BTreeMap<String, IngestConfig> = toml::from_str(&text).unwrap();
        let config = IngestConfig { inputs: vec![folder.path().to_owned()], ..sections["ingest"].clone() };
        let (scenes, report) = read(&config).unwrap();
        assert!(report.warnings.is_empty(), "{:?}", report.warnings);
        let tracks: Vec<_> = scenes[0].tracks.iter().map(|track| (track.id.0.as_str(), track.class)).collect();
        assert_eq!(tracks, [("car0", AgentClass::Vehicle), ("ped0", AgentClass::Pedestrian)]);
        for (i, state) in scenes[0].tracks[1].trajectory.valid() {
            let state = state.transformed(&scenes[0].world_from_scene);
            assert!(
                (state.position.x - 5.0).abs() < 1e-6 && (state.velocity.norm() - 1.0).abs() < 1e-6,
                "{i} {state:?}"
            );
            assert!((state.heading_rad - std::f64::consts::FRAC_PI_2).abs() < 1e-9, "{i} {state:?}");
        }
    }
}

#[test]
fn parquet_is_read_whatever_types_its_columns_have() {
    use arrow::array::{ArrayRef, Float64Array, Int64Array, RecordBatch};
    use arrow::compute::cast;
    use arrow::datatypes::{DataType, TimeUnit};
    use std::sync::Arc;
    let n = 60;
    let floats = |of: fn(i64) -> f64| -> ArrayRef { Arc::new(Float64Array::from_iter((0..n).map(of))) };
    let whole = |of: fn(i64) -> i64| -> ArrayRef { Arc::new(Int64Array::from_iter((0..n).map(of))) };
    let as_type = |column: ArrayRef, to: DataType| cast(&column, &to).unwrap();
    let decimal = |column: ArrayRef| as_type(column, DataType::Decimal128(12, 2));
    let category =
        |column: ArrayRef| as_type(column, DataType::Dictionary(Box::new(DataType::Int32), Box::new(DataType::Utf8)));
    let ids = [floats(|_| 1.0), whole(|_| 1), decimal(whole(|_| 1)), category(whole(|_| 1))];
    let ns = || whole(|i| 1_700_000_000_000_000_000 + i * 100_000_000);
    let us = |of: DataType| as_type(whole(|i| i * 100_000), of);
    let times = [
        floats(|i| i as f64 / 10.0),
        as_type(ns(), DataType::Timestamp(TimeUnit::Nanosecond, Some("UTC".into()))),
        us(DataType::Timestamp(TimeUnit::Microsecond, None)),
        us(DataType::Duration(TimeUnit::Microsecond)),
        decimal(floats(|i| i as f64 / 10.0)),
    ];
    let classes = [floats(|_| 2.0), whole(|_| 2), category(whole(|_| 2))];
    for (at, time) in times.iter().enumerate() {
        let columns: [(&str, ArrayRef); 5] = [
            ("id", Arc::clone(&ids[at % ids.len()])),
            ("t", Arc::clone(time)),
            ("x", decimal(whole(|i| i))),
            ("y", floats(|_| 2.0)),
            ("c", Arc::clone(&classes[at % classes.len()])),
        ];
        let batch = RecordBatch::try_from_iter(columns).unwrap();
        let mut bytes = Vec::new();
        let mut writer = parquet::arrow::ArrowWriter::try_new(&mut bytes, batch.schema(), None).unwrap();
        writer.write(&batch).unwrap();
        writer.close().unwrap();
        let folder = file("a.meta", "id,l,w\n1.0,4.5,1.8\n");
        fs_err::write(folder.path().join("train/a.parquet"), bytes).unwrap();
        let mapping = "
            files = '*.parquet'
            track_files = '*.meta'
            columns = { track = 'id', x = 'x', y = 'y', time = 't', class = 'c', length = 'l', width = 'w' }
            classes = { 2 = 'bus' }";
        let (scenes, _) = read(&config(folder.path(), mapping)).unwrap_or_else(|error| panic!("{at}: {error}"));
        let ego = scenes[0].ego();
        assert_eq!((ego.id.0.as_str(), ego.class, ego.trajectory.n_valid()), ("1", AgentClass::Bus, 40), "{at}");
        assert!(ego.extent.is_some() && (ego.trajectory.get(20).unwrap().velocity.x - 10.0).abs() < 1e-3, "{at}");
    }
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
