//! Cut-in as defined by the DJINN paper: does one vehicle get into the path of another shortly before the other gets
//! there?

#[cfg(test)]
mod tests;

use super::intrusion::Intrusion;
use super::pairs::PairSearch;
use super::swept_boxes::SweptBoxes;
use super::{Behavior, BehaviorEvent, EventLabel};
use crate::geometry::angle_difference;
use crate::scene::Scene;
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

/// Name of the behavior in configs and tables.
pub(super) const ID: &str = "cut_in_paper";
/// `ego` is cut off, `other` cuts in.
pub(super) const ROLES: &[&str] = &["ego", "other"];
/// The parameters of events; [`CutInPaper`] has the definitions.
pub(super) const PARAMETERS: &[&str] = &[
    "intrusion_timestep",
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
    "side",
    "ego_length_m",
    "other_length_m",
    "min_distance_m",
];

/// The ego must reach the other's place less than this much later, seconds (the paper's).
const MAX_DELAY_S: f64 = 3.0;

/// One vehicle (`other`) merges into the path of another (`ego`), whichever of the two changes course: the definition
/// of the DJINN paper, with the default options to the letter. [`CutIn`](super::CutIn) is what safety engineers call a
/// cut-in.
///
/// **Positive** (DJINN, "Conditional Generation from Behavior Classes"): the box of `other` at a future time t_other
/// overlaps the box of `ego` at a future time t_ego, with t_ego - 3 s < t_other < t_ego (both strict).
/// The future is every timestep after the present t_obs - 1.
///
/// - The event *starts* at the intrusion: the first t_other for which there is such a t_ego.
/// - It is *complete* at the first such t_ego: the ego stands where the other was.
/// - *What does not count*: pairs in which the box of `other` at present overlaps any box of the ego's trajectory,
///   since there the ego merely follows; agents not tracked at present, since they have no initial state.
/// - *What does count*, by the letter: crossing and oncoming traffic, unless `max_heading_difference_rad` is given; an
///   ego that moves in behind the other itself, and boxes that only graze, unless `min_shift_m` is given; driving into
///   the ego, unless `collision_free` is set.
///
/// **Negative**: any other ordered pair whose boxes come closer than 5 m, by default at any two timesteps of the
/// scene. Start and end are the first and the last timestep considered.
///
/// Parameters, all at the intrusion unless said otherwise. "Along" and "across" refer to the path that the ego goes on
/// to drive; a parameter is absent where it is not defined.
///
/// - `intrusion_timestep`, `t_other_s`: the start, as a timestep and in seconds since the first timestep of the scene;
/// - `t_ego_s`: the end, in seconds since the first timestep of the scene;
/// - `ego_speed_mps`, `other_speed_mps`: speeds;
/// - `relative_speed_mps`: ego's speed less the other's along the path; positive when closing;
/// - `gap_m`: along the path from the ego's front to the nearest part of the other; negative when alongside;
/// - `ttc_s`: gap / relative speed; absent when not closing or alongside;
/// - `time_headway_s`: gap / ego's speed; absent when the ego stands or is alongside;
/// - `lateral_speed_mps`: the other's speed across the path, positive toward it;
/// - `shift_m`: how far the other moves sideways toward the path within the future, across its heading at present;
/// - `side`: the side the other comes from: +1 left, -1 right;
/// - `ego_length_m`, `other_length_m`: lengths of the boxes, which tell cars from trucks where a dataset calls both
///   vehicles; nominal where it gives no size;
/// - `min_distance_m`: smallest distance of the boxes at the same time, from the present on; also for negatives.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(default, deny_unknown_fields)]
pub struct CutInPaper {
    /// A pair without a cut-in is a hard negative if its boxes come closer than this, meters. Default 5.
    #[schemars(range(min = 0.0))]
    pub negative_distance_m: f64,
    /// If given, the two headings at the overlap must differ by less than this, radians. This excludes crossing and
    /// oncoming traffic; π/4 is a good value. Default none.
    #[schemars(extend("exclusiveMinimum" = 0), range(max = 6.3))]
    pub max_heading_difference_rad: Option<f64>,
    /// If given, the other must move sideways toward the ego's path by at least this within the future, meters across
    /// its own heading at present. This excludes egos that move in behind the other, and boxes that graze while both
    /// keep their lanes; 1 is a good value. On a bend any motion along the road is sideways too. Default none.
    #[schemars(range(min = 0.0))]
    pub min_shift_m: Option<f64>,
    /// Whether the distance for hard negatives is between states at the same time. Default false: at any two times.
    pub same_time: bool,
    /// Whether to exclude pairs whose boxes overlap at the same time, at present or in the future. Default false.
    pub collision_free: bool,
}

