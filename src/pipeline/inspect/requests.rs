//! Requests: what was requested, what was delivered, and at what cost?

use crate::engine::Result;
use crate::generate::{ArmSummary, BucketSummary, RequestSummary};
use crate::pipeline::stages::read_requests;
use serde_json::{Map, Value, json};
use std::path::Path;

/// The figures of the requests of a folder of samples, by name. `None` where it has none.
pub(super) fn describe(samples: &Path) -> Result<Option<Value>> {
    let requests = read_requests(samples)?;
    let described: Map<String, Value> =
        requests.iter().map(|request| (request.name.clone(), of_request(request))).collect();
    Ok((!described.is_empty()).then_some(Value::Object(described)))
}

fn of_request(request: &RequestSummary) -> Value {
    let (n_buckets, n_short) = (request.buckets.len(), request.short().count());
    json!({
        "behavior": request.behavior,
        "ended": request.ended,
        "n_wanted": request.n_wanted,
        "n_accepted": request.n_accepted,
        "n_samples": request.n_samples,
        "n_evaluations": request.n_evaluations,
        "n_evaluations_per_accepted": per_accepted(request.n_evaluations, request.n_accepted),
        "n_rounds": request.n_rounds,
        "n_buckets": n_buckets,
        "n_buckets_filled": n_buckets - n_short,
        "n_buckets_short": n_short,
        "buckets": request.buckets.iter().map(of_bucket).collect::<Vec<_>>(),
        "arms": request.arms.iter().map(of_arm).collect::<Vec<_>>(),
    })
}

fn of_bucket(bucket: &BucketSummary) -> Value {
    let parts: Vec<String> = bucket.parts.iter().map(|part| format!("{} {}", part.parameter, part.range)).collect();
    json!({
        "bucket": parts.join(", "),
        "n_wanted": bucket.n_wanted,
        "n_accepted": bucket.n_accepted,
        "n_short": bucket.n_wanted.saturating_sub(bucket.n_accepted),
        "n_evaluations_per_accepted": bucket.n_evaluations_per_accepted().map(rounded),
    })
}

fn of_arm(arm: &ArmSummary) -> Value {
    let own = &arm.total;
    json!({
        "arm": arm.name,
        "n_samples": own.n_samples,
        "n_found": own.n_found,
        "n_beyond_limits": own.n_beyond_limits,
        "n_hits": own.n_hits,
        "n_accepted": own.n_accepted,
        "n_evaluations_per_accepted": per_accepted(own.n_samples * arm.n_evaluations_per_sample, own.n_accepted),
    })
}

/// Evaluations per accepted scenario; `None` if nothing was accepted.
fn per_accepted(n_evaluations: u64, n_accepted: u64) -> Option<f64> {
    (n_accepted > 0).then(|| rounded(n_evaluations as f64 / n_accepted as f64))
}

fn rounded(value: f64) -> f64 {
    (value * 10.0).round() / 10.0
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::pipeline::inspect::Description;

    #[test]
    fn the_figures_of_a_request_are_read_from_its_folder() {
        let dir = tempfile::tempdir().unwrap();
        assert_eq!(describe(dir.path()).unwrap(), None);
        let bucket = |idx: usize, range: &str, n_accepted: u64| {
            json!({ "idx": idx, "parts": [{ "parameter": "gap_m", "range": range }],
                "n_feasible": 4, "is_given_up": false,
                "n_wanted": 5, "n_accepted": n_accepted, "n_surplus": 0, "n_repeated": 0, "n_near_duplicates": 0,
                "accepted_by_arm": [n_accepted],
                "hits_by_arm": [n_accepted], "first_round_hits_by_arm": [0], "n_samples_while_open": 100,
                "n_evaluations_while_open": 1900 })
        };
        let own = |n_accepted: u64| {
            json!({ "n_samples": 100, "n_found": 20, "n_outside": 3, "n_beyond_limits": 2, "n_hits": 15,
                "n_accepted": n_accepted })
        };
        let request = json!({ "name": "tight", "behavior": "cut_in", "ended": "budget",
            "budget": { "n_samples": null, "n_evaluations": 1900 }, "n_rounds": 3, "n_samples": 100,
            "n_evaluations": 1900, "n_scenes": 4, "n_cells": 4, "n_infeasible": 0,
            "n_wanted": 15, "n_accepted": 6, "n_situations": 4,
            "arms": [{ "name": "guided", "strength": 2.0, "weight": 0.0, "n_evaluations_per_sample": 19,
                "n_aimed": 0, "n_aimed_hits": 0,
                "total": own(6), "first_round": own(0) }],
            "buckets": [bucket(0, "0..5", 5), bucket(1, "5..10", 1), bucket(2, "10..20", 0)] });
        fs_err::write(dir.path().join("requests.json"), json!([request]).to_string()).unwrap();
        let found = describe(dir.path()).unwrap().unwrap();
        let tight = &found["tight"];
        assert_eq!((&tight["n_buckets"], &tight["n_buckets_filled"]), (&json!(3), &json!(1)));
        assert_eq!((&tight["n_buckets_short"], &tight["n_evaluations_per_accepted"]), (&json!(2), &json!(316.7)));
        assert_eq!(tight["buckets"][1]["n_evaluations_per_accepted"], json!(1900.0));
        assert_eq!(tight["arms"][0]["n_evaluations_per_accepted"], json!(316.7));
        let text = Description::new("generated scenarios").with("requests", found).text();
        // A bucket without accepted scenarios has no cost.
        assert!(text.contains("        3: bucket gap_m 10..20; n_accepted 0; n_short 5; n_wanted 5\n"), "{text}");
    }
}
