//! `djinn corpus diff`: the common and the changed parts of two corpora, and shifts of distributions.

use super::Result;
use super::rows::{Content, contents, texts};
use crate::progress::Progress;
use crate::store::{CorpusChunk, CorpusScan, Fingerprint, PartitionCount, fingerprint, united, widened};
use arrow::array::{Array, Float64Array, RecordBatch};
use arrow::compute::cast;
use arrow::datatypes::{DataType, SchemaRef};
use serde::Serialize;
use std::collections::{BTreeMap, BTreeSet};
use std::path::Path;

/// Ids that are listed at most; all are counted.
const MAX_LISTED: usize = 20;

/// The differences between two corpora A and B.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct DiffReport {
    /// Number of scenarios in A and in B.
    pub n_scenarios: [u64; 2],
    /// Number of scenarios and of verified ones by behavior and place, in A and in B, if they differ.
    pub partitions: Vec<PartitionDiff>,
    /// Columns that only A or only B has.
    pub columns_only_in: [Vec<String>; 2],
    /// Scenarios that are equal in both.
    pub n_same: u64,
    /// Scenarios that only A or only B has.
    pub n_only_in: [u64; 2],
    /// The first of their ids.
    pub only_in: [Vec<String>; 2],
    /// Scenarios with one id whose row or states differ.
    pub n_changed: u64,
    /// The first of their ids.
    pub changed: Vec<String>,
    /// The number of scenarios that differ in each column; `states` stands for their rows of `tracks`.
    pub changed_by_column: BTreeMap<String, u64>,
    /// The distributions of numbers in A and B that differ.
    pub shifts: Vec<DistributionShift>,
}

/// The counts of a partition in A and B.
#[derive(Debug, Clone, PartialEq, Eq, Serialize)]
pub struct PartitionDiff {
    /// The behavior.
    pub behavior: String,
    /// The place.
    pub place: String,
    /// Number of scenarios in A and B.
    pub n_scenarios: [u64; 2],
    /// Number of verified ones in A and B.
    pub n_verified: [u64; 2],
}

/// The distribution of one number in A and B.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct DistributionShift {
    /// A column of scenarios, or `speed_mps` of generated states.
    pub name: String,
    /// Summaries of A and B.
    pub summaries: [Summary; 2],
    /// Difference of the means, B less A, in standard deviations of A; `None` if undefined.
    pub mean_shift_std: Option<f64>,
}

/// Some numbers summed up.
#[derive(Debug, Clone, Copy, Default, PartialEq, Serialize)]
pub struct Summary {
    /// The number of values.
    pub n: u64,
    /// Their mean.
    pub mean: f64,
    /// Their standard deviation.
    pub std: f64,
    /// The smallest value; 0 if there are none.
    pub min: f64,
    /// The largest value; 0 if there are none.
    pub max: f64,
    /// Sum of squared distances from the mean (Welford 1962).
    #[serde(skip)]
    squares: f64,
}

impl Summary {
    fn add(&mut self, number: f64) {
        self.n += 1;
        let distance = number - self.mean;
        self.mean += distance / self.n as f64;
        self.squares += distance * (number - self.mean);
        self.std = if self.n > 1 { (self.squares / (self.n - 1) as f64).sqrt() } else { 0.0 };
        (self.min, self.max) =
            if self.n == 1 { (number, number) } else { (self.min.min(number), self.max.max(number)) };
    }

    /// Whether the numbers are distributed alike, however they were ordered: sums depend on the order in their last
    /// digits.
    fn is_as(&self, other: &Self) -> bool {
        let size = self.max.abs().max(self.min.abs()).max(1.0);
        let is_same = |a: f64, b: f64| (a - b).abs() <= 1e-9 * size || (a.is_nan() && b.is_nan());
        self.n == other.n
            && is_same(self.mean, other.mean)
            && is_same(self.std, other.std)
            && is_same(self.min, other.min)
            && is_same(self.max, other.max)
    }
}

/// Compares the corpora in `a` and `b`.
pub fn diff(a: &Path, b: &Path, progress: &dyn Progress) -> Result<DiffReport> {
    let scans = [CorpusScan::open(a)?, CorpusScan::open(b)?];
    let schemas = [scans[0].scenario_schema()?, scans[1].scenario_schema()?];
    let schema = united(&schemas);
    let n_all: u64 = scans.iter().map(|scan| scan.manifest().n_scenarios).sum();
    progress.start("compare", n_all, "scenarios");
    let matched = matched(&scans, &schema, progress)?;
    progress.finish();
    let (changed_ids, changed_by_column) = columns_that_changed(&scans, &schema, &matched.changed)?;
    let only = |own: &SchemaRef, other: &SchemaRef| {
        let names = own.fields().iter().map(|field| field.name());
        names.filter(|name| other.field_with_name(name).is_err()).cloned().collect()
    };
    Ok(DiffReport {
        n_scenarios: [scans[0].manifest().n_scenarios, scans[1].manifest().n_scenarios],
        partitions: partitions(
            &scans[0].manifest().scenarios_by_partition,
            &scans[1].manifest().scenarios_by_partition,
        ),
        columns_only_in: [only(&schemas[0], &schemas[1]), only(&schemas[1], &schemas[0])],
        n_same: matched.n_same,
        n_only_in: matched.only_in.each_ref().map(|ids| ids.n),
        only_in: matched.only_in.map(|ids| ids.first),
        n_changed: matched.changed.len() as u64,
        changed: changed_ids,
        changed_by_column,
        shifts: shifts(matched.summaries),
    })
}

