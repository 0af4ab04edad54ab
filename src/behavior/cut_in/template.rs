//! Cut-ins that are solved for a gap and a relative speed. The other follows its lane and then moves over to the path
//! of the ego. The ego keeps its lane, and its speed until it has to brake for the other.

use super::CutIn;
use super::feasible::{CutInPlan, Pair};
use crate::behavior::Outcome;
use crate::behavior::following::opens_mps;
use crate::behavior::lane_relation::SceneLanes;
use crate::behavior::limits::REACTIONS_S;
use crate::behavior::maneuver::{Others, going_on, has_room, spread};
use crate::behavior::sideways::{CHANGE_PEAK, Sideways, changed_s};
use crate::behavior::template::{InTheWay, MOST_ANGLE_RAD, Template, distinct};
use crate::geometry::{Vec2, angle_difference};
use crate::scene::Scene;
use std::cell::OnceCell;
use std::collections::BTreeMap;

/// The search for the time at which the box enters the path: spacing of times in seconds, and how often the start is
/// corrected.
const STEP_S: f64 = 0.02;
const N_CORRECTIONS: usize = 2;
/// How long before the end of the scene the other must be in the lane, seconds.
const IN_LANE_S: f64 = 0.2;
/// The largest final offset from the center line, meters.
const MOST_OFFSET_M: f64 = 0.6;
/// Distances below this need no lane change, meters.
const NOTHING_M: f64 = 0.01;
/// The hardest deceleration of the ego, and the least that it must need, m/s².
const HARDEST_MPS2: f64 = 6.5;
const LEAST_NEEDED_MPS2: f64 = 0.5;
/// The gap that the ego keeps to the other while braking, seconds and meters: the smaller one counts.
const LEFT_S: f64 = 0.5;
const LEFT_M: f64 = 2.0;
/// The largest angle to the lane in the last state, radians.
const ALONG_AT_END_RAD: f64 = 0.2;
/// How much later than planned the box may enter the path, seconds.
const LATE_S: f64 = 0.1;
/// How far the ego must pass the place where the other came in, meters, because positions are known only at timesteps.
const IN_PLACE_M: f64 = 0.5;

/// A pair for which ways to cut in are looked for.
pub(super) struct Search<'a> {
    cut_in: &'a CutIn,
    scene: &'a Scene,
    lanes: SceneLanes<'a>,
    ego_idx: usize,
    other_idx: usize,
    pair: Pair,
    /// The ego and those behind it, who need no room: they slow down with it.
    behind: Vec<usize>,
    /// Everybody, going on; known once a way needs room.
    all: OnceCell<Others>,
}

impl<'a> Search<'a> {
    /// The search for ways in which `other` cuts in before `ego`. `None` if the ego is in no lane, or if the other is
    /// in the ego's lane or path already, does not head along it, or is too far to the side, ahead or behind.
    pub(super) fn new(cut_in: &'a CutIn, scene: &'a Scene, [ego_idx, other_idx]: [usize; 2]) -> Option<Self> {
        let pair = cut_in.pair(scene, ego_idx, other_idx)?;
        let is_behind = |idx: &usize| {
            let now = scene.state(*idx, scene.current_timestep()).filter(|now| pair.lane.holds(now.position));
            let place = now.and_then(|now| pair.lane.project(now.position));
            place.is_some_and(|place| place.station_m <= pair.own_station_m)
        };
        let behind = (0..scene.tracks.len()).filter(|idx| *idx == ego_idx || is_behind(idx)).collect();
        let (lanes, all) = (SceneLanes::new(&scene.lanes), OnceCell::new());
        Some(Self { cut_in, scene, lanes, ego_idx, other_idx, pair, behind, all })
    }

    /// The outcomes of a cut-in for which a maneuver can be solved. The other moves over as fast as drivers do
    /// ([`CUT_IN`](crate::behavior::sideways::CUT_IN)) and, at its peak, with -4 to 2.5 m/s² along the lane. The ego
    /// keeps its lane and brakes for the other with at most 6.5 m/s². No other agent but those behind, which react, is
    /// in the way if all of them continue straight. Before the scene ends, the other's center is in the lane and the
    /// ego reaches the place where the other came in. Only the past and the map are used.
    pub(super) fn outcomes(&self) -> Option<Vec<Outcome>> {
        let plans = self.cut_in.plans(&self.pair)?.into_iter();
        Some(plans.filter(|plan| self.way(plan, STYLES[0]).is_some()).map(|plan| plan.outcome).collect())
    }

