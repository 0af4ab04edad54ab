//! How do vehicles move over to the lane beside: how fast, how hard, for how long?
//!
//! Where a template is joined to the observed motion, its speed across becomes up to 8 % higher than planned, so the
//! fastest speeds here are a tenth below the fastest that were recorded.

use super::BehaviorEvent;

/// The fastest speeds are multiplied by this to be those that were recorded.
const JOINED: f64 = 1.1;

/// How drivers move over.
#[derive(Debug, Clone, Copy)]
pub(super) struct Manner {
    /// The speed across the lanes that is preferred, and the fastest, m/s.
    pub(super) mps: [f64; 2],
    /// The hardest acceleration across, m/s².
    pub(super) most_mps2: f64,
}

/// Lane changes. In simulated recordings their median is 0.95 m/s at the crossing, their 95 % quantile 1.32 m/s, their
/// maximum 1.45 m/s (346 lane changes). On roads they take 3 to 6 s (Toledo and Zohar 2007: 4.6 s in the mean).
pub(super) const LANE_CHANGE: Manner = Manner { mps: [0.95, 1.33], most_mps2: 2.0 };
/// Cut-ins. In simulated recordings their median is 1.0 m/s at the intrusion, their 95 % quantile 1.35 m/s, their
/// maximum 1.57 m/s. UN Regulation No. 157 and the framework of JAMA judge lateral speeds of up to 1.8 m/s.
pub(super) const CUT_IN: Manner = Manner { mps: [0.95, 1.43], most_mps2: 2.0 };
/// Moving over to the oncoming lane, as to overtake: the largest lateral speed that the regulation judges.
pub(super) const OVERTAKING: Manner = Manner { mps: [0.95, 1.65], most_mps2: 2.4 };
/// Vehicles that are longer than cars are, meters, accelerate across by this at most, m/s².
const LONG_M: f64 = 6.5;
const LONG_MPS2: f64 = 1.5;
/// Faster and faster ways differ by this factor.
const FASTER: f64 = 1.15;
/// The shortest time in which the speed rises, seconds, and the time in which it falls as a multiple of the former.
const LEAST_RISE_S: f64 = 0.9;
const FALLS: f64 = 2.0;
/// The largest slope of a smooth change from 0 to 1, by 3 u² - 2 u³.
pub(super) const CHANGE_PEAK: f64 = 1.5;

impl Manner {
    /// The manner with this multiple of the fastest speed and of the hardest acceleration, of a vehicle of this length.
    pub(super) fn of(self, hurry: f64, length_m: f64) -> Self {
        let most_mps2 = if length_m > LONG_M { LONG_MPS2 } else { self.most_mps2 };
        Self { mps: [self.mps[0], self.mps[1] * hurry], most_mps2: most_mps2 * hurry }
    }

    /// Ways to move aside by `aside_m`, from the preferred speed times `eager` to the fastest.
    pub(super) fn ways(self, aside_m: f64, eager: f64) -> impl Iterator<Item = Sideways> {
        let [preferred_mps, most_mps] = self.mps;
        let speeds = std::iter::successors(Some((preferred_mps * eager).min(most_mps)), move |mps| {
            (*mps < most_mps).then(|| (mps * FASTER).min(most_mps))
        });
        speeds.map(move |mps| Sideways::new(aside_m, mps, self.most_mps2))
    }

    /// Whether drivers move over as fast as this event says, all of those that were recorded at least.
    pub(super) fn holds(self, event: &BehaviorEvent) -> bool {
        event.parameters.get("lateral_speed_mps").is_none_or(|mps| *mps <= JOINED * self.mps[1])
    }

    /// The fastest way to move aside by `aside_m`.
    pub(super) fn fastest(self, aside_m: f64) -> Sideways {
        Sideways::new(aside_m, self.mps[1], self.most_mps2)
    }
}

/// A motion aside whose speed rises smoothly, stays, and falls more slowly than it rose.
#[derive(Debug, Clone, Copy)]
pub(super) struct Sideways {
    /// How far it leads, meters, and the largest speed, m/s.
    aside_m: f64,
    pub(super) mps: f64,
    rises_s: f64,
    /// When the speed begins to fall, seconds after the start.
    stays_s: f64,
}

