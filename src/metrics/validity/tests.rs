//! Every check by itself, with values known beforehand.

use super::*;
use crate::behavior::testing::SceneSpec;
use crate::geometry::Vec2;
use crate::scene::{AgentClass, Dataset, Roles, State, Track, TrackRole, Trajectory};

const ROAD: &str = "lanes = [{ id = 1, centerline = [[-60, 0], [300, 0]], width_m = 4.0 }]";

/// A car on a straight road of 4 m that starts at (0, 0) along x, and moves through the given `segments`.
fn scene(speed_mps: f64, segments: &str) -> Scene {
    built(&format!(
        "{{ id = \"a\", start = {{ x_m = 0, y_m = 0, speed_mps = {speed_mps:?} }}, segments = [{segments}] }}"
    ))
}

fn built(agents: &str) -> Scene {
    let spec: SceneSpec = toml::from_str(&format!("agents = [{agents}]\n{ROAD}")).expect("valid");
    spec.build("judged")
}

/// The scene with the states of its first agent changed.
fn changed(mut scene: Scene, change: impl Fn(usize, State) -> State) -> Scene {
    let entries = scene.tracks[0].trajectory.entries().iter().enumerate();
    let states = entries.map(|(timestep, state)| state.map(|state| change(timestep, state))).collect();
    scene.tracks[0].trajectory = Trajectory::new(states);
    scene
}

fn found(scene: &Scene, config: &ValidityConfig) -> Vec<Violation> {
    Judged::future_of(scene, Roles::none()).violations(config)
}

fn checks(scene: &Scene, config: &ValidityConfig) -> Vec<&'static str> {
    found(scene, config).iter().map(|violation| violation.check.name()).collect()
}

fn only(scene: &Scene, config: &ValidityConfig) -> (Check, f64, usize) {
    match &found(scene, config)[..] {
        [Violation { check, value, timestep, .. }] => (*check, *value, *timestep),
        other => panic!("one violation expected: {other:?}"),
    }
}

fn defaults() -> ValidityConfig {
    ValidityConfig::default()
}

#[test]
fn names_are_those_of_configurations() {
    for check in Check::ALL {
        assert_eq!(serde_json::to_value(check).expect("a name"), check.name());
        assert_eq!(Check::from_name(check.name()), Some(check));
    }
    assert!(Check::ALL.is_sorted() && Check::from_name("none").is_none());
}

#[test]
fn ordinary_driving_is_valid() {
    for segments in [
        "",
        "{ duration_s = 1.2 }, { duration_s = 2, acceleration_mps2 = -4.0 }",
        "{ duration_s = 1.0 }, { duration_s = 3, shift_m = 1.5 }",
    ] {
        assert_eq!(checks(&scene(12.0, segments), &defaults()), [""; 0], "{segments}");
    }
    assert_eq!(checks(&scene(0.0, ""), &defaults()), [""; 0]);
}

#[test]
fn accelerations_have_a_sign() {
    let hard = |acceleration: f64| {
        scene(15.0, &format!("{{ duration_s = 1.5 }}, {{ duration_s = 1.5, acceleration_mps2 = {acceleration:?} }}"))
    };
    let (check, value, _) = only(&hard(6.0), &defaults());
    assert!(check == Check::Acceleration && (value - 6.0).abs() < 0.01, "{value}");
    assert_eq!(checks(&hard(-6.0), &defaults()), [""; 0]);
    let (check, value, timestep) = only(&hard(-6.0), &ValidityConfig { max_deceleration_mps2: 5.0, ..defaults() });
    // Seven states between 1.5 and 3.0 s see nothing else.
    assert!(check == Check::Deceleration && (value - 6.0).abs() < 0.01 && (15..30).contains(&timestep), "{value}");
    assert_eq!(checks(&hard(-12.0), &defaults()), ["deceleration", "jerk"]);
}

