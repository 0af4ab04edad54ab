//! The change of an agent's speed over time, without the noise of single timesteps.

use crate::scene::Trajectory;

/// How long after the present a smoothed trajectory still corrects the error of its observed part, seconds.
const SETTLING_S: f64 = 1.0;

/// The acceleration at every timestep, m/s² along the motion: the slope of the least-squares line through the speeds in
/// a window of at least `window_s` (and at least three timesteps) centered there. `None` if the window reaches beyond
/// the trajectory or over a timestep that is not tracked. For a smoothed trajectory also if the window holds states of
/// the second after `present`: earlier states were smoothed without later ones, and that second corrects their error.
pub(crate) fn smoothed_accelerations_mps2(
    trajectory: &Trajectory,
    present: usize,
    dt_s: f64,
    window_s: f64,
) -> Vec<Option<f64>> {
    let speeds: Vec<Option<f64>> = trajectory
        .entries()
        .iter()
        .map(|state| state.as_ref().filter(|s| s.is_finite()).map(crate::scene::State::speed_mps))
        .collect();
    let half = half_window(dt_s, window_s);
    // Σ i² over the offsets -half..=half.
    let spread = (half * (half + 1) * (2 * half + 1)) as f64 / 3.0;
    let has_seam = trajectory.derivation().is_some_and(|derivation| !derivation.recorded.is_empty());
    let settling = (SETTLING_S / dt_s).round() as usize;
    let slope = |center: usize| {
        if has_seam && center + half > present && center < present + settling + half {
            return None;
        }
        let window = speeds.get(center.checked_sub(half)?..=center + half)?;
        let weighted = window.iter().zip(0..).map(|(speed, i)| speed.map(|v| (f64::from(i) - half as f64) * v));
        weighted.sum::<Option<f64>>().map(|sum| sum / (spread * dt_s))
    };
    (0..speeds.len()).map(slope).collect()
}

/// Timesteps on either side of the center, such that the window spans at least `window_s`.
fn half_window(dt_s: f64, window_s: f64) -> usize {
    ((window_s / dt_s / 2.0 - 1e-9).ceil().max(1.0)) as usize
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::geometry::Vec2;
    use crate::scene::{Derivation, RecordedPosition, State};

    fn trajectory(speeds: &[f64]) -> Trajectory {
        let state = |v: &f64| v.is_finite().then(|| State { velocity: Vec2::new(0.0, *v), ..State::default() });
        Trajectory::new(speeds.iter().map(state).collect())
    }

    #[test]
    fn a_steady_change_has_its_own_slope() {
        let speeds: Vec<f64> = (0..7).map(|t| 10.0 - 0.4 * f64::from(t)).collect();
        let slopes = smoothed_accelerations_mps2(&trajectory(&speeds), 3, 0.1, 0.3);
        let found = slopes.iter().map(Option::is_some).collect::<Vec<_>>();
        assert_eq!(found, [false, false, true, true, true, false, false]);
        assert!(slopes.into_iter().flatten().all(|slope| (slope + 4.0).abs() < 1e-9));
    }

    #[test]
    fn a_single_outlier_is_damped_and_a_gap_ends_the_window() {
        // Weights -2..2 over Σ i² = 10: an outlier of +1 m/s two timesteps ahead adds 2 / 10 / 0.1 s = 2 m/s².
        let slopes = smoothed_accelerations_mps2(&trajectory(&[5.0, 5.0, 5.0, 5.0, 6.0, 5.0]), 3, 0.1, 0.3);
        assert!((slopes[2].expect("inside") - 2.0).abs() < 1e-9);
        let slopes =
            smoothed_accelerations_mps2(&trajectory(&[5.0, 5.0, f64::NAN, 5.0, 5.0, 5.0, 5.0, 5.0]), 3, 0.1, 0.3);
        assert_eq!(slopes.iter().filter(|slope| slope.is_some()).count(), 1);
    }

    #[test]
    fn the_step_where_a_smoothed_trajectory_begins_anew_is_no_braking() {
        // 10 m/s up to timestep 4, the present, then within a second down to 8 m/s, as Argoverse 1 has it.
        let after = [9.0, 8.4, 8.2, 8.1, 8.0, 8.0, 8.0, 8.0, 8.0, 8.0, 8.0, 8.0];
        let speeds: Vec<f64> = [10.0; 5].into_iter().chain(after).collect();
        let stepped = trajectory(&speeds);
        let steepest = |trajectory: &Trajectory| {
            let slopes = smoothed_accelerations_mps2(trajectory, 4, 0.1, 0.3);
            slopes.into_iter().flatten().fold(0.0, f64::min)
        };
        let recorded = vec![RecordedPosition { time_s: 0.0, position: Vec2::ZERO }];
        let smoothed = stepped.clone().derived(Derivation { held_headings: vec![false; 17], recorded });
        assert!(steepest(&stepped) < -4.0 && steepest(&smoothed) == 0.0);
    }

    #[test]
    fn windows_span_what_is_asked() {
        let found = (half_window(0.1, 0.3), half_window(0.1, 0.4), half_window(0.1, 0.0), half_window(0.5, 0.3));
        assert_eq!(found, (2, 2, 1, 1));
    }
}
