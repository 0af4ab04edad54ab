//! Columns and types as datasets and tools write them.

use super::*;

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
            assert!((state.position.x - 5.0).abs() < 1e-6, "{i} {state:?}");
            assert!((state.velocity.norm() - 1.0).abs() < 1e-6, "{i} {state:?}");
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
fn types_of_agents_that_are_not_mapped_are_named() {
    let rows = |_, t: f64, x: f64| format!("{t};car0;{x};-3;90;car\n{t};ped0;{};5;90;DEFAULT_PEDTYPE", 30.0 - 0.1 * x);
    let header = "timestep_time;vehicle_id;vehicle_x;vehicle_y;vehicle_angle;vehicle_type";
    let folder = file("traffic.csv", &drive(header, 40, rows));
    let columns = "columns = { track = 'vehicle_id', x = 'vehicle_x', y = 'vehicle_y', time = 'timestep_time' }";
    let (_, report) = read(&config(folder.path(), columns)).unwrap();
    let said = &report.warnings["columns_of_types_not_mapped"].examples[0];
    let expected = "column vehicle_type (car, DEFAULT_PEDTYPE) is not mapped, and everybody is of class vehicle";
    assert!(said.contains(expected) && said.contains("ingest.table.columns.class"), "{said}");
}