#[test]
fn a_step_in_acceleration_is_a_jerk() {
    // By hand: the cubic fitted to seven positions of a step of size a in the middle has a third derivative of 10 a / 3
    // per second.
    let braking = scene(15.0, "{ duration_s = 1.5 }, { duration_s = 2.5, acceleration_mps2 = -6.0 }");
    let (check, value, timestep) = only(&braking, &ValidityConfig { max_jerk_mps3: 15.0, ..defaults() });
    assert!(check == Check::Jerk && (value - 20.0).abs() < 0.5 && timestep == 15, "{value} at {timestep}");
}

#[test]
fn bends_are_limited_by_grip_yaw_rate_and_steering() {
    let turning = |speed: f64, degrees: f64| {
        scene(speed, &format!("{{ duration_s = 1 }}, {{ duration_s = 2, turn_deg = {degrees:?} }}"))
    };
    let others = vec![Check::Jerk, Check::Heading, Check::Offroad, Check::StartAcceleration];
    let loose = ValidityConfig { skip: others, ..defaults() };
    // 90 degrees in 2 s are 0.785 rad/s: 10 m/s² across at 12.7 m/s.
    let (check, value, _) = only(&turning(12.7324, 90.0), &loose);
    assert!(check == Check::LateralAcceleration && (value - 10.0).abs() < 0.3, "{value}");
    // 160 degrees in 2 s at 5 m/s: 1.396 rad/s, and 7 m/s² across.
    let (check, value, _) = only(&turning(5.0, 160.0), &loose);
    assert!(check == Check::YawRate && (value - 1.396).abs() < 1e-3, "{value}");
    // 100 degrees in 2 s at 2 m/s: 0.873 rad/s, with 0.3 · 2 + 0.2 allowed.
    let slow = turning(2.0, 100.0);
    let (check, value, _) = only(&slow, &loose);
    assert!(check == Check::Curvature && (value - 0.873).abs() < 1e-3, "{value}");
    assert_eq!(checks(&slow, &ValidityConfig { max_curvature_per_m: 0.4, ..loose.clone() }), [""; 0]);
    // Turning on the spot.
    let spinning = changed(scene(0.0, ""), |timestep, state| State { heading_rad: 0.03 * timestep as f64, ..state });
    let (check, value, _) = only(&spinning, &loose);
    assert!(check == Check::Curvature && (value - 0.3).abs() < 1e-9);
}

#[test]
fn vehicles_point_where_they_go() {
    let drifting = |speed: f64, from: usize| {
        changed(scene(speed, ""), |timestep, state| State {
            heading_rad: if timestep < from { 0.04 } else { 0.14 },
            ..state
        })
    };
    // By 0.1 more than in the ten observed states.
    let (check, value, timestep) = only(&drifting(10.0, 20), &defaults());
    assert!(check == Check::Heading && (value - 0.1).abs() < 1e-9 && timestep >= 20, "{value} at {timestep}");
    assert_eq!(checks(&drifting(1.5, 20), &defaults()), [""; 0], "slow maneuvers may go any way");
    assert_eq!(checks(&drifting(10.0, 0), &defaults()), [""; 0], "headings were recorded that far off");
}

#[test]
fn who_turns_about_the_rear_axle_does_not_slide() {
    // The center of a car, 1.5 m ahead of its rear axle on a circle of 10 m, moves at atan(1.5 / 10) to the heading.
    let (radius_m, axle_m, speed_mps) = (10.0, 1.5, 4.0);
    let turning = |side: f64| {
        let mut scene = scene(speed_mps, "");
        for timestep in 0..scene.n_timesteps {
            let angle = speed_mps / radius_m * 0.1 * (timestep as f64 - 9.0);
            let heading_rad = side * angle.max(0.0);
            let axle = match angle > 0.0 {
                true => Vec2::new(angle.sin(), side * (1.0 - angle.cos())) * radius_m,
                false => Vec2::new(angle * radius_m, 0.0),
            };
            let position = axle + Vec2::from_angle(heading_rad) * axle_m;
            scene = changed(scene, |at, state| match at == timestep {
                true => State { position, heading_rad, ..state },
                false => state,
            });
        }
        scene
    };
    let config =
        ValidityConfig { skip: vec![Check::Offroad, Check::StartAcceleration, Check::StartPosition], ..defaults() };
    for side in [1.0, -1.0] {
        assert_eq!(checks(&turning(side), &config), [""; 0]);
        // The motion unchanged, with headings along it turned the other way.
        let wrong = changed(turning(side), |_, state| State { heading_rad: -state.heading_rad, ..state });
        assert!(checks(&wrong, &config).contains(&"heading"));
    }
}

