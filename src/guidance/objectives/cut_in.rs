//! Move into the lane of another agent, ahead of it.

use super::motion::{best_moment, nothing, penalty};
use super::{AgentSelector, SceneContext, SceneObjective, beyond, default_weight, interval, one_agent};
use crate::geometry::Vec2;
use crate::settings;
use candle_core::{D, DType, Result, Tensor};
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

/// Move into the path of `before`, ahead of it, at a moment with the wanted gap and relative speed.
///
/// With d(t) the lateral offset of an agent from the path that `before` drives *in the sample*, carried straight on at both ends,
/// g(t) the gap along it from front to rear, u(t) the speed at which it closes, h half the sum of both widths, and v the speed of `before`,
/// a moment costs
///
/// c(t) = ½ ((|d| - h) / 0.5 m)² + ½ (\[g\] / τ)² + ½ (\[u\] / τ_u)² + ½ (max(g - 0.9 v Δ(t), 0) / τ)²,
///
/// where \[·\] is the distance to the wanted interval: the boxes begin to share a path there, and `before` gets there within
/// Δ(t), the longest delay or the time that is left of the scene. The best moment decides, smoothly: (Σ (c + δ)⁻⁴)^(-1/4) with δ = 0.01. To it comes the mean over the last second of
/// ½ (max(|d| - (h - overlap), 0) / 0.5 m)² + ½ (max(1 m - g, 0) / τ)²: who has moved over stays, in front.
///
/// `before` is taken as it is: nothing pulls at it, so that it does not move in behind the other instead. J = -(both), and 0 where one of the
/// two has no future.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct CutIn {
    /// Weight of this objective relative to others.
    #[serde(default = "default_weight")]
    #[schemars(extend("exclusiveMinimum" = 0))]
    pub weight: f64,
    /// The agent that moves over: a role, or `ego`.
    #[serde(default = "other")]
    pub agents: AgentSelector,
    /// The agent whose path it enters: a role, or `ego`.
    #[serde(default = "ego")]
    pub before: AgentSelector,
    /// The gap when the boxes begin to share a path, least and most, from the front of the one to the rear of the
    /// other, meters. Left out: the open bucket of a request, else 1 to 30.
    #[serde(default)]
    pub gap_m: Option<[f64; 2]>,
    /// The relative speed then, least and most, positive where `before` closes in, m/s. Left out: the open bucket, else
    /// any.
    #[serde(default)]
    pub relative_speed_mps: Option<[f64; 2]>,
    /// The time after which `before` is to reach the place, at most, seconds.
    #[serde(default = "default_max_delay_s")]
    #[schemars(extend("exclusiveMinimum" = 0), range(max = 100.0))]
    pub max_delay_s: f64,
    /// How far the boxes overlap sideways at the end, at least, meters.
    #[serde(default = "default_overlap_m")]
    #[schemars(range(min = 0.0, max = 2.0))]
    pub overlap_m: f64,
    /// The error τ of the gap that costs ½, meters.
    #[serde(default = "default_weight")]
    #[schemars(extend("exclusiveMinimum" = 0))]
    pub tolerance_m: f64,
    /// The error τ_u of the relative speed that costs ½, m/s.
    #[serde(default = "default_weight")]
    #[schemars(extend("exclusiveMinimum" = 0))]
    pub tolerance_mps: f64,
}

const fn default_max_delay_s() -> f64 {
    3.0
}

const fn default_overlap_m() -> f64 {
    0.8
}

fn ego() -> AgentSelector {
    AgentSelector::new(AgentSelector::EGO)
}

fn other() -> AgentSelector {
    AgentSelector::new("other")
}