/// Matches the scenarios of two corpora by their ids and contents.
#[derive(Default)]
struct Matched {
    n_same: u64,
    /// Ids in both corpora with different contents.
    changed: BTreeSet<Fingerprint>,
    only_in: [Listing; 2],
    /// The numbers of each corpus, by column.
    summaries: [BTreeMap<String, Summary>; 2],
}

/// Matches the scenarios of both corpora, in columns that both share. Reads the first one again if some of its ids are
/// not in the second.
fn matched(scans: &[CorpusScan; 2], schema: &SchemaRef, progress: &dyn Progress) -> Result<Matched> {
    let mut matched = Matched::default();
    let mut in_a: BTreeMap<Fingerprint, Content> = BTreeMap::new();
    each(&scans[0], schema, progress, |chunk, ids, contents| {
        summarize(chunk, &mut matched.summaries[0])?;
        in_a.extend(ids.iter().copied().zip(contents.iter().copied()));
        Ok(())
    })?;
    let mut seen: BTreeSet<Fingerprint> = BTreeSet::new();
    each(&scans[1], schema, progress, |chunk, ids, contents| {
        summarize(chunk, &mut matched.summaries[1])?;
        let names = texts(&chunk.scenarios, "scenario_id", &chunk.path)?;
        for (row, (id, content)) in ids.iter().zip(contents).enumerate() {
            match in_a.get(id) {
                Some(known) if known == content => matched.n_same += 1,
                Some(_) => {
                    matched.changed.insert(*id);
                }
                None => matched.only_in[1].add(names.value(row)),
            }
            seen.insert(*id);
        }
        Ok(())
    })?;
    if in_a.keys().any(|id| !seen.contains(id)) {
        each_id(&scans[0], |id| {
            if !seen.contains(&fingerprint(id.as_bytes())) {
                matched.only_in[0].add(id);
            }
        })?;
    }
    Ok(matched)
}

/// Ids: the first ones, and how many there are.
#[derive(Default)]
struct Listing {
    n: u64,
    first: Vec<String>,
}

impl Listing {
    fn add(&mut self, id: &str) {
        self.n += 1;
        if self.first.len() < MAX_LISTED {
            self.first.push(id.to_owned());
        }
    }
}

/// Shows every chunk of a corpus with the fingerprints of its ids and contents, in columns that both corpora share.
fn each(
    scan: &CorpusScan,
    schema: &SchemaRef,
    progress: &dyn Progress,
    mut visit: impl FnMut(&CorpusChunk, &[Fingerprint], &[Content]) -> Result<()>,
) -> Result<()> {
    for chunk in scan.all_chunks(true) {
        let mut chunk = chunk?;
        chunk.scenarios = widened(&chunk.scenarios, schema, &chunk.path)?;
        let names = texts(&chunk.scenarios, "scenario_id", &chunk.path)?;
        let ids: Vec<Fingerprint> = names.iter().map(|id| fingerprint(id.unwrap_or_default().as_bytes())).collect();
        let contents: Vec<Content> = contents(&chunk, |_| true)?.into_iter().flatten().collect();
        visit(&chunk, &ids, &contents)?;
        progress.advance(chunk.len() as u64);
    }
    Ok(())
}

fn each_id(scan: &CorpusScan, mut visit: impl FnMut(&str)) -> Result<()> {
    for chunk in scan.all_chunks(false) {
        let chunk = chunk?;
        texts(&chunk.scenarios, "scenario_id", &chunk.path)?.iter().flatten().for_each(&mut visit);
    }
    Ok(())
}

/// The number of these scenarios that differ in each column. The columns of those of A are kept as one hash each until
/// those of B are read.
fn columns_that_changed(
    scans: &[CorpusScan; 2],
    schema: &SchemaRef,
    changed: &BTreeSet<Fingerprint>,
) -> Result<(Vec<String>, BTreeMap<String, u64>)> {
    let mut ids = Vec::new();
    let mut counts: BTreeMap<String, u64> = BTreeMap::new();
    if changed.is_empty() {
        return Ok((ids, counts));
    }
    let mut in_a: BTreeMap<Fingerprint, Vec<Fingerprint>> = BTreeMap::new();
    for (is_b, scan) in scans.iter().enumerate() {
        each(scan, schema, &crate::progress::Silent, |chunk, chunk_ids, contents| {
            let rows: Vec<usize> = (0..chunk.len()).filter(|row| changed.contains(&chunk_ids[*row])).collect();
            if rows.is_empty() {
                return Ok(());
            }
            let columns = column_fingerprints(&chunk.scenarios, &chunk.path)?;
            let names = texts(&chunk.scenarios, "scenario_id", &chunk.path)?;
            for row in rows {
                let of_row: Vec<Fingerprint> =
                    columns.iter().map(|column| column[row]).chain([contents[row].states]).collect();
                if is_b == 0 {
                    in_a.insert(chunk_ids[row], of_row);
                    continue;
                }
                if ids.len() < MAX_LISTED {
                    ids.push(names.value(row).to_owned());
                }
                let labels = schema.fields().iter().map(|field| field.name().as_str()).chain(["states"]);
                for ((label, a), b) in labels.zip(&in_a[&chunk_ids[row]]).zip(&of_row) {
                    if a != b {
                        *counts.entry(label.to_owned()).or_default() += 1;
                    }
                }
            }
            Ok(())
        })?;
    }
    Ok((ids, counts))
}

