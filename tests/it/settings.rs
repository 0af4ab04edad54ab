//! Is every setting that cannot work refused before anything runs, by its key, its value and what was expected?
//!
//! A new setting gets its row: with a range in `BEYOND_RANGES`, anything else in `REFUSED`.

use crate::support::{SMALL_PIPELINE, Workspace};
use djinn::pipeline::config::parse;

/// Keys, values that are refused, and what the message says was expected. Every value is a case of its own.
const BEYOND_RANGES: &[(&str, &[&str], &str)] = &[
    ("run.threads", &["1000000000000", "1025"], "0 to 1024"),
    ("run.memory_limit_gb", &["0.0", "-1.0", "inf"], "a positive number"),
    ("ingest.n_history", &["0", "1000000000000"], "1 to 10000"),
    ("ingest.n_future", &["1000000000000"], "0 to 10000"),
    ("ingest.window_stride", &["0", "9223372036854775807"], "1 to 1000000"),
    ("ingest.holdout_share", &["-0.1", "1.5", "inf"], "0 to 1"),
    ("ingest.max_agents", &["0", "1000000000000"], "1 to 10000"),
    ("ingest.map_radius_m", &["0.0", "-5.0", "inf"], "a positive number"),
    ("ingest.limit", &["0"], "a number of at least 1"),
    ("cluster.workers", &["0", "100001"], "1 to 100000"),
    ("cluster.ranks", &["0", "2048"], "1 to 1024"),
    ("cluster.ranks_wait_s", &["0", "100000"], "1 to 86400"),
    ("cluster.retries", &["1001"], "0 to 1000"),
    ("cluster.gpus", &["65"], "0 to 64"),
    ("cluster.cpus", &["1025"], "0 to 1024"),
    ("cluster.notice_s", &["9", "3601"], "10 to 3600"),
    ("train.denoiser.steps", &["0", "9223372036854775807"], "1 to 1000000000"),
    ("train.denoiser.batch_size", &["0", "1000000000"], "1 to 16384"),
    ("train.denoiser.learning_rate", &["0.0", "-1e-3", "inf"], "a positive number"),
    ("train.denoiser.warmup_steps", &["9223372036854775807"], "0 to 1000000000"),
    ("train.denoiser.clip_norm", &["0.0", "-1.0", "inf"], "a positive number"),
    ("train.denoiser.ema_decay", &["-0.1", "1.0", "2.0"], "0 up to below 1"),
    ("train.denoiser.max_agents", &["0", "1000000000000"], "1 to 10000"),
    ("train.denoiser.max_lanes", &["1000000000000"], "0 to 100000"),
    ("train.denoiser.state_dim", &["0", "1", "4", "5"], "2 to 3"),
    ("train.denoiser.n_eval_scenes", &["9223372036854775807"], "0 to 1000000"),
    ("train.denoiser.evaluate_every", &["0"], "1 to 1000000000"),
    ("train.denoiser.save_every", &["0"], "1 to 1000000000"),
    ("train.denoiser.parts", &["0", "2048"], "1 to 1024"),
    ("train.denoiser.own_weight", &["-0.5", "inf"], "a number of at least 0"),
    ("train.denoiser.path_loss", &["-0.1", "inf"], "a number of at least 0"),
    ("train.denoiser.objectives_below_sigma", &["0.0", "inf"], "a positive number"),
    ("train.denoiser.diffusion.sigma_data", &["0.0", "0.7", "1.0"], "0.5: it is fixed"),
    ("train.denoiser.diffusion.sigma_min", &["0.0", "-1.0", "inf"], "a positive number"),
    ("train.denoiser.diffusion.sigma_max", &["0.0", "-1.0", "inf"], "more than 0 and at most 1000000"),
    ("train.denoiser.diffusion.rho", &["0.0", "-7.0", "inf"], "more than 0 and at most 100"),
    ("train.denoiser.noise.p_mean", &["inf", "-21.0", "1e9"], "-20 to 20"),
    ("train.denoiser.noise.p_std", &["-1.0", "inf"], "0 to 10"),
    ("train.denoiser.tasks.predictive", &["-1.0", "inf"], "a number of at least 0"),
    ("train.denoiser.network.width", &["0", "9223372036854775807"], "1 to 16384"),
    ("train.denoiser.network.n_heads", &["0", "1000000000000"], "1 to 1024"),
    ("train.denoiser.network.feed_forward", &["0", "1000000000000"], "1 to 65536"),
    ("train.denoiser.network.encoding", &["0", "1", "15", "1000000000000"], "2 to 16384, a multiple of 2"),
    ("train.denoiser.network.geometry.patch", &["0", "101"], "1 to 100"),
    ("train.denoiser.network.geometry.n_lanes", &["0", "201"], "1 to 200"),
    ("train.denoiser.network.geometry.n_neighbors", &["201"], "0 to 200"),
    ("train.denoiser.network.geometry.n_nearest_lanes", &["201"], "0 to 200"),
    ("train.denoiser.network.geometry.relation_width", &["0", "4097"], "1 to 4096"),
    ("train.classifier.network.width", &["0", "9223372036854775807"], "1 to 16384"),
    ("train.classifier.network.n_hidden", &["1000000"], "0 to 100"),
    ("train.classifier.network.encoding", &["0", "3"], "2 to 16384, a multiple of 2"),
    ("train.classifier.pos_weight", &["0.0", "-2.0", "inf"], "a positive number"),
    ("train.classifier.noise.p_std", &["-1.0"], "0 to 10"),
    ("train.classifier.max_examples", &["0"], "1 to 1000000000"),
    ("train.classifier.steps", &["0"], "1 to 1000000000"),
    ("train.classifier.batch_size", &["0", "1000000000"], "1 to 16384"),
    ("train.classifier.parts", &["0", "2048"], "1 to 1024"),
    ("train.classifier.learning_rate", &["0.0", "inf"], "a positive number"),
    ("train.classifier.clip_norm", &["0.0"], "a positive number"),
    ("train.classifier.evaluate_every", &["0"], "1 to 1000000000"),
    ("train.classifier.save_every", &["0"], "1 to 1000000000"),
    ("train.baseline.steps", &["0"], "1 to 1000000000"),
    ("train.baseline.batch_size", &["0", "1000000000"], "1 to 16384"),
    ("train.baseline.parts", &["0"], "1 to 1024"),
    ("train.baseline.mode_loss", &["0.0", "inf"], "a positive number"),
    ("train.baseline.ema_decay", &["1.0"], "0 up to below 1"),
    ("train.baseline.state_dim", &["0", "5"], "2 to 3"),
    ("train.baseline.network.n_modes", &["0", "1000000000000"], "1 to 1000"),
    ("train.baseline.network.encoding", &["7"], "2 to 16384, a multiple of 2"),
    ("train.distill.steps", &["0"], "1 to 1000000000"),
    ("train.distill.batch_size", &["0", "1000000000"], "1 to 16384"),
    ("train.distill.parts", &["0"], "1 to 1024"),
    ("train.distill.huber", &["-0.1", "inf"], "a number of at least 0"),
    ("train.distill.path_loss", &["-0.1"], "a number of at least 0"),
    ("train.distill.ema_decay", &["-0.5", "1.0"], "0 up to below 1"),
    ("generate.batch_size", &["0", "1000000000", "1000000000000"], "1 to 10000"),
    ("generate.scenes_per_shard", &["0", "9223372036854775807"], "1 to 100000"),
    ("generate.validity_strength", &["-1.0", "inf"], "0 to 1000000"),
    ("generate.sweeps.1.validity_strength", &["-1.0", "inf"], "0 to 1000000"),
    ("generate.sampler.n_steps", &["0", "1000000000", "1000000000000"], "1 to 10000"),
    ("generate.sampler.s_churn", &["-1.0", "inf"], "a number of at least 0"),
    ("generate.sampler.s_tmin", &["-1.0", "inf"], "a number of at least 0"),
    ("generate.sampler.s_tmax", &["0.0", "-1.0", "inf"], "a positive number"),
    ("generate.sampler.s_noise", &["-1.0", "inf", "11.0"], "0 to 10"),
    ("generate.sampler.grid.rho", &["0.0", "-1.0", "inf"], "more than 0 and at most 100"),
    ("generate.sampler.grid.sigma_min", &["0.0", "inf"], "a positive number"),
    ("generate.sampler.grid.sigma_max", &["0.0", "inf"], "more than 0 and at most 1000000"),
    ("generate.sweeps.1.n_samples", &["0", "1000000000000"], "1 to 100000"),
    ("generate.sweeps.1.stop_after_verified", &["0"], "a number of at least 1"),
    ("generate.sweeps.1.pairs.per_scene", &["0", "1000000000000"], "1 to 10000"),
    ("generate.sweeps.1.pairs.max_distance_m", &["0.0", "-1.0", "inf"], "a positive number"),
    ("generate.sweeps.1.pairs.n_scenes_ranked", &["0"], "a number of at least 1"),
    ("generate.sweeps.1.guidance.sigma_lo", &["-1.0", "inf"], "a number of at least 0"),
    ("generate.sweeps.1.guidance.sigma_hi", &["0.0", "inf"], "a positive number"),
    ("generate.sweeps.1.guidance.max_shift", &["0.0", "inf"], "a positive number"),
    ("generate.sweeps.1.objective_guidance.inner_steps", &["0", "1001"], "1 to 1000"),
    ("generate.sweeps.1.edit.tau", &["-0.1", "inf"], "0 to 1000000"),
    ("evaluate.duplicate_distance_m", &["-1.0", "inf"], "a number of at least 0"),
    ("evaluate.gates.min_validity_rate", &["-0.1", "1.1", "inf"], "0 to 1"),
    ("evaluate.gates.max_collision_rate", &["-0.1", "1.1", "inf"], "0 to 1"),
    ("evaluate.gates.max_offroad_rate", &["-0.1", "1.1", "inf"], "0 to 1"),
    ("evaluate.modes.n_modes", &["0", "1000000000000"], "1 to 1000"),
    ("evaluate.modes.n_starts", &["0"], "1 to 1000"),
    ("evaluate.modes.max_iterations", &["0"], "1 to 1000000"),
    ("evaluate.modes.min_std_m", &["0.0", "-1.0"], "a positive number"),
    ("evaluate.validity.window_s", &["0.0", "-1.0", "700.0", "inf"], "more than 0 and at most 5"),
    ("evaluate.validity.max_acceleration_mps2", &["-1.0", "inf"], "a number of at least 0"),
    ("evaluate.validity.max_jerk_mps3", &["-1.0", "inf"], "a number of at least 0"),
    ("evaluate.validity.max_slip_rad", &["-1.0", "inf"], "a number of at least 0"),
    ("evaluate.validity.offroad_slack_m", &["-1.0", "inf"], "a number of at least 0"),
    ("evaluate.validity.max_recorded_offroad", &["-0.1", "1.5", "inf"], "0 to 1"),
    ("evaluate.careful_driver.ramp_s", &["0.0", "-1.0", "inf"], "a positive number"),
    ("evaluate.careful_driver.delay_s", &["-1.0", "inf"], "a number of at least 0"),
    ("report.n_drawn", &["1000000000000"], "0 to 100000"),
    ("report.n_compared", &["1000000000000"], "0 to 100000"),
];

