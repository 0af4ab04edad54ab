//! Finds when a vehicle stands for so long that it is parked.

use crate::geometry::Vec2;
use std::ops::RangeInclusive;

/// A vehicle that stays within this distance of a place stands, meters; trackers err by less.
const STANDING_M: f64 = 1.0;
/// A vehicle that stands for this long is parked, seconds; no signal is red for as long.
const PARKED_S: f64 = 180.0;

/// The standing of a vehicle up to some time.
#[derive(Debug, Default)]
pub(super) struct Standing {
    parked_s: Vec<RangeInclusive<f64>>,
    /// Where it came to stand, when, and the last time at which it stood there.
    now: Option<(Vec2, f64, f64)>,
}

impl Standing {
    /// Adds the next position. Times must ascend; an earlier time starts anew.
    pub(super) fn see(&mut self, time_s: f64, position: Vec2) {
        match &mut self.now {
            Some((place, _, until_s)) if time_s >= *until_s && place.distance(position) <= STANDING_M => {
                *until_s = time_s;
            }
            _ => {
                self.end();
                self.now = Some((position, time_s, time_s));
            }
        }
    }

    /// The times, seconds after `start_s`, between which it is parked.
    pub(super) fn parked_s(mut self, start_s: f64) -> Vec<RangeInclusive<f64>> {
        self.end();
        let after_start = |times: RangeInclusive<f64>| times.start() - start_s..=times.end() - start_s;
        self.parked_s.into_iter().map(after_start).collect()
    }

    fn end(&mut self) {
        let parked = self.now.take().filter(|(_, from_s, until_s)| until_s - from_s >= PARKED_S);
        self.parked_s.extend(parked.map(|(_, from_s, until_s)| from_s..=until_s));
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn who_stands_longer_than_at_a_signal_is_parked() {
        let mut seen = Standing::default();
        // Waits for two minutes, drives on, parks with a noise of half a meter, is hidden for a while, and leaves.
        let place = |t: f64| match t {
            _ if t < 120.0 => 0.0,
            _ if t < 130.0 => (t - 120.0) * 5.0,
            _ if t <= 400.0 => 50.0 + 0.5 * (7.0 * t).sin(),
            _ => 50.0 + (t - 400.0) * 5.0,
        };
        for t in (0..=500).map(f64::from).filter(|t| !(200.0..210.0).contains(t)) {
            seen.see(t + 1000.0, Vec2::new(place(t), 3.0));
        }
        let parked = seen.parked_s(1000.0);
        assert_eq!(parked, [130.0..=400.0]);
        assert_eq!(Standing::default().parked_s(0.0), []);
    }
}
