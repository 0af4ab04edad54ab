//! Evidence from earlier runs about the arms of a request.
//!
//! Hit rates of an arm depend on the behavior, the buckets and the models, so rates of an earlier run are evidence, but
//! worth some samples at most: a request that differs soon overrules them.

use super::resolve::{ArmPrior, ResolvedRequest};
use super::summary::RequestSummary;
use crate::settings::Issue;

/// Earlier results of an arm count as at most this many samples.
const MOST_SAMPLES: f64 = 20.0;

impl ArmPrior {
    fn new(n_samples: u64, n_hits: u64) -> Option<Self> {
        let weight = (MOST_SAMPLES / n_samples as f64).min(1.0);
        (n_samples > 0).then_some(Self { n_samples: weight * n_samples as f64, n_hits: weight * n_hits as f64 })
    }
}

impl ResolvedRequest {
    /// Adopts how often the arms hit buckets in `earlier` requests for the same behavior. Arms are identified by name.
    ///
    /// # Errors
    /// When none of the arms occurs there.
    pub fn learn(&mut self, earlier: &[RequestSummary]) -> Result<(), Issue> {
        let alike: Vec<&RequestSummary> =
            earlier.iter().filter(|request| request.behavior == self.config.behavior).collect();
        for arm in &mut self.arms {
            let same = alike.iter().flat_map(|request| &request.arms).filter(|known| known.name == arm.name);
            let (n_samples, n_hits) = same.fold((0, 0), |(n_samples, n_hits), known| {
                let (samples, hits) = match arm.aims {
                    true => (known.n_aimed, known.n_aimed_hits),
                    false => (known.total.n_samples, known.total.n_hits),
                };
                (n_samples + samples, n_hits + hits.min(samples))
            });
            arm.prior = ArmPrior::new(n_samples, n_hits);
        }
        if self.arms.iter().all(|arm| arm.prior.is_none()) {
            let why = format_args!(
                "tells nothing about the arms {}: no request for {} there has tried them",
                self.arms.iter().map(|arm| arm.name.as_str()).collect::<Vec<_>>().join(", "),
                self.config.behavior
            );
            return Err(Issue::new("prior", why));
        }
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use crate::generate::request::RequestSummary;
    use crate::generate::request::tests::{fulfil, pool, tight, world};

    const REQUEST: &str = "per_bucket = 5\nbudget = { n_samples = 1500 }";

    fn finished() -> RequestSummary {
        let request = tight(REQUEST);
        let (rounds, _, ledger) = fulfil(&request, &pool(30), 1, world);
        RequestSummary::new(&request, &pool(30), &ledger, rounds.len())
    }

    #[test]
    fn what_is_known_is_not_tried_again_and_costs_fewer_samples() {
        let (mut n_samples, mut n_with_prior) = (0, 0);
        for seed in 2..12 {
            let mut request = tight(REQUEST);
            n_samples += fulfil(&request, &pool(30), seed, world).2.spent().0;
            request.learn(&[finished()]).unwrap();
            let (rounds, _, ledger) = fulfil(&request, &pool(30), seed, world);
            assert_eq!(rounds[0].shards.len(), request.config.shards_per_round);
            assert_eq!(ledger.first_round[0].n_samples, 0, "no round compares the arms");
            n_with_prior += ledger.spent().0;
        }
        assert!(n_with_prior < n_samples, "{n_with_prior} of {n_samples}");
    }

    #[test]
    fn arms_that_no_run_knows_are_tried_first() {
        let mut earlier = finished();
        earlier.arms.retain(|arm| arm.name != "guided@8");
        let mut request = tight(REQUEST);
        request.learn(&[earlier]).unwrap();
        let (rounds, _, _) = fulfil(&request, &pool(30), 1, world);
        assert_eq!(rounds[0].shards.iter().map(|shard| shard.arm).collect::<Vec<_>>(), [2]);
    }

    #[test]
    fn earlier_results_count_as_a_few_samples() {
        let mut request = tight(REQUEST);
        let mut earlier = finished();
        (earlier.arms[2].total.n_samples, earlier.arms[2].total.n_hits) = (5000, 1000);
        (earlier.arms[0].total.n_samples, earlier.arms[0].total.n_hits) = (4, 1);
        request.learn(&[earlier]).unwrap();
        let priors: Vec<(f64, f64)> =
            request.arms.iter().filter_map(|arm| arm.prior.map(|prior| (prior.n_samples, prior.n_hits))).collect();
        assert_eq!((priors[2], priors[0]), ((20.0, 4.0), (4.0, 1.0)));
    }

    #[test]
    fn a_run_that_knows_no_arm_is_refused() {
        let other = RequestSummary { behavior: "near_miss".to_owned(), ..finished() };
        let issue = tight(REQUEST).learn(&[other]).unwrap_err().to_string();
        assert!(issue.starts_with("prior tells nothing about the arms plain, guided@1, guided@8"), "{issue}");
    }
}
