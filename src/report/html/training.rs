//! How were the networks trained, and how good is the classifier?

use super::{Section, facts, table};
use crate::report::model::{Chart, Curve, NoiseLevelQuality, ReportModel};
use crate::report::number::{count, percent, value};
use crate::report::svg::line_chart;
use maud::{Markup, html};

/// Facts and curves of each network.
pub(super) fn networks(model: &ReportModel) -> Option<Section> {
    (!model.training.is_empty()).then(|| {
        let body = html! {
            @for network in &model.training {
                h3 { (network.name) }
                (facts(&network.facts))
                div class="grid" { @for chart in &network.charts { (line_chart(chart)) } }
            }
        };
        Section::new("training", "Training", body)
    })
}

/// Precision and recall by noise level.
pub(super) fn classifier(model: &ReportModel) -> Option<Section> {
    let rows = &model.classifier_quality;
    (!rows.is_empty()).then(|| {
        let body = html! {
            p class="note" {
                "The classifier sees trajectories with noise of level σ added and guides sampling from great noise to small. "
                "At great noise nothing can be told; what counts is how early in sampling, that is at how large a σ, it becomes useful."
            }
            (quality_table(rows))
            div class="grid" { (line_chart(&quality_chart(rows))) }
        };
        Section::new("classifier", "Classifier by noise level", body)
    })
}

fn quality_table(rows: &[NoiseLevelQuality]) -> Markup {
    let head = html! {
        tr { th scope="col" class="n" { "σ" } th scope="col" class="n" { "Examples" } th scope="col" class="n" { "Positive" }
            th scope="col" class="n" { "Precision" } th scope="col" class="n" { "Recall" } }
    };
    let body = html! {
        @for row in rows {
            tr { th scope="row" class="n" { (value(row.sigma)) } td class="n" { (count(row.n)) } td class="n" { (count(row.n_positive)) }
                td class="n" { (percent(row.precision.unwrap_or(f64::NAN))) } td class="n" { (percent(row.recall.unwrap_or(f64::NAN))) } }
        }
    };
    table("Precision and recall on held-out pairs", &head, &body)
}

fn quality_chart(rows: &[NoiseLevelQuality]) -> Chart {
    let curve = |name: &str, of: fn(&NoiseLevelQuality) -> Option<f64>| Curve {
        name: name.to_owned(),
        points: rows.iter().filter_map(|row| of(row).map(|share| [row.sigma, 100.0 * share])).collect(),
    };
    Chart {
        title: "Precision and recall by noise level".to_owned(),
        x_label: "noise level σ".to_owned(),
        y_label: "%".to_owned(),
        log_x: true,
        curves: vec![curve("precision", |row| row.precision), curve("recall", |row| row.recall)],
    }
}