#[test]
fn the_future_begins_where_the_past_ends() {
    let shifted = |by_m: f64| {
        changed(scene(10.0, ""), |timestep, state| match timestep < 10 {
            true => state,
            false => State { position: state.position + Vec2::new(0.0, by_m), ..state },
        })
    };
    let others = vec![Check::Jerk, Check::LateralAcceleration, Check::Heading, Check::StartAcceleration];
    let violation = &found(&shifted(0.5), &ValidityConfig { skip: others, ..defaults() });
    let seams: Vec<_> = violation.iter().map(|v| (v.check, v.timestep)).collect();
    assert_eq!(seams, [(Check::StartPosition, 10)], "{violation:?}");
    assert!((violation[0].value - 0.5).abs() < 1e-9);
    assert!(!checks(&shifted(0.2), &defaults()).contains(&"start_position"));
    let turned = changed(scene(1.0, ""), |timestep, state| State {
        heading_rad: if timestep < 10 { 0.0 } else { 0.25 },
        ..state
    });
    assert!(found(&turned, &defaults()).iter().any(|v| v.check == Check::StartHeading && v.timestep == 10));
    // With an observed end and a generated middle there are two seams.
    let end_given = shifted(0.5);
    let judged = Judged::new(&end_given, Roles::none(), |_, timestep| (12..20).contains(&timestep));
    assert!(!judged.violations(&defaults()).iter().any(|v| v.check == Check::StartPosition), "the jump was given");
    let leap = changed(scene(10.0, ""), |timestep, state| match (12..20).contains(&timestep) {
        true => State { position: state.position + Vec2::new(0.0, 0.5), ..state },
        false => state,
    });
    let judged = Judged::new(&leap, Roles::none(), |_, timestep| (12..20).contains(&timestep));
    assert!(judged.violations(&defaults()).iter().any(|v| v.check == Check::StartPosition && v.timestep == 12));
}

#[test]
fn acceleration_does_not_change_at_once_where_motion_begins_to_be_generated() {
    // Braking begins with the first generated state, after a past that drives on steadily or shakes.
    let start = |braking_mps2: f64, shake_m: f64| {
        let braking = changed(scene(10.0, ""), |timestep, state| {
            let since_s = 0.1 * (timestep as f64 - 9.0).max(0.0);
            let shake = if timestep % 2 == 0 { shake_m } else { 0.0 };
            State { position: state.position - Vec2::new(braking_mps2 * since_s * since_s / 2.0 + shake, 0.0), ..state }
        });
        let found = found(&braking, &defaults());
        found.into_iter().find(|violation| violation.check == Check::StartAcceleration)
    };
    let violation = start(3.0, 0.0).expect("3 m/s² at once");
    assert!((violation.value - 3.0).abs() < 1e-6 && violation.timestep == 10, "{violation:?}");
    assert_eq!(start(1.5, 0.0), None);
    assert_eq!(start(3.0, 0.02), None, "steps of 8 m/s² are ordinary in this recording");
}

#[test]
fn only_what_was_generated_is_judged() {
    // Braking until 0.6 s; the first window with a future state begins at 0.4 s.
    let before = scene(15.0, "{ duration_s = 0.4, acceleration_mps2 = -12.0 }");
    assert_eq!(checks(&before, &ValidityConfig { max_jerk_mps3: 60.0, ..defaults() }), [""; 0]);
    let all = Judged::new(&before, Roles::none(), |_, _| true);
    assert!(all.violations(&defaults()).iter().any(|v| v.check == Check::Deceleration));
    let none = Judged::new(&before, Roles::none(), |_, _| false);
    assert_eq!(none.violations(&ValidityConfig { max_deceleration_mps2: 0.0, ..defaults() }), []);
}

