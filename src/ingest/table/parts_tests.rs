//! Are the scenes of a table that is read in parts those of the table read as a whole?

use super::*;
use crate::ingest::raw::{RawScene, Reject};
use arrow::array::{ArrayRef, Float64Array, RecordBatch, StringArray};
use parquet::arrow::ArrowWriter;
use parquet::file::properties::WriterProperties;
use std::collections::BTreeMap;
use std::ops::ControlFlow;
use std::sync::Arc;

const SMALL: Sizes = Sizes { whole_bytes: 1000, part_bytes: 4000, part_s: 12.0, n_at_a_time: 2 };

/// Four minutes at 5 Hz of a truck that drives, a car that appears late, is not seen for a while and repeats a row, a
/// car that parks, and an agent without an id.
fn rows() -> Vec<(f64, String)> {
    let mut rows = Vec::new();
    for i in 0..1200 {
        let t = 1000.1 + f64::from(i) / 5.0;
        rows.push((t, format!("truck,{t},{},3.5,truck,x", 2.0 * f64::from(i))));
        if i > 100 && !(300..305).contains(&i) {
            rows.push((t, format!("\"late, car\",{t},{},0,car,x", f64::from(i) * 1.5)));
        }
        if i == 400 {
            rows.push((t, format!("\"late, car\",{t},600,0,car,x")));
            rows.push((t, format!(",{t},1,2,car,x")));
        }
        rows.push((t, format!("parked,{t},50,8,car,x")));
    }
    rows
}

fn table(rows: &[(f64, String)]) -> String {
    rows.iter().fold("id,t,x,y,c,more\r\n".to_owned(), |text, (_, row)| text + row + "\r\n")
}

fn config(mapping: &str) -> IngestConfig {
    let table = format!(
        "columns.track = 'id'\ncolumns.x = 'x'\ncolumns.y = 'y'\ncolumns.time = 't'\ncolumns.class = 'c'
         classes = {{ car = 'vehicle', truck = 'vehicle' }}\nmax_gap_s = 1.5\n{mapping}"
    );
    IngestConfig {
        table: Some(toml::from_str(&table).unwrap()),
        maps: crate::ingest::MapsConfig::None,
        window_stride: 7,
        ..IngestConfig::new(Dataset::Table, Vec::new())
    }
}

fn units<T: AsRef<[u8]>>(tables: &Tables<'_>, sizes: Sizes, files: &[(&str, T)]) -> Vec<Result<RawUnit, Reject>> {
    read(tables, sizes, files).1
}

/// The units of files, in as many passes as requested, and the number of passes.
fn read<T: AsRef<[u8]>>(
    tables: &Tables<'_>,
    sizes: Sizes,
    files: &[(&str, T)],
) -> (usize, Vec<Result<RawUnit, Reject>>) {
    let (mut reader, mut units, mut n_passes) = (tables.part_reader(sizes), Vec::new(), 0);
    let mut emit = |unit| {
        units.push(unit);
        ControlFlow::Continue(())
    };
    loop {
        for (name, text) in files {
            let entry = Entry { path: (*name).to_owned(), container: "in".into(), size: None };
            assert!(reader.read(&entry, &mut text.as_ref(), &mut emit).unwrap().is_continue());
        }
        n_passes += 1;
        if !reader.next_pass() {
            break;
        }
    }
    assert!(reader.finish(&mut emit).unwrap().is_continue());
    (n_passes, units)
}

/// Scenes by their id or the reject, and the sums of findings.
fn scenes(
    tables: &Tables<'_>,
    units: Vec<Result<RawUnit, Reject>>,
) -> (BTreeMap<String, String>, BTreeMap<String, u64>) {
    let (mut scenes, mut counts) = (BTreeMap::new(), BTreeMap::new());
    for unit in units {
        let made: Vec<Result<RawScene, Reject>> = match unit {
            Ok(unit) => tables.parse(unit).into_iter().map(|make| make()).collect(),
            Err(reject) => vec![Err(reject)],
        };
        for scene in made {
            let (id, said) = match scene {
                Ok(RawScene { id, tracks, source, findings, .. }) => {
                    for finding in findings {
                        *counts.entry(finding.what.to_owned()).or_default() += finding.n;
                    }
                    (id.0, format!("{source:?} {tracks:?}"))
                }
                Err(Reject { reason, detail }) => (detail, reason.to_owned()),
            };
            scenes.insert(id, said);
        }
    }
    (scenes, counts)
}

