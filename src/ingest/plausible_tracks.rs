//! Judges by the motion of vehicles whether a recording agrees with its format: radians, meters, m/s, its map.

use super::lane_index::{Circle, LaneIndex};
use super::raw::{Finding, RawScene, Reject};
use crate::geometry::{Vec2, angle_difference, wrap_angle};
use crate::scene::{AgentClass, DatasetFacts, State, Track};
use std::f64::consts::TAU;

/// Vehicles faster than this move along their heading, m/s.
const FAST_MPS: f64 = 5.0;
/// A track is judged by its motion if it is fast for this many timesteps.
const MIN_FAST_STEPS: usize = 5;
/// Headings are off if they differ from the motion by more than this, radians.
const MAX_SLIP_RAD: f64 = std::f64::consts::FRAC_PI_4;
/// Headings of vehicles that hardly move are added up over fewer turns than this, and degrees mostly are more radians.
const MAX_ADDED_UP_RAD: f64 = 5.0 * TAU;
/// The limit for headings beyond a full turn, which are degrees or were added up, radians.
const MAX_SLIP_BEYOND_TURN_RAD: f64 = 0.15;
/// No vehicle is faster than this, m/s, nor with the noise and the uneven times of some datasets.
pub(super) const MAX_SPEED_MPS: f64 = 80.0;
const MAX_NOISY_SPEED_MPS: f64 = 500.0;
/// Recorded velocities of moving vehicles contradict the positions if they differ by this factor.
const MAX_SPEED_RATIO: f64 = 2.0;
const MOVING_MPS: f64 = 2.0;
/// A vehicle farther than this from all lanes is beside the road, meters.
const BESIDE_ROAD_M: f64 = 10.0;
/// A scene is rejected if this many of its tracks are doubtful, and more than half of those that can be judged.
const MIN_REJECTED_TRACKS: u64 = 3;

struct Fault {
    what: &'static str,
    /// What happens to a scene if most of its tracks have it.
    of_most: OfMost,
}

