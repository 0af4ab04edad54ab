//! Argoverse 2 tracks: what is read, and what is rejected for which reason?

use super::*;
use crate::ingest::UnitSplit;
use arrow::array::{ArrayRef, Float64Array, Int64Array, RecordBatch, StringArray};
use arrow::compute::cast;
use arrow::datatypes::DataType;
use parquet::arrow::ArrowWriter;
use parquet::basic::Compression;
use parquet::file::properties::WriterProperties;
use std::sync::Arc;

/// Two tracks over `n_timesteps`: the focal vehicle `7` drives north at 10 m/s, `AV` stands.
fn columns(n_timesteps: usize) -> Vec<(&'static str, ArrayRef)> {
    let rows: Vec<(usize, bool)> = (0..2 * n_timesteps).map(|i| (i / 2, i % 2 == 0)).collect();
    let floats = |value: &dyn Fn(usize, bool) -> f64| -> ArrayRef {
        Arc::new(rows.iter().map(|(t, is_focal)| value(*t, *is_focal)).collect::<Float64Array>())
    };
    let texts = |value: &dyn Fn(bool) -> &'static str| -> ArrayRef {
        Arc::new(StringArray::from_iter_values(rows.iter().map(|(_, is_focal)| value(*is_focal))))
    };
    let integers = |value: &dyn Fn(usize, bool) -> i64| -> ArrayRef {
        Arc::new(rows.iter().map(|(t, is_focal)| value(*t, *is_focal)).collect::<Int64Array>())
    };
    vec![
        ("track_id", texts(&|is_focal| if is_focal { "7" } else { "AV" })),
        ("object_type", texts(&|is_focal| if is_focal { "bus" } else { "vehicle" })),
        ("object_category", integers(&|_, is_focal| if is_focal { 3 } else { 1 })),
        ("timestep", integers(&|t, _| t as i64)),
        ("position_x", floats(&|_, is_focal| if is_focal { 5.0 } else { -5.0 })),
        ("position_y", floats(&|t, is_focal| if is_focal { t as f64 } else { 0.0 })),
        ("heading", floats(&|_, is_focal| if is_focal { std::f64::consts::FRAC_PI_2 } else { -4.0 })),
        ("velocity_x", floats(&|_, _| 0.0)),
        ("velocity_y", floats(&|_, is_focal| if is_focal { 10.0 } else { 0.0 })),
        ("scenario_id", texts(&|_| "abc")),
        ("focal_track_id", texts(&|_| "7")),
        ("city", texts(&|_| "austin")),
        ("start_timestamp", integers(&|_, _| 315_000_000_000_000_000)),
    ]
}

/// A whole scenario file.
/// A scenario in a file that names its writer.
pub(in crate::ingest) fn scenario_bytes(writer: &str) -> Vec<u8> {
    parquet_bytes_with(columns(110), WriterProperties::builder().set_created_by(writer.to_owned()).build())
}

