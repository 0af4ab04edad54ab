//! Cut-in: does one vehicle cross into the lane of another, shortly ahead of it?

mod crossing;
mod feasible;
mod template;
#[cfg(test)]
mod tests;

use super::kept_lane::KeptLane;
use super::lane_relation::SceneLanes;
use super::pairs::PairSearch;
use super::sideways::CUT_IN;
use super::swept_boxes::SweptBoxes;
use super::{Behavior, BehaviorEvent, EventLabel, Outcome, Template};
use crate::geometry::Vec2;
use crate::scene::Scene;
use crossing::{Crossing, LaneCrossing};
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};
use std::cell::OnceCell;
use std::collections::BTreeMap;
use std::f64::consts::FRAC_PI_6;
use template::Search;

/// Name of the behavior in configs and tables.
pub(super) const ID: &str = "cut_in";
/// `ego` is cut off, `other` cuts in.
pub(super) const ROLES: &[&str] = &["ego", "other"];
/// The parameters of events; [`CutIn`] has the definitions.
pub(super) const PARAMETERS: &[&str] = &[
    "intrusion_timestep",
    "crossing_timestep",
    "t_other_s",
    "t_ego_s",
    "ego_speed_mps",
    "other_speed_mps",
    "relative_speed_mps",
    "gap_m",
    "ttc_s",
    "time_headway_s",
    "lateral_speed_mps",
    "shift_m",
    "ego_shift_m",
    "side",
    "ego_length_m",
    "other_length_m",
    "min_distance_m",
];

/// A pair without a cut-in is a hard negative if its boxes come closer than this at any two timesteps of the scene,
/// meters.
const NEGATIVE_DISTANCE_M: f64 = 5.0;
/// The least headway at which drivers come in, seconds: of 34 recorded cut-ins, the least begins at 0.27 s.
const LEAST_DRIVEN_HEADWAY_S: f64 = 0.25;
/// From the present until it is in the lane of the ego, the other must head along that lane within this, radians. This
/// excludes agents that turn into the lane, enter a roundabout or come toward the ego.
const ALONG_RAD: f64 = FRAC_PI_6;

/// One vehicle (`other`) crosses into the lane that another (`ego`) keeps, shortly ahead of it.
///
/// The lane of the ego is the one it is in at present, with those that lead to it and follow on; the other is measured
/// along and across its center line, so that a bend is no sideways motion. The future is every timestep after the
/// present.
///
/// **Positive**: all of
///
/// - At present the other's center is beyond a side of the lane, and its box not in front of the ego's. In the future
///   it crosses that side and stays beyond it for a second (or to the end of the scene), heading along the lane
///   throughout (within 30 degrees).
/// - It moves over by at least 0.5 m, and by more than the ego moves toward it, from the present to a second after it
///   has come in.
/// - The ego keeps its lane until the other has come in (its center is at most 0.3 m beyond a side).
/// - The event remains when the ego is replayed straight along its lane, that is at its present offset and with its own
///   progress: at a future time t_other the other's box is in the strip that the replayed ego sweeps, and at t_ego with
///   t_other < t_ego < t_other + 3 s the ego's box is where the other's was.
/// - The other comes into the way of the ego as it drives, too: at some future time, and not at present, it is ahead,
///   and beside the place at which the ego passes it, or is last, by at most half of both widths.
/// - The other's center is ahead of the ego's then and when it crosses, its whole box when both have happened, and then
///   nobody else's center is in the lane between theirs; and both move, with at least 1 m/s at t_other.
///
/// The event *starts* at the intrusion, the first such t_other, and is *complete* at the first such t_ego.
///
/// *What does not count*: an ego that moves in behind the other, changes lanes itself, or makes so much room that the
/// other is never in its way; boxes that graze while both keep their lanes; crossing, turning and oncoming traffic;
/// agents not tracked at present; an ego that is in no lane of the map, or a scene without a map: of two paths that
/// meet, it is then unknown which one is kept; another that keeps a lane of its own (its center at most 0.3 m beyond a
/// side) which runs beside that of the ego or overlaps it, as through junctions. Where the two lanes lead into each
/// other within 50 m and both vehicles keep theirs, as on a ramp, offsets do not show which one cuts in: it is the one
/// that moves more across the mean of its headings at both ends.
///
/// **Negative**: any other ordered pair whose boxes come closer than 5 m at any two timesteps of the scene. Start and
/// end are the first and the last timestep of the scene.
///
/// Parameters, all at the intrusion and of the replayed ego unless said otherwise; a parameter is absent where it is
/// not defined.
///
/// - `intrusion_timestep`, `t_other_s`: the start, as a timestep and in seconds since the first timestep of the scene;
/// - `crossing_timestep`: when the other's center crosses the side of the lane;
/// - `t_ego_s`: the end, in seconds since the first timestep of the scene;
/// - `ego_speed_mps`, `other_speed_mps`: speeds;
/// - `relative_speed_mps`: ego's speed less the other's, along the lane; positive when closing;
/// - `gap_m`: along the lane from the ego's front to the nearest part of the other; negative when alongside;
/// - `ttc_s`: gap / relative speed; absent when not closing or alongside;
/// - `time_headway_s`: gap / ego's speed; absent when the ego stands or is alongside;
/// - `lateral_speed_mps`: the other's speed across the lane, positive toward the ego's side;
/// - `shift_m`, `ego_shift_m`: how far the other moves over across the lane, and how far the ego moves toward it, from
///   the present to a second after the other has come in;
/// - `side`: the side the other comes from: +1 left, -1 right;
/// - `ego_length_m`, `other_length_m`: lengths of the boxes, which tell cars from trucks where a dataset calls both
///   vehicles; nominal where it gives no size;
/// - `min_distance_m`: smallest distance of the boxes at the same time, from the present on; also for negatives.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(default, deny_unknown_fields)]
pub struct CutIn {
    /// The ego must reach the other's place less than this much later, seconds. Default 3.
    #[schemars(extend("exclusiveMinimum" = 0), range(max = 100.0))]
    pub max_delay_s: f64,
    /// The other must move over by at least this, across the lane of the ego, meters. Default 0.5.
    #[schemars(range(min = 0.0))]
    pub min_shift_m: f64,
    /// Whether to exclude pairs whose boxes overlap at the same time, at present or in the future. Default false.
    pub collision_free: bool,
    /// In templates, aims and what is accepted, the other moves over this many times as fast as drivers do at most, and
    /// comes in at a headway of at least a quarter of a second over it. Default 1.
    #[schemars(range(min = 0.5, max = 3.0))]
    pub hurry: f64,
}