impl Sideways {
    /// The motion with this speed, or a lower one where the way is too short for it.
    fn new(aside_m: f64, mps: f64, most_mps2: f64) -> Self {
        let rises_s = (CHANGE_PEAK * mps / most_mps2).max(LEAST_RISE_S);
        let mean_s = rises_s * (1.0 + FALLS) / 2.0;
        let mps = mps.min(aside_m / mean_s);
        let stays_s = if mps > 0.0 { rises_s + aside_m / mps - mean_s } else { rises_s };
        Self { aside_m, mps, rises_s, stays_s }
    }

    /// How long it takes, seconds.
    pub(super) fn takes_s(&self) -> f64 {
        self.stays_s + FALLS * self.rises_s
    }

    /// When half of the way is done, seconds after the start.
    pub(super) fn midway_s(&self) -> f64 {
        self.reaches_s(self.aside_m / 2.0)
    }

    /// The way after `elapsed_s`, meters.
    fn moved_m(&self, elapsed_s: f64) -> f64 {
        let falls_s = FALLS * self.rises_s;
        self.mps * (changed_s(elapsed_s, self.rises_s) - changed_s(elapsed_s - self.stays_s, falls_s))
    }

    /// The share of the way after `elapsed_s`.
    pub(super) fn share(&self, elapsed_s: f64) -> f64 {
        if self.aside_m > 0.0 { self.moved_m(elapsed_s) / self.aside_m } else { 1.0 }
    }

    /// When it has led this far, seconds after the start; at most when it ends.
    pub(super) fn reaches_s(&self, moved_m: f64) -> f64 {
        let (mut low_s, mut high_s) = (0.0, self.takes_s());
        for _ in 0..40 {
            let middle_s = f64::midpoint(low_s, high_s);
            if self.moved_m(middle_s) < moved_m { low_s = middle_s } else { high_s = middle_s }
        }
        high_s
    }
}

/// The integral of a value that changes smoothly from 0 to 1 within `takes_s`, by 3 u² - 2 u³, and stays: over the
/// first `elapsed_s`, seconds.
pub(super) fn changed_s(elapsed_s: f64, takes_s: f64) -> f64 {
    if takes_s <= 0.0 {
        return elapsed_s.max(0.0);
    }
    let u = (elapsed_s / takes_s).clamp(0.0, 1.0);
    takes_s * u * u * u * (1.0 - u / 2.0) + (elapsed_s - takes_s).max(0.0)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn vehicles_move_over_as_fast_as_drivers_do_and_for_as_long() {
        let h = 1e-4;
        for (manner, length_m, most_mps2) in [(LANE_CHANGE, 4.5, 2.0), (CUT_IN, 4.5, 2.0), (LANE_CHANGE, 12.0, 1.5)] {
            for way in manner.of(1.0, length_m).ways(3.5, 1.0) {
                let at = |t: f64| 3.5 * way.share(t);
                let times = || (0..800).map(|i| f64::from(i) * 0.01);
                let fastest = times().map(|t| (at(t + h) - at(t - h)) / (2.0 * h)).fold(0.0, f64::max);
                let hardest = times().map(|t| ((at(t + h) - 2.0 * at(t) + at(t - h)) / (h * h)).abs());
                let hardest = hardest.fold(0.0, f64::max);
                assert!((fastest - way.mps).abs() < 1e-6 && (0.9..1.431).contains(&fastest), "{fastest} m/s");
                assert!(hardest < most_mps2 + 1e-3, "{hardest} m/s²");
                assert!((3.0..=6.0).contains(&way.takes_s()), "{} s", way.takes_s());
                assert!(at(0.0).abs() < 1e-12 && (at(way.takes_s()) - 3.5).abs() < 1e-9);
                assert!((at(9.0) - 3.5).abs() < 1e-9);
                assert!((at(way.reaches_s(2.0)) - 2.0).abs() < 1e-6);
            }
        }
        // The speed rises within 1.5 · 1.33 / 2 s, half of which at 1.33 m/s are its way, and falls within twice that.
        let fastest = LANE_CHANGE.fastest(3.5);
        assert!((fastest.takes_s() - (3.0 * 0.9975 + 3.5 / 1.33 - 1.5 * 0.9975)).abs() < 1e-9);
        assert!((fastest.reaches_s(1.33 * (0.9975 / 2.0 + 0.5)) - 1.4975).abs() < 1e-6);
        assert!(LANE_CHANGE.fastest(0.3).mps < 0.3, "a short way takes its time, too");
        assert!((LANE_CHANGE.of(1.5, 4.5).fastest(3.5).mps - 1.995).abs() < 1e-12, "only who is asked to hurries");
    }
}