/// Numbers that must not be NaN; the message names the key.
const NOT_NAN: &[&str] = &[
    "run.memory_limit_gb",
    "ingest.holdout_share",
    "ingest.map_radius_m",
    "train.denoiser.learning_rate",
    "train.denoiser.noise.p_mean",
    "train.denoiser.diffusion.rho",
    "train.classifier.noise.p_mean",
    "generate.sampler.s_churn",
    "generate.sampler.s_noise",
    "generate.sampler.s_tmax",
    "generate.sweeps.1.guidance.sigma_lo",
    "generate.sweeps.1.guidance.max_shift",
    "generate.sweeps.1.pairs.max_distance_m",
    "evaluate.gates.max_collision_rate",
    "evaluate.duplicate_distance_m",
    "evaluate.validity.max_jerk_mps3",
    "evaluate.careful_driver.delay_s",
];

const REQUEST: &str = "generate.arms=[{ name = \"guided\", strengths = [2.0] }]";

/// Settings, and words that the message must hold.
const REFUSED: &[(&[&str], &[&str])] = &[
    // Definitions of behaviors.
    (
        &["mine.behaviors=[{ kind = \"hard_brake\", min_deceleration_mps2 = -4.0 }]"],
        &["mine.behaviors.0.min_deceleration_mps2 is -4, expected a positive number"],
    ),
    (
        &["mine.behaviors=[{ kind = \"hard_brake\", smoothing_s = 1e9 }]"],
        &["mine.behaviors.0.smoothing_s is 1000000000, expected 0 to 5"],
    ),
    (
        &["mine.behaviors=[{ kind = \"hard_brake\", min_deceleration_mps2 = 13.0 }]"],
        &["mine.behaviors.0.min_deceleration_mps2 is 13, expected at most max_deceleration_mps2, which is 12"],
    ),
    (
        &["mine.behaviors=[{ kind = \"hard_brake\", negative_deceleration_mps2 = 5.0 }]"],
        &["negative_deceleration_mps2 is 5, expected at most min_deceleration_mps2, which is 4"],
    ),
    (&["mine.behaviors=[{ kind = \"hard_brake\", min_speed_mps = nan }]"], &["mine.behaviors.0.min_speed_mps is NaN"]),
    (&["mine.behaviors=[{ kind = \"cut_in\", max_delay_s = -3.0 }]"], &["mine.behaviors.0.max_delay_s is -3"]),
    (&["mine.behaviors=[{ kind = \"cut_in\", max_delay_s = nan }]"], &["mine.behaviors.0.max_delay_s is NaN"]),
    (
        &["mine.behaviors=[{ kind = \"cut_in\" }, { kind = \"near_miss\", max_ttc_s = -1.0 }]"],
        &["mine.behaviors.1.max_ttc_s is -1, expected 0 to 100"],
    ),
    (
        &["mine.behaviors=[{ kind = \"near_miss\", max_pet_s = -1.0 }]"],
        &["mine.behaviors.0.max_pet_s is -1, expected 0 to 100"],
    ),
    (
        &["mine.behaviors=[{ kind = \"near_miss\", min_drac_mps2 = -1.0 }]"],
        &["mine.behaviors.0.min_drac_mps2 is -1, expected a number of at least 0"],
    ),
    (
        &["mine.behaviors=[{ kind = \"near_miss\", min_passing_mps = -1.0 }]"],
        &["mine.behaviors.0.min_passing_mps is -1, expected a number of at least 0"],
    ),
    (
        &["mine.behaviors=[{ kind = \"near_miss\", min_overlap_m = -1.0 }]"],
        &["mine.behaviors.0.min_overlap_m is -1, expected 0 to 10"],
    ),
    (
        &["mine.behaviors=[{ kind = \"right_turn\", max_roundabout_m = -1.0 }]"],
        &["mine.behaviors.0.max_roundabout_m is -1, expected 0 to 10000"],
    ),
    (
        &["mine.behaviors=[{ kind = \"tailgating\", max_headway_s = 2.0 }]"],
        &["mine.behaviors.0.max_headway_s is 2, expected at most negative_headway_s, which is 1.4"],
    ),
    (
        &["mine.behaviors=[{ kind = \"pedestrian_steps_out\", max_time_to_arrival_s = 6.0 }]"],
        &["max_time_to_arrival_s is 6, expected at most negative_time_to_arrival_s, which is 5"],
    ),
    (
        &["mine.behaviors=[{ kind = \"cut_out\", max_speed_share = 1.5 }]"],
        &["mine.behaviors.0.max_speed_share is 1.5, expected 0 to 1"],
    ),
    (&["mine.behaviors=[{ kind = \"cut_in\", min_shift_m = -0.5 }]"], &["mine.behaviors.0.min_shift_m is -0.5"]),
    (&["mine.behaviors=[{ kind = \"lane_change\", min_stay_s = -1.0 }]"], &["mine.behaviors.0.min_stay_s is -1"]),
    (
        &["mine.behaviors=[{ kind = \"left_turn\", min_radius_m = 60.0 }]"],
        &["min_radius_m is 60, expected at most max_radius_m, which is 50"],
    ),
    (
        &["mine.behaviors=[{ kind = \"right_turn\", negative_heading_change_rad = 2.0 }]"],
        &["negative_heading_change_rad is 2, expected at most min_heading_change_rad"],
    ),
    (&["mine.behaviors=[{ kind = \"cut_in\" }, { kind = \"cut_in\" }]"], &["mine.behaviors.1", "given twice"]),
    // Scenes of other runs.
    (
        &["train.denoiser.data=[{ scenes = \"a\", weight = 0.0 }]"],
        &["train.denoiser.data.0.weight is 0, expected a positive number"],
    ),
    (&["train.denoiser.own_weight=0"], &["train.denoiser.own_weight is 0", "scenes of other runs"]),
    // Parts of batches.
    (
        &["train.denoiser.batch_size=8", "train.denoiser.parts=3"],
        &["train.denoiser.parts is 3, expected a power of two, at most batch_size, which is 8"],
    ),
    (
        &["train.denoiser.parts=4"],
        &["train.denoiser.parts is 4, expected a power of two, at most batch_size, which is 2"],
    ),
    (&["train.classifier.parts=32"], &["train.classifier.parts is 32, expected", "which is 16"]),
    (&["train.distill.parts=16"], &["train.distill.parts is 16, expected", "which is 8"]),
    (&["train.baseline.parts=6"], &["train.baseline.parts is 6, expected a power of two"]),
    (&["cluster.ranks=6"], &["cluster.ranks is 6, expected a power of two"]),
    // Networks.
    (
        &["train.denoiser.network.layers=TXYZ"],
        &["train.denoiser.network.layers is \"TXYZ\", but X is not a layer", "T (time)"],
    ),
    (
        &["train.denoiser.network.n_heads=3"],
        &["train.denoiser.network.n_heads is 3, expected a divisor of width, which is 16"],
    ),
    (&["train.denoiser.network.latent_periods=[2.0, 1.0]"], &["train.denoiser.network.latent_periods are 2 and 1"]),
    (
        &[
            "train.denoiser.network={ layers = \"TTTTTTTTTTTTTTTTTTTTTTTTTTTTTTTT\", width = 16384, feed_forward = 65536 }",
        ],
        &[
            "train.denoiser.batch_size is 2, for which train_denoiser takes about",
            "this machine has",
            "smaller network",
        ],
    ),
    (&["train.baseline.network={ encoder = \"TQ\" }"], &["train.baseline.network.encoder is \"TQ\""]),
    (
        &["train.baseline.network={ width = 30 }"],
        &["train.baseline.network.n_heads is 4, expected a divisor of width, which is 30"],
    ),
    (
        &["train.denoiser.diffusion={ sigma_min = 90.0 }"],
        &["train.denoiser.diffusion.sigma_min is 90, expected at most diffusion.sigma_max"],
    ),
    (
        &["train.distill.method={ kind = \"consistency\", gap = { ratio = 1.0 } }"],
        &["train.distill.method.gap.ratio is 1, expected a number beyond 1"],
    ),
    (
        &["train.distill.method={ kind = \"steps\", n_steps = 0 }"],
        &["train.distill.method.n_steps is 0, expected 1 to 1000"],
    ),
    (
        &["train.distill.method={ kind = \"steps\", teacher_steps = 1000000000000 }"],
        &["train.distill.method.teacher_steps is 1000000000000"],
    ),
    (
        &[
            "train.denoiser.tasks={ predictive = 0.0, goal_conditioned = 0.0, agent_conditioned = 0.0, ego_conditioned = 0.0, windowed = 0.0, upsampling = 0.0, imputation = 0.0 }",
        ],
        &["train.denoiser.tasks"],
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
        &["generate.sweeps.1.select.best is 0, expected a number of at least 1"],
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
        &["generate.requests.0.budget.n_samples is 0, expected a number of at least 1"],
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
        &["generate.arms=[{ name = \"a\", strengths = [2.0, 2.0] }]"],
        &["generate.arms.0.strengths.1 is 2, which is already listed"],
    ),
    (
        &["generate.arms=[{ name = \"a\" }, { name = \"a\" }]"],
        &["generate.arms.1.name", "is \"a\", the name of another arm"],
    ),
    // Names.
    (&["generate.sweeps.0.name=\"\""], &["generate.sweeps.0.name is empty"]),
    (
        &["generate.sweeps.0.name=\"a\\u001b[31mred\""],
        &["generate.sweeps.0.name is \"a\\u{1b}[31mred\"", "without control characters"],
    ),
    (&["generate.sweeps.0.name=\"two\\nlines\""], &["generate.sweeps.0.name is \"two\\nlines\""]),
    (
        &["generate.sweeps.1.name=as_recorded"],
        &["generate.sweeps.1.name is \"as_recorded\", the name of another sweep"],
    ),
    (&["generate.arms=[{ name = \"\" }]"], &["generate.arms.0.name is empty"]),
    (&["run.name=\"two\\nlines\""], &["run.name is \"two\\nlines\"", "without control characters"]),
    (&["report.title=\"\\u0007\""], &["report.title is \"\\u{7}\""]),
    (&["cluster.partition=two words"], &["cluster.partition is \"two words\", expected one word"]),
    (&["cluster.image=two words"], &["cluster.image is \"two words\", expected one word"]),
    (&["cluster.volumes={ data = 'data' }"], &["cluster.volumes.data is \"data\", expected a path from the root"]),
    (&["cluster.lines=[\"\", \"a\\nb\"]"], &["cluster.lines.1 is \"a\\nb\"", "without control characters"]),
    // Types, and where a mistake stands.
    (&["generate.batch_size=-1"], &["--set generate.batch_size=-1", "expected a whole number of at least 0"]),
    (&["generate.batch_size=many"], &["--set generate.batch_size=many", "expected a whole number of at least 0"]),
    (&["ingest.holdout_share=much"], &["expected a number"]),
    (&["generate.sampler.n_steps=many"], &["--set generate.sampler.n_steps=many", "expected a whole number"]),
    (&["run.seed=1", "generate.sampler.n_steps=-5"], &["--set generate.sampler.n_steps=-5"]),
    (
        &["generate.sampler.n_steps=0", "run.seed=1"],
        &["--set generate.sampler.n_steps=0: generate.sampler.n_steps is 0"],
    ),
    (&["evaluate.modes={ by = [] }"], &["evaluate.modes.by is empty"]),
];

