//! Braking distances and cut-ins worked out by hand.

use super::braking::Braking;
use super::*;
use crate::behavior::testing::SceneSpec;
use crate::metrics::{Metric, SampleGroup};
use crate::scene::Roles;

fn near(found: f64, expected: f64) -> bool {
    (found - expected).abs() < 1e-9
}

#[test]
fn braking_grows_stays_and_ends() {
    let at = |speed_mps, from_s| Braking { speed_mps, from_s, ramp_s: 0.5, max_deceleration_mps2: 8.0 };
    // From 10 m/s at 1 s: the ramp takes 2 m/s and ends at 15 - 8 · 0.5² / 6 m; 8 m/s at 8 m/s² are 1 s and 4 m.
    let braking = at(10.0, Some(1.0));
    assert!(near(braking.driven_m(1.0), 10.0) && near(braking.speed_mps(1.5), 8.0));
    assert!(near(braking.driven_m(1.5), 15.0 - 1.0 / 3.0) && near(braking.speed_mps(2.0), 4.0));
    assert!(near(braking.stands_from_s().expect("stands"), 2.5) && near(braking.driven_m(9.0), 19.0 - 1.0 / 3.0));
    assert_eq!(braking.speed_mps(2.5), 0.0);
    // From 1 m/s it stands while the deceleration grows: 8 t² = 1 m/s.
    let braking = at(1.0, Some(1.0));
    let t = 0.125_f64.sqrt();
    assert!(near(braking.stands_from_s().expect("stands"), 1.0 + t));
    assert!(near(braking.driven_m(5.0), 1.0 + t - 8.0 * t.powi(3) / 3.0));
    let steady = at(10.0, None);
    assert!(near(steady.driven_m(3.0), 30.0) && steady.stands_from_s().is_none());
}

/// The ego at 20 m/s, the other at 10 m/s in the lane to the left, `gap_m` between bumpers at the present (0.9 s), when
/// the other starts to move over by `shift_m` within a second.
fn cut_in(gap_m: f64, y_m: f64, shift_m: f64) -> Scene {
    let spec: SceneSpec = toml::from_str(&format!(
        "agents = [
            {{ id = \"ego\", start = {{ x_m = 0, y_m = 0, speed_mps = 20 }} }},
            {{ id = \"other\", start = {{ x_m = {:?}, y_m = {y_m:?}, speed_mps = 10 }},
               segments = [{{ duration_s = 0.9 }}, {{ duration_s = 1, shift_m = {shift_m:?} }}] }},
        ]",
        gap_m + 4.5 + 9.0
    ))
    .expect("valid");
    spec.build("cut-in")
}

fn judged(scene: &Scene) -> Option<CutInJudgment> {
    CutInJudgment::of(scene, [0, 1])
}

#[test]
fn a_cut_in_is_preventable_down_to_the_distance_that_braking_takes() {
    // After 0.3 s the other has moved by 0.52 m (after 0.2 s by 0.17 m), which is seen 0.4 s later. By then the gap is
    // at most 20 m, two seconds at 10 m/s, and 0.75 s later, 1.45 s after the present, the driver brakes. Until then
    // the gap shrinks by 14.5 m. While the brake builds up another 10 · 0.6 - 7.593 · 0.6² / 6 = 5.544 m, with 7.722
    // m/s left, and then 7.722² / (2 · 7.593) = 3.927 m.
    let least_m = 14.5 + 5.5444 + 3.9268;
    let enough = judged(&cut_in(least_m + 0.1, 3.5, -3.5)).expect("comes into the lane");
    assert!(enough.preventable && near(enough.braking_from_s.expect("brakes"), 1.45), "{enough:?}");
    let short = judged(&cut_in(least_m - 0.1, 3.5, -3.5)).expect("comes into the lane");
    assert!(!short.preventable && near(short.braking_from_s.expect("brakes"), 1.45), "{short:?}");
    // Farther ahead the danger comes later: 35 m shrink to 20 m in 1.5 s.
    let far = judged(&cut_in(35.0, 3.5, -3.5)).expect("comes into the lane");
    assert!(far.preventable && near(far.braking_from_s.expect("brakes"), 2.25), "{far:?}");
}

#[test]
fn the_simple_bound_is_on_the_time_to_collision_at_the_intrusion() {
    // 2 m beside the path, its flank at 1.1 m, it is in the lane already. 10 m/s: 10 / 12 + 0.35 = 1.183 s, 11.83 m.
    let required = |gap_m: f64| judged(&cut_in(gap_m, 2.0, 0.0)).expect("is in the lane");
    assert_eq!(required(12.0).avoidance_required, Some(true));
    assert_eq!(required(11.7).avoidance_required, Some(false));
    assert!(near(required(12.0).intrusion_ttc_s.expect("closes"), 1.2));
    assert_eq!((required(-1.0).avoidance_required, required(-1.0).intrusion_ttc_s), (None, None));
    // It never moves sideways, so nothing is seen, and 0.2 m lie between the two.
    assert_eq!((required(12.0).preventable, required(12.0).braking_from_s), (true, None));
}

#[test]
fn who_stays_in_its_lane_does_not_cut_in() {
    assert_eq!(judged(&cut_in(20.0, 3.5, -0.5)), None);
    assert_eq!(judged(&cut_in(20.0, 3.5, 1.0)), None);
    let scene = cut_in(20.0, 3.5, -3.5);
    assert_eq!(CutInJudgment::of(&scene, [0, 2]), None);
}

#[test]
fn the_rate_is_over_samples_that_cut_in() {
    let samples = [cut_in(40.0, 3.5, -3.5), cut_in(12.0, 3.5, -3.5), cut_in(40.0, 3.5, 0.0)];
    let asked = Roles::from([("ego", "ego"), ("other", "other")]);
    let group = SampleGroup { asked: &asked, ..SampleGroup::equally_likely(&samples[0], &samples) };
    assert_eq!(PreventableRate.evaluate(&group), Some(0.5));
    assert_eq!(PreventableRate.evaluate(&SampleGroup { samples: &samples[2..], ..group }), None);
    assert_eq!(PreventableRate.evaluate(&SampleGroup { asked: Roles::none(), ..group }), None);
    let cut_off = Scene { n_timesteps: samples[0].n_history, ..samples[0].clone() };
    assert_eq!(PreventableRate.evaluate(&SampleGroup { recorded: &cut_off, ..group }), None, "a test split");
}
