//! Settings of sampling and requests that cannot work, with what the message must say.

const REQUEST: &str = "generate.arms=[{ name = \"guided\", strengths = [2.0] }]";

/// Settings, and words that the message must hold.
pub(super) const REFUSED_GENERATION: &[(&[&str], &[&str])] = &[
    // Names.
    (
        &[
            REQUEST,
            "generate.sweeps.1.name=\"y/guided\"",
            "generate.requests=[{ name = \"y\", behavior = \"cut_in\", buckets = { gap_m = [0, 10] }, per_bucket = 1, arms = [\"guided\"], \
             budget = { n_samples = 9 } }]",
        ],
        &[
            "generate.requests.0.name is \"y\": samples of its arm guided are called y/guided, as are those of one of generate.sweeps",
        ],
    ),
    (
        &["generate.sweeps.1.observe=[{ agents = \"all\", times = { timesteps = { from = 0, every = 0 } } }]"],
        &["generate.sweeps.1.observe.0.times.timesteps.every is 0, expected 1 to 20000"],
    ),
    (
        &["generate.sweeps.1.observe=[{ agents = { n_random = 18446744073709551615 }, times = \"all\" }]"],
        &["generate.sweeps.1.observe.0.agents.n_random is 18446744073709551615, expected 1 to 10000"],
    ),
    // Sampling.
    (
        &["generate.sampler.s_tmin=2.0", "generate.sampler.s_tmax=1.0"],
        &["generate.sampler.s_tmin is 2, expected at most s_tmax, which is 1"],
    ),
    (
        &["generate.sampler.grid={ sigma_max = 0.001 }"],
        &["generate.sampler.grid.sigma_max is 0.001, expected more than sigma_min"],
    ),
    (
        &["generate.sweeps.1.guidance={ sigma_lo = 3.0, sigma_hi = 1.0 }"],
        &["generate.sweeps.1.guidance.sigma_lo is 3, expected at most guidance.sigma_hi, which is 1"],
    ),
    (&["generate.sweeps.1.classifier_potential=\"odds\""], &["log_probability", "log_odds"]),
    (&["generate.sweeps.1.strengths=[1.0, 1.0]"], &["generate.sweeps.1.strengths.1 is 1, which is already listed"]),
    (&["generate.sweeps.1.strengths=[0.0, nan]"], &["generate.sweeps.1.strengths.1 is NaN"]),
    (&["generate.sweeps.1.strengths=[inf]"], &["generate.sweeps.1.strengths.0 is inf, expected a finite number"]),
    (&["generate.sweeps.1.strengths=[]"], &["generate.sweeps.1.strengths is empty, expected at least one number"]),
    (&["generate.sweeps.1.n_scenes=0"], &["generate.sweeps.1.n_scenes is 0, expected at least 1"]),
    (
        &[
            "generate.sweeps.0.classifier_free={ extra = [{ agents = \"all\", times = \"goal\" }], weights = [0.5, 0.5] }",
        ],
        &["generate.sweeps.0.classifier_free.weights.1 is 0.5, which is already listed"],
    ),
    (
        &["generate.sweeps.0.classifier_free={ extra = [{ agents = \"all\", times = \"goal\" }], goal_std_m = -1.0 }"],
        &["generate.sweeps.0.classifier_free.goal_std_m is -1, expected 0 to 1000"],
    ),
    (
        &["generate.sweeps.0.edit={ edits = [{ kind = \"shift\", agent = \"ego\", left_m = 1.0, onset_s = 200.0 }] }"],
        &["generate.sweeps.0.edit.edits.0.onset_s is 200, expected more than 0 and at most 60"],
    ),
    (
        &["generate.sweeps.0.edit={ edits = [{ kind = \"meet\", agent = \"ego\", with = \"ego\", at_s = 2.0 }] }"],
        &["edit.edits.0.with is ego, the agent that is moved"],
    ),
    (
        &[
            "generate.sweeps.0.edit={ edits = [{ kind = \"meet\", agent = \"ego\", with = { track = \"7\" }, at_s = 200.0 }] }",
        ],
        &["edit.edits.0.at_s is 200"],
    ),
    (
        &["generate.sweeps.0.edit={ edits = [{ kind = \"scale_speed\", agent = \"ego\", factor = -1.0 }] }"],
        &["edit.edits.0.factor is -1, expected 0 to 100"],
    ),
    (
        &["generate.sweeps.0.edit={ edits = [{ kind = \"shift\", agent = { role = \"third\" }, onset_s = 1.0 }] }"],
        &["the agent with the role third"],
    ),
    (
        &["generate.sweeps.1.objectives=[{ kind = \"speed_limit\", limit_mps = -1.0 }]"],
        &["generate.sweeps.1.objectives.0.limit_mps is -1, expected a number of at least 0"],
    ),
    (
        &["generate.sweeps.1.objectives=[{ kind = \"goal\", x_m = inf, y_m = 0.0 }]"],
        &["generate.sweeps.1.objectives.0.x_m is inf"],
    ),
    (
        &["generate.sweeps.1.select={ best = 0, by = [\"mfd_m\"] }"],
        &["generate.sweeps.1.select.best is 0, expected 1 to 100000"],
    ),
    (
        &["generate.sweeps.1.select={ limits = { collision_rate = nan } }"],
        &["generate.sweeps.1.select.limits.collision_rate is NaN"],
    ),
    // Requests.
    (
        &[
            REQUEST,
            "generate.requests=[{ name = \"r\", behavior = \"cut_in\", buckets = { gap_m = [0, 10] }, per_bucket = 1, arms = [\"guided\", \"guided\"], budget = { n_samples = 10 } }]",
        ],
        &["arms.1 is guided, which is already listed"],
    ),
    (
        &[
            REQUEST,
            "generate.requests=[{ name = \"r\", behavior = \"cut_in\", buckets = { gap_m = [0, 10] }, per_bucket = 1, arms = [\"guided\"], budget = { n_samples = 0 } }]",
        ],
        &["generate.requests.0.budget.n_samples is 0, expected 1 to 1000000000000"],
    ),
    (
        &[
            REQUEST,
            "generate.requests=[{ name = \"r\", behavior = \"cut_in\", buckets = { gap_m = [0, 10] }, per_bucket = 0, arms = [\"guided\"], budget = { n_samples = 9 } }]",
        ],
        &["generate.requests.0.per_bucket is 0"],
    ),
    (
        &[
            REQUEST,
            "generate.requests=[{ name = \"r\", behavior = \"cut_in\", buckets = { gap_m = 3 }, per_bucket = 1, arms = [\"guided\"], budget = { n_samples = 9 } }]",
        ],
        &["expected a list of ascending numbers or a list of texts"],
    ),
    (
        &[
            REQUEST,
            "generate.requests=[{ name = \"r\", behavior = \"cut_in\", buckets = { gap_m = [0, 10] }, where = { gap_m = 3 }, per_bucket = 1, arms = [\"guided\"], budget = { n_samples = 9 } }]",
        ],
        &["expected a range [least, most] or a list of texts"],
    ),
    (
        &[
            REQUEST,
            "generate.requests=[{ name = \"r\", behavior = \"cut_in\", buckets = { gap_m = [0, 10] }, per_bucket = 1, arms = [\"guided\"], plan = \"even\", prior = \"requests.json\", budget = { n_samples = 9 } }]",
        ],
        &["generate.requests.0 (r): prior has no effect on plan = \"even\""],
    ),
    (
        &["generate.arms=[{ name = \"a\", strengths = [2.0, 2.0] }]"],
        &["generate.arms.0.strengths.1 is 2, which is already listed"],
    ),
    (
        &["generate.arms=[{ name = \"a\" }, { name = \"a\" }]"],
        &["generate.arms.1.name", "is \"a\", the name of another arm"],
    ),
];