/// Values at the ends of ranges, which work.
const WITHIN_RANGES: &[&str] = &[
    "run.memory_limit_gb=0.5",
    "ingest.holdout_share=0.0",
    "ingest.holdout_share=1.0",
    "ingest.limit=1",
    "train.denoiser.ema_decay=0.0",
    "train.denoiser.state_dim=2",
    "train.denoiser.parts=2",
    "cluster.ranks=1024",
    "train.denoiser.diffusion.sigma_data=0.5",
    "train.denoiser.network.encoding=2",
    "generate.sampler.n_steps=10000",
    "generate.sampler.s_noise=0.0",
    "generate.sweeps.1.guidance.sigma_lo=0.0",
    "generate.sweeps.1.guidance.max_shift=1e9",
    "evaluate.gates.max_collision_rate=1.0",
    "evaluate.gates.max_collision_rate=0.0",
    "evaluate.validity.window_s=5.0",
    "evaluate.validity.max_jerk_mps3=0.0",
    "mine.behaviors=[{ kind = \"hard_brake\", smoothing_s = 0.0 }]",
    "generate.sweeps.1.select={ limits = { pair_min_ttc_s = [2.0, inf] } }",
];

/// Dry runs with these settings end with 1 and say these words, in one line that names no type of the program.
fn expect_refusals(rows: &[(Vec<String>, Vec<String>)]) {
    let workspace = Workspace::new();
    let check = |(settings, words): &(Vec<String>, Vec<String>)| {
        let set = settings.iter().flat_map(|setting| ["--set", setting]);
        let outcome = workspace.run("out", &["--dry-run"].into_iter().chain(set).collect::<Vec<_>>());
        let found = &outcome.stderr;
        let is_told = words.iter().all(|word| found.contains(word));
        let leaks =
            ["usize", "f64", "untagged", "Some(", "panicked", "\u{1b}"].iter().find(|text| found.contains(**text));
        match outcome.code == 1 && is_told && leaks.is_none() && outcome.stdout.is_empty() {
            true => None,
            false => Some(format!("{settings:?}\n  wanted {words:?}\n  exit code {}: {found}", outcome.code)),
        }
    };
    let wrong: Vec<String> = std::thread::scope(|scope| {
        let parts: Vec<_> = rows
            .chunks(rows.len().div_ceil(4))
            .map(|part| scope.spawn(|| part.iter().filter_map(check).collect::<Vec<_>>()))
            .collect();
        parts.into_iter().flat_map(|part| part.join().unwrap()).collect()
    });
    assert!(wrong.is_empty(), "{} of {} settings:\n{}", wrong.len(), rows.len(), wrong.join("\n"));
    assert!(!workspace.path("out").exists());
}

