//! The training of a network as facts, curves and tables.

use super::model::{Chart, Curve, Fact, TrainingSummary};
use super::number::{count, value};
use super::plain::PlainTable;
use crate::model::{ChangedLoss, PlaceLoss, SceneChange};
use crate::train::{FitStatistics, SCENE_ERROR};
use std::collections::BTreeMap;

/// The prefix of held-out losses, before the noise level and any change of the scenes.
const HELD_OUT_LOSS: &str = "held_out_loss_at_sigma_";

impl TrainingSummary {
    /// The curves of the training loop: the loss, and charts of the evaluations. Held-out losses of all noise levels
    /// share one chart, and so do those of changed scenes.
    pub fn of_fit(name: impl Into<String>, facts: Vec<Fact>, statistics: &[FitStatistics]) -> Self {
        let loss: Vec<[f64; 2]> = statistics.iter().filter_map(|line| Some([line.step as f64, line.loss?])).collect();
        let mut charts: BTreeMap<String, Vec<Curve>> = BTreeMap::new();
        let figures: std::collections::BTreeSet<&String> =
            statistics.iter().flat_map(|line| line.evaluation.keys()).collect();
        let is_changed =
            |sigma: &str| figures.iter().any(|figure| figure.starts_with(&format!("{HELD_OUT_LOSS}{sigma}_")));
        for figure in &figures {
            let value = |line: &FitStatistics| Some([line.step as f64, *line.evaluation.get(*figure)?]);
            let points: Vec<[f64; 2]> = statistics.iter().filter_map(value).collect();
            let mut add = |title: String, curve: String| {
                charts.entry(title).or_default().push(Curve::new(curve, points.clone()));
            };
            match figure.strip_prefix(HELD_OUT_LOSS).map(|rest| rest.split_once('_').ok_or(rest)) {
                None => add(figure.replace('_', " "), "held-out scenes".to_owned()),
                Some(Err(sigma)) => {
                    add("held-out loss".to_owned(), format!("σ = {sigma}"));
                    if is_changed(sigma) {
                        add(changed_title(sigma), words(SceneChange::AsRecorded.name()));
                    }
                }
                Some(Ok((sigma, change))) => add(changed_title(sigma), words(change)),
            }
        }
        let chart = |title: &str, curves: Vec<Curve>| Chart {
            title: title.to_owned(),
            x_label: "training step".to_owned(),
            y_label: if title.contains("loss") { "loss" } else { title }.to_owned(),
            log_x: false,
            curves,
        };
        // A network from an existing checkpoint has no losses.
        let training = (!loss.is_empty()).then(|| chart("loss", vec![Curve::new("training scenes", loss)]));
        let charts = training.into_iter().chain(charts.into_iter().map(|(title, curves)| chart(&title, curves)));
        let tables = by_minute(statistics);
        Self { name: name.into(), facts, charts: charts.collect(), tables: tables.into_iter().collect() }
    }

    /// Adds the held-out losses stored in a denoiser's checkpoint.
    #[must_use]
    pub fn with_losses(mut self, changed: &[ChangedLoss], by_place: &[PlaceLoss]) -> Self {
        let mut table = PlainTable::new(
            "Held-out loss by input of the denoiser, relative to unchanged scenes; the further from 1, the more it \
             uses the changed input",
            &["Scenes", "σ", "Loss", "Of that compared with"],
        );
        for ChangedLoss { change, sigma, loss } in changed {
            // Without neighbors, only the ego can be scored.
            let compared =
                if *change == SceneChange::EgoAlone { SceneChange::EgoOnly } else { SceneChange::AsRecorded };
            let is_compared = |other: &&ChangedLoss| other.change == compared && other.sigma == *sigma;
            let ratio = changed.iter().find(is_compared).map_or(f64::NAN, |other| loss / other.loss);
            table.push(vec![words(change.name()), value(*sigma), value(*loss), value(ratio)]);
        }
        let mut places =
            PlainTable::new("Held-out loss by place", &["Place", "Scenes", "σ", "Loss", "With the map turned"]);
        for PlaceLoss { place, n_scenes, sigma, loss, map_turned } in by_place {
            places.push(vec![place.clone(), count(*n_scenes), value(*sigma), value(*loss), value(*map_turned)]);
        }
        self.tables.extend([table, places].into_iter().filter(|table| !table.rows.is_empty()));
        self
    }
}

