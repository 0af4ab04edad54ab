//! Class and size of the agents of a table, and doubts about those of whole classes.

use super::columns::Table;
use super::left_out::LeftOut;
use super::mapping::TableColumns;
use super::rows::Rows;
use super::tracks::{Clock, MAX_SIZE_M};
use crate::ingest::Reject;
use crate::ingest::recorded_track::RecordedTrack;
use crate::scene::{AgentClass, Extent};
use std::cmp::Reverse;
use std::collections::BTreeMap;

/// Sizes of one agent vary by less, as shares of their median.
const MAX_SIZE_CHANGE: f64 = 0.25;
/// Agents are this many times as large as usual in their class, in the mean of length and width: from a child to a
/// truck with a trailer, but not feet, centimeters or meters taken for feet.
const TIMES_USUAL: std::ops::RangeInclusive<f64> = 0.4..=2.75;
/// Units in which sizes may be, meters.
const UNITS_M: [f64; 6] = [1.0, 0.3048, 0.1, 0.01, 0.001, 0.0254];
/// Agents faster than this move, m/s.
const MOVING_MPS: f64 = 0.5;
/// Speeds are looked at in one of so many states.
const SPEEDS_EACH: usize = 5;

impl Rows<'_> {
    /// The class of a track: the most frequent one of its rows that is not blank, or that of the table of tracks.
    pub(super) fn class(
        &self,
        id: &str,
        rows: &[u32],
        clock: Clock,
        left_out: &mut LeftOut,
    ) -> Result<AgentClass, Reject> {
        let Some(name) = self.mapping.columns.class.as_deref() else { return Ok(self.mapping.class) };
        let (found, file, place) = match (self.table.text(Some(name)), &self.of_tracks) {
            (Some(texts), _) => {
                let text = |row: u32| &texts.different[texts.of_row[row as usize] as usize];
                let mut counts: BTreeMap<u32, usize> = BTreeMap::new();
                for of_row in rows.chunk_by(|a, b| texts.of_row[*a as usize] == texts.of_row[*b as usize]) {
                    *counts.entry(texts.of_row[of_row[0] as usize]).or_default() += of_row.len();
                }
                let rank = |(text, n): &(u32, usize)| (!texts.different[*text as usize].is_empty(), *n, Reverse(*text));
                let taken = counts.into_iter().max_by_key(rank).map_or(0, |(text, _)| text);
                let (own, others): (Vec<u32>, Vec<u32>) =
                    rows.iter().partition(|row| texts.of_row[**row as usize] == taken);
                let first = own.first().copied().unwrap_or(rows[0]);
                let n = others.iter().filter(|row| self.is_own(self.time_s(**row) - clock.start_s)).count();
                if let Some(other) = others.first() {
                    let (place, found, taken) = (self.table.place_of(*other as usize), text(*other), text(first));
                    let detail = format!(
                        "{}: {place}: track {id} is \"{found}\"; most often \"{taken}\", which is taken",
                        self.file
                    );
                    left_out.note("rows_of_another_class", n, &detail);
                }
                (text(first).clone(), self.file.clone(), self.table.place_of(first as usize))
            }
            (None, Some(of_tracks)) => {
                let row = of_tracks.row_of(id)?;
                let texts = of_tracks.table.text(Some(name));
                let found = texts.map(|texts| texts.different[texts.of_row[row] as usize].clone());
                (found.unwrap_or_default(), of_tracks.file.clone(), of_tracks.table.place_of(row))
            }
            (None, None) => (String::new(), self.file.clone(), self.table.place_of(rows[0] as usize)),
        };
        self.mapping.class_of(&found).ok_or_else(|| Reject {
            reason: "unknown_class",
            detail: format!(
                "{file}, {place}: column {name} is \"{found}\", which ingest.table.classes does not list; add it, as \
                 one of {}",
                AgentClass::ALL.map(AgentClass::name).join(", ")
            ),
        })
    }

    /// The size of a track: the median of the lengths and that of the widths in its rows, or those of the table of
    /// tracks.
    pub(super) fn extent(
        &self,
        id: &str,
        rows: &[u32],
        clock: Clock,
        left_out: &mut LeftOut,
    ) -> Result<Option<Extent>, Reject> {
        let TableColumns { length, width, .. } = &self.mapping.columns;
        let Some((length, width)) = length.as_deref().zip(width.as_deref()) else { return Ok(None) };
        let of = |table: &Table, row: usize| {
            let sizes = table.number(Some(length)).zip(table.number(Some(width)))?;
            let size_m = <[&[f64]; 2]>::from(sizes).map(|sizes| sizes[row] * self.mapping.length_unit_m);
            size_m.iter().all(|size_m| *size_m != 0.0 && size_m.is_finite()).then_some(size_m)
        };
        let found: Vec<(u32, [f64; 2])> = match &self.of_tracks {
            Some(of_tracks) if self.table.number(Some(length)).is_none() => {
                of(&of_tracks.table, of_tracks.row_of(id)?).map(|size_m| (rows[0], size_m)).into_iter().collect()
            }
            _ => rows.iter().filter_map(|row| Some((*row, of(&self.table, *row as usize)?))).collect(),
        };
        let Some((_, [length_m, width_m])) = found.first().copied() else { return Ok(None) };
        if found.iter().all(|(_, size_m)| *size_m == [length_m, width_m]) && is_possible([length_m, width_m]) {
            return Ok(Some(Extent { length_m, width_m }));
        }
        let possible = found.iter().map(|(_, size_m)| *size_m).filter(|size_m| is_possible(*size_m));
        let (lengths, widths): (Vec<f64>, Vec<f64>) = possible.map(<(f64, f64)>::from).unzip();
        let Some(median) = median(lengths).zip(median(widths)).map(<[f64; 2]>::from) else {
            let detail = format!(
                "track {id} is {length_m} by {width_m} m in length and width, expected 0 to {MAX_SIZE_M}; is \
                 ingest.table.length_unit_m right?"
            );
            return Err(self.reject("out_of_range", rows[0], &detail));
        };
        let is_off = |(size_m, median): (&f64, &f64)| (size_m - median).abs() > MAX_SIZE_CHANGE * median;
        let mut others = found.iter().filter(|(_, size_m)| size_m.iter().zip(&median).any(is_off)).peekable();
        if let Some((row, size_m)) = others.peek().copied() {
            let ([length_m, width_m], [usual_m, usually_wide_m]) = (size_m, median);
            let detail = format!(
                "{}, {}: track {id} is {length_m:.2} by {width_m:.2} m; its median, {usual_m:.2} by \
                 {usually_wide_m:.2}, is taken",
                self.file,
                self.table.place_of(*row as usize)
            );
            let n = others.filter(|(row, _)| self.is_own(self.time_s(*row) - clock.start_s)).count();
            left_out.note("rows_of_another_size", n, &detail);
        }
        Ok(Some(Extent { length_m: median[0], width_m: median[1] }))
    }

    /// Notes agents that are too large or small for their class, and classes that are too fast.
    pub(super) fn judge_classes(&self, tracks: &[RecordedTrack], left_out: &mut LeftOut) {
        let judged = AgentClass::ALL.into_iter().filter(|class| class.is_road_user() && *class != AgentClass::Unknown);
        for class in judged {
            let own = || tracks.iter().filter(|track| track.class == class);
            let usual = class.nominal_extent();
            let times_usual =
                |extent: Extent| (extent.length_m * extent.width_m / usual.length_m / usual.width_m).sqrt();
            let mut sized: Vec<(f64, Extent, &RecordedTrack)> =
                own().filter_map(|track| Some((times_usual(track.extent?), track.extent?, track))).collect();
            sized.sort_by(|(a, ..), (b, ..)| a.total_cmp(b));
            let is_odd = |(times, ..): &&(f64, Extent, &RecordedTrack)| !TIMES_USUAL.contains(times);
            let n_odd = sized.iter().filter(is_odd).count();
            let middle = sized.get(sized.len() / 2).filter(is_odd);
            if let Some((times, Extent { length_m, width_m }, track)) = middle.or_else(|| sized.iter().find(is_odd)) {
                let unit_m = self.mapping.length_unit_m;
                let off = |other_m: &f64| (times * other_m / unit_m).ln().abs();
                let nearest_m = UNITS_M.into_iter().min_by(|a, b| off(a).total_cmp(&off(b))).unwrap_or(unit_m);
                let doubt = match middle {
                    Some(_) if nearest_m == unit_m => "are columns.length and columns.width right?".to_owned(),
                    Some(_) => format!(
                        "is ingest.table.length_unit_m {nearest_m} instead of {unit_m}? If positions are in another \
                         unit than sizes, convert these"
                    ),
                    None => "is that its class, by ingest.table.columns.class and classes?".to_owned(),
                };
                let detail = format!(
                    "{}: track {} is a {} of {length_m:.2} by {width_m:.2} m, usual are {} by {}: {doubt}",
                    self.file,
                    track.id,
                    class.name(),
                    usual.length_m,
                    usual.width_m
                );
                left_out.note("agents_of_unusual_size", n_odd, &detail);
            }
            let speeds = own().flat_map(|track| track.states.iter().step_by(SPEEDS_EACH));
            let speeds = speeds.map(|(_, state, _)| state.velocity.norm()).filter(|speed_mps| *speed_mps > MOVING_MPS);
            let (median_mps, limit_mps) = (median(speeds.collect()).unwrap_or_default(), max_usual_mps(class));
            let detail = format!(
                "{}: class {} moves at {median_mps:.1} m/s, in the median of moving agents, expected at most \
                 {limit_mps}: are ingest.table.length_unit_m and time_unit_s right? Velocities follow from positions, \
                 unsmoothed: do these jitter?",
                self.file,
                class.name()
            );
            left_out.note("classes_too_fast", usize::from(median_mps > limit_mps), &detail);
        }
    }
}

fn is_possible([length_m, width_m]: [f64; 2]) -> bool {
    length_m.max(width_m) <= MAX_SIZE_M && length_m.min(width_m) >= 0.0
}

/// No class is usually faster than this, m/s: a run, a sprint by bicycle, a motorway without limit.
const fn max_usual_mps(class: AgentClass) -> f64 {
    match class {
        AgentClass::Pedestrian => 3.5,
        AgentClass::Cyclist | AgentClass::PedestrianOrCyclist => 12.0,
        _ => 60.0,
    }
}

fn median(mut values: Vec<f64>) -> Option<f64> {
    let middle = values.len() / 2;
    (middle < values.len()).then(|| *values.select_nth_unstable_by(middle, f64::total_cmp).1)
}
