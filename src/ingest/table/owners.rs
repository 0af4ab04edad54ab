//! Finds where an id passes from one agent to another, and rows that are out of place.

use super::headings::LongStands;
use crate::geometry::Vec2;
use crate::ingest::assemble::MAX_COORDINATE_M;
use crate::ingest::plausible_tracks::MAX_SPEED_MPS;
use crate::ingest::raw::{Change, SeenTrack};
use crate::ingest::standing::Standing;
use crate::scene::AgentClass;
use std::collections::VecDeque;

/// No vehicle speeds up by more, m/s².
const MAX_ACCELERATION_MPS2: f64 = 10.0;
/// Positions of trackers err by less, meters; simulated vehicles change lanes within one step.
const MAX_ERROR_M: f64 = 4.0;
/// Times without rows up to this are usual, seconds.
const USUAL_GAP_S: f64 = 1.0;
/// Rows that are farther apart show no motion, seconds.
const SHORT_S: f64 = 0.5;
/// The motion is that of this time, seconds: noise of positions weighs less in it than in a single step.
const MOTION_S: f64 = 0.3;
/// Where more than a row or two are missing, an agent is as near as this to where its motion leads, meters, and does
/// not leap: what is filled in could have been driven.
const GAP_S: f64 = 0.3;
const MAX_OFF_M: f64 = 1.0;
/// An id that was not seen for longer is another agent's: datasets count anew in each recording, seconds, and times the
/// longest gap that is filled in, and the usual time between rows.
const LOST_S: f64 = 60.0;
const LOST_GAPS: f64 = 10.0;
/// An agent that is farther than this from where its motion leads leaps, meters; after a single row out of place it is
/// back this near.
const MAX_LEAP_M: f64 = 2.0;
const BACK_M: f64 = 0.5;
/// Sizes of one agent differ by less, meters.
const MAX_OFF_SIZE_M: f64 = 0.5;

/// An agent in one row.
#[derive(Debug, Clone, Copy)]
pub(super) struct Seen {
    pub(super) time_s: f64,
    /// Meters, as recorded.
    position: Vec2,
    /// Length and width, meters.
    size_m: Option<[f64; 2]>,
    class: Option<AgentClass>,
}

/// What the rows of an id show, by ascending time.
#[derive(Debug, Default)]
pub(super) struct Owners {
    last: Option<Seen>,
    /// A row that the agent of the last one cannot reach: out of place, or of another agent.
    suspect: Option<Seen>,
    /// Rows of the present agent, the time of the first, and how fast it has been.
    n_rows: usize,
    begun_s: f64,
    fastest_mps: f64,
    /// Its last times and positions, which show its motion.
    recent: VecDeque<(f64, Vec2)>,
    /// From when on the id is that of another agent, in the unit of rows, seconds.
    changes: Vec<(f64, Change)>,
    /// Rows that are out of place.
    jumps_s: Vec<f64>,
    /// Rows to which the agent leaps, and goes on from there.
    leaps_s: Vec<f64>,
    standing: Standing,
    long_stands: LongStands,
}

impl Seen {
    pub(super) fn new(time_s: f64, position: Vec2, size_m: Option<[f64; 2]>, class: Option<AgentClass>) -> Self {
        // Blank sizes, and those of pedestrians, are none.
        Self { time_s, position, size_m: size_m.filter(|size_m| size_m.iter().all(|size_m| *size_m > 0.0)), class }
    }

    /// Whether it is on the earth.
    pub(super) fn is_possible(&self) -> bool {
        self.position.x.abs().max(self.position.y.abs()) <= MAX_COORDINATE_M
    }
}