/// The parameters at which it aims, as the events report them.
const GAP: &str = "gap_m";
const RELATIVE_SPEED: &str = "relative_speed_mps";
/// The error of a lateral offset that costs ½, meters.
const LATERAL_TOLERANCE_M: f64 = 0.5;
/// The default gap, meters.
const ANY_GAP_M: [f64; 2] = [1.0, 30.0];
/// The default relative speed, m/s.
const ANY_SPEED_MPS: [f64; 2] = [-1e3, 1e3];
/// How long before the end who has moved over must stay there, seconds.
const SETTLED_S: f64 = 1.0;
/// The least gap at the end, meters.
const LEAST_GAP_M: f64 = 1.0;
/// The share of the longest delay that is made use of.
const DELAY_SHARE: f64 = 0.9;
/// Rounding of |d| at zero, meters.
const ROUNDING_M: f64 = 0.05;
/// The step below which a heading does not follow from a motion, meters.
const LEAST_STEP_M: f64 = 0.05;

impl SceneObjective for CutIn {
    fn kind(&self) -> &'static str {
        "cut_in"
    }

    fn weight(&self) -> f64 {
        self.weight
    }

    fn agents(&self) -> Vec<&AgentSelector> {
        vec![&self.agents, &self.before]
    }

    fn aims_at(&self) -> &'static [&'static str] {
        &[GAP, RELATIVE_SPEED]
    }

    fn validate(&self) -> settings::Result {
        one_agent("agents", &self.agents)?;
        one_agent("before", &self.before)?;
        interval(GAP, self.gap_m)?;
        interval(RELATIVE_SPEED, self.relative_speed_mps)
    }

    fn log_potential(&self, states: &Tensor, context: &SceneContext) -> Result<Tensor> {
        let (n_rows, n_agents, n_timesteps, _) = states.dims4()?;
        let (egos, others) = (context.slots(&self.before)?, context.slots(&self.agents)?);
        let flat = |slots: &[usize]| -> Result<Tensor> {
            let at = slots.iter().enumerate().map(|(row, slot)| (row * n_agents + slot) as u32);
            Tensor::from_vec(at.collect::<Vec<_>>(), n_rows, states.device())
        };
        let (egos, others) = (flat(egos)?, flat(others)?);
        let of = |tensor: &Tensor, agents: &Tensor| tensor.flatten(0, 1)?.index_select(agents, 0);
        let own = of(states, &others)?;
        let paths = Paths::new(&of(states, &egos)?, &own, &of(&context.valid, &egos)?, context)?;
        let on_device = |values: Vec<f64>| {
            Tensor::from_vec(values, (n_rows, n_timesteps), states.device())?.to_dtype(states.dtype())
        };
        let valid = (of(&context.valid, &others)? * on_device(paths.is_known)?)?;
        let counts = (&valid * of(&context.latent, &others)?)?;

        // Along and across the path, from the pose of it that is nearest.
        let coordinate = |dim: usize| own.narrow(D::Minus1, dim, 1)?.squeeze(D::Minus1);
        let (dx, dy) = ((coordinate(0)? - on_device(paths.x)?)?, (coordinate(1)? - on_device(paths.y)?)?);
        let (cos, sin) = (on_device(paths.cos)?, on_device(paths.sin)?);
        let along_m = ((&dx * &cos)? + (&dy * &sin)?)?;
        let across_m = ((&dy * &cos)? - (&dx * &sin)?)?;
        let beside_m = (across_m.sqr()? + ROUNDING_M * ROUNDING_M)?.sqrt()?;
        let halves = |dim: usize| -> Result<Tensor> {
            let of = |agents| of(&context.extent_m, agents)?.narrow(1, dim, 1);
            ((of(&egos)? + of(&others)?)? * 0.5)?.to_dtype(states.dtype())
        };
        let gap_m = (along_m + on_device(paths.station_m)?)?.broadcast_sub(&halves(0)?)?;
        let half_widths_m = halves(1)?;
        let excess_m = beside_m.broadcast_sub(&half_widths_m)?;

        let reach_m: Vec<f64> = (paths.speed_mps.iter().enumerate())
            .map(|(at, speed_mps)| {
                let left_s = (n_timesteps - 1 - at % n_timesteps) as f64 * context.dt_s;
                DELAY_SHARE * speed_mps * left_s.min(self.max_delay_s)
            })
            .collect();
        let wanted_m = context.wanted(GAP, self.gap_m, ANY_GAP_M, states)?;
        let mut cost =
            (penalty(&excess_m, LATERAL_TOLERANCE_M)? + penalty(&beyond(&gap_m, &wanted_m)?, self.tolerance_m)?)?;
        cost = (cost + penalty(&(&gap_m - on_device(reach_m)?)?.relu()?, self.tolerance_m)?)?;
        let velocity = |x: &Tensor| backward_rate(x, context.dt_s);
        let own_mps = ((velocity(&coordinate(0)?)? * &cos)? + (velocity(&coordinate(1)?)? * &sin)?)?;
        let closing_mps = (on_device(paths.speed_mps)? - own_mps)?;
        let wanted = context.wanted(RELATIVE_SPEED, self.relative_speed_mps, ANY_SPEED_MPS, states)?;
        cost = (cost + penalty(&beyond(&closing_mps, &wanted)?, self.tolerance_mps)?)?;
        let best = best_moment(&cost.neg()?, &counts)?;

        let n_settled = (SETTLED_S / context.dt_s).round().max(1.0) as usize;
        let n_settled = n_settled.min(n_timesteps.saturating_sub(context.n_history));
        if n_settled == 0 {
            return nothing(states);
        }
        let last = |tensor: &Tensor| tensor.narrow(1, n_timesteps - n_settled, n_settled);
        let outside_m = (last(&excess_m)? + self.overlap_m)?.relu()?;
        let short_m = (LEAST_GAP_M - last(&gap_m)?)?.relu()?;
        let unsettled = (penalty(&outside_m, LATERAL_TOLERANCE_M)? + penalty(&short_m, self.tolerance_m)?)?;
        let counted = last(&counts)?;
        let n_counted = (counted.sum(1)? + 1e-6)?;
        let unsettled = (unsettled * &counted)?.sum(1)?.div(&n_counted)?;

        unsettled - best
    }
}

