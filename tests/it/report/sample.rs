//! A hand-made report: a cut-in on a three-lane road, with every section filled.

mod scenes;

use djinn::coverage::CoverageRow;
use djinn::evaluate::{EvaluationSummary, MiningSummary};
use djinn::generate::RequestSummary;
use djinn::ingest::IngestReport;
use djinn::rates::{Calibration, RateMethod, RateRow};
use djinn::report::{
    Chart, Curve, Distribution, Drawn, Fact, HardnessSummary, PlainSection, PlainTable, ReportModel, TrainingSummary,
    Warning,
};
use djinn::seed::Seed;
use djinn::statistics::{Estimate, Interval};
use djinn::train::NoiseLevelReport;
use serde::Deserialize;
use serde_json::Value;

pub(crate) use self::scenes::card;

/// A report with every section.
pub(crate) fn model() -> ReportModel {
    model_named("v17")
}

/// [`model`] with `name` wherever a name comes from the recordings or the configuration.
pub(crate) fn model_named(name: &str) -> ReportModel {
    let Results { evaluation, requests, mining, ingest } = results(name);
    ReportModel {
        n_continued: 3,
        hardness: Some(HardnessSummary {
            n_situations: 2,
            n_critical: Some(1),
            n_without_ttc: Some(1),
            n_careful: 0,
            n_not_preventable: 0,
        }),
        title: format!("Cut-ins at the merging highway ({name})"),
        facts: vec![
            Fact::new("Run", name),
            Fact::new("Seed", 20),
            Fact::new("Device", "cpu"),
            Fact::new("Denoiser", "small, residual parametrization, 0.6 million parameters"),
            Fact::new("Checkpoint", "9f3c0d1be2"),
            Fact::new("Recordings", "INTERACTION v1.2, 3 places"),
        ],
        warnings: vec![
            Warning {
                stage: "ingest".into(),
                message: format!("1 case of {name} was rejected as non_finite; see Recordings."),
            },
            Warning {
                stage: "evaluate".into(),
                message: "Collision rate of guided samples is more than twice that of unguided ones; lower the \
                          guidance strength."
                    .into(),
            },
        ],
        ingest: Some(ingest),
        mining: Some(mining),
        rates: rates(name),
        coverage: coverage(name),
        calibration: calibration(name),
        modeled: rates(name).into_iter().map(|row| RateRow { method: RateMethod::Modeled, ..row }).collect(),
        training: vec![training("Denoiser", 2.2), training("Classifier (cut_in)", 0.6)],
        classifier_quality: (0..12).map(quality).collect(),
        requests,
        evaluation,
        distributions: distributions(),
        scenes: vec![card(0, name, 1.0, 0.0), card(1, name, 0.6, std::f64::consts::FRAC_PI_3), scenes::gallery(name)],
        drawn: vec![Drawn {
            sweep: name.into(),
            what: "verified scenarios".into(),
            n_drawn: 12,
            n_there: 1_313,
            limit: "report.n_drawn = 12".into(),
        }],
        more: vec![more(name)],
        config: format!(
            "[run]\nname = \"{name}\"\nseed = 20\n\n[generate]\nsplit = \"val\"\n\
             sampler = {{ kind = \"heun\", n_steps = 20 }}\n"
        ),
    }
}

/// What a run writes about its results: two buckets, of which one stayed short, and a map that lacks road.
#[derive(Deserialize)]
struct Results {
    evaluation: EvaluationSummary,
    requests: Vec<RequestSummary>,
    mining: MiningSummary,
    ingest: IngestReport,
}

fn results(name: &str) -> Results {
    let mut results: Value = serde_json::from_str(include_str!("sample/results.json")).unwrap();
    rename(&mut results, name);
    serde_json::from_value(results).unwrap()
}

fn rename(value: &mut Value, name: &str) {
    match value {
        Value::String(text) => *text = text.replace("{name}", name),
        Value::Array(items) => items.iter_mut().for_each(|item| rename(item, name)),
        Value::Object(object) => {
            object.values_mut().for_each(|item| rename(item, name));
            *object =
                std::mem::take(object).into_iter().map(|(key, item)| (key.replace("{name}", name), item)).collect();
        }
        _ => {}
    }
}

fn training(name: &str, scale: f64) -> TrainingSummary {
    let curve = |name: &str, offset: f64| {
        let loss = |i| scale * (0.2 + offset + (-f64::from(i) / 12.0).exp());
        Curve::new(name, (1..60).map(|i| [f64::from(i) * 100.0, loss(i)]).collect())
    };
    let loss = |title: &str, y_label: &str| Chart {
        title: title.into(),
        x_label: "training step".into(),
        y_label: y_label.into(),
        log_x: false,
        curves: vec![curve("train", 0.0), curve("val", 0.06)],
    };
    TrainingSummary {
        name: name.into(),
        facts: vec![Fact::new("Steps", "6 000"), Fact::new("Batch size", 16), Fact::new("Parameters", "604 931")],
        charts: vec![loss("Loss", "loss"), loss("minSceneADE of 6 samples", "m")],
        tables: Vec::new(),
    }
}

