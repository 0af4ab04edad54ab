//! What became of a scenario that was generated for a request?

/// The request behind a scenario, and what became of it there.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct RequestTag {
    /// Name of the request.
    pub request: String,
    /// The round in which it was generated.
    pub round: usize,
    /// What became of it.
    pub outcome: RequestOutcome,
    /// The bucket it falls into, if there is one.
    pub bucket: Option<BucketTag>,
}

/// A bucket of a request.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct BucketTag {
    /// Its index among the buckets of the request.
    pub idx: usize,
    /// What it holds: `gap_m 0..5, relative_speed_mps -5..0`.
    pub ranges: String,
}

/// What became of a scenario that was generated for a request.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum RequestOutcome {
    /// It is as asked, and one of those wanted.
    Accepted,
    /// It is as asked, but its bucket was full.
    Surplus,
    /// It is as asked, but its bucket had enough of the same scene and agents.
    Repeated,
    /// It holds the behavior, but is in no bucket, or not as the request's conditions say.
    Outside,
    /// It would be in a bucket, but breaks a limit of validity.
    BeyondLimits,
    /// It does not hold the behavior with the agents that were asked.
    NotFound,
}

impl RequestOutcome {
    /// All of them.
    pub const ALL: [Self; 6] =
        [Self::Accepted, Self::Surplus, Self::Repeated, Self::Outside, Self::BeyondLimits, Self::NotFound];

    /// The name in tables.
    pub const fn name(self) -> &'static str {
        match self {
            Self::Accepted => "accepted",
            Self::Surplus => "surplus",
            Self::Repeated => "repeated",
            Self::Outside => "outside",
            Self::BeyondLimits => "beyond_limits",
            Self::NotFound => "not_found",
        }
    }

    /// The outcome of this name.
    pub fn from_name(name: &str) -> Option<Self> {
        Self::ALL.into_iter().find(|outcome| outcome.name() == name)
    }
}