#[test]
fn collisions_are_excused_only_where_they_were_asked_for() {
    // The second one closes 15.5 m at 10 m/s: contact after 1.55 s.
    let crash = built(
        "{ id = \"a\", start = { x_m = 20, y_m = 0, speed_mps = 5 } }, { id = \"b\", start = { x_m = 0, y_m = 0, \
         speed_mps = 15 } }",
    );
    let (check, value, timestep) = only(&crash, &defaults());
    assert!(check == Check::Collision && (value - 10.0).abs() < 1e-9 && timestep == 16, "{value} {timestep}");
    let asked = Roles::from([("ego", "b"), ("other", "a")]);
    let excusing = ValidityConfig { asked_may_collide: true, ..defaults() };
    assert_eq!(Judged::future_of(&crash, &asked).violations(&excusing), []);
    assert_eq!(Judged::future_of(&crash, &asked).violations(&defaults()).len(), 1);
    assert_eq!(Judged::future_of(&crash, &asked).excused_if(true).violations(&defaults()), []);
    assert_eq!(Judged::future_of(&crash, &asked).excused_if(false).violations(&defaults()).len(), 1);
    assert_eq!(Judged::future_of(&crash, &[("ego", "b")].into()).violations(&excusing).len(), 1);
}

#[test]
fn who_has_no_known_size_collides_as_the_smallest_of_its_kind_would() {
    // Two side by side, at 10 and 15 m/s, with this distance between centers: boxes of 1.9 m would overlap when one
    // passes.
    let passing = |distance_m: f64, agents: [(AgentClass, TrackRole); 2]| {
        let mut scene = built(&format!(
            "{{ id = \"a\", start = {{ x_m = 15, y_m = 0, speed_mps = 10 }} }}, {{ id = \"b\", start = {{ x_m = 0, \
             y_m = {distance_m:?}, speed_mps = 15 }} }}"
        ));
        for (track, (class, role)) in scene.tracks.iter_mut().zip(agents) {
            *track = Track { class, role, extent: None, ..track.clone() };
        }
        checks(&scene, &defaults()).contains(&"collision")
    };
    let (car, unknown) = ((AgentClass::Vehicle, TrackRole::Context), (AgentClass::Unknown, TrackRole::Context));
    assert!(passing(1.45, [car, car]) && !passing(1.55, [car, car]));
    assert!(passing(0.25, [unknown, unknown]) && !passing(0.35, [unknown, unknown]));
    for role in [TrackRole::Focal, TrackRole::Recorder] {
        let vehicle = (AgentClass::Unknown, role);
        assert!(passing(0.85, [vehicle, unknown]) && !passing(0.95, [vehicle, unknown]), "{role:?}");
    }
    let mut of_known_size = built(
        "{ id = \"a\", start = { x_m = 15, y_m = 0, speed_mps = 10 } }, { id = \"b\", start = { x_m = 0, y_m = 1.55, \
         speed_mps = 15 } }",
    );
    of_known_size.tracks.iter_mut().for_each(|track| track.extent = Some(AgentClass::Vehicle.nominal_extent()));
    assert_eq!(checks(&of_known_size, &defaults()), ["collision"]);
}

#[test]
fn nothing_is_claimed_of_two_tracks_that_may_be_of_one_vehicle() {
    // One comes up from behind, 1 m/s faster, from this distance at present, after 0.9 s.
    let catching_up = |present_m: f64| {
        let start_m = present_m + 0.9;
        let mut scene = built(&format!(
            "{{ id = \"a\", start = {{ x_m = {start_m:?}, y_m = 0, speed_mps = 10 }} }}, {{ id = \"b\", \
             start = {{ x_m = 0, y_m = 0.1, speed_mps = 11 }} }}"
        ));
        scene.tracks.iter_mut().for_each(|track| (track.class, track.extent) = (AgentClass::Unknown, None));
        checks(&scene, &defaults())
    };
    // A usual car is 4.6 m long: from its middle to its end are 2.3 m, to the end of 0.3 m there 2.45 m.
    assert_eq!(catching_up(2.4), [""; 0]);
    assert_eq!(catching_up(2.5), ["collision"]);
}