fn column_fingerprints(batch: &RecordBatch, path: &Path) -> Result<Vec<Vec<Fingerprint>>> {
    let of_column = |i: usize| {
        let column = batch.project(&[i]).map_err(super::Error::arrow(path))?;
        let rows = super::rows::RowBytes::new(&column.schema(), path)?.rows(&column, path)?;
        Ok((0..batch.num_rows()).map(|row| super::rows::of_rows(&rows, row..row + 1)).collect())
    };
    (0..batch.num_columns()).map(of_column).collect()
}

/// Sums up the numbers of the scenarios of a chunk, and the speeds of its generated states.
fn summarize(chunk: &CorpusChunk, summaries: &mut BTreeMap<String, Summary>) -> Result<()> {
    for (field, column) in chunk.scenarios.schema_ref().fields().iter().zip(chunk.scenarios.columns()) {
        // Names in the form of numbers have no distribution.
        if !field.data_type().is_numeric() || ["seed", "sample_idx"].contains(&field.name().as_str()) {
            continue;
        }
        let numbers = cast(column, &DataType::Float64).map_err(super::Error::arrow(&chunk.path))?;
        if let Some(numbers) = numbers.as_any().downcast_ref::<Float64Array>() {
            let summary = summaries.entry(field.name().clone()).or_default();
            numbers.iter().flatten().for_each(|number| summary.add(number));
        }
    }
    let tracks = crate::store::Columns::of_batch(&chunk.tracks, &chunk.tracks_path);
    let vx: &arrow::array::Float32Array = tracks.get("vx_mps")?;
    let vy: &arrow::array::Float32Array = tracks.get("vy_mps")?;
    let summary = summaries.entry("speed_mps".to_owned()).or_default();
    for row in 0..chunk.tracks.num_rows() {
        if !tracks.flag("observed", row)? {
            summary.add(f64::from(vx.value(row)).hypot(f64::from(vy.value(row))));
        }
    }
    Ok(())
}

fn shifts([mut a, mut b]: [BTreeMap<String, Summary>; 2]) -> Vec<DistributionShift> {
    let names: BTreeSet<String> = a.keys().chain(b.keys()).cloned().collect();
    let mut shifts = Vec::new();
    for name in names {
        let summaries = [a.remove(&name).unwrap_or_default(), b.remove(&name).unwrap_or_default()];
        if !summaries[0].is_as(&summaries[1]) {
            let [of_a, of_b] = summaries;
            let is_known = of_a.std > 0.0 && of_b.n > 0;
            let mean_shift_std = is_known.then(|| (of_b.mean - of_a.mean) / of_a.std);
            shifts.push(DistributionShift { name, summaries, mean_shift_std });
        }
    }
    shifts
}

fn partitions(a: &[PartitionCount], b: &[PartitionCount]) -> Vec<PartitionDiff> {
    let mut counts: BTreeMap<(&str, &str), [[u64; 2]; 2]> = BTreeMap::new();
    for (side, list) in [a, b].into_iter().enumerate() {
        for count in list {
            let [n_scenarios, n_verified] = counts.entry((&count.behavior, &count.place)).or_default();
            n_scenarios[side] = count.n_scenarios;
            n_verified[side] = count.n_verified;
        }
    }
    let differs = |[n, verified]: &[[u64; 2]; 2]| n[0] != n[1] || verified[0] != verified[1];
    let diff = |((behavior, place), [n_scenarios, n_verified]): ((&str, &str), [[u64; 2]; 2])| PartitionDiff {
        behavior: behavior.to_owned(),
        place: place.to_owned(),
        n_scenarios,
        n_verified,
    };
    counts.into_iter().filter(|(_, counts)| differs(counts)).map(diff).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn numbers_are_summed_up_as_by_hand() {
        let mut summary = Summary::default();
        [2.0, 4.0, 9.0].into_iter().for_each(|number| summary.add(number));
        // Mean 5, squares 9 + 1 + 16 = 26, variance 13.
        assert_eq!((summary.n, summary.mean, summary.min, summary.max), (3, 5.0, 2.0, 9.0));
        assert!((summary.std - 13.0f64.sqrt()).abs() < 1e-12);
    }
}
