//! Settings that cannot work, with what the message must say.

/// Settings, and words that the message must hold.
pub(super) const REFUSED: &[(&[&str], &[&str])] = &[
    // What is not mined, and what teaches nothing.
    (
        &["train.classifier.behavior=\"hard_brake\""],
        &["train.classifier.behavior is \"hard_brake\", expected one of mine.behaviors, which are cut_in"],
    ),
    (
        &["train.denoiser.splits=[\"test\"]"],
        &["train.denoiser.splits is [\"test\"], whose scenes have no futures to learn from"],
    ),
    (&["a.b.c.d.e.f.g.h.i.j.k.l.m.n.o.p.q.r.s.t.u.v.w.x.y.z.a.b.c.d.e.f.g=1"], &["33 parts, expected at most 32"]),
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
    (
        &["mine.behaviors=[{ kind = \"unprotected_left_turn\", max_pet_s = 5.0 }]"],
        &["mine.behaviors.0.max_pet_s is 5, expected at most negative_pet_s, which is 4"],
    ),
    (
        &["mine.behaviors=[{ kind = \"unprotected_left_turn\", min_heading_change_rad = 0.0 }]"],
        &["mine.behaviors.0.min_heading_change_rad is 0, expected more than 0 and at most 2.6"],
    ),
    (
        &["mine.behaviors=[{ kind = \"failure_to_yield\", negative_pet_s = 0.5 }]"],
        &["mine.behaviors.0.max_pet_s is 1, expected at most negative_pet_s, which is 0.5"],
    ),
    (
        &["mine.behaviors=[{ kind = \"failure_to_yield\", min_deceleration_mps2 = 0.0 }]"],
        &["mine.behaviors.0.min_deceleration_mps2 is 0, expected a positive number"],
    ),
    (
        &["mine.behaviors=[{ kind = \"wrong_way\", min_duration_s = 0.2 }]"],
        &["mine.behaviors.0.negative_duration_s is 0.5, expected at most min_duration_s, which is 0.2"],
    ),
    (
        &["mine.behaviors=[{ kind = \"wrong_way\", min_speed_mps = 0.0 }]"],
        &["mine.behaviors.0.min_speed_mps is 0, expected a positive number"],
    ),
    (
        &["mine.behaviors=[{ kind = \"runs_stop_line\", max_rolling_mps = 0.3 }]"],
        &["mine.behaviors.0.negative_speed_mps is 0.5, expected at most max_rolling_mps, which is 0.3"],
    ),
    (
        &["mine.behaviors=[{ kind = \"runs_stop_line\", approach_m = 2000.0 }]"],
        &["mine.behaviors.0.approach_m is 2000, expected more than 0 and at most 1000"],
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
    (&["mine.behaviors=[{ kind = \"cut_in\" }, { kind = \"cut_in\" }]"], &["mine.behaviors.1", "listed twice"]),
    // Scenes of other runs.
    (
        &["train.denoiser.data=[{ scenes = \"a\", weight = 0.0 }]"],
        &["train.denoiser.data.0.weight is 0, expected a positive number"],
    ),
    (&["train.denoiser.own_weight=0"], &["train.denoiser.own_weight is 0", "scenes of other runs"]),
    // Parts of batches.
    // Networks.
    (
        &["run.precision=bf16"],
        &["run.precision is \"bf16\", which needs the tensor cores of a GPU", "run.precision = \"f32\""],
    ),
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
        &["train.denoiser.network.geometry={ patch = 4 }", "train.denoiser.state_parametrization=scene"],
        &["train.denoiser.network.geometry needs state_parametrization"],
    ),
    (
        &["train.denoiser.objectives=[{ kind = \"speed_limit\", weight = -1.0, limit_mps = 8.0 }]"],
        &["train.denoiser.objectives.0.weight is -1"],
    ),
    (&["train.distill.method={ n_steps = 0 }"], &["train.distill.method.n_steps is 0, expected 1 to 1000"]),
    (
        &["train.distill.method={ teacher_steps = 1000000000000 }"],
        &["train.distill.method.teacher_steps is 1000000000000"],
    ),
    (
        &[
            "train.denoiser.tasks={ predictive = 0.0, goal_conditioned = 0.0, agent_conditioned = 0.0, ego_conditioned = 0.0, windowed = 0.0, upsampling = 0.0, imputation = 0.0 }",
        ],
        &["train.denoiser.tasks"],
    ),
    // Events.
    (
        &["train.denoiser.events={ behaviors = [\"cut_in\"], share = 1.0 }"],
        &["train.denoiser.events.share is 1, expected more than 0 and less than 1"],
    ),
    (
        &["train.denoiser.events={ behaviors = [\"cut_in\"], value_dropout = 1.0 }"],
        &["train.denoiser.events.value_dropout is 1, expected 0 up to below 1"],
    ),
    (&["train.denoiser.events={ behaviors = [] }"], &["train.denoiser.events.behaviors is empty"]),
    (
        &["train.denoiser.events={ behaviors = [\"drift\"] }"],
        &["train.denoiser.events.behaviors.0 is \"drift\", expected one of cut_in, "],
    ),
    (
        &["train.denoiser.events={ behaviors = [\"near_miss\"] }"],
        &["train.denoiser.events.behaviors.0 is \"near_miss\", expected one of mine.behaviors, which are cut_in"],
    ),
    (
        &["train.denoiser.events={ behaviors = [\"cut_in\"] }", "train.denoiser.network={}"],
        &["train.denoiser.events needs train.denoiser.network.geometry"],
    ),
    (
        &["train.distill.events={ behaviors = [\"cut_in\", \"cut_in\"] }"],
        &["train.distill.events.behaviors.1 is cut_in, which is already listed"],
    ),
    (
        &["generate.sweeps.0.classifier_free={ event = true }"],
        &["generate.sweeps.0.classifier_free.event is true, which needs a behavior"],
    ),
    (&["generate.sweeps.1.classifier_free={}"], &["generate.sweeps.1.classifier_free.extra has no rule"]),
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
    (&["cluster.volumes={ data = 'data' }"], &["cluster.volumes.data is \"data\", expected an absolute path"]),
    (&["cluster.lines=[\"\", \"a\\nb\"]"], &["cluster.lines.1 is \"a\\nb\"", "without control characters"]),
    // URLs of object stores.
    (
        &["train.denoiser.checkpoint=s3://bucket/model.safetensors"],
        &["train.denoiser.checkpoint is s3://bucket/model.safetensors, expected a path on disk", "copy it to disk"],
    ),
    (
        &["train.denoiser.data=[{ scenes = \"gs://bucket/scenes\" }]"],
        &["train.denoiser.data.0.scenes is gs://bucket/scenes, expected a path on disk"],
    ),
    (&["run.output=s3://"], &["run.output is no URL of an object store: expected s3://bucket/folder"]),
    (
        &["ingest.inputs=[\"az://b/../x\"]"],
        &["ingest.inputs.0 is no URL of an object store", "none called `.` or `..`"],
    ),
    #[cfg(not(feature = "cloud"))]
    (
        &["ingest.inputs=[\"s3://bucket/x.zip\"]"],
        &["ingest.inputs.0 is s3://bucket/x.zip", "built without object stores", "--features cloud"],
    ),
    #[cfg(not(feature = "cloud"))]
    (&["run.output=az://container/runs"], &["run.output is az://container/runs", "built without object stores"]),
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
