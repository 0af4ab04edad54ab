//! Are the scenes of a table that is read in parts those of the table read as a whole?

use super::columns::csv_reader;
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

/// The units of files, in as many passes as requested.
fn units<T: AsRef<[u8]>>(tables: &Tables<'_>, sizes: Sizes, files: &[(&str, T)]) -> Vec<Result<RawUnit, Reject>> {
    let (mut reader, mut units) = (tables.part_reader(sizes), Vec::new());
    let mut emit = |unit| {
        units.push(unit);
        ControlFlow::Continue(())
    };
    loop {
        for (name, text) in files {
            let entry = Entry { path: (*name).to_owned(), container: "in".into(), size: None };
            assert!(reader.read(&entry, &mut text.as_ref(), &mut emit).unwrap().is_continue());
        }
        if !reader.next_pass() {
            break;
        }
    }
    assert!(reader.finish(&mut emit).unwrap().is_continue());
    units
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
fn compared(config: &IngestConfig, n_parts_above: usize, files: &[(&str, Vec<u8>)]) -> BTreeMap<String, u64> {
    let tables = Tables::new(config).unwrap();
    let (whole, parts) = (units(&tables, SIZES, files), units(&tables, SMALL, files));
    assert!(whole.len() == 1 && parts.len() > n_parts_above, "{} parts", parts.len());
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
    for (rows, n_passes_at_least) in [(by_time, 1), (by_track, 2)] {
        let text = table(&rows);
        for (mapping, companion) in
            [("", None), ("track_files = '*.meta'", Some("id,c\ntruck,truck\n\"late, car\",car\nparked,car\n"))]
        {
            let text = if companion.is_some() { text.replace("id,t,x,y,c,", "id,t,x,y,d,") } else { text.clone() };
            let both = |name, table: Vec<u8>| {
                let companion = companion.map(|text| ("a.meta", text.as_bytes().to_vec()));
                [(name, table)].into_iter().chain(companion).collect::<Vec<_>>()
            };
            let n_parts_above = n_passes_at_least * SMALL.n_at_a_time;
            let counts = compared(&config(mapping), n_parts_above, &both("a.csv", text.clone().into_bytes()));
            let expected = [("gaps_filled", 1), ("rows_repeated", 1), ("rows_without_track", 1)];
            assert_eq!(counts, expected.map(|(what, n)| (what.to_owned(), n)).into());
            let mapping = format!("files = '*.parquet'\n{mapping}");
            let of_parquet = compared(&config(&mapping), n_parts_above, &both("a.parquet", parquet(&text)));
            assert_eq!(of_parquet, counts);
        }
    }
}

/// The table of `text` in Parquet, in row groups of 100 rows.
fn parquet(text: &str) -> Vec<u8> {
    let mut reader = csv_reader(b',').from_reader(text.as_bytes());
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
fn recordings_of_one_file_are_cut_each_for_itself_however_their_rows_lie() {
    let recording = |name: &'static str, shift_s: f64, n_rows: usize| {
        let again = rows().into_iter().take(n_rows);
        again.map(move |(t, row)| {
            let at = t + shift_s;
            (at, format!("{name},{}", row.replacen(&format!(",{t},"), &format!(",{at},"), 1)))
        })
    };
    let one_after_the_other: Vec<(f64, String)> =
        recording("b", 0.0, 3500).chain(recording("a", 50.0, 3300)).chain(recording("short", 7.0, 9)).collect();
    let mut at_a_time = one_after_the_other.clone();
    at_a_time.sort_by(|(a, _), (b, _)| a.total_cmp(b));
    let mut by_track = one_after_the_other.clone();
    by_track.sort_by(|(a, one), (b, other)| one[2..5].cmp(&other[2..5]).then(a.total_cmp(b)));
    let config = config("files = 'a.*'\ncolumns.recording = 'r'");
    for rows in [one_after_the_other, at_a_time, by_track] {
        let text = table(&rows).replacen("id,", "r,id,", 1);
        compared(&config, 2 * SMALL.n_at_a_time, &[("a.csv", text.clone().into_bytes())]);
        compared(&config, 2 * SMALL.n_at_a_time, &[("a.parquet", parquet(&text))]);
    }
}

#[test]
fn what_is_wrong_in_a_part_is_said_with_its_line_and_costs_that_part() {
    let config = config("");
    let tables = Tables::new(&config).unwrap();
    let mut rows = rows();
    let whole = scenes(&tables, units(&tables, SMALL, &[("a.csv", &table(&rows))])).0.len();
    let at = rows.iter().position(|(t, row)| *t > 1080.0 && row.starts_with("truck")).unwrap();
    rows[at].1 = rows[at].1.replace(",3.5,", ",north,");
    let (found, _) = scenes(&tables, units(&tables, SMALL, &[("a.csv", &table(&rows))]));
    // Adjacent parts have its row, too, if it is near.
    let expected = format!("a.csv: line {}: column y is \"north\", expected a number", at + 2);
    assert!(found.keys().any(|detail| *detail == expected), "{:?}", found.keys());
    assert!(found.len() > whole / 3 && found.len() < whole, "{} of {whole}", found.len());
}

#[test]
fn tables_that_cannot_be_cut_are_read_as_a_whole() {
    let config = config("");
    let tables = Tables::new(&config).unwrap();
    let whole = table(&rows());
    for text in [
        whole.replace("id,t,x", "id,t,t"),
        whole.replace(",x\r\n", "\r\n"),
        whole.replacen("1000.1,", ",", 1),
        format!("PAR1{whole}"),
        whole.replacen("1000.1,", "1e9,", 1),
    ] {
        let found = units(&tables, SMALL, &[("a.csv", &text)]);
        assert!(matches!(&found[..], [Ok(unit)] if unit.bytes == text.as_bytes() && unit.part.is_none()));
    }
    let alone = self::config("track_files = '*.meta'");
    let tables = Tables::new(&alone).unwrap();
    let found = units(&tables, SMALL, &[("a.csv", &whole)]);
    assert!(matches!(&found[..], [Err(Reject { reason: "no_track_file", .. })]), "{found:?}");
}
