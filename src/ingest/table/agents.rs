//! The agents that an id of a table stands for, and their rows.

use super::left_out::LeftOut;
use super::mapping::TableColumns;
use super::owners::{Owners, Seen};
use super::rows::Rows;
use super::tracks::{Clock, MAX_RECORDING_S, is_of_recording};
use crate::geometry::Vec2;
use crate::ingest::Reject;
use crate::ingest::assemble::MAX_COORDINATE_M;
use crate::ingest::raw::{Change, SeenTrack};
use crate::ingest::recorded_track::RecordedTrack;

/// Rows of a track closer in time than this are at one time, seconds.
const SAME_S: f64 = 1e-9;
/// Two rows of a track at one time are the same if their positions are this close, meters.
const SAME_M: f64 = 1e-6;
/// Positions in degrees are this close to their origin, meters: farther away, its plane is not true to scale.
const MAX_FROM_ORIGIN_M: f64 = 1e5;

impl Rows<'_> {
    /// The agents that have the id in these rows.
    pub(super) fn agents(
        &self,
        id: &str,
        rows: &[u32],
        clock: Clock,
        left_out: &mut LeftOut,
    ) -> Result<Vec<RecordedTrack>, Reject> {
        let is_own = |row: u32| self.is_own(self.time_s(row) - clock.start_s);
        let kept = self.in_order(id, rows, clock, left_out)?;
        let Some(seen) = self.seen(id, &kept, clock) else { return Ok(Vec::new()) };
        let kept = self.in_place(id, kept, &seen, clock, left_out)?;
        let mut tracks = Vec::new();
        for number in 0..=seen.changes.len() {
            let change = number.checked_sub(1).map(|before| seen.changes[before]);
            let from_s = change.map_or(f64::NEG_INFINITY, |(from_s, _)| from_s);
            let until_s = seen.changes.get(number).map_or(f64::INFINITY, |(until_s, _)| *until_s);
            let [from, until] = [from_s, until_s].map(|at_s| kept.partition_point(|row| self.time_s(*row) < at_s));
            let own = &kept[from..until];
            let Some(first) = own.first() else { continue };
            let name = if number == 0 { id.to_owned() } else { self.free_name(id, number + 1) };
            if let Some((_, change)) = change.filter(|(from_s, _)| (self.time_s(*first) - from_s).abs() < SAME_S) {
                let why = match change {
                    Change::Size => "its size is another",
                    Change::Class => "its class is another",
                    Change::Place => "no vehicle comes here from where it was",
                    Change::Time => "nobody had it for more than a minute",
                };
                let place = self.table.place_of(*first as usize);
                let detail = format!("{}, {place}: track {id} goes on as {name}: {why}", self.file);
                left_out.note("ids_of_another_agent", usize::from(is_own(*first)), &detail);
            }
            match self.track((id, name), own, &seen, clock, left_out) {
                Ok(track) => tracks.extend(track),
                Err(reject) if seen.changes.is_empty() => return Err(reject),
                Err(reject) => left_out.agent(reject, is_own(*first)),
            }
            left_out.n_agents += usize::from(number > 0);
        }
        Ok(tracks)
    }

    /// The rows that can be, by ascending time, without repeated ones.
    fn in_order(&self, id: &str, rows: &[u32], clock: Clock, left_out: &mut LeftOut) -> Result<Vec<u32>, Reject> {
        let is_own = |row: u32| self.is_own(self.time_s(row) - clock.start_s);
        let mut kept: Vec<u32> = Vec::with_capacity(rows.len());
        for row in rows {
            match self.check(*row, clock) {
                Ok(()) => kept.push(*row),
                Err(reject) if rows.len() == 1 => return Err(reject),
                Err(reject) => left_out.row(reject, is_own(*row)),
            }
        }
        kept.sort_by(|a, b| self.time_s(*a).total_cmp(&self.time_s(*b)));
        for pair in kept.windows(2) {
            let is_same_time = self.time_s(pair[1]) - self.time_s(pair[0]) < SAME_S;
            if is_same_time && self.position(pair[0]).distance(self.position(pair[1])) > SAME_M {
                let detail = format!(
                    "track {id} is at two positions at one time; if the table has several recordings, name the column \
                     that distinguishes them in ingest.table.columns.recording; if times are rounded, name that of \
                     frames instead, in columns.frame"
                );
                return Err(self.reject("duplicate_time", pair[1], &detail));
            }
        }
        let mut n_repeated = 0;
        kept.dedup_by(|again, first| {
            let is_repeated = self.time_s(*again) - self.time_s(*first) < SAME_S;
            n_repeated += usize::from(is_repeated && is_own(*again));
            is_repeated
        });
        let repeated = format!("{}: rows that repeat the one before are left out", self.file);
        left_out.note("rows_repeated", n_repeated, &repeated);
        Ok(kept)
    }

    /// The rows that are not out of place.
    fn in_place(
        &self,
        id: &str,
        mut rows: Vec<u32>,
        seen: &SeenTrack,
        clock: Clock,
        left_out: &mut LeftOut,
    ) -> Result<Vec<u32>, Reject> {
        let is_jump = |row: u32| seen.jumps_s.binary_search_by(|at_s| at_s.total_cmp(&self.time_s(row))).is_ok();
        let jumps: Vec<u32> = rows.iter().copied().filter(|row| is_jump(*row)).collect();
        for row in &jumps {
            let Vec2 { x, y } = self.position(*row);
            let detail = format!(
                "track {id} is at ({x:.1}, {y:.1}) m, where no vehicle comes from the rows around; are \
                 ingest.table.length_unit_m and time_unit_s right?"
            );
            let reject = self.reject("implausible_positions", *row, &detail);
            if 2 * jumps.len() > rows.len() {
                return Err(reject);
            }
            left_out.row(reject, self.is_own(self.time_s(*row) - clock.start_s));
        }
        rows.retain(|row| !is_jump(*row));
        let is_leap = |row: u32| seen.leaps_s.binary_search_by(|at_s| at_s.total_cmp(&self.time_s(row))).is_ok();
        for pair in rows.windows(2).filter(|_| !seen.leaps_s.is_empty()).filter(|pair| is_leap(pair[1])) {
            let [(from, from_s), (to, to_s)] = [pair[0], pair[1]].map(|row| (self.position(row), self.time_s(row)));
            let detail = format!(
                "{}, {}: track {id} moves {:.1} m within {:.2} s, off its way, and goes on from there; it is kept, as \
                 simulators change lanes in one step",
                self.file,
                self.table.place_of(pair[1] as usize),
                from.distance(to),
                to_s - from_s
            );
            left_out.note("rows_off_the_motion_before", usize::from(self.is_own(to_s - clock.start_s)), &detail);
        }
        Ok(rows)
    }

    /// A name for an agent that has the id of another one.
    fn free_name(&self, id: &str, number: usize) -> String {
        let names = self.table.text(Some(&self.mapping.columns.track));
        let is_taken = |name: &String| match &self.part {
            Some(part) => part.tracks.contains_key(name),
            None => names.is_some_and(|names| names.has(name)),
        };
        let mut name = format!("{id}#{number}");
        while is_taken(&name) {
            name.push('#');
        }
        name
    }

    /// What all rows of an id show, of which `rows` are those at hand; `None` without any.
    fn seen(&self, id: &str, rows: &[u32], clock: Clock) -> Option<SeenTrack> {
        rows.first()?;
        if let Some(part) = &self.part {
            return part.tracks.get(id).cloned();
        }
        let TableColumns { length, width, class, .. } = &self.mapping.columns;
        let sizes = self.table.number(length.as_deref()).zip(self.table.number(width.as_deref()));
        let classes = self.table.text(class.as_deref());
        let mut owners = Owners::default();
        for row in rows {
            let at = *row as usize;
            let size =
                sizes.map(|(length, width)| [length[at], width[at]].map(|size| size * self.mapping.length_unit_m));
            let class =
                classes.and_then(|classes| self.mapping.class_of(&classes.different[classes.of_row[at] as usize]));
            owners.see(Seen::new(self.time_s(*row), self.position(*row), size, class), self.mapping.max_gap_s);
        }
        owners.end();
        Some(owners.seen_track(0, clock.start_s))
    }

    /// Refuses a row that is far from all others, in time or place.
    fn check(&self, row: u32, Clock { start_s, first_s }: Clock) -> Result<(), Reject> {
        let after_s = self.time_s(row) - start_s - first_s;
        if !is_of_recording(after_s, 0.0) {
            let detail = format!(
                "is {after_s:.0} s after the first row, expected at most {MAX_RECORDING_S}; is the time right, and \
                 ingest.table.time_unit_s or frame_rate_hz?"
            );
            return Err(self.reject("implausible_times", row, &detail));
        }
        let TableColumns { x, y, .. } = &self.mapping.columns;
        let at = self.position(row);
        if self.mapping.origin.is_some() && !(0.0..=MAX_FROM_ORIGIN_M).contains(&at.norm()) {
            let detail = format!(
                "is {:.0} km from ingest.table.origin, expected at most {}; is {x} the longitude and {y} the latitude, \
                 in degrees?",
                at.norm() / 1e3,
                MAX_FROM_ORIGIN_M / 1e3
            );
            return Err(self.reject("out_of_range", row, &detail));
        }
        for (name, at_m) in [(x, at.x), (y, at.y)] {
            if at_m.abs() > MAX_COORDINATE_M {
                let detail = format!(
                    "column {name} is {at_m:e} m, expected at most {MAX_COORDINATE_M}; is ingest.table.length_unit_m \
                     right?"
                );
                return Err(self.reject("out_of_range", row, &detail));
            }
        }
        Ok(())
    }
}