    /// At most `n` different ways in which the other cuts in with every `wanted` parameter in its range.
    pub(super) fn solved(&self, wanted: &BTreeMap<String, [f64; 2]>, n: usize) -> Option<Vec<Template>> {
        let mut plans = self.cut_in.plans(&self.pair)?;
        plans.retain(|plan| plan.outcome.may_be_within(wanted));
        plans.sort_by(|a, b| a.outcome.effort().total_cmp(&b.outcome.effort()));
        // The first few spread over all plans, and both pairs and plans over the styles.
        let own = self.ego_idx + self.other_idx;
        let styled =
            (0..STYLES.len()).flat_map(|round| (0..plans.len()).map(move |i| (i, (own + i + round) % STYLES.len())));
        let mut templates: Vec<Template> = Vec::new();
        for (i, style) in styled {
            let Some(template) = self.way(&plans[spread(i, plans.len())], STYLES[style]) else { continue };
            templates = distinct(templates.into_iter().chain([template]));
            if templates.len() >= n {
                break;
            }
        }
        Some(templates)
    }

    /// At most `n` ways in which the other comes in for which the ego must brake: when its box enters the path, seconds
    /// after the present, and its positions at present and at each timestep after it.
    pub(super) fn closing(&self, n: usize) -> Option<Vec<(f64, Vec<Vec2>)>> {
        let mut plans = self.cut_in.plans(&self.pair)?;
        let needed_mps2 = |plan: &CutInPlan| {
            let closing_mps = plan.outcome.get("relative_speed_mps").unwrap_or_default().max(0.0);
            closing_mps.powi(2) / (2.0 * plan.outcome.get("gap_m").unwrap_or(f64::INFINITY))
        };
        plans.retain(|plan| needed_mps2(plan) >= LEAST_NEEDED_MPS2);
        plans.sort_by(|a, b| needed_mps2(b).total_cmp(&needed_mps2(a)));
        let tried = (0..plans.len()).map(|i| (&plans[spread(i, plans.len())], STYLES[i % STYLES.len()]));
        let found = tried.filter_map(|(plan, style)| {
            Some((plan.time_s, self.way(plan, style)?.positions(self.scene, self.other_idx)?))
        });
        Some(found.take(n).collect())
    }

    fn all(&self) -> &Others {
        self.all.get_or_init(|| going_on(self.scene, &self.lanes))
    }

    /// The way to follow a plan with nobody in the way.
    fn way(&self, plan: &CutInPlan, style: Style) -> Option<Template> {
        let Self { scene, ref pair, ego_idx, other_idx, .. } = *self;
        let braking = pair.braking(plan, self.cut_in.max_delay_s, style)?;
        let over = pair.coming_over(plan, style)?;
        let template = Template::empty().with(scene, other_idx, |elapsed_s| pair.place(plan, over, elapsed_s))?;
        let template = template.with(scene, ego_idx, |elapsed_s| pair.own_place(plan, braking, elapsed_s))?;
        let last = template.last_state(other_idx)?;
        let there = pair.lane.project(last.position)?;
        let positions = template.positions(scene, other_idx)?;
        let is_possible = angle_difference(last.heading_rad, there.heading_rad).abs() < ALONG_AT_END_RAD
            && template.is_drivable(scene)
            && template.keeps_road(scene, &self.lanes)
            && template.keeps_apart(scene)
            && template.is_clear(scene, InTheWay::Ahead)
            && has_room(scene, other_idx, (-pair.side, over.midway_s(), &positions), self.all(), &self.behind);
        is_possible.then_some(template)
    }
}

/// How drivers perform a maneuver.
#[derive(Debug, Clone, Copy)]
struct Style {
    /// Speed across the lanes, as a multiple of the preferred one, if it suffices.
    eager: f64,
    /// Preferred deceleration of the ego, m/s².
    brakes_mps2: f64,
}

/// Styles, the ordinary one first.
const STYLES: [Style; 4] = [
    Style { eager: 1.0, brakes_mps2: 2.0 },
    Style { eager: 1.25, brakes_mps2: 3.0 },
    Style { eager: 0.85, brakes_mps2: 1.2 },
    Style { eager: 1.1, brakes_mps2: 4.0 },
];

/// When the other moves over, seconds after the present.
#[derive(Clone, Copy)]
struct ComingOver {
    begins_s: f64,
    sideways: Sideways,
}