#[test]
fn leaving_the_road_is_measured_in_meters() {
    // The road ends 2 m to the left.
    let leaving =
        |shift: f64| scene(10.0, &format!("{{ duration_s = 1 }}, {{ duration_s = 2.5, shift_m = {shift:?} }}"));
    let (check, value, _) = only(&leaving(3.0), &defaults());
    assert!(check == Check::Offroad && (value - 1.0).abs() < 1e-6, "{value}");
    assert_eq!(checks(&leaving(2.2), &defaults()), [""; 0]);
    assert_eq!(checks(&leaving(2.2), &ValidityConfig { offroad_slack_m: 0.1, ..defaults() }), ["offroad"]);
}

#[test]
fn a_lane_that_ends_on_the_road_is_not_carried_on() {
    // The right one of two lanes ends at 20 m, where the left one goes on; the car in it would be 12 m beyond after 3.9
    // s.
    let lanes = |successors: &str| {
        let spec: Result<SceneSpec, _> = toml::from_str(&format!(
            "agents = [{{ id = \"a\", start = {{ x_m = -7, y_m = 0, speed_mps = 10 }} }}]\n\
             lanes = [{{ id = 1, centerline = [[-60, 0], [20, 0]], width_m = 4.0, left_neighbor = 2 }},\
             {{ id = 2, centerline = [[-60, 4], [20, 4]], width_m = 4.0, right_neighbor = 1, \
             successors = [{successors}] }},{{ id = 3, centerline = [[20, 4], [300, 4]], width_m = 4.0, \
             predecessors = [2] }}]"
        ));
        spec.expect("valid").build("judged")
    };
    // It is beside the left lane, 2 m from its outline.
    let (check, value, _) = only(&lanes("3"), &defaults());
    assert!(check == Check::Offroad && (value - 2.0).abs() < 1e-6, "{value}");
    // If both lanes end, the map does.
    assert_eq!(checks(&lanes(""), &defaults()), [""; 0]);
}

#[test]
fn motion_is_not_checked_where_positions_are_noise() {
    let mut hard = scene(15.0, "{ duration_s = 1.5 }, { duration_s = 1.5, acceleration_mps2 = -12.0 }");
    hard.source.dataset = Dataset::Argoverse1;
    assert_eq!(checks(&hard, &defaults()), [""; 0]);
    assert_eq!(checks(&hard, &ValidityConfig { motion_of: vec![Dataset::Argoverse1], ..defaults() }).len(), 2);
}

#[test]
fn what_is_no_number_is_never_valid() {
    let broken = changed(scene(10.0, ""), |timestep, state| match timestep {
        30 => State { position: Vec2::new(f64::NAN, 0.0), ..state },
        _ => state,
    });
    assert_eq!(checks(&broken, &defaults()), ["offroad"]);
}

/// Four cars that drive side by side, `n_off` of which are beside the road, for the whole scene.
fn fit(n_off: usize) -> MapFit {
    let car = |i: usize| {
        let y_m = if i < n_off { 8.0 + 3.0 * i as f64 } else { 0.0 };
        format!("{{ id = \"{i}\", start = {{ x_m = {}, y_m = {y_m:?}, speed_mps = 5 }} }}", 8 * i)
    };
    MapFit::of(&built(&(0..4).map(car).collect::<Vec<_>>().join(", ")), &defaults(), MapGaps::none())
}

#[test]
fn a_map_that_recordings_leave_does_not_allow_to_judge_departures() {
    // Forty timesteps, every fifth of them: 8 states of each car.
    assert_eq!(fit(1), MapFit { n_scenes: 1, n_scenes_leaving: 0, n_states: 32, n_states_off: 8 });
    assert!(fit(0).allows_offroad(&defaults()) && !fit(1).allows_offroad(&defaults()));
    assert!(fit(1).allows_offroad(&ValidityConfig { max_recorded_offroad: 1.0, ..defaults() }));
    // With half of the lanes removed, cars that were in them are beside the road throughout, and "leave" nothing. 1 of
    // 40 cars is 2.5 %.
    let many = (0..9).fold(fit(1), |all, _| all.with(fit(0)));
    assert!(many.allows_offroad(&defaults()) && !many.with(fit(1)).allows_offroad(&defaults()));
    // A single recorded departure is attributed to a driver, several to the map.
    let leaving = |n: u64| MapFit { n_scenes: 20, n_scenes_leaving: n, n_states: 1000, n_states_off: 5 };
    assert!(leaving(1).allows_offroad(&defaults()) && !leaving(2).allows_offroad(&defaults()));
}

