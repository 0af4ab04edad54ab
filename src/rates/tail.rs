//! How often is a severity passed that was hardly or never recorded?

use super::Within;
use crate::statistics::{ClusteredRate, Estimate, Interval, Pareto};

/// The measures of severity, and whether the larger ones are the more severe.
const SEVERITIES: [(&str, bool); 7] = [
    ("ttc_s", false),
    ("min_ttc_s", false),
    ("pet_s", false),
    ("time_headway_s", false),
    ("time_to_arrival_s", false),
    ("max_deceleration_mps2", true),
    ("mean_deceleration_mps2", true),
];
/// The shares of events that thresholds to try let pass, the lowest threshold first: the least severe event, where the
/// definition of the behavior cuts the tail already.
const SHARES: [f64; 9] = [1.0, 0.7, 0.5, 0.4, 0.3, 0.25, 0.2, 0.15, 0.1];
/// A threshold is passed by at least so many events.
const LEAST_EVENTS: usize = 30;
/// No rate is given of what is expected less than once in so many times what was recorded.
const TIMES_RECORDED: f64 = 10.0;
/// A bucket is left for more severe events by at most this share of those that enter it.
const LARGEST_REST: f64 = 0.1;
/// No rate is given whose interval spans a larger factor.
pub(super) const WIDEST: f64 = 100.0;

/// How severe a value is. Times are by the logarithm, with which no tail goes on below zero. Where the density of times
/// at zero is positive, it has an exponential tail; their own ends there as none of a regular shape does.
fn severity_of(value: f64, is_larger: bool) -> f64 {
    if is_larger { value } else { -value.max(0.0).ln() }
}

/// A bucket of the most severe events.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct Level {
    pub(super) parameter: String,
    is_larger: bool,
    /// The severity that events of the bucket pass.
    severity: f64,
    /// The severity at its far end.
    end: f64,
}

/// A tail that was fitted to recorded severities.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct Tail {
    /// The severity beyond which it was fitted.
    pub(super) threshold: f64,
    fitted: Pareto,
    /// The recordings of the events that it was fitted to.
    clusters: Vec<usize>,
}

impl Level {
    /// The level of a bucket of a single measure of severity. `None` for other buckets.
    pub(super) fn of(within: &Within) -> Option<Self> {
        let (parameter, [from, to]) = within.0.first_key_value().filter(|_| within.0.len() == 1)?;
        let (_, is_larger) = SEVERITIES.into_iter().find(|(name, _)| name == parameter)?;
        let severity_of = |value| severity_of(value, is_larger);
        let (severity, end) = if is_larger { (*from, *to) } else { (severity_of(*to), severity_of(*from)) };
        Some(Self { parameter: parameter.clone(), is_larger, severity, end })
    }

    pub(super) fn severity_of(&self, value: f64) -> f64 {
        severity_of(value, self.is_larger)
    }

    /// The value of the parameter that has a severity.
    pub(super) fn value_of(&self, severity: f64) -> f64 {
        if self.is_larger { severity } else { (-severity).exp() }
    }

    /// The tail of recorded severities, each with its cluster: beyond the lowest threshold of those tried at which a
    /// generalized Pareto distribution is not rejected.
    pub(super) fn tail(&self, severities: &[(usize, f64)]) -> Result<Tail, &'static str> {
        let mut sorted = severities.to_vec();
        sorted.sort_by(|(_, a), (_, b)| b.total_cmp(a));
        if sorted.first().is_some_and(|(_, most)| *most > self.end) {
            return Err("more severe events than those of the bucket were recorded");
        }
        if self.severity == f64::INFINITY {
            return Err("no time is below zero");
        }
        if sorted.first().is_some_and(|(_, most)| *most == f64::INFINITY) {
            return Err("times of zero were recorded, which no tail reaches");
        }
        let mut is_tried = false;
        for share in SHARES {
            let n = ((share * sorted.len() as f64) as usize).min(sorted.len().saturating_sub(1));
            let Some((_, threshold)) = sorted.get(n).filter(|(_, threshold)| *threshold < self.severity) else {
                continue;
            };
            let (clusters, beyond): (Vec<usize>, Vec<f64>) =
                sorted.iter().map(|(cluster, x)| (*cluster, x - threshold)).filter(|(_, y)| *y > 0.0).unzip();
            if beyond.len() < LEAST_EVENTS {
                continue;
            }
            is_tried = true;
            if let Some(fitted) = Pareto::fit(beyond).filter(Pareto::is_good) {
                return match fitted.is_crowded() {
                    true => Err("the most severe events are about as severe as each other, as at a limit"),
                    false => Ok(Tail { threshold: *threshold, fitted, clusters }),
                };
            }
        }
        Err(match is_tried {
            true => "no generalized Pareto distribution fits the recorded tail",
            false => "fewer than 30 events to begin from",
        })
    }

    /// The rate beyond the level, from that `beyond` the threshold: their product, with the interval of Zou and Donner
    /// (2008) for a product, on logarithms. `n_beyond` events, which cluster, are beyond the threshold.
    pub(super) fn rate(
        &self,
        tail: &Tail,
        n_beyond: u64,
        beyond: ClusteredRate,
    ) -> Result<(f64, Interval), &'static str> {
        let Tail { threshold, fitted, clusters } = tail;
        let at = self.severity - threshold;
        let (share, of_share) = fitted.survival(at, fitted.dispersion(at, clusters));
        if fitted.survival(self.end - threshold, 1.0).0 > LARGEST_REST * share {
            return Err("the tail goes on beyond the far end of the bucket");
        }
        let found = Estimate::new(beyond.rate, beyond.interval).times(Estimate::new(share, of_share));
        if n_beyond as f64 / beyond.rate * found.interval.high * TIMES_RECORDED < 1.0 {
            return Err("one would be expected in more than ten times what was recorded");
        }
        if found.span() > WIDEST {
            return Err("the interval would span more than a factor of 100");
        }
        Ok((found.value, found.interval))
    }
}