impl ComingOver {
    /// When the center is midway between the lanes, seconds after the present.
    fn midway_s(self) -> f64 {
        self.begins_s + self.sideways.midway_s()
    }
}

/// How the ego slows down to the speed of the other, from some time after the intrusion on.
#[derive(Clone, Copy)]
struct Braking {
    reacts_s: f64,
    takes_s: f64,
    less_mps: f64,
}

impl Pair {
    /// How the ego brakes for the other: in the given `style`, or as hard as it must to keep its distance. `None` if it
    /// would have to brake too hard, or would reach the place where the other came in too late. It reacts as late as
    /// leaves it that.
    fn braking(&self, plan: &CutInPlan, max_delay_s: f64, style: Style) -> Option<Braking> {
        let gap_m = plan.outcome.get("gap_m")?;
        // A vehicle that is too close behind falls back.
        let less_mps = (self.own_mps - plan.then_mps + opens_mps(plan.then_mps, gap_m)).clamp(0.0, self.own_mps);
        let least_m = LEFT_M.min(LEFT_S * plan.then_mps).min(gap_m / 2.0);
        let reached_s = max_delay_s.min(self.horizon_s - IN_LANE_S - plan.time_s);
        REACTIONS_S.into_iter().find_map(|reacts_s| {
            let left_m = gap_m - least_m - (self.own_mps - plan.then_mps).max(0.0) * reacts_s;
            // While it brakes, it closes the gap at half of the speed difference on average.
            let most_s = if less_mps > 0.0 { 2.0 * left_m / less_mps } else { f64::INFINITY };
            let takes_s = most_s.min(CHANGE_PEAK * less_mps / style.brakes_mps2);
            let braking = Braking { reacts_s, takes_s, less_mps };
            let driven_m = self.own_driven_m(plan, braking, plan.time_s + reached_s) - self.own_mps * plan.time_s;
            let is_possible = CHANGE_PEAK * less_mps <= HARDEST_MPS2 * takes_s && driven_m > gap_m + IN_PLACE_M;
            is_possible.then_some(braking)
        })
    }

    /// The distance driven by the ego, meters.
    fn own_driven_m(&self, plan: &CutInPlan, Braking { reacts_s, takes_s, less_mps }: Braking, elapsed_s: f64) -> f64 {
        let since_s = (elapsed_s - plan.time_s - reacts_s).max(0.0);
        self.own_mps * elapsed_s - less_mps * changed_s(since_s, takes_s)
    }

    /// The place of the ego under the plan, `elapsed_s` after the present.
    fn own_place(&self, plan: &CutInPlan, braking: Braking, elapsed_s: f64) -> Option<Vec2> {
        self.lane.beside(self.own_station_m + self.own_driven_m(plan, braking, elapsed_s), self.own_offset_m)
    }

    /// When the other moves over so that its box enters the ego's path at the time of the plan and its center is in the
    /// lane before the scene ends, as comfortably as that allows. `None` if it takes too much acceleration.
    fn coming_over(&self, plan: &CutInPlan, style: Style) -> Option<ComingOver> {
        let aside_m = self.aside_m(plan);
        if plan.aside_m.min(aside_m) < NOTHING_M {
            return Some(ComingOver { begins_s: 0.0, sideways: self.manner.fastest(0.0) });
        }
        self.manner.ways(aside_m, style.eager).find_map(|sideways| {
            let along_mps = f64::midpoint(self.their_mps, plan.then_mps);
            let needed_s = sideways.reaches_s(plan.shift_m.min(aside_m));
            if sideways.mps > MOST_ANGLE_RAD.tan() * along_mps || needed_s > plan.time_s + LATE_S {
                return None;
            }
            // A vehicle that moves over is turned, so a corner of its box enters the path first.
            let mut over = ComingOver { begins_s: (plan.time_s - needed_s).max(0.0), sideways };
            for _ in 0..N_CORRECTIONS {
                over.begins_s = (over.begins_s + plan.time_s - self.intrusion_s(plan, over)?).max(0.0);
            }
            let end = self.place(plan, over, self.horizon_s - IN_LANE_S)?;
            let is_in_time = self.intrusion_s(plan, over)? <= plan.time_s + LATE_S;
            (is_in_time && self.lane.beyond_m(end, self.side)? < 0.0).then_some(over)
        })
    }