/// What was won by each minute of a training that was given time; `None` for others.
fn by_minute(statistics: &[FitStatistics]) -> Option<PlainTable> {
    let evaluated: Vec<[f64; 3]> = (statistics.iter())
        .filter_map(|line| Some([line.minutes?, line.step as f64, *line.evaluation.get(SCENE_ERROR)?]))
        .collect();
    let mut table = PlainTable::new(
        "What each minute of training won on held-out scenes",
        &["Minutes", "Steps", "minSceneADE (m)", "Less by each minute (m)"],
    );
    for (i, [minutes, step, error_m]) in evaluated.iter().enumerate() {
        let won = i.checked_sub(1).and_then(|before| evaluated.get(before)).map_or_else(
            || "–".to_owned(),
            |[earlier, _, before_m]| format!("{:.4}", (before_m - error_m) / (minutes - earlier)),
        );
        table.push(vec![format!("{minutes:.1}"), count(*step as u64), value(*error_m), won]);
    }
    (!evaluated.is_empty()).then_some(table)
}

fn changed_title(sigma: &str) -> String {
    format!("held-out loss at σ = {sigma} of changed scenes")
}

/// A change of scenes in words.
fn words(change: &str) -> String {
    match change {
        "map_turned" => "map turned by 90°",
        "map_shifted" => "map shifted by 4 m",
        "ego_only" => "as recorded, loss of the ego alone",
        "ego_alone" => "without neighbors, loss of the ego alone",
        other => return other.replace('_', " "),
    }
    .to_owned()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_figure_of_the_evaluations_has_a_curve() {
        let line = |step, loss, evaluation: &[(&str, f64)]| FitStatistics {
            step,
            loss,
            gradient_norm: None,
            evaluation: evaluation.iter().map(|(name, value)| ((*name).to_owned(), *value)).collect(),
            minutes: None,
            planned: None,
        };
        let figures = [
            ("held_out_loss_at_sigma_0.2", 0.1),
            ("held_out_loss_at_sigma_0.8", 0.3),
            ("held_out_loss_at_sigma_0.8_map_turned", 0.6),
            ("min_scene_ade_m", 0.5),
        ];
        let summary =
            TrainingSummary::of_fit("denoiser", vec![], &[line(10, Some(2.0), &[]), line(10, None, &figures)]);
        let drawn: Vec<(&str, Vec<(&str, f64)>)> = (summary.charts.iter())
            .map(|c| (c.title.as_str(), c.curves.iter().map(|c| (c.name.as_str(), c.points[0][1])).collect()))
            .collect();
        assert_eq!(
            drawn,
            [
                ("loss", vec![("training scenes", 2.0)]),
                ("held-out loss", vec![("σ = 0.2", 0.1), ("σ = 0.8", 0.3)]),
                ("held-out loss at σ = 0.8 of changed scenes", vec![("as recorded", 0.3), ("map turned by 90°", 0.6)]),
                ("min scene ade m", vec![("held-out scenes", 0.5)]),
            ]
        );
        assert!(TrainingSummary::of_fit("taken over", vec![], &[]).charts.is_empty());
    }

    #[test]
    fn losses_stand_beside_those_that_they_are_compared_with() {
        let loss = |change, loss| ChangedLoss { change, sigma: 0.8, loss };
        let changed = [
            loss(SceneChange::AsRecorded, 0.2),
            loss(SceneChange::MapTurned, 0.5),
            loss(SceneChange::EgoOnly, 0.1),
            loss(SceneChange::EgoAlone, 0.4),
        ];
        let summary = TrainingSummary::of_fit("denoiser", vec![], &[]).with_losses(&changed, &[]);
        let last: Vec<&str> = summary.tables[0].rows.iter().map(|row| row.cells[3].as_str()).collect();
        assert_eq!((summary.tables.len(), last), (1, vec!["1.00", "2.50", "0.500", "4.00"]));
    }
}
