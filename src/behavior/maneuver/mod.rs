//! How could agents drive to show a behavior? Candidates along the lanes are drawn up, and tried with the behavior's
//! own miner before one becomes a template.
//!
//! One behavior per file. Those of the near miss are in its own folder; the templates of the cut-in are solved
//! directly.

mod collision;
mod cut_out;
mod driver;
mod failure_to_yield;
mod hard_brake;
mod lane_change;
mod moving_over;
mod passing_ahead;
mod pedestrian_steps_out;
mod reason;
mod runs_stop_line;
mod tailgating;
#[cfg(test)]
mod tests;
mod turn;
mod unprotected_left_turn;
mod ways;
mod wrong_way;

pub(crate) use driver::RELEASE_JERK_MPS3;
pub(super) use driver::{Driver, ORDINARY_MPS2, Pace, SLOWER_MPS, STANDS_MPS, building_up_s};
pub(super) use moving_over::{going_on, has_room};
pub(super) use reason::{Others, Slowing, slowing};
pub(super) use turn::maneuvers as turn_maneuvers;

use super::lane_relation::SceneLanes;
use super::outcome::Outcome;
use super::template::{InTheWay, Template, distinct};
use super::{Behavior, BehaviorEntry, BehaviorEvent, EventLabel};
use crate::geometry::Vec2;
use crate::scene::Scene;
use std::collections::BTreeMap;

/// How many plans of one kind are kept to list outcomes and to choose a template from, and how many candidates are
/// tried for them.
const N_TO_TELL: usize = 2;
const N_TO_CHOOSE: usize = 4;
const N_TRIED: usize = 8;
/// The share of all plans between one variant and the next. With the golden ratio, few variants spread over all plans.
const STRIDE: f64 = 0.618;

/// A way in which agents may drive to show a behavior. It was not tried yet.
#[derive(Debug, Clone)]
pub struct Maneuver {
    /// Maneuvers of one kind resemble each other.
    pub(super) kind: [usize; 2],
    /// The share of the limits of driving that it uses, from 0 to 1.
    pub(super) effort: f64,
    /// The parameters of the event that its outcome names.
    pub(super) parameters: &'static [&'static str],
    /// Which other agents may be in the way; `None` if it is known that none are.
    pub(super) in_the_way: Option<InTheWay>,
    /// The positions of each agent, in the order of the roles: at present, and at each timestep after it.
    pub(super) positions: Vec<Vec<Vec2>>,
    /// Other agents that the event happens because of.
    pub(super) others: Others,
}

/// A maneuver that works, with its outcome.
#[derive(Debug, Clone)]
pub(super) struct Plan {
    pub(super) outcome: Outcome,
    positions: Vec<Vec<Vec2>>,
    others: Others,
}

/// The plans by which `agents` show `behavior`, easiest first: maneuvers in which nobody leaves the road, accelerates
/// too hard or collides with others that continue straight, and in which the miner finds the event with the agents
/// alone.
fn plans(behavior: &(impl Behavior + ?Sized), scene: &Scene, agents: &[usize], n_alike: usize) -> Vec<Plan> {
    let mut maneuvers = behavior.maneuvers(scene, agents);
    if maneuvers.is_empty() {
        return Vec::new();
    }
    maneuvers.sort_by(|a, b| a.effort.total_cmp(&b.effort));
    let tracks = agents.iter().map(|agent_idx| scene.tracks[*agent_idx].clone()).collect();
    let trial = Trial {
        scene,
        agents,
        lanes: SceneLanes::new(&scene.lanes),
        alone: Scene { tracks, ..scene.clone() },
        touches: BehaviorEntry::is_collision(Some(behavior.id())),
    };
    let mut counts: BTreeMap<[usize; 2], [usize; 2]> = BTreeMap::new();
    let tried = maneuvers.into_iter().filter_map(|maneuver| {
        let [n_tried, n_found] = counts.entry(maneuver.kind).or_default();
        if *n_tried == N_TRIED || *n_found == n_alike {
            return None;
        }
        *n_tried += 1;
        let plan = trial.plan(behavior, maneuver)?;
        *n_found += 1;
        Some(plan)
    });
    tried.collect()
}

/// The outcomes of the plans of `agents`.
pub(super) fn outcomes(behavior: &(impl Behavior + ?Sized), scene: &Scene, agents: &[usize]) -> Vec<Outcome> {
    plans(behavior, scene, agents, N_TO_TELL).into_iter().map(|plan| plan.outcome).collect()
}