    /// How far the other moves over in total, meters.
    fn aside_m(&self, plan: &CutInPlan) -> f64 {
        plan.aside_m + self.side * (self.own_offset_m - self.kept_offset_m())
    }

    /// The final offset of the other from the center line of the lane, meters: that of the ego, limited to stay well
    /// within the lane.
    fn kept_offset_m(&self) -> f64 {
        self.own_offset_m.clamp(-MOST_OFFSET_M, MOST_OFFSET_M)
    }

    /// When the other's box first enters the path of the ego.
    fn intrusion_s(&self, plan: &CutInPlan, over: ComingOver) -> Option<f64> {
        let is_in_path = |elapsed_s: f64| {
            let (at, soon) = (self.place(plan, over, elapsed_s)?, self.place(plan, over, elapsed_s + STEP_S)?);
            let place = self.lane.project(at)?;
            let (sin, cos) = angle_difference((soon - at).angle(), place.heading_rad).sin_cos();
            let half_across_m = (self.lengths_m[1] * sin.abs() + self.widths_m[1] * cos.abs()) / 2.0;
            Some((place.offset_m - self.own_offset_m).abs() <= self.widths_m[0] / 2.0 + half_across_m)
        };
        let at = |step: usize| step as f64 * STEP_S;
        let (mut outside, mut inside) = (0, (2.0 * plan.time_s / STEP_S) as usize);
        if is_in_path(at(outside))? {
            return Some(at(outside));
        }
        // Coming nearer all the time, it enters the path once.
        is_in_path(at(inside)).filter(|is_in_path| *is_in_path)?;
        while inside - outside > 1 {
            let middle = usize::midpoint(outside, inside);
            if is_in_path(at(middle))? { inside = middle } else { outside = middle }
        }
        Some(at(inside))
    }

