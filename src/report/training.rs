//! How a network was trained, as facts and curves.

use super::model::{Chart, Curve, Fact, TrainingSummary};
use crate::train::FitStatistics;
use std::collections::BTreeSet;

impl TrainingSummary {
    /// The curves of the training loop: the loss, and one chart for each figure of the evaluations.
    pub fn of_fit(name: impl Into<String>, facts: Vec<Fact>, statistics: &[FitStatistics]) -> Self {
        let chart = |title: &str, over: &str, points: Vec<[f64; 2]>| Chart {
            title: title.replace('_', " "),
            x_label: "training step".to_owned(),
            y_label: title.to_owned(),
            log_x: false,
            curves: vec![Curve::new(over, points)],
        };
        let loss: Vec<[f64; 2]> = statistics.iter().filter_map(|line| Some([line.step as f64, line.loss?])).collect();
        let figures: BTreeSet<&String> = statistics.iter().flat_map(|line| line.evaluation.keys()).collect();
        let of_figure = |figure: &String| -> Vec<[f64; 2]> {
            let value = |line: &FitStatistics| Some([line.step as f64, *line.evaluation.get(figure)?]);
            statistics.iter().filter_map(value).collect()
        };
        // A network that was taken over as it is has no losses.
        let mut charts: Vec<Chart> =
            (!loss.is_empty()).then(|| chart("loss", "training scenes", loss)).into_iter().collect();
        charts.extend(figures.into_iter().map(|figure| chart(figure, "held-out scenes", of_figure(figure))));
        Self { name: name.into(), facts, charts }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_figure_of_the_evaluations_has_a_chart() {
        let line = |step, loss, ade: Option<f64>| FitStatistics {
            step,
            loss,
            gradient_norm: None,
            evaluation: ade.map(|ade| ("min_scene_ade_m".to_owned(), ade)).into_iter().collect(),
        };
        let summary =
            TrainingSummary::of_fit("denoiser", vec![], &[line(10, Some(2.0), None), line(10, None, Some(0.5))]);
        let points: Vec<_> = summary.charts.iter().map(|c| (c.y_label.as_str(), c.curves[0].points.clone())).collect();
        assert_eq!(points, [("loss", vec![[10.0, 2.0]]), ("min_scene_ade_m", vec![[10.0, 0.5]])]);
        let names: Vec<&str> = summary.charts.iter().map(|chart| chart.curves[0].name.as_str()).collect();
        assert_eq!(names, ["training scenes", "held-out scenes"]);
        assert!(TrainingSummary::of_fit("taken over", vec![], &[]).charts.is_empty());
    }
}