fn quality(i: u32) -> NoiseLevelReport {
    let sigma = 0.002 * 2.6f64.powi(i as i32);
    let skill = 1.0 / (1.0 + sigma * sigma);
    NoiseLevelReport {
        sigma,
        n_positive: 20,
        n_negative: 600,
        precision: (i < 11).then_some(0.05 + 0.8 * skill),
        recall: Some(0.1 + 0.85 * skill),
        false_positive_rate: Some(0.02),
        accuracy: Some(0.9),
        auc: Some(0.5 + 0.48 * skill),
        calibration_error: Some(0.04),
    }
}

fn distributions() -> Vec<Distribution> {
    let mut rng = Seed(5).rng();
    let mut draw = |mean: f64, std: f64, n: usize| (0..n).map(|_| mean + std * rng.normal()).collect::<Vec<_>>();
    [("speed", "m/s", 11.9, 1.9), ("longitudinal acceleration", "m/s²", 0.0, 0.8), ("gap at intrusion", "m", 9.0, 4.0)]
        .into_iter()
        .map(|(title, unit, mean, std)| {
            let (recorded, generated) = (draw(mean, std, 4000), draw(mean - 0.3 * std, 1.2 * std, 2500));
            let groups = [("recorded", recorded.as_slice()), ("generated, α = 2", generated.as_slice())];
            Distribution::of(title, unit, "every agent at every future timestep", 40, &groups)
        })
        .collect()
}

/// A behavior that was found in several recordings, and a bucket in which it was not.
fn rates(name: &str) -> Vec<RateRow> {
    let of = |place: &str, within: &str, n_events: u64| RateRow {
        place: place.to_owned(),
        split: String::new(),
        behavior: name.to_owned(),
        within: within.to_owned(),
        n_events,
        n_recordings: 12,
        observed_h: 2.0,
        motorized_km: 500.0,
        rate_per_hour: n_events as f64 / 2.0,
        per_hour: Interval { low: 0.6 * n_events as f64, high: 2.0 + n_events as f64 },
        rate_per_1000_km: Some(2.0 * n_events as f64),
        per_1000_km: Some(Interval { low: 1.8 * n_events as f64, high: 8.0 + 2.4 * n_events as f64 }),
        dispersion: Some(2.5),
        method: if n_events > 0 { RateMethod::OverRecordings } else { RateMethod::NoneFound },
        note: (n_events == 0).then(|| "not extrapolated: fewer than 30 events to begin from".to_owned()),
    };
    vec![of("", "", 40), of("", "ttc_s 0..0.5", 0), of(name, "", 40)]
}

/// Surroundings in which a behavior is covered, missing, and never recorded, and a pair of them that is missing.
fn coverage(name: &str) -> Vec<CoverageRow> {
    let of = |tags: [Option<&str>; 2], n_recorded: u64, n_accepted: u64| CoverageRow {
        tags: tags.map(|tag| tag.and_then(|tag| tag.parse().ok())),
        behavior: name.to_owned(),
        within: String::new(),
        observed_h: 2.0,
        n_recorded,
        rate_per_hour: Some(n_recorded as f64 / 2.0),
        per_hour: Some(Interval { low: 0.4 * n_recorded as f64, high: 2.0 + n_recorded as f64 }),
        n_generated: n_accepted,
        n_accepted,
    };
    let [merge, slow, fast] = ["junction:merge", "speed:below_15_km_h", "speed:above_60_km_h"].map(Some);
    vec![
        of([None, None], 42, 7),
        of([merge, None], 42, 7),
        of([slow, None], 42, 0),
        of([fast, None], 0, 0),
        of([merge, slow], 42, 0),
    ]
}

/// Modeled rates as often as recorded ones, too often, and where too few events were recorded.
fn calibration(name: &str) -> Vec<Calibration> {
    let of = |value: f64| Estimate::new(value, Interval { low: 0.8 * value, high: 1.25 * value });
    let one = |(n_recorded, modeled): (u64, f64)| Calibration {
        place: name.to_owned(),
        behavior: name.to_owned(),
        n_recorded,
        recorded: of(10.0),
        modeled: of(modeled),
        factor: Some(of(modeled / 10.0)),
    };
    [(40, 11.0), (40, 30.0), (4, 10.0)].map(one).into()
}

fn more(name: &str) -> PlainSection {
    let mut table = PlainTable::new("How hard it was", &["Group", "Mean"]);
    table.push(vec![name.into(), "0.25".into()]);
    PlainSection {
        id: "more-of-it".into(),
        title: "More".into(),
        note: name.into(),
        tables: vec![table],
        charts: vec![],
    }
}