    /// The place of the other under the plan, `elapsed_s` after the present.
    fn place(&self, plan: &CutInPlan, over: ComingOver, elapsed_s: f64) -> Option<Vec2> {
        // Its speed changes smoothly, by the same amount and over the same distance as at a constant rate.
        let driven_m =
            self.their_mps * elapsed_s + (plan.then_mps - self.their_mps) * changed_s(elapsed_s, plan.time_s);
        let on_own = self.their_lane.beside(self.their_station_m + driven_m, self.their_offset_m)?;
        let station_m = self.lane.project(on_own)?.station_m;
        let on_egos = self.lane.beside(station_m, self.kept_offset_m())?;
        Some(on_own.lerp(on_egos, over.sideways.share(elapsed_s - over.begins_s)))
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::behavior::testing::{going_on, two_lanes};
    use crate::behavior::{Behavior, BehaviorEvent, EventLabel};
    use crate::scene::Trajectory;
    use crate::scene::testing::Drive;

    /// Two lanes; the ego in one, another car ahead in the other.
    fn beside(other: Drive) -> Scene {
        going_on(&[Drive::straight(0.0, 0.0, 0.0, 10.0), other], two_lanes())
    }

    #[test]
    fn the_miner_finds_the_cut_in_that_a_template_was_solved_for() {
        let behavior = CutIn::default();
        let scene = beside(Drive::straight(16.0, 3.5, 0.0, 9.0));
        let outcomes = behavior.feasible(&scene, &[0, 1]);
        let (mut n_found, mut n_braked) = (0, 0);
        for outcome in &outcomes {
            let around = |name: &str, half: f64| {
                (name.to_owned(), [outcome.get(name).unwrap() - half, outcome.get(name).unwrap() + half])
            };
            let wanted = BTreeMap::from([around("gap_m", 0.5), around("relative_speed_mps", 0.25)]);
            let Some(template) = behavior.template(&scene, &[0, 1], &wanted, 0) else { continue };
            let mut changed = scene.clone();
            template.apply(&mut changed);
            let events = behavior.detect(&changed);
            let is_of_other = |event: &&BehaviorEvent| {
                event.roles.iter().any(|(role, track)| role == "other" && *track == scene.tracks[1].id)
            };
            let event = events.iter().filter(|event| event.label == EventLabel::Positive).find(is_of_other);
            let event = event.unwrap_or_else(|| panic!("nothing is found for {wanted:?}"));
            for (name, [least, most]) in &wanted {
                let found = event.parameters[name];
                assert!((least - 0.6..=most + 0.6).contains(&found), "{name} is {found}, wanted {least} to {most}");
            }
            assert!(event.parameters["min_distance_m"] > 0.0, "the ego drives into the other for {wanted:?}");
            n_found += 1;
            n_braked += usize::from(changed.state(0, changed.n_timesteps - 1).unwrap().speed_mps() < 9.0);
        }
        assert!(
            n_found >= 10 && n_braked >= 3,
            "{n_found} of {} outcomes have a template, {n_braked} with an ego that brakes",
            outcomes.len()
        );
    }

    #[test]
    fn nobody_cuts_in_at_a_steep_angle_or_while_drifting_away() {
        let behavior = CutIn::default();
        let slow = going_on(&[Drive::straight(0.0, 0.0, 0.0, 3.0), Drive::straight(8.0, 3.5, 0.0, 3.0)], two_lanes());
        let scenes = [slow, beside(Drive::straight(12.0, 3.5, 0.0, 10.0))];
        let mut n_templates = 0;
        for (scene, variant) in scenes.iter().flat_map(|scene| (0..40).map(move |variant| (scene, variant))) {
            let Some(template) = behavior.template(scene, &[0, 1], &BTreeMap::new(), variant) else { continue };
            let mut changed = scene.clone();
            template.apply(&mut changed);
            let states = changed.tracks[1].trajectory.entries().iter().flatten();
            let steepest = states.map(|state| state.heading_rad.abs()).fold(0.0, f64::max);
            assert!(steepest < MOST_ANGLE_RAD + 0.05, "{steepest}");
            let last = changed.tracks[1].trajectory.entries().last().unwrap().unwrap();
            assert!(last.heading_rad.abs() < ALONG_AT_END_RAD, "{} at the end", last.heading_rad);
            n_templates += 1;
        }
        assert!(n_templates > 20, "{n_templates}");
        let away = |heading_rad: f64| {
            behavior.template(&beside(Drive::straight(14.0, 3.5, heading_rad, 10.0)), &[0, 1], &BTreeMap::new(), 0)
        };
        assert!(away(0.03).is_some() && away(-0.08).is_some() && away(0.08).is_none());
    }

    #[test]
    fn who_would_drive_into_somebody_has_no_template() {
        let behavior = CutIn::default();
        let free = beside(Drive::straight(12.0, 3.5, 0.0, 10.0));
        assert!(behavior.template(&free, &[0, 1], &BTreeMap::new(), 0).is_some());
        let mut taken = free.clone();
        // A queue in the lane of the ego, just ahead of it.
        for i in 0..8u32 {
            let mut track = taken.tracks[0].clone();
            track.id = crate::scene::TrackId(format!("{}", 10 + i));
            let moved = track.trajectory.entries().iter().map(|state| {
                state
                    .map(|s| crate::scene::State { position: s.position + Vec2::new(6.0 * f64::from(i + 1), 0.0), ..s })
            });
            track.trajectory = Trajectory::new(moved.collect());
            taken.tracks.push(track);
        }
        assert_eq!(behavior.template(&taken, &[0, 1], &BTreeMap::new(), 0), None);
        let impossible = BTreeMap::from([("gap_m".to_owned(), [200.0, 300.0])]);
        assert_eq!(behavior.template(&free, &[0, 1], &impossible, 0), None);
    }

    #[test]
    fn nobody_cuts_in_close_behind_somebody_slower() {
        let behavior = CutIn::default();
        let drives = [(0.0, 0.0, 10.0), (12.0, 3.5, 10.0), (34.0, 0.0, 7.0)];
        let scene = going_on(&drives.map(|(x, y, mps)| Drive::straight(x, y, 0.0, mps)), two_lanes());
        let mut n_templates = 0;
        for template in (0..60).filter_map(|variant| behavior.template(&scene, &[0, 1], &BTreeMap::new(), variant)) {
            let mut changed = scene.clone();
            template.apply(&mut changed);
            let own = *changed.state(1, changed.n_timesteps - 1).unwrap();
            let ahead_x = scene.state(2, scene.current_timestep()).unwrap().position.x
                + 7.0 * scene.dt_s * (scene.n_timesteps - scene.n_history) as f64;
            let gap_m = ahead_x - own.position.x - scene.tracks[1].extent_or_nominal().length_m;
            assert!(gap_m > 0.7 * own.speed_mps(), "{gap_m} m at {}", own.speed_mps());
            n_templates += 1;
        }
        assert!(n_templates > 5, "{n_templates}");
    }
}