/// What happens to a scene if most of its tracks have a fault.
enum OfMost {
    /// It is rejected for this reason.
    Reject(&'static str),
    /// It is kept with a warning, also if fewer tracks have the fault: generated traffic may be so.
    Keep,
    /// It is kept with a warning, and without one if fewer tracks have the fault, which are then errors of a tracker.
    Warn,
}

const FAULTS: [Fault; 6] = [
    Fault { what: "tracks_with_headings_beyond_a_turn", of_most: OfMost::Reject("implausible_headings") },
    Fault { what: "tracks_with_headings_off_their_motion", of_most: OfMost::Keep },
    Fault { what: "tracks_that_jump", of_most: OfMost::Keep },
    Fault { what: "tracks_that_jump_against_their_velocities", of_most: OfMost::Reject("implausible_positions") },
    Fault { what: "tracks_wider_than_long", of_most: OfMost::Reject("implausible_sizes") },
    // Velocities are derived from positions, so these do no harm.
    Fault { what: "tracks_whose_velocities_contradict_their_positions", of_most: OfMost::Warn },
];

/// The judgment of a track: not to be judged, sound, or doubtful with the figures.
type Verdict = Option<Result<(), String>>;

/// Adds the doubtful tracks to the findings of a scene, and wraps the headings of its vehicles, which arrive as
/// recorded.
///
/// # Errors
/// Rejects a scene if most of its tracks are implausible.
pub(super) fn judge(raw: &mut RawScene) -> Result<(), Reject> {
    let facts = raw.source.dataset.facts();
    let mut doubtful = FAULTS.map(|_| (0, 0, None));
    for track in raw.tracks.iter_mut().filter(|track| track.class.is_motorized()) {
        for (verdict, (n_judged, n_doubtful, first)) in verdicts(track, raw.dt_s, facts).into_iter().zip(&mut doubtful)
        {
            *n_judged += u64::from(verdict.is_some());
            if let Some(Err(figures)) = verdict {
                *n_doubtful += 1;
                first.get_or_insert_with(|| format!("track {} {figures}", track.id));
            }
        }
        if facts.has_headings {
            let wrapped = |state: &State| State { heading_rad: wrap_angle(state.heading_rad), ..*state };
            let states = track.trajectory.entries().iter().map(|state| state.as_ref().map(wrapped)).collect();
            track.trajectory = track.trajectory.with_states(states);
        }
    }
    for (fault, (n_judged, n_doubtful, first)) in FAULTS.into_iter().zip(doubtful) {
        let Some(first) = first else { continue };
        let detail = format!("{}: scene {}: {n_doubtful} of {n_judged}: {first}", raw.source.file, raw.id);
        match (fault.of_most, 2 * n_doubtful > n_judged) {
            (OfMost::Reject(reason), true) if n_doubtful >= MIN_REJECTED_TRACKS => {
                return Err(Reject { reason, detail });
            }
            (OfMost::Warn, false) => {}
            _ => raw.findings.push(Finding { what: fault.what, n: n_doubtful, detail }),
        }
    }
    Ok(())
}

/// The heading of a track as its reader passes it on: for a vehicle as recorded, so that it can be judged.
pub(super) fn recorded_heading(heading_rad: f64, class: AgentClass) -> f64 {
    if class.is_motorized() { heading_rad } else { wrap_angle(heading_rad) }
}

fn verdicts(track: &Track, dt_s: f64, facts: &DatasetFacts) -> [Verdict; FAULTS.len()] {
    let max_speed_mps = if facts.has_uneven_times { MAX_NOISY_SPEED_MPS } else { MAX_SPEED_MPS };
    let (mut n_steps, mut n_fast, mut n_off, mut n_off_beyond) = (0, 0, 0, 0);
    let (mut moved_m, mut recorded_m) = (0.0, 0.0);
    let (mut off, mut beyond, mut jump) = (None, None::<f64>, None);
    let mut before: Option<(usize, &State)> = None;
    for (timestep, state) in track.trajectory.valid() {
        if state.heading_rad.abs() > f64::max(TAU, beyond.map_or(0.0, f64::abs)) {
            beyond = Some(state.heading_rad);
        }
        let Some((timestep_before, from)) = before.replace((timestep, state)) else { continue };
        let (step, step_s) = (state.position - from.position, (timestep - timestep_before) as f64 * dt_s);
        let (step_m, recorded_mps) = (step.norm(), from.velocity.norm());
        if step_m > max_speed_mps * step_s {
            jump.get_or_insert_with(|| format!("moves {step_m:.1} m in {step_s:.1} s"));
        }
        n_steps += 1;
        moved_m += step_m;
        recorded_m += recorded_mps * step_s;
        if step_m > FAST_MPS * step_s {
            let slip_rad = angle_difference(from.heading_rad, step.angle()).abs();
            n_fast += 1;
            n_off_beyond += usize::from(slip_rad > MAX_SLIP_BEYOND_TURN_RAD);
            if slip_rad > MAX_SLIP_RAD {
                n_off += 1;
                off.get_or_insert((from.heading_rad, step.angle()));
            }
        }
    }
    let is_judged = n_fast >= MIN_FAST_STEPS;
    let verdict = |fault: Option<String>| Some(fault.map_or(Ok(()), Err));
    let (beyond, off) = match (beyond, off) {
        _ if !facts.has_headings => (None, None),
        // Headings that were added up agree with the motion.
        (Some(heading_rad), _) if (!is_judged && heading_rad.abs() > MAX_ADDED_UP_RAD) || 2 * n_off_beyond > n_fast => {
            let figures = format!(
                "has a heading of {heading_rad:.1}, expected radians: is it in degrees, as ingest.table.heading = \
                 \"degrees\" reads them?"
            );
            (verdict(Some(figures)), None)
        }
        (_, Some((heading_rad, motion_rad))) if is_judged && 2 * n_off > n_fast => {
            let figures = format!("has a heading of {heading_rad:.2} rad and moves along {motion_rad:.2} rad");
            (verdict(None), verdict(Some(figures)))
        }
        _ if is_judged => (verdict(None), verdict(None)),
        _ => (None, None),
    };
    let sizes = track.extent.map(|extent| match extent.width_m > extent.length_m {
        true => Err(format!("is {} m wide and {} m long", extent.width_m, extent.length_m)),
        false => Ok(()),
    });
    let duration_s = n_steps as f64 * dt_s;
    let is_moving = f64::max(moved_m, recorded_m) > MOVING_MPS * duration_s;
    let velocities = (facts.has_velocities && n_steps >= MIN_FAST_STEPS && is_moving).then(|| {
        let agrees = recorded_m <= MAX_SPEED_RATIO * moved_m && moved_m <= MAX_SPEED_RATIO * recorded_m;
        let [recorded_mps, moved_mps] = [recorded_m, moved_m].map(|m| m / duration_s);
        let figures = || format!("has a velocity of {recorded_mps:.1} m/s and moves at {moved_mps:.1} m/s");
        if agrees { Ok(()) } else { Err(figures()) }
    });
    let (jumps, against) = if velocities.as_ref().is_some_and(Result::is_err) { (None, jump) } else { (jump, None) };
    let [jumps, against] = [jumps, against].map(|jump| verdict(jump).filter(|_| n_steps > 0));
    [beyond, off, jumps, against, sizes, velocities]
}

/// Adds a finding if all vehicles of a scene are far beside the lanes of its map.
pub(super) fn judge_place(raw: &mut RawScene, present: usize, map: &LaneIndex) {
    let vehicles = raw.tracks.iter().filter(|track| track.class.is_motorized());
    let positions: Vec<Vec2> =
        vehicles.filter_map(|track| track.trajectory.get(present).map(|state| state.position)).collect();
    let is_on_road = |center: &Vec2| map.has_any_within(Circle { center: *center, radius_m: BESIDE_ROAD_M });
    if !positions.is_empty() && !positions.iter().any(is_on_road) {
        let n = positions.len() as u64;
        let figures = format!("0 of {n} are within {BESIDE_ROAD_M} m of a lane of {}", raw.map_id);
        let detail = format!("{}: scene {}: {figures}", raw.source.file, raw.id);
        raw.findings.push(Finding { what: "vehicles_beside_all_lanes", n, detail });
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::ingest::lane_topology::tests::lane;
    use crate::ingest::test_data;
    use crate::scene::testing;
    use crate::scene::{Derivation, Extent, LaneGraph, Scene};
    use std::sync::Arc;

    type Change = dyn Fn(usize, &mut State);

    /// A car that drives east or north at 10 m/s, its states changed by `change`.
    fn car(id: usize, change: impl Fn(usize, &mut State)) -> Track {
        let heading_rad = if id.is_multiple_of(2) { 0.0 } else { std::f64::consts::FRAC_PI_2 };
        let direction = Vec2::from_angle(heading_rad);
        let states = (0..20).map(|timestep| {
            let position = direction * timestep as f64 + Vec2::new(0.0, 4.0 * id as f64);
            let mut state = State { position, heading_rad, velocity: direction * 10.0 };
            change(timestep, &mut state);
            Some(state)
        });
        testing::vehicle(&id.to_string(), states)
    }

    fn scene(tracks: Vec<Track>) -> RawScene {
        test_data::raw(Scene { n_timesteps: 20, n_history: 10, tracks, ..testing::scene(&[]) })
    }

    /// The judged scene of five cars, `n_changed` of which are changed.
    fn judged(n_changed: usize, change: impl Fn(usize, &mut State)) -> Result<RawScene, Reject> {
        let cars = (0..5).map(|id| {
            car(id, |timestep, state| {
                if id < n_changed {
                    change(timestep, state);
                }
            })
        });
        let mut scene = scene(cars.collect());
        judge(&mut scene).map(|()| scene)
    }

    #[test]
    fn recordings_in_other_units_are_named_with_figures_and_rejected_if_most_tracks_are() {
        let degrees = |_: usize, state: &mut State| state.heading_rad = 100.0 + state.heading_rad.to_degrees();
        let pixels = |_: usize, state: &mut State| state.position = state.position * 12.0;
        let jumps = |timestep: usize, state: &mut State| state.position.x += if timestep > 9 { 500.0 } else { 0.0 };
        let cases: [(&Change, &str, &str, &str); 3] = [
            (
                &degrees,
                "tracks_with_headings_beyond_a_turn",
                "implausible_headings",
                "100.0, expected radians: is it in",
            ),
            (
                &pixels,
                "tracks_that_jump_against_their_velocities",
                "implausible_positions",
                "track 0 moves 12.0 m in 0.1 s",
            ),
            (
                &jumps,
                "tracks_that_jump_against_their_velocities",
                "implausible_positions",
                "1 of 5: track 0 moves 501.0 m in 0.1 s",
            ),
        ];
        for (change, what, reason, figures) in cases {
            let kept = judged(1, change).expect("most tracks are sound");
            assert_eq!(kept.findings[0].what, what);
            assert!(kept.findings[0].detail.contains(figures), "{:?}", kept.findings);
            assert_eq!(judged(5, change).expect_err("nothing is sound").reason, reason);
        }
        let backwards = |_: usize, state: &mut State| state.heading_rad += 3.0;
        let kept = judged(5, backwards).expect("it may be generated").findings;
        assert_eq!((kept[0].what, kept[0].n), ("tracks_with_headings_off_their_motion", 5));
        assert!(kept[0].detail.ends_with("a heading of 3.00 rad and moves along 0.00 rad"), "{kept:?}");
        let racing = |_: usize, state: &mut State| {
            (state.position, state.velocity) = (state.position * 12.0, state.velocity * 12.0);
        };
        let kept = judged(5, racing).expect("it may be generated").findings;
        assert_eq!((kept[0].what, kept[0].n), ("tracks_that_jump", 5));
        let kmh = |_: usize, state: &mut State| state.velocity = state.velocity * 3.6;
        let kept = judged(5, kmh).expect("velocities are not used").findings;
        assert_eq!((kept.len(), kept[0].n), (1, 5));
        assert!(
            kept[0].detail.ends_with("5 of 5: track 0 has a velocity of 36.0 m/s and moves at 10.0 m/s"),
            "{kept:?}"
        );
    }

    #[test]
    fn cars_that_are_wider_than_long_are_named() {
        let mut cars: Vec<Track> = (0..5).map(|id| car(id, |_, _| ())).collect();
        cars[3].extent = Some(Extent { length_m: 1.8, width_m: 4.5 });
        let mut scene = scene(cars);
        judge(&mut scene).expect("four cars are sound");
        assert_eq!(scene.findings[0].what, "tracks_wider_than_long");
        assert!(scene.findings[0].detail.ends_with("1 of 5: track 3 is 4.5 m wide and 1.8 m long"));
    }

    #[test]
    fn sound_recordings_pass_and_full_turns_are_none() {
        // Standing vehicles may have any heading, and headings may be added up over roundabouts.
        let turned = |_: usize, state: &mut State| state.heading_rad += 2.0 * TAU;
        let scene = judged(5, turned).expect("sound");
        assert_eq!(scene.findings, []);
        let headings: Vec<f64> =
            scene.tracks.iter().filter_map(|track| Some(track.trajectory.get(3)?.heading_rad)).collect();
        assert!(headings.iter().all(|heading_rad| (0.0..2.0).contains(heading_rad)), "{headings:?}");
        let standing = |timestep: usize, state: &mut State| {
            let jitter = if timestep.is_multiple_of(2) { 0.05 } else { 0.0 };
            *state = State { position: Vec2::new(jitter, 0.0), velocity: Vec2::ZERO, heading_rad: 2.0 };
        };
        assert_eq!(judged(5, standing).expect("sound").findings, []);
    }

    #[test]
    fn what_is_derived_stays_marked() {
        let derivation = Derivation { held_headings: vec![true; 20], recorded: Vec::new() };
        let derived = car(0, |_, _| ());
        let derived = Track { trajectory: derived.trajectory.derived(derivation.clone()), ..derived };
        let mut scene = scene(vec![derived, car(1, |_, _| ())]);
        judge(&mut scene).expect("sound");
        let found: Vec<_> = scene.tracks.iter().map(|track| track.trajectory.derivation()).collect();
        assert_eq!(found, [Some(&derivation), None]);
    }

    #[test]
    fn a_scene_beside_its_map_is_named() {
        let map = |y: f64| LaneIndex::new(Arc::new(LaneGraph::new(vec![lane(1, (0.0, y), (50.0, y))])));
        let findings = |y: f64| {
            let mut scene = scene(vec![car(0, |_, _| ()), car(2, |_, _| ())]);
            judge_place(&mut scene, 9, &map(y));
            scene.findings
        };
        assert_eq!(findings(3.0), []);
        let found = findings(-60.0);
        assert_eq!((found[0].what, found[0].n), ("vehicles_beside_all_lanes", 2));
        assert!(found[0].detail.ends_with("0 of 2 are within 10 m of a lane of Test"), "{found:?}");
    }
}
