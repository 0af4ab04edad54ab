//! Estimates with intervals, and what is computed from independent ones.
//!
//! The interval of a result follows from those of its parts alone, by the variance that each end implies (method of
//! variance estimates recovery: Zou and Donner 2008).

use super::Interval;
use serde::{Deserialize, Serialize};
use std::fmt;

/// A value that is not negative, with its 95 % interval.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct Estimate {
    /// The value.
    pub value: f64,
    /// Its interval.
    pub interval: Interval,
}

impl Estimate {
    /// An estimate.
    pub const fn new(value: f64, interval: Interval) -> Self {
        Self { value, interval }
    }

    /// The product with an independent one: on logarithms, or for zeros by the product's slopes.
    #[must_use]
    pub fn times(self, other: Self) -> Self {
        let value = self.value * other.value;
        let ends = |end: fn(Interval) -> f64| [(self, end(self.interval)), (other, end(other.interval))];
        if value > 0.0 {
            let spread = |end| {
                let [of_self, of_other] = ends(end).map(|(known, end)| (end / known.value).ln());
                of_self.hypot(of_other)
            };
            let (down, up) = (spread(|interval| interval.low), spread(|interval| interval.high));
            return Self::new(value, Interval { low: value * (-down).exp(), high: value * up.exp() });
        }
        let [(one, one_high), (other, other_high)] = ends(|interval| interval.high);
        let high = (other_high * (one_high - one.value)).hypot(one.value * (other_high - other.value));
        Self::new(0.0, Interval { low: 0.0, high })
    }

    /// The ratio to an independent one that is not zero.
    #[must_use]
    pub fn over(self, other: Self) -> Self {
        let Interval { low, high } = other.interval;
        self.times(Self::new(1.0 / other.value, Interval { low: 1.0 / high, high: 1.0 / low }))
    }

    /// The sum of independent ones.
    pub fn sum(parts: impl IntoIterator<Item = Self>) -> Self {
        let (mut value, mut below, mut above) = (0.0, 0.0_f64, 0.0_f64);
        for Self { value: part, interval } in parts {
            value += part;
            below = below.hypot(part - interval.low);
            above = above.hypot(interval.high - part);
        }
        Self::new(value, Interval { low: (value - below).max(0.0), high: value + above })
    }

    /// Whether both intervals have values in common.
    pub fn overlaps(self, other: Self) -> bool {
        self.interval.low <= other.interval.high && other.interval.low <= self.interval.high
    }

    /// The factor between the ends of the interval; infinite if one of them is zero.
    pub fn span(self) -> f64 {
        if self.interval.low > 0.0 { self.interval.high / self.interval.low } else { f64::INFINITY }
    }
}

impl fmt::Display for Estimate {
    /// For people: the value with its interval, or the upper end if nothing was found.
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let Self { value, interval: Interval { low, high } } = self;
        let plain = |x: f64| format!("{x:.2e}").parse().unwrap_or(x);
        match *value > 0.0 {
            true => write!(f, "{} ({} to {})", plain(*value), plain(*low), plain(*high)),
            false => write!(f, "below {}", plain(*high)),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn results_have_the_ends_of_hand_calculations() {
        let of = |value, low, high| Estimate::new(value, Interval { low, high });
        let e = std::f64::consts::E;
        let close = |a: Estimate, b: Estimate| {
            let ends = |x: Estimate| [x.value, x.interval.low, x.interval.high];
            assert!(ends(a).iter().zip(ends(b)).all(|(a, b)| (a - b).abs() < 1e-12), "{a:?}, expected {b:?}");
        };
        // Factors e^3 and e^4 down make e^5; e^6 and e^8 up make e^10.
        let (one, other) = (of(2.0, 2.0 * e.powi(-3), 2.0 * e.powi(6)), of(5.0, 5.0 * e.powi(-4), 5.0 * e.powi(8)));
        close(
            one.times(other).over(of(e.powi(10), e.powi(10), e.powi(10))),
            of(10.0 / e.powi(10), 10.0 / e.powi(15), 10.0),
        );
        close(of(4.0, 2.0, 8.0).over(of(1.0, 1.0, 1.0)), of(4.0, 2.0, 8.0));
        close(of(1.0, 1.0, 1.0).over(of(4.0, 2.0, 8.0)), of(0.25, 0.125, 0.5));
        // Nothing is found: what both upper ends allow.
        close(of(3.0, 1.0, 7.0).times(of(0.0, 0.0, 1.0)), of(0.0, 0.0, 5.0));
        close(of(0.0, 0.0, 4.0).times(of(0.5, 0.2, 0.8)), of(0.0, 0.0, 3.2));
        close(Estimate::sum([of(10.0, 7.0, 16.0), of(20.0, 16.0, 28.0)]), of(30.0, 25.0, 40.0));
        assert_eq!(of(0.123_45, 0.01, 1.5).to_string(), "0.123 (0.01 to 1.5)");
        assert_eq!(of(0.0, 0.0, 12.34).to_string(), "below 12.3");
        assert_eq!((of(0.0, 0.0, 1.0).span(), of(2.0, 1.0, 4.0).span()), (f64::INFINITY, 4.0));
    }
}
