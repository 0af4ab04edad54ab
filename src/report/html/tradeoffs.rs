//! The section of curves over guidance strength: yield and cost.

use super::Section;
use crate::report::model::ReportModel;
use crate::report::svg::line_chart;
use crate::report::tradeoffs::tradeoffs;
use maud::html;

pub(super) fn section(model: &ReportModel) -> Option<Section> {
    let charts = tradeoffs(&model.evaluation);
    (!charts.is_empty()).then(|| {
        let body = html! {
            p class="note" {
                "Sweeps at several guidance strengths; 0 is unguided sampling of the same scenes and agents. Whiskers \
                 are Wilson's 95 % intervals over scenarios; "
                "samples of one scene are correlated, so the true uncertainty is larger. Level lines are the \
                 recordings that the sweep continues. The cost of a verified scenario counts the failures, too."
            }
            div class="grid" { @for chart in &charts { (line_chart(chart)) } }
        };
        Section::new("tradeoffs", "Guidance strength: yield, cost", body)
    })
}