impl Default for CutIn {
    fn default() -> Self {
        Self { max_delay_s: 3.0, min_shift_m: 0.5, collision_free: false, hurry: 1.0 }
    }
}

/// At most `n` ways in which the second agent cuts in before the first, which must brake for it: when it is in the way,
/// seconds after the present, and its positions at present and at each timestep after it.
pub(super) fn closing(scene: &Scene, pair: [usize; 2], n: usize) -> Vec<(f64, Vec<Vec2>)> {
    let cut_in = CutIn::default();
    Search::new(&cut_in, scene, pair).and_then(|search| search.closing(n)).unwrap_or_default()
}

impl CutIn {
    fn positive(&self, scene: &Scene, pair: [usize; 2], crossing: &Crossing) -> BehaviorEvent {
        let timesteps = crossing.intrusion..=crossing.reached;
        let event = BehaviorEvent::new((ID, ROLES), scene, EventLabel::Positive, &pair, timesteps)
            .with("intrusion_timestep", crossing.intrusion as f64)
            .with("crossing_timestep", crossing.crossing as f64)
            .with("t_other_s", crossing.intrusion as f64 * scene.dt_s)
            .with("t_ego_s", crossing.reached as f64 * scene.dt_s)
            .with("ego_shift_m", crossing.ego_shift_m);
        crossing.moment.describe(event)
    }
}

impl Behavior for CutIn {
    fn id(&self) -> &'static str {
        ID
    }

    fn feasible(&self, scene: &Scene, agents: &[usize]) -> Vec<Outcome> {
        let search = agents.try_into().ok().and_then(|pair| Search::new(self, scene, pair));
        search.and_then(|search| search.outcomes()).unwrap_or_default()
    }

    fn is_as_driven(&self, event: &BehaviorEvent) -> bool {
        let value = |name: &str| event.parameters.get(name).copied().unwrap_or_default();
        let least_m = LEAST_DRIVEN_HEADWAY_S / self.hurry * value("ego_speed_mps");
        CUT_IN.of(self.hurry, 0.0).holds(event) && value("gap_m") >= least_m
    }

    fn template_parameters(&self) -> &'static [&'static str] {
        &["gap_m", "relative_speed_mps", "side"]
    }

    fn templates(
        &self,
        scene: &Scene,
        agents: &[usize],
        wanted: &BTreeMap<String, [f64; 2]>,
        n: usize,
    ) -> Vec<Template> {
        let search = agents.try_into().ok().and_then(|pair| Search::new(self, scene, pair));
        search.and_then(|search| search.solved(wanted, n)).unwrap_or_default()
    }

    /// Pairs in the order of tracks, each pair first with the earlier track as the ego, then with the later one.
    fn detect(&self, scene: &Scene) -> Vec<BehaviorEvent> {
        let lanes = SceneLanes::new(&scene.lanes);
        let kept: Vec<OnceCell<Option<KeptLane>>> = scene.tracks.iter().map(|_| OnceCell::new()).collect();
        let kept = |agent_idx: usize| kept[agent_idx].get_or_init(|| KeptLane::of(scene, &lanes, agent_idx)).as_ref();
        let collides = |ego: &SweptBoxes, other: &SweptBoxes| {
            let future = scene.current_timestep()..scene.n_timesteps;
            self.collision_free && ego.both_at(other, future).any(|(_, own, theirs)| own.overlaps(theirs))
        };
        let search = PairSearch {
            scene,
            names: (ID, ROLES),
            negative_distance_m: NEGATIVE_DISTANCE_M,
            judged: 0..scene.n_timesteps,
            same_time: false,
        };
        search.events(|pair, ego, other| {
            let lane = kept(pair[0])?;
            let crossing = LaneCrossing { scene, pair, lane, behavior: self }.find(|| kept(pair[1]))?;
            (!collides(ego, other)).then(|| self.positive(scene, pair, &crossing))
        })
    }
}
