//! The figures that a reviewer must see first: those of generated traffic that is clearly worse than the recordings.

use crate::behavior::BehaviorEntry;
use crate::evaluate::SamplingRow;
use crate::metrics::{Group, MetricRow};

/// How far a rate of generated traffic may be above the recording's without a caution.
const RATE_MARGIN: f64 = 0.1;

/// Warnings about the aggregates over all places, sweep by sweep in the order of the rows. Sweeps that request
/// collisions, judging by `sampling`, get none for them.
pub fn cautions(aggregates: &[MetricRow], sampling: &[SamplingRow]) -> Vec<String> {
    let rows: Vec<&MetricRow> = aggregates.iter().filter(|row| row.place.is_empty()).collect();
    let mut sweeps: Vec<&str> = Vec::new();
    for row in &rows {
        if !sweeps.contains(&row.sweep.as_str()) {
            sweeps.push(&row.sweep);
        }
    }
    let asks_for_collision = |sweep: &str| {
        let behaviors = sampling.iter().filter(|row| row.sweep == sweep).map(|row| row.behavior.as_deref());
        behaviors.into_iter().any(BehaviorEntry::is_collision)
    };
    sweeps.into_iter().flat_map(|sweep| of_sweep(sweep, &rows, asks_for_collision(sweep))).collect()
}

fn of_sweep(sweep: &str, rows: &[&MetricRow], asks_for_collision: bool) -> Vec<String> {
    let of = |metric: &str| -> Vec<&MetricRow> {
        rows.iter().filter(|row| row.sweep == sweep && row.metric == metric).copied().collect()
    };
    let group = |rows: &[&MetricRow], group: Group| rows.iter().find(|row| row.group == group).map(|row| row.value);
    let mut found = Vec::new();

    let errors = of("min_scene_ade_m");
    if let (Some(own), Some(baseline)) = (group(&errors, Group::Unguided), group(&errors, Group::ConstantVelocity))
        && own >= baseline
    {
        found.push(format!(
            "Sweep {sweep}: unguided samples are no closer to the recording than a constant velocity (minSceneADE \
             {own:.3} m against {baseline:.3} m). Train the denoiser longer, or on more scenes like these."
        ));
    }
    for (metric, what) in [
        ("collision_rate", "of samples contain a collision"),
        ("offroad_rate", "of vehicles leave the road"),
        ("acceleration_violation_rate", "of vehicles break the acceleration limit"),
    ] {
        if asks_for_collision && metric == "collision_rate" {
            continue;
        }
        let rates = of(metric);
        let Some(recorded) = group(&rates, Group::Recorded) else { continue };
        let generated = rates.iter().filter(|row| row.group.is_generated());
        let worst = generated.max_by(|a, b| a.value.total_cmp(&b.value));
        if let Some(worst) = worst.filter(|row| row.value > recorded + RATE_MARGIN) {
            found.push(format!(
                "Sweep {sweep}: at {}, {:.0} % {what}; in the recording {:.0} %.",
                worst.level,
                100.0 * worst.value,
                100.0 * recorded
            ));
        }
    }
    let rates = of("behavior_rate");
    if let Some(unguided) = group(&rates, Group::Unguided) {
        let guided = rates.iter().filter(|row| matches!(row.group, Group::Sweep(_)));
        for row in guided.filter(|row| row.value <= unguided) {
            found.push(format!(
                "Sweep {sweep}: guidance at {} does not raise the rate of the behavior ({:.1} % against {:.1} % \
                 unguided).",
                row.level,
                100.0 * row.value,
                100.0 * unguided
            ));
        }
    }
    found
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::scene::GuidanceLevel;

    fn row(group: &str, strength: f64, metric: &str, value: f64) -> MetricRow {
        MetricRow {
            group: group.to_owned().into(),
            level: GuidanceLevel::of_strength(strength),
            n: 16,
            ..MetricRow::example(metric, value)
        }
    }

    #[test]
    fn good_figures_need_no_words_and_bad_ones_name_sweep_and_values() {
        let figures = |ade: f64, collisions: f64, guided: f64| {
            [
                row("recorded", 0.0, "collision_rate", 0.02),
                row("constant_velocity", 0.0, "collision_rate", 0.9),
                row("unguided", 0.0, "collision_rate", 0.05),
                row("cut_ins", 30.0, "collision_rate", collisions),
                row("constant_velocity", 0.0, "min_scene_ade_m", 0.5),
                row("unguided", 0.0, "min_scene_ade_m", ade),
                row("unguided", 0.0, "behavior_rate", 0.1),
                row("cut_ins", 30.0, "behavior_rate", guided),
            ]
        };
        assert!(cautions(&figures(0.4, 0.1, 0.3), &[]).is_empty());
        let found = cautions(&figures(0.6, 0.4, 0.1), &[]);
        assert_eq!(found.len(), 3, "{found:?}");
        assert!(found[0].contains("0.600 m against 0.500 m"));
        assert!(found[1].contains("at α = 30, 40 %") && found[1].contains("in the recording 2 %"));
        assert!(found[2].contains("10.0 % against 10.0 %"));
    }

    #[test]
    fn collisions_that_were_asked_for_need_no_words() {
        let figures = [row("recorded", 0.0, "collision_rate", 0.02), row("cut_ins", 30.0, "collision_rate", 0.6)];
        let asking = |behavior: &str| SamplingRow {
            behavior: Some(behavior.to_owned()),
            place: String::new(),
            sampler: String::new(),
            n_scenes: 1,
            n_scenarios: 1,
            n_collision: 0,
            n_evaluations: 1,
            ..SamplingRow::example(30.0, 0)
        };
        assert_eq!(cautions(&figures, &[asking("cut_in")]).len(), 1);
        assert!(cautions(&figures, &[asking("collision")]).is_empty());
    }

    #[test]
    fn single_places_are_left_to_the_tables() {
        let mut of_a_place = row("unguided", 0.0, "min_scene_ade_m", 9.0);
        let mut baseline = row("constant_velocity", 0.0, "min_scene_ade_m", 1.0);
        of_a_place.place = "A".to_owned();
        baseline.place = "A".to_owned();
        assert!(cautions(&[of_a_place, baseline], &[]).is_empty());
    }
}