/// Compares the scenes and the sums of findings with those of the table read as a whole; returns the findings.
fn compared(config: &IngestConfig, is_by_time: bool, files: &[(&str, Vec<u8>)]) -> BTreeMap<String, u64> {
    let tables = Tables::new(config).unwrap();
    let (whole, (n_passes, parts)) = (units(&tables, SIZES, files), read(&tables, SMALL, files));
    assert!(whole.len() == 1 && parts.len() > 15, "{} parts", parts.len());
    // Once for the footer of Parquet, once for the times, and once for all parts if rows are by time.
    let n_least = if files[0].0.ends_with("parquet") { 3 } else { 2 };
    assert!(n_passes >= n_least && (n_passes == n_least) == is_by_time, "{n_passes} passes");
    let (whole, parts) = (scenes(&tables, whole), scenes(&tables, parts));
    assert!(whole.0.len() > 150 && whole.0.keys().eq(parts.0.keys()));
    for (id, scene) in &whole.0 {
        assert_eq!(scene, &parts.0[id], "{id}");
    }
    assert_eq!(whole.1, parts.1);
    let n_parked = |scenes: &BTreeMap<String, String>| scenes.values().filter(|scene| scene.contains("Parked")).count();
    assert!(n_parked(&whole.0) > whole.0.len() * 2 / 3);
    whole.1
}

#[test]
fn parts_give_the_scenes_of_the_whole() {
    let by_time = rows();
    let mut by_track = rows();
    by_track.sort_by(|(a, one), (b, other)| one[..3].cmp(&other[..3]).then(a.total_cmp(b)));
    for (rows, is_by_time) in [(by_time, true), (by_track, false)] {
        let text = table(&rows);
        for (mapping, companion) in
            [("", None), ("track_files = '*.meta'", Some("id,c\ntruck,truck\n\"late, car\",car\nparked,car\n"))]
        {
            let text = if companion.is_some() { text.replace("id,t,x,y,c,", "id,t,x,y,d,") } else { text.clone() };
            let both = |name, table: Vec<u8>| {
                let companion = companion.map(|text| ("a.meta", text.as_bytes().to_vec()));
                [(name, table)].into_iter().chain(companion).collect::<Vec<_>>()
            };
            let counts = compared(&config(mapping), is_by_time, &both("a.csv", text.clone().into_bytes()));
            let expected = [("gaps_filled", 1), ("rows_repeated", 1), ("rows_without_track", 1)];
            assert_eq!(counts, expected.map(|(what, n)| (what.to_owned(), n)).into());
            let mapping = format!("files = '*.parquet'\n{mapping}");
            let of_parquet = compared(&config(&mapping), is_by_time, &both("a.parquet", parquet(&text)));
            assert_eq!(of_parquet, counts);
        }
    }
}

/// The table of `text` in Parquet, in row groups of 100 rows.
fn parquet(text: &str) -> Vec<u8> {
    let mut reader = csv::Reader::from_reader(text.as_bytes());
    let names = reader.headers().unwrap().clone();
    let rows: Vec<csv::StringRecord> = reader.records().map(Result::unwrap).collect();
    let column = |(index, name): (usize, &str)| -> (String, ArrayRef) {
        let cells = rows.iter().map(|row| Some(&row[index]).filter(|cell| !cell.is_empty()));
        let array: ArrayRef = match name {
            "t" | "x" | "y" => Arc::new(Float64Array::from_iter(cells.map(|cell| cell.map(|n| n.parse().unwrap())))),
            _ => Arc::new(StringArray::from_iter(cells)),
        };
        (name.to_owned(), array)
    };
    let batch = RecordBatch::try_from_iter(names.iter().enumerate().map(column)).unwrap();
    let properties = WriterProperties::builder().set_max_row_group_row_count(Some(100)).build();
    let mut bytes = Vec::new();
    let mut writer = ArrowWriter::try_new(&mut bytes, batch.schema(), Some(properties)).unwrap();
    writer.write(&batch).unwrap();
    writer.close().unwrap();
    bytes
}

#[test]
fn who_parks_for_longer_than_a_part_points_where_it_came() {
    // Drives north for 10 s, and parks for the other 230.
    let row = |i: i32| {
        let t = f64::from(i) / 5.0;
        format!("a,{t},{},7,car,x\nb,{t},3,{},car,x\n", 2.0 * t, f64::min(5.0 * t, 50.0))
    };
    let text = (0..1200).fold("id,t,x,y,c,more\n".to_owned(), |text, i| text + &row(i));
    let config = config("");
    let tables = Tables::new(&config).unwrap();
    let mut n_seen = 0;
    for unit in units(&tables, SMALL, &[("a.csv", text)]) {
        for scene in tables.parse(unit.unwrap()) {
            // One lies across the beginning of val.
            let Ok(scene) = scene() else { continue };
            assert!(scene.heading_gaps.is_empty(), "{}", scene.id);
            let parks = scene.tracks.iter().find(|track| track.id.0 == "b").unwrap();
            for (_, state) in parks.trajectory.valid() {
                assert!((state.heading_rad - std::f64::consts::FRAC_PI_2).abs() < 1e-9, "{} {state:?}", scene.id);
                n_seen += 1;
            }
        }
    }
    assert!(n_seen > 10_000, "{n_seen}");
}