/// Differences to the timestep before, per second, (B, T); the first is that of the second.
fn backward_rate(x: &Tensor, dt_s: f64) -> Result<Tensor> {
    let n = x.dim(1)?.saturating_sub(1);
    let rate = ((x.narrow(1, 1, n)? - x.narrow(1, 0, n)?)? * (1.0 / dt_s))?;
    Tensor::cat(&[&rate.narrow(1, 0, 1)?, &rate], 1)
}

/// What is read off the paths that are cut into, for each row and timestep: numbers that nothing pulls at.
struct Paths {
    /// Position of the pose of the path that is nearest to the other, meters.
    x: Vec<f64>,
    y: Vec<f64>,
    /// Direction of that pose.
    cos: Vec<f64>,
    sin: Vec<f64>,
    /// Way from where the path's owner is at this timestep to that pose, negative where it lies behind, meters.
    station_m: Vec<f64>,
    /// The owner's speed, m/s.
    speed_mps: Vec<f64>,
    /// 1 where the owner has a state.
    is_known: Vec<f64>,
}

impl Paths {
    /// The paths of `owners` (B, T, 3), as far as they are `valid` (B, T), seen from `others` (B, T, 3).
    fn new(owners: &Tensor, others: &Tensor, valid: &Tensor, context: &SceneContext) -> Result<Self> {
        let (n_rows, n_timesteps, _) = owners.dims3()?;
        let host = |tensor: &Tensor| tensor.detach().to_dtype(DType::F64)?.flatten_all()?.to_vec1::<f64>();
        let (owners, others, is_known) = (host(owners)?, host(others)?, host(valid)?);
        let n = n_rows * n_timesteps;
        let zeros = || vec![0.0; n];
        let mut paths = Self {
            x: zeros(),
            y: zeros(),
            cos: zeros(),
            sin: zeros(),
            station_m: zeros(),
            speed_mps: zeros(),
            is_known,
        };
        let present = context.n_history.saturating_sub(1);
        for row in 0..n_rows {
            let first = row * n_timesteps;
            let known: Vec<usize> = (present..n_timesteps).filter(|t| paths.is_known[first + t] > 0.0).collect();
            let position = |t: usize| Vec2::new(owners[3 * (first + t)], owners[3 * (first + t) + 1]);
            let mut poses: Vec<Pose> = Vec::with_capacity(known.len());
            for &t in &known {
                let before = poses.last().copied();
                let step_m = before.map_or(0.0, |before| before.position.distance(position(t)));
                let mut heading_rad = owners[3 * (first + t) + 2];
                if let (false, Some(before)) = (context.generates_headings, before) {
                    let step = position(t) - before.position;
                    heading_rad = if step_m < LEAST_STEP_M { before.heading_rad } else { step.y.atan2(step.x) };
                }
                let station_m = before.map_or(0.0, |before| before.station_m + step_m);
                poses.push(Pose { position: position(t), heading_rad, station_m });
            }
            for (i, &t) in known.iter().enumerate() {
                let at = first + t;
                let place = Vec2::new(others[3 * at], others[3 * at + 1]);
                let nearest =
                    poses.iter().min_by(|a, b| a.position.distance(place).total_cmp(&b.position.distance(place)));
                let Some(nearest) = nearest else { continue };
                (paths.x[at], paths.y[at]) = (nearest.position.x, nearest.position.y);
                (paths.sin[at], paths.cos[at]) = nearest.heading_rad.sin_cos();
                paths.station_m[at] = nearest.station_m - poses[i].station_m;
                let (a, b) = if i == 0 { (0, 1.min(known.len() - 1)) } else { (i - 1, i) };
                let elapsed_s = (known[b] - known[a]).max(1) as f64 * context.dt_s;
                paths.speed_mps[at] = (poses[b].station_m - poses[a].station_m) / elapsed_s;
            }
        }
        Ok(paths)
    }
}