#[test]
fn numbers_beyond_their_ranges_are_refused_with_the_range() {
    let beyond = BEYOND_RANGES.iter().flat_map(|(key, values, range)| {
        values
            .iter()
            .map(move |value| (vec![format!("{key}={value}")], vec![format!("{key} is "), format!("expected {range}")]))
    });
    let not_nan = NOT_NAN.iter().map(|key| (vec![format!("{key}=nan")], vec![format!("{key} is NaN")]));
    expect_refusals(&beyond.chain(not_nan).collect::<Vec<_>>());
}

#[test]
fn what_cannot_work_is_refused_in_words() {
    let owned = |texts: &[&str]| texts.iter().map(|text| (*text).to_owned()).collect();
    expect_refusals(&REFUSED.iter().map(|(settings, words)| (owned(settings), owned(words))).collect::<Vec<_>>());
}

#[test]
fn the_ends_of_ranges_work() {
    for setting in WITHIN_RANGES {
        let outcome = parse(None, SMALL_PIPELINE, &[(*setting).to_owned()]);
        assert!(outcome.is_ok(), "{setting}: {}", outcome.unwrap_err());
    }
}

#[test]
fn a_number_of_the_file_is_refused_where_it_stands() {
    let text = SMALL_PIPELINE.replace("kind = \"heun\", n_steps = 2", "kind = \"heun\", n_steps = 0");
    let error = parse(Some("p.toml".as_ref()), &text, &["run.seed=4".to_owned()]).unwrap_err().to_string();
    assert!(error.starts_with("p.toml:38:38: "), "{error}");
    assert!(error.ends_with("generate.sampler.n_steps is 0, expected 1 to 10000"), "{error}");
}