#[test]
fn recordings_of_one_file_are_cut_each_for_itself_however_their_rows_lie() {
    let recording = |name: &'static str, shift_s: f64, n_rows: usize| {
        let again = rows().into_iter().take(n_rows);
        again.map(move |(t, row)| {
            let at = t + shift_s;
            (at, format!("{name},{}", row.replacen(&format!(",{t},"), &format!(",{at},"), 1)))
        })
    };
    let one_after_the_other: Vec<(f64, String)> = recording("b", 1.7e9, 3500)
        .chain(recording("a", 1.7e9 + 50.0, 3300))
        .chain(recording("short", 7.0, 9))
        .collect();
    let mut at_a_time = one_after_the_other.clone();
    at_a_time.sort_by(|(a, _), (b, _)| a.total_cmp(b));
    let mut by_track = one_after_the_other.clone();
    by_track.sort_by(|(a, one), (b, other)| one[2..5].cmp(&other[2..5]).then(a.total_cmp(b)));
    let config = config("files = 'a.*'\ncolumns.recording = 'r'");
    for (rows, is_by_time) in [(one_after_the_other, true), (at_a_time, true), (by_track, false)] {
        let text = table(&rows).replacen("id,", "r,id,", 1);
        compared(&config, is_by_time, &[("a.csv", text.clone().into_bytes())]);
        compared(&config, is_by_time, &[("a.parquet", parquet(&text))]);
    }
}

#[test]
fn what_is_wrong_in_a_long_table_is_left_out_once_with_its_line() {
    let config = config("columns.length = 'l'\ncolumns.width = 'w'");
    let mut rows = rows();
    let sized = |row: &str, length: f64| format!("{row},{length},2");
    // The truck's id is a longer one's after a minute without rows; then a row is elsewhere.
    rows.retain(|(t, row)| !(row.starts_with("truck") && (1080.0..1140.0).contains(t)));
    for (t, row) in &mut rows {
        *row = sized(row, if row.starts_with("truck") && *t > 1139.0 { 18.0 } else { 4.5 });
    }
    let at = |from_s: f64| rows.iter().position(|(t, row)| *t > from_s && row.starts_with("truck")).unwrap();
    let (unread, elsewhere, changed) = (at(1060.0), at(1160.0), at(1130.0));
    rows[unread].1 = rows[unread].1.replace(",3.5,", ",north,");
    rows[elsewhere].1 = rows[elsewhere].1.replace(",3.5,", ",93.5,");
    let text = rows.iter().fold("id,t,x,y,c,more,l,w\n".to_owned(), |text, (_, row)| text + row + "\n");
    let files = [("a.csv", text.into_bytes())];
    let counts = compared(&config, true, &files);
    let expected = [
        ("gaps_filled", 3),
        ("ids_of_another_agent", 1),
        ("rows_left_out", 1),
        ("rows_out_of_place", 1),
        ("rows_repeated", 1),
        ("rows_without_track", 1),
    ];
    assert_eq!(counts.iter().map(|(what, n)| (what.as_str(), *n)).collect::<Vec<_>>(), expected);
    let tables = Tables::new(&config).unwrap();
    let mut said = Vec::new();
    for unit in units(&tables, SMALL, &files) {
        for scene in tables.parse(unit.unwrap()) {
            said.extend(scene().map(|scene| scene.findings).unwrap_or_default().into_iter().map(|found| found.detail));
        }
    }
    for expected in [
        format!("a.csv: line {}: column y is \"north\", expected a number", unread + 2),
        format!("a.csv, line {}: track truck goes on as truck#2: its size is another", changed + 2),
        format!("a.csv, line {}: track truck is at", elsewhere + 2),
    ] {
        assert!(said.iter().any(|said| said.starts_with(&expected)), "{expected}: {said:?}");
    }
}

#[test]
fn tables_that_cannot_be_read_are_rejects() {
    let config = config("");
    let tables = Tables::new(&config).unwrap();
    let whole = table(&rows());
    for (text, expected) in
        [(whole.replace(",x\r\n", "\r\n"), "a.csv: line 2: 5 cells, expected 6"), (format!("PAR1{whole}"), "a.csv: ")]
    {
        let found = units(&tables, SMALL, &[("a.csv", &text)]);
        assert!(matches!(&found[..], [Err(reject)] if reject.detail.starts_with(expected)), "{found:?}");
    }
    // A time that cannot be costs its row.
    let mut odd = rows();
    (odd[0].1, odd[2].1) = ("truck,,0,3.5,truck,x".to_owned(), "truck,1e9,2,3.5,truck,x".to_owned());
    let (found, counts) = scenes(&tables, units(&tables, SMALL, &[("a.csv", &table(&odd))]));
    assert!(found.len() > 150 && counts["rows_left_out"] == 1, "{} scenes, {counts:?}", found.len());
    let alone = self::config("track_files = '*.meta'");
    let tables = Tables::new(&alone).unwrap();
    let found = units(&tables, SMALL, &[("a.csv", &whole)]);
    assert!(matches!(&found[..], [Err(Reject { reason: "no_track_file", .. })]), "{found:?}");
}