/// A pose of a path.
#[derive(Clone, Copy)]
struct Pose {
    position: Vec2,
    heading_rad: f64,
    /// Way driven since the present, meters.
    station_m: f64,
}

#[cfg(test)]
mod tests {
    use super::super::testing::{Traffic, after_ascent, assert_gradients_of_match};
    use super::*;

    fn objective(gap_m: [f64; 2], relative_speed_mps: Option<[f64; 2]>) -> CutIn {
        let defaults: CutIn = toml::from_str("").expect("everything has a default");
        CutIn { gap_m: Some(gap_m), relative_speed_mps, max_delay_s: 10.0, ..defaults }
    }

    /// The other drives one lane to the left, level with the ego's front.
    fn beside() -> Traffic {
        Traffic::straight(&[(0.0, 0.0, 0.0, 8.0), (9.0, 3.5, 0.0, 8.0)])
    }

    #[test]
    fn gradients_match_for_the_other_and_nothing_pulls_at_the_ego() {
        for relative in [None, Some([1.0, 2.0])] {
            let objective = objective([6.0, 8.0], relative);
            let traffic = beside();
            assert_gradients_of_match(&objective, &traffic, &[1]);
            let gradient = traffic.gradient(&objective);
            assert!(gradient[..gradient.len() / 2].iter().all(|g| *g == 0.0));
        }
    }

    #[test]
    fn following_the_gradient_moves_the_other_in_front_with_the_wanted_gap() {
        let traffic = beside();
        let wanted = objective([5.0, 6.0], None);
        let states = &after_ascent(&wanted, &traffic, 600)[0];
        assert_eq!(states[0], traffic.states_vec()[0][0]);
        let last = traffic.generated().end - 1;
        assert!(states[1][last][1].abs() < 1.3, "{:?}", states[1][last]);
        // The boxes begin to share a path with the gap that was wanted.
        let is_met = |t: usize| {
            let gap_m = states[1][t][0] - states[0][t][0] - 4.5;
            (states[1][t][1].abs() - 1.8).abs() < 0.3 && (4.8..6.2).contains(&gap_m)
        };
        assert!(traffic.generated().any(is_met), "{:?}", states[1]);
    }