fn parquet_bytes(columns: Vec<(&'static str, ArrayRef)>) -> Vec<u8> {
    parquet_bytes_with(columns, WriterProperties::default())
}

fn parquet_bytes_with(columns: Vec<(&'static str, ArrayRef)>, properties: WriterProperties) -> Vec<u8> {
    let batch = RecordBatch::try_from_iter(columns).expect("columns of one length");
    let mut bytes = Vec::new();
    let mut writer = ArrowWriter::try_new(&mut bytes, batch.schema(), Some(properties)).expect("a plain schema");
    writer.write(&batch).expect("memory");
    writer.close().expect("memory");
    bytes
}

fn parse_bytes(bytes: Vec<u8>, split: Split) -> Result<RawScene, Reject> {
    let unit = RawUnit {
        file: "abc/scenario_abc.parquet".to_owned(),
        split: UnitSplit::All(split),
        bytes,
        ..RawUnit::default()
    };
    parse(&unit, RECORDED)
}

fn parse_columns(columns: Vec<(&'static str, ArrayRef)>) -> Result<RawScene, Reject> {
    parse_bytes(parquet_bytes(columns), Split::Train)
}

fn replaced(name: &str, column: impl Fn(&ArrayRef) -> ArrayRef) -> Vec<(&'static str, ArrayRef)> {
    columns(110).into_iter().map(|(n, c)| (n, if n == name { column(&c) } else { c })).collect()
}

#[test]
fn a_file_becomes_a_scene() {
    let scene = parse_columns(columns(110)).expect("well formed");
    assert_eq!(scene.id.0, "argoverse2/train/austin/abc");
    assert_eq!((scene.n_timesteps, scene.n_history), (110, 50));
    assert_eq!(scene.source.first_frame, "315000000000000000");
    let focal = &scene.tracks[0];
    assert_eq!((focal.role, focal.class), (TrackRole::Focal, AgentClass::Bus));
    let state = focal.trajectory.get(49).expect("tracked");
    assert_eq!((state.position, state.velocity), (Vec2::new(5.0, 49.0), Vec2::new(0.0, 10.0)));
    assert_eq!(scene.tracks[1].role, TrackRole::Recorder);
    let heading = scene.tracks[1].trajectory.get(0).expect("tracked").heading_rad;
    assert!((heading + 4.0).abs() < 1e-12, "headings of vehicles are judged before they are wrapped");
}

#[test]
fn a_scenario_without_city_is_told() {
    let blank = |column: &ArrayRef| Arc::new(StringArray::from(vec![" "; column.len()])) as ArrayRef;
    let scene = parse_columns(replaced("city", blank)).expect("well formed");
    let found: Vec<&str> = scene.findings.iter().map(|finding| finding.what).collect();
    assert_eq!(found, ["scenarios_without_city"]);
}

#[test]
fn the_encoding_of_columns_does_not_matter() {
    let plain = parse_columns(columns(110)).expect("well formed");
    let dictionary = DataType::Dictionary(Box::new(DataType::Int32), Box::new(DataType::Utf8));
    for (name, data_type) in [
        ("track_id", dictionary),
        ("object_type", DataType::Utf8View),
        ("city", DataType::LargeUtf8),
        ("timestep", DataType::UInt16),
        ("start_timestamp", DataType::Float64),
    ] {
        let scene = parse_columns(replaced(name, |column| cast(column, &data_type).expect("castable"))).expect(name);
        assert_eq!((scene.tracks, scene.source), (plain.tracks.clone(), plain.source.clone()), "{name}");
    }
}

#[test]
fn a_start_of_another_type_is_none() {
    let texts = |column: &ArrayRef| Arc::new(StringArray::from(vec!["2021"; column.len()])) as ArrayRef;
    let times = |column: &ArrayRef| {
        let time = DataType::Timestamp(arrow::datatypes::TimeUnit::Nanosecond, None);
        cast(column, &time).expect("castable")
    };
    for columns in [replaced("start_timestamp", texts), replaced("start_timestamp", times)] {
        assert_eq!(parse_columns(columns).expect("it is optional").source.first_frame, "0");
    }
}

#[test]
fn types_outside_the_list_are_no_vehicles() {
    let of_types = |focal: &'static str, other: &'static str| {
        let types = move |column: &ArrayRef| {
            let each = (0..column.len()).map(|row| if row % 2 == 0 { focal } else { other });
            Arc::new(StringArray::from_iter_values(each)) as ArrayRef
        };
        parse_columns(replaced("object_type", types))
    };
    let scene = of_types("BUS", "Pedestrian").expect("listed, in another case");
    assert_eq!([scene.tracks[0].class, scene.tracks[1].class], [AgentClass::Bus, AgentClass::Pedestrian]);
    assert_eq!(scene.findings, []);
    let scene = of_types("bus", "unknown").expect("listed");
    assert_eq!((scene.tracks[1].class, scene.findings.len()), (AgentClass::Unknown, 0));
    let scene = of_types("bus", "hovercraft").expect("the bus is listed");
    assert_eq!((scene.findings[0].what, scene.findings[0].n), ("tracks_of_unlisted_types", 1));
    assert!(scene.findings[0].detail.contains("\"hovercraft\""), "{:?}", scene.findings);
    assert_eq!(of_types("unknown", "vehicle").expect_err("nobody to predict").reason, "unknown_agent_type");
}

#[test]
fn only_test_files_may_end_at_the_present() {
    let scene = parse_bytes(parquet_bytes(columns(50)), Split::Test).expect("a test file");
    assert_eq!((scene.n_timesteps, scene.n_history), (50, 50));
    for (n_timesteps, split) in [(50, Split::Train), (49, Split::Test), (109, Split::Val)] {
        let reject = parse_bytes(parquet_bytes(columns(n_timesteps)), split).expect_err("short");
        assert_eq!(reject.reason, "wrong_timestamp_count");
    }
}

#[test]
fn malformed_tables_are_rejected() {
    let reason = |columns| {
        let reject = parse_columns(columns).expect_err("malformed");
        assert!(reject.detail.starts_with("abc/scenario_abc.parquet: "), "{}", reject.detail);
        reject.reason
    };
    let floats =
        |value: f64| move |column: &ArrayRef| Arc::new(Float64Array::from(vec![value; column.len()])) as ArrayRef;
    let integers =
        |value: i64| move |column: &ArrayRef| Arc::new(Int64Array::from(vec![value; column.len()])) as ArrayRef;
    let texts = |value: &'static str| {
        move |column: &ArrayRef| Arc::new(StringArray::from(vec![value; column.len()])) as ArrayRef
    };
    let nulls = |column: &ArrayRef| Arc::new(Float64Array::from(vec![None; column.len()])) as ArrayRef;
    assert_eq!(reason(columns(110).into_iter().filter(|(name, _)| *name != "heading").collect()), "missing_column");
    assert_eq!(reason(replaced("position_x", floats(f64::NAN))), "non_finite");
    assert_eq!(reason(replaced("position_x", nulls)), "malformed_row");
    assert_eq!(reason(replaced("position_x", texts("east"))), "malformed_row");
    assert_eq!(reason(replaced("timestep", integers(-1))), "malformed_row");
    assert_eq!(reason(replaced("timestep", integers(110))), "malformed_row");
    assert_eq!(reason(replaced("track_id", texts("7"))), "duplicate_frame");
    assert_eq!(reason(replaced("focal_track_id", texts("8"))), "no_focal_track");
    let two_spellings = |column: &ArrayRef| {
        let ids = (0..column.len()).map(|i| ["7", "07"][i % 2]);
        Arc::new(StringArray::from_iter_values(ids)) as ArrayRef
    };
    assert_eq!(reason(replaced("track_id", two_spellings)), "ambiguous_id");
    assert_eq!(reason(columns(0)), "bad_parquet");
}

#[test]
fn columns_of_another_type_are_rejected_with_it() {
    let detail = |name: &str, data_type: DataType| {
        let columns = replaced(name, |column| cast(column, &data_type).expect("castable"));
        let reject = parse_columns(columns).expect_err("another type");
        assert_eq!(reject.reason, "malformed_row");
        reject.detail
    };
    let dictionary = DataType::Dictionary(Box::new(DataType::Int32), Box::new(DataType::Utf8));
    for (name, data_type, expected) in [
        ("position_x", DataType::Utf8, "column position_x is of type text, expected numbers"),
        ("heading", DataType::LargeUtf8, "column heading is of type text, expected numbers"),
        ("velocity_y", dictionary, "column velocity_y is of type text, expected numbers"),
        ("timestep", DataType::Utf8, "column timestep is of type text, expected whole numbers"),
        ("object_category", DataType::Boolean, "column object_category is of type Boolean, expected whole numbers"),
    ] {
        assert!(detail(name, data_type).ends_with(expected), "{name}");
    }
    let halves = |column: &ArrayRef| Arc::new(Float64Array::from(vec![0.5; column.len()])) as ArrayRef;
    let reject = parse_columns(replaced("timestep", halves)).expect_err("no timestep");
    assert!(reject.detail.ends_with("column timestep is 0.5 in row 0, expected a whole number"), "{}", reject.detail);
}

#[test]
fn every_usual_compression_is_read() {
    let plain = parse_columns(columns(110)).expect("well formed");
    for compression in [
        Compression::SNAPPY,
        Compression::ZSTD(Default::default()),
        Compression::GZIP(Default::default()),
        Compression::BROTLI(Default::default()),
        Compression::LZ4,
        Compression::LZ4_RAW,
    ] {
        let properties = WriterProperties::builder().set_compression(compression).build();
        let scene = parse_bytes(parquet_bytes_with(columns(110), properties), Split::Train).expect("readable");
        assert_eq!(scene.tracks, plain.tracks, "{compression}");
    }
}

#[test]
fn cut_files_are_rejected() {
    let whole = parquet_bytes(columns(110));
    for n_bytes in [0, 3, 8, 100, whole.len() / 2, whole.len() - 1] {
        let reject = parse_bytes(whole[..n_bytes].to_vec(), Split::Train).expect_err("cut");
        assert_eq!(reject.reason, "bad_parquet");
    }
}

/// Some kilobytes of file that hold one text many times, or packed, and would take gigabytes.
#[test]
fn what_packs_well_is_bounded_unpacked() {
    let properties = |has_dictionary: bool| {
        let properties = WriterProperties::builder().set_compression(Compression::SNAPPY);
        properties.set_dictionary_enabled(has_dictionary).set_dictionary_page_size_limit(1 << 30).build()
    };
    for (n_bytes, has_dictionary, why) in [
        (1 << 20, true, "column city has 220 MiB of text, expected at most 64"),
        (1 << 19, false, "its columns have 110 MiB, "),
    ] {
        let long = "x".repeat(n_bytes);
        let columns = replaced("city", |city| Arc::new(StringArray::from_iter_values((0..city.len()).map(|_| &long))));
        let bytes = parquet_bytes_with(columns, properties(has_dictionary));
        assert!(bytes.len() < 8 << 20, "{} bytes", bytes.len());
        let reject = parse_bytes(bytes, Split::Train).expect_err("too large");
        assert!(reject.detail.contains(why), "{}", reject.detail);
    }
    // Columns that are not read may be as large as they like.
    let mut columns = columns(110);
    let long = "x".repeat(1 << 20);
    columns.push(("remarks", Arc::new(StringArray::from_iter_values((0..220).map(|_| &long)))));
    assert!(parse_bytes(parquet_bytes_with(columns, properties(true)), Split::Train).is_ok());
}

#[test]
fn columns_that_are_neither_numbers_nor_texts_are_not_decoded() {
    let binary =
        replaced("city", |city| Arc::new(arrow::array::BinaryArray::from_iter_values((0..city.len()).map(|_| b"a"))));
    let reject = parse_columns(binary).expect_err("no text");
    assert!(reject.detail.contains("column city is of type Binary, expected numbers or text"), "{}", reject.detail);
}