impl Default for CutInPaper {
    fn default() -> Self {
        Self {
            negative_distance_m: 5.0,
            max_heading_difference_rad: None,
            min_shift_m: None,
            same_time: false,
            collision_free: false,
        }
    }
}

impl CutInPaper {
    /// (t_other, t_ego) of the cut-in of `other` before `ego`, if there is one. Both sweeps hold a box at present.
    fn overlap(
        &self,
        scene: &Scene,
        [ego_idx, other_idx]: [usize; 2],
        ego: &SweptBoxes,
        other: &SweptBoxes,
    ) -> Option<(usize, usize)> {
        let present = scene.current_timestep();
        let same_way = |t_other: usize, t_ego: usize| {
            self.max_heading_difference_rad.is_none_or(|limit_rad| {
                let heading =
                    |agent_idx: usize, timestep: usize| scene.state(agent_idx, timestep).map(|s| s.heading_rad);
                heading(other_idx, t_other)
                    .zip(heading(ego_idx, t_ego))
                    .is_some_and(|(theirs, own)| angle_difference(theirs, own).abs() < limit_rad)
            })
        };
        let overlap =
            ego.first_overlap_after(other, scene.n_history..scene.n_timesteps, Self::max_delay(scene.dt_s), same_way)?;
        let initial = other.at(present)?;
        let is_following = ego.overlaps_any(initial, 0..scene.n_timesteps);
        let collides = self.collision_free
            && ego.both_at(other, present..scene.n_timesteps).any(|(_, own, theirs)| own.overlaps(theirs));
        let moves_over = || {
            self.min_shift_m.is_none_or(|least_m| {
                let intrusion = Intrusion::at(scene, [ego_idx, other_idx], overlap.0);
                intrusion.and_then(|i| i.shift_m).is_some_and(|shift_m| shift_m >= least_m)
            })
        };
        (!is_following && !collides && moves_over()).then_some(overlap)
    }

    /// The largest number of timesteps that is strictly less than the longest delay.
    fn max_delay(dt_s: f64) -> usize {
        // Delays that are a whole number of timesteps up to rounding, such as 30 of 0.1 s, are excluded.
        (MAX_DELAY_S / dt_s - 1e-6).floor().max(0.0) as usize
    }

    fn positive(&self, scene: &Scene, pair: [usize; 2], (t_other, t_ego): (usize, usize)) -> BehaviorEvent {
        let event = BehaviorEvent::new((ID, ROLES), scene, EventLabel::Positive, &pair, t_other..=t_ego)
            .with("intrusion_timestep", t_other as f64)
            .with("t_other_s", t_other as f64 * scene.dt_s)
            .with("t_ego_s", t_ego as f64 * scene.dt_s);
        match Intrusion::at(scene, pair, t_other) {
            Some(intrusion) => intrusion.describe(event),
            None => event,
        }
    }
}

impl Behavior for CutInPaper {
    fn id(&self) -> &'static str {
        ID
    }

    /// Pairs in the order of tracks, each pair first with the earlier track as the ego, then with the later one.
    fn detect(&self, scene: &Scene) -> Vec<BehaviorEvent> {
        let search = PairSearch {
            scene,
            names: (ID, ROLES),
            negative_distance_m: self.negative_distance_m,
            judged: 0..scene.n_timesteps,
            same_time: self.same_time,
        };
        search.events(|pair, ego, other| Some(self.positive(scene, pair, self.overlap(scene, pair, ego, other)?)))
    }
}