impl Owners {
    /// Adds the next row of the id. Rows out of order, which few tables have, and repeated ones tell nothing.
    pub(super) fn see(&mut self, seen: Seen, max_gap_s: f64) {
        let Some(last) = self.last else { return self.accept(seen) };
        if seen.time_s - last.time_s < 1e-9 {
            return;
        }
        let gap_s = seen.time_s - last.time_s;
        if gap_s > USUAL_GAP_S.max(max_gap_s) + 1e-4
            && let Some(change) =
                change(&last, &seen).or_else(|| self.is_lost(gap_s, max_gap_s).then_some(Change::Time))
        {
            self.jumps_s.extend(self.suspect.take().map(|suspect| suspect.time_s));
            return self.pass_to(seen, change);
        }
        let fastest_mps = if self.n_rows > 1 { self.fastest_mps } else { MAX_SPEED_MPS };
        let is_near = is_reached(&last, &seen, fastest_mps);
        // Beyond the longest gap nothing is filled in.
        let gap_ends_s = self.suspect.map_or(seen.time_s, |suspect| suspect.time_s);
        let is_filled = gap_ends_s - last.time_s <= SHORT_S.max(max_gap_s) + 1e-4;
        let off_m = if is_filled { self.off_m(&seen) } else { None };
        let longest_step_s = f64::max(GAP_S, 1.5 * self.usual_s()) + 1e-4;
        let most_m = if gap_s > longest_step_s { MAX_OFF_M } else { MAX_LEAP_M };
        let goes_on = is_near && off_m.is_none_or(|off_m| off_m <= most_m);
        let Some(other) = self.suspect.take() else {
            if goes_on {
                return self.accept(seen);
            }
            self.suspect = Some(seen);
            return;
        };
        let leaps = other.time_s - last.time_s <= longest_step_s && is_reached(&last, &other, fastest_mps);
        if goes_on && (!leaps || off_m.is_some_and(|off_m| off_m <= BACK_M)) {
            self.jumps_s.push(other.time_s);
            return self.accept(seen);
        }
        if leaps {
            self.leaps_s.push(other.time_s);
            self.recent.clear();
            self.accept(other);
            return self.see(seen, max_gap_s);
        }
        if other.time_s < seen.time_s && is_reached(&other, &seen, MAX_SPEED_MPS) {
            if self.n_rows == 1 && self.changes.is_empty() {
                // The first row is the one out of place.
                self.jumps_s.push(last.time_s);
                self.last = None;
                self.n_rows = 0;
                self.accept(other);
            } else {
                self.pass_to(other, Change::Place);
            }
            return self.accept(seen);
        }
        self.jumps_s.push(other.time_s);
        self.suspect = Some(seen);
    }

    /// How far a row is from where the motion leads, meters, beyond what an agent can speed up; `None` if the motion is
    /// not known.
    fn off_m(&self, seen: &Seen) -> Option<f64> {
        let ((from_s, from), (last_s, last)) = (*self.recent.front()?, *self.recent.back()?);
        let (over_s, gap_s) = (last_s - from_s, seen.time_s - last_s);
        if over_s <= 0.0 {
            return None;
        }
        // The velocity is that of half the time before.
        let gained_m = MAX_ACCELERATION_MPS2 * gap_s * (gap_s + over_s) / 2.0;
        Some(seen.position.distance(last + (last - from) * (gap_s / over_s)) - gained_m)
    }

    /// The usual time between the rows of the present agent, seconds; 0 if there is one row.
    fn usual_s(&self) -> f64 {
        let lasts_s = self.last.map_or(0.0, |last| last.time_s - self.begun_s);
        lasts_s / self.n_rows.saturating_sub(1).max(1) as f64
    }

    /// Whether the present agent is not the one that has the id after this gap.
    fn is_lost(&self, gap_s: f64, max_gap_s: f64) -> bool {
        self.n_rows > 1 && gap_s > LOST_S.max(LOST_GAPS * max_gap_s.max(self.usual_s()))
    }

    pub(super) fn end(&mut self) {
        self.jumps_s.extend(self.suspect.take().map(|suspect| suspect.time_s));
        self.jumps_s.sort_by(f64::total_cmp);
        self.long_stands.end(f64::INFINITY);
    }

    /// What is known of the track with this number, in a recording that begins at `start_s`.
    pub(super) fn seen_track(self, number: usize, start_s: f64) -> SeenTrack {
        let Self { changes, jumps_s, leaps_s, standing, long_stands, .. } = self;
        let parked_s = standing.parked_s(start_s);
        SeenTrack { number, parked_s, changes, jumps_s, leaps_s, stood_rad: long_stands.into_headings() }
    }

    fn pass_to(&mut self, seen: Seen, change: Change) {
        self.changes.push((seen.time_s, change));
        self.long_stands.end(seen.time_s);
        (self.n_rows, self.fastest_mps, self.last) = (0, 0.0, None);
        self.accept(seen);
    }

    fn accept(&mut self, seen: Seen) {
        if let Some(last) = self.last {
            let gap_s = seen.time_s - last.time_s;
            self.fastest_mps = self.fastest_mps.max(seen.position.distance(last.position) / gap_s.max(0.1));
        }
        if self.last.is_none_or(|last| seen.time_s - last.time_s > SHORT_S + 1e-4) {
            self.recent.clear();
        }
        while self.recent.len() > 1 && seen.time_s - self.recent[0].0 > MOTION_S + 1e-4 {
            self.recent.pop_front();
        }
        self.recent.push_back((seen.time_s, seen.position));
        if self.n_rows == 0 {
            self.begun_s = seen.time_s;
        }
        self.n_rows += 1;
        self.standing.see(seen.time_s, seen.position);
        self.long_stands.see(seen.time_s, seen.position);
        // Its size may be blank in some rows.
        let size_m = seen.size_m.or(self.last.and_then(|last| last.size_m));
        self.last = Some(Seen { size_m, ..seen });
    }
}

