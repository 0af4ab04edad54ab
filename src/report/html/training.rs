//! The section on the training of networks and the quality of the classifier.

use super::plain::plain_table;
use super::{Section, facts, table};
use crate::report::model::{Chart, Curve, ReportModel};
use crate::report::number::{count, optional, percent, value};
use crate::report::svg::line_chart;
use crate::train::NoiseLevelReport;
use maud::{Markup, html};

/// Facts and curves of each network.
pub(super) fn networks(model: &ReportModel) -> Option<Section> {
    (!model.training.is_empty()).then(|| {
        let body = html! {
            @for network in &model.training {
                h3 { (network.name) }
                (facts(&network.facts))
                div class="grid" { @for chart in &network.charts { (line_chart(chart)) } }
                @for table in &network.tables { (plain_table(table)) }
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
                "The classifier sees trajectories with noise of level σ added and guides sampling from high to low \
                 noise. "
                "At high noise there is no signal; what counts is how early in sampling, at how large a σ, it becomes \
                 useful. "
                "Decisions are taken at probability 1/2; AUC is the probability that a positive pair scores higher \
                 than a negative one. "
                "The calibration error is the mean distance of probabilities from shares of positive pairs, which \
                 count as much as in training."
            }
            (quality_table(rows))
            div class="grid" { (line_chart(&quality_chart(rows))) }
        };
        Section::new("classifier", "Classifier by noise level", body)
    })
}

fn quality_table(rows: &[NoiseLevelReport]) -> Markup {
    let head = html! {
        tr {
            @for name in
                ["σ", "Positive", "Negative", "Precision", "Recall", "False alarms", "AUC", "Calibration error"]
            {
                th scope="col" class="n" { (name) }
            }
        }
    };
    let body = html! {
        @for row in rows {
            tr {
                th scope="row" class="n" { (value(row.sigma)) }
                td class="n" { (count(row.n_positive)) }
                td class="n" { (count(row.n_negative)) }
                @for share in [row.precision, row.recall, row.false_positive_rate] {
                    td class="n" { (percent(share.unwrap_or(f64::NAN))) }
                }
                td class="n" { (optional(row.auc)) }
                td class="n" { (optional(row.calibration_error)) }
            }
        }
    };
    table("Precision and recall on held-out pairs", &head, &body)
}

fn quality_chart(rows: &[NoiseLevelReport]) -> Chart {
    let curve = |name: &str, of: fn(&NoiseLevelReport) -> Option<f64>| {
        Curve::new(name, rows.iter().filter_map(|row| of(row).map(|share| [row.sigma, 100.0 * share])).collect())
    };
    Chart {
        title: "Precision, recall and AUC by noise level".to_owned(),
        x_label: "noise level σ".to_owned(),
        y_label: "%".to_owned(),
        log_x: true,
        curves: vec![
            curve("precision", |row| row.precision),
            curve("recall", |row| row.recall),
            curve("AUC", |row| row.auc),
        ],
    }
}