    #[test]
    fn the_relative_speed_is_that_of_the_moment() {
        // The other moves over at once, 2 m/s slower than the ego.
        let slower = Traffic::straight(&[(0.0, 0.0, 0.0, 8.0), (14.0, 2.6, -0.245, 6.185)]);
        let value = |interval| slower.potential(&objective([1.0, 30.0], Some(interval)))[0];
        let (right, wrong) = (value([1.5, 2.5]), value([-2.5, -1.5]));
        assert!(right > -0.1, "{right}");
        // 3.5 tolerances off at every moment, of which there are nine: together between 6.1 / 9^(1/4) and 6.1.
        assert!((-6.2..-6.1 / 9f64.powf(0.25)).contains(&(wrong - right)), "{wrong}");
    }

    #[test]
    fn a_cut_in_costs_little_and_what_is_none_costs_much() {
        let mut done = beside();
        let mut states: Vec<f64> = done.states.flatten_all().unwrap().to_vec1().unwrap();
        for (t, state) in states[36..].chunks_exact_mut(3).enumerate() {
            state[1] = 3.5 * (1.0 - (t as f64 - 2.0).max(0.0) / 7.0).max(0.0);
        }
        let states = Tensor::from_vec(states, done.states.shape(), &candle_core::Device::Cpu).unwrap();
        done.states = candle_core::Var::from_tensor(&states).unwrap();
        let objective = objective([1.0, 30.0], None);
        let (met, missed) = (done.potential(&objective)[0], beside().potential(&objective)[0]);
        assert!(met > -0.1 && missed < -2.0, "{met}, {missed}");
        // From behind nobody cuts in: the gap is negative at the same offset.
        let behind = Traffic::straight(&[(0.0, 0.0, 0.0, 8.0), (-9.0, 1.0, 0.0, 8.0)]);
        assert!(behind.potential(&objective)[0] < -10.0);
    }

    #[test]
    fn a_bend_is_no_shift() {
        // Both on circles around (0, 50), the other 3.5 m further in and ahead: across the ego's path it stays where it is.
        let arc = |radius_m: f64, ahead_m: f64, t: usize| {
            let angle = (1.6 * t as f64 + ahead_m) / 50.0;
            [radius_m * angle.sin(), 50.0 - radius_m * angle.cos(), angle]
        };
        let mut traffic = beside();
        let states: Vec<f64> =
            (0..12).flat_map(|t| arc(50.0, 0.0, t)).chain((0..12).flat_map(|t| arc(46.5, 10.0, t))).collect();
        let states = Tensor::from_vec(states, traffic.states.shape(), &candle_core::Device::Cpu).unwrap();
        traffic.states = candle_core::Var::from_tensor(&states).unwrap();
        let objective = objective([1.0, 30.0], None);
        let (bend, straight) = (traffic.potential(&objective)[0], beside().potential(&objective)[0]);
        // The path is carried on straight where its owner's way ends, which adds 10² / (2 · 50) = 1 m there.
        assert!((bend - straight).abs() < 0.5 * straight.abs(), "{bend}, {straight}");
    }

    #[test]
    fn the_bucket_that_is_asked_for_stands_in_where_nothing_is_configured() {
        let mut traffic = beside();
        let open = CutIn { gap_m: None, ..objective([1.0, 30.0], None) };
        assert_eq!(traffic.potential(&open), traffic.potential(&objective([1.0, 30.0], None)));
        traffic.context.targets[0] = [(GAP.to_owned(), [11.0, 12.0]), ("side".to_owned(), [0.0, 1.0])].into();
        assert_eq!(traffic.potential(&open), traffic.potential(&objective([11.0, 12.0], None)));
        assert_eq!(traffic.potential(&objective([1.0, 30.0], None)), beside().potential(&open));
    }

    #[test]
    fn an_interval_the_wrong_way_round_and_everybody_at_once_are_refused() {
        let good = objective([1.0, 2.0], None);
        assert!(good.validate().is_ok());
        assert!(CutIn { gap_m: Some([2.0, 1.0]), ..good.clone() }.validate().is_err());
        assert!(CutIn { relative_speed_mps: Some([f64::NAN, 1.0]), ..good.clone() }.validate().is_err());
        assert!(CutIn { agents: AgentSelector::default(), ..good }.validate().is_err());
    }
}