/// Another size or class.
fn change(last: &Seen, seen: &Seen) -> Option<Change> {
    let sizes = last.size_m.zip(seen.size_m);
    let is_other_size = sizes.is_some_and(|(a, b)| a.iter().zip(b).any(|(a, b)| (a - b).abs() > MAX_OFF_SIZE_M));
    let is_other_class = last.class.zip(seen.class).is_some_and(|(a, b)| a != b);
    if is_other_size { Some(Change::Size) } else { is_other_class.then_some(Change::Class) }
}

fn is_reached(from: &Seen, to: &Seen, fastest_mps: f64) -> bool {
    let gap_s = to.time_s - from.time_s;
    let speed_mps = MAX_SPEED_MPS.min(fastest_mps + MAX_ACCELERATION_MPS2 * gap_s);
    from.position.distance(to.position) <= speed_mps * gap_s + MAX_ERROR_M
}

#[cfg(test)]
mod tests {
    use super::*;

    /// What rows of time, x, length and class show.
    fn owners(rows: &[(f64, f64, f64, AgentClass)]) -> (Vec<(f64, Change)>, Vec<f64>) {
        let mut owners = Owners::default();
        for (time_s, x, length_m, class) in rows {
            owners.see(Seen::new(*time_s, Vec2::new(*x, 0.0), Some([*length_m, 2.0]), Some(*class)), 1.0);
        }
        owners.end();
        (owners.changes, owners.jumps_s)
    }

    #[test]
    fn an_id_passes_on_by_size_class_or_place_and_no_other_way() {
        use AgentClass::{Bus, Vehicle};
        // A car that drives at 10 m/s for two seconds, then what follows.
        let drive: Vec<_> = (0..20).map(|i| (f64::from(i) * 0.1, f64::from(i), 4.5, Vehicle)).collect();
        let goes_on = |from: (f64, f64, f64, AgentClass)| {
            let (t, x, length_m, class) = from;
            (0..3).map(move |i| (t + 0.1 * f64::from(i), x + f64::from(i), length_m, class)).collect::<Vec<_>>()
        };
        for (next, expected) in [
            ((2.0, 20.0, 4.5, Vehicle), None),
            ((2.0, 23.0, 4.5, Vehicle), None),
            ((2.0, 20.0, 12.0, Bus), None),
            ((2.0, 25.0, 4.5, Vehicle), Some(Change::Place)),
            ((2.0, 60.0, 4.5, Vehicle), Some(Change::Place)),
            // Where the motion leads within half a second, 24 m, and braking or speeding up brings it.
            ((2.4, 26.5, 4.5, Vehicle), None),
            ((2.4, 29.0, 4.5, Vehicle), Some(Change::Place)),
            ((2.9, 36.0, 4.5, Vehicle), None),
            ((2.9, 40.0, 4.5, Vehicle), Some(Change::Place)),
            ((2.8, 28.0, 4.5, Vehicle), None),
            ((2.8, 68.0, 4.5, Vehicle), Some(Change::Place)),
            ((50.0, 0.0, 4.4, Vehicle), None),
            // Blank in these rows.
            ((50.0, 0.0, 0.0, Vehicle), None),
            ((50.0, 0.0, 12.0, Vehicle), Some(Change::Size)),
            ((50.0, 0.0, 4.5, Bus), Some(Change::Class)),
            ((50.0, 9000.0, 4.5, Vehicle), Some(Change::Place)),
            ((61.8, 0.0, 4.5, Vehicle), None),
            ((886.0, 0.0, 4.5, Vehicle), Some(Change::Time)),
        ] {
            let rows = [drive.clone(), goes_on(next)].concat();
            let found: Vec<(f64, Change)> = expected.map(|change| (next.0, change)).into_iter().collect();
            assert_eq!(owners(&rows), (found, vec![]), "{next:?}");
        }
        // Rows that are always far apart are one agent's.
        let seldom: Vec<_> = (0..9).map(|i| (f64::from(i) * 100.0, 0.0, 4.5, Vehicle)).collect();
        assert_eq!(owners(&seldom), (vec![], vec![]));
        // A single row that is elsewhere, within, at the beginning and at the end.
        for out_of_place in [0, 7, 19] {
            let mut rows = drive.clone();
            rows[out_of_place].1 += 40.0;
            assert_eq!(owners(&rows), (vec![], vec![rows[out_of_place].0]), "{out_of_place}");
        }
    }
}
