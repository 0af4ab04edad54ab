//! The outcome of a scenario for the request that it was generated for.

use crate::settings::named;

/// The request behind a scenario, and the scenario's outcome there.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct RequestTag {
    /// Name of the request.
    pub request: String,
    /// The round in which it was generated.
    pub round: usize,
    /// Its outcome.
    pub outcome: RequestOutcome,
    /// The bucket it falls into, if any.
    pub bucket: Option<BucketTag>,
}

/// A bucket of a request.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct BucketTag {
    /// Its index among the buckets of the request.
    pub idx: usize,
    /// Its ranges: `gap_m 0..5, relative_speed_mps -5..0`.
    pub ranges: String,
}

/// The outcome of a scenario for its request.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum RequestOutcome {
    /// It meets the request and counts.
    Accepted,
    /// It meets the request, but its bucket was full.
    Surplus,
    /// It meets the request, but its bucket had enough scenarios of the same scene and agents.
    Repeated,
    /// It meets the request, but its agents move almost as in one that the request accepted before.
    NearDuplicate,
    /// It shows the behavior, but falls into no bucket or fails a condition of the request.
    Outside,
    /// It would fall into a bucket, but breaks a limit of validity.
    BeyondLimits,
    /// The requested agents do not show the behavior.
    NotFound,
}

named! { RequestOutcome {
    Accepted = "accepted", Surplus = "surplus", Repeated = "repeated", NearDuplicate = "near_duplicate",
    Outside = "outside", BeyondLimits = "beyond_limits", NotFound = "not_found",
} }