/// At most `n` different templates of plans whose outcomes have every `wanted` parameter in its range, those in the
/// middle of the ranges first.
pub(super) fn templates(
    behavior: &(impl Behavior + ?Sized),
    scene: &Scene,
    agents: &[usize],
    wanted: &BTreeMap<String, [f64; 2]>,
    n: usize,
) -> Vec<Template> {
    // The sum of the distances from the middles of the ranges, as shares of half their widths.
    let beside = |plan: &Plan| {
        let shares = wanted.iter().map(|(name, [least, most])| {
            let (middle, half) = (f64::midpoint(*least, *most), (most - least) / 2.0);
            plan.outcome.get(name).map(|value| (value - middle).abs() / half)
        });
        shares.sum::<Option<f64>>().filter(|_| plan.outcome.is_within(wanted))
    };
    let within =
        plans(behavior, scene, agents, N_TO_CHOOSE).into_iter().filter_map(|plan| Some((beside(&plan)?, plan)));
    let mut within: Vec<(f64, Plan)> = within.collect();
    within.sort_by(|a, b| a.0.total_cmp(&b.0));
    let templates = distinct(within.iter().filter_map(|(_, plan)| plan.template(scene, agents)));
    let at = |variant: usize| if wanted.is_empty() { spread(variant, templates.len()) } else { variant };
    (0..n.min(templates.len())).map(|variant| templates[at(variant)].clone()).collect()
}

/// The index of the `variant`-th of `n`: each index once before any is repeated, and the first few spread over all.
pub(super) fn spread(variant: usize, n: usize) -> usize {
    let greatest_common_divisor = |mut a: usize, mut b: usize| {
        while b > 0 {
            (a, b) = (b, a % b);
        }
        a
    };
    let nearest = (n as f64 * STRIDE) as usize;
    let stride = (1..=nearest).rev().find(|stride| greatest_common_divisor(*stride, n) == 1).unwrap_or(1);
    if n == 0 { 0 } else { variant % n * stride % n }
}

/// A scene in which maneuvers are tried.
struct Trial<'a> {
    scene: &'a Scene,
    agents: &'a [usize],
    lanes: SceneLanes<'a>,
    /// The scene without any other agents.
    alone: Scene,
    /// Whether the agents are to touch.
    touches: bool,
}

impl Trial<'_> {
    /// The plan of a maneuver; `None` if it does not lead to the event.
    fn plan(&self, behavior: &(impl Behavior + ?Sized), maneuver: Maneuver) -> Option<Plan> {
        let outcome = Outcome::default().at_effort(maneuver.effort);
        let mut plan = Plan { outcome, positions: maneuver.positions, others: maneuver.others };
        let alone = &self.alone;
        let among_all = plan.template(self.scene, self.agents)?;
        let is_possible = among_all.is_drivable(self.scene)
            && among_all.keeps_road(self.scene, &self.lanes)
            && (self.touches || among_all.keeps_apart(self.scene))
            && maneuver.in_the_way.is_none_or(|who| among_all.is_clear(self.scene, who));
        if !is_possible {
            return None;
        }
        let mut driven = alone.clone();
        let own: Vec<usize> = (0..alone.tracks.len()).collect();
        plan.template_of(alone, &own, &[])?.apply(&mut driven);
        let is_meant = |event: &BehaviorEvent| {
            event.label == EventLabel::Positive
                && event.is_mostly_ahead(&driven)
                && event.roles.tracks().eq(alone.tracks.iter().map(|track| &track.id))
        };
        let event = behavior.detect(&driven).into_iter().find(is_meant)?;
        for name in maneuver.parameters {
            plan.outcome = plan.outcome.with(name, event.parameters.get(*name).copied());
        }
        Some(plan)
    }
}

impl Plan {
    /// The template of all agents and others. `None` if one of them cannot follow it.
    fn template(&self, scene: &Scene, agents: &[usize]) -> Option<Template> {
        self.template_of(scene, agents, &self.others)
    }

    fn template_of(&self, scene: &Scene, agents: &[usize], others: &[(usize, Vec<Vec2>)]) -> Option<Template> {
        let others = others.iter().map(|(agent_idx, positions)| (agent_idx, positions));
        agents.iter().zip(&self.positions).chain(others).try_fold(
            Template::empty(),
            |template, (agent_idx, positions)| {
                template.with(scene, *agent_idx, |elapsed_s| {
                    let step = elapsed_s / scene.dt_s;
                    let before = (step as usize).min(positions.len() - 1);
                    let after = (before + 1).min(positions.len() - 1);
                    Some(positions[before].lerp(positions[after], step - before as f64))
                })
            },
        )
    }
}