#[test]
fn what_is_not_checked_is_said() {
    let leaving = scene(10.0, "{ duration_s = 1 }, { duration_s = 2.5, shift_m = 3.0 }");
    let not_checked =
        |scene: &Scene, config: &ValidityConfig| Judged::future_of(scene, Roles::none()).not_checked(config);
    assert_eq!((checks(&leaving, &defaults()), not_checked(&leaving, &defaults())), (vec!["offroad"], Vec::new()));
    let with_gap_at = |place: &str| {
        let map_gaps = MapGaps { places: [place.to_owned()].into(), ..MapGaps::default() };
        let judged = Judged::future_of(&leaving, Roles::none()).with_gaps(&map_gaps);
        (judged.violations(&defaults()).len(), judged.not_checked(&defaults()))
    };
    assert_eq!(with_gap_at(&leaving.source.place), (0, vec![Check::Offroad]));
    assert_eq!(with_gap_at("elsewhere"), (1, Vec::new()));
    let mut noisy = leaving;
    noisy.source.dataset = Dataset::Argoverse1;
    noisy.lanes = std::sync::Arc::default();
    let of_noisy = not_checked(&noisy, &ValidityConfig { skip: vec![Check::Collision], ..defaults() });
    assert_eq!(of_noisy, Check::ALL);
}

#[test]
fn who_moves_off_or_stops_at_the_present_may_do_so_at_once() {
    // Moving off with 3 m/s² from a stand, or braking with them to one.
    let moved = |at_m: &dyn Fn(f64) -> f64| {
        let moved = changed(scene(10.0, ""), |timestep, state| State {
            position: Vec2::new(at_m(0.1 * (timestep as f64 - 9.0)), 0.0),
            ..state
        });
        checks(&moved, &defaults())
    };
    assert_eq!(moved(&|s| 1.5 * s.max(0.0).powi(2)), [""; 0]);
    assert_eq!(moved(&|s| -1.5 * s.min(0.0).powi(2)), [""; 0]);
    assert_eq!(moved(&|s| s + 1.5 * s.max(0.0).powi(2)), ["start_acceleration"]);
}

#[test]
fn somebody_is_left() {
    let left_after = |n_timesteps: usize| {
        let mut scene = scene(10.0, "");
        let states = scene.tracks[0].trajectory.entries().iter().take(n_timesteps).copied();
        scene.tracks[0].trajectory = Trajectory::new(states.chain(std::iter::repeat(None)).take(40).collect());
        scene
    };
    let (check, value, timestep) = only(&left_after(15), &defaults());
    assert!(check == Check::Deserted && (value - 2.5).abs() < 1e-9 && timestep == 14, "{value} at {timestep}");
    assert_eq!(checks(&left_after(30), &defaults()), [""; 0]);
}

#[test]
fn vehicles_do_not_drive_backward_unless_they_were_seen_to() {
    // Braking with 1 m/s² from 1.5 m/s half a second before the present, and on.
    let braking = |stops: bool, heading_rad: f64| {
        changed(scene(10.0, ""), |timestep, state| {
            let s = 0.1 * (timestep as f64 - 4.0);
            let s = if stops { s.min(1.5) } else { s };
            State { position: Vec2::new(1.5 * s - 0.5 * s * s, 0.0), heading_rad, ..state }
        })
    };
    let (check, value, timestep) = only(&braking(false, 0.0), &defaults());
    let last = scene(10.0, "").n_timesteps - 1;
    let back_m = 0.5 * (0.1 * (last as f64 - 19.0)).powi(2);
    assert!(check == Check::Reverse && (value - back_m).abs() < 1e-9 && timestep == last, "{value} at {timestep}");
    assert_eq!(checks(&braking(true, 0.0), &defaults()), [""; 0]);
    assert_eq!(checks(&braking(true, std::f64::consts::PI), &defaults()), [""; 0], "it was seen to go backward");
}
