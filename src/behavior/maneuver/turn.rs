//! Turning where a lane turns: along it, at a speed that the bend allows.

use super::{Driver, Maneuver, Pace};
use crate::behavior::feasible::effort;
use crate::behavior::lane_relation::SceneLanes;
use crate::behavior::template::InTheWay;
use crate::behavior::turn::TurnConfig;
use crate::scene::Scene;

/// Speeds at which bends are driven, m/s, and how hard drivers brake or accelerate to have them, m/s².
const SPEEDS_MPS: [f64; 5] = [3.5, 5.0, 6.5, 8.0, 10.0];
const RATES_MPS2: [f64; 3] = [1.0, 2.0, 3.0];
/// Nobody accelerates harder to turn, m/s².
const HARDEST_MPS2: f64 = 2.0;

/// The ways on from where an agent is, each at several speeds; which of them turn is for the miner to say.
pub(in crate::behavior) fn maneuvers(config: &TurnConfig, scene: &Scene, agent_idx: usize) -> Vec<Maneuver> {
    let driver = config.agents.admits(scene.tracks[agent_idx].class).then(|| SceneLanes::new(&scene.lanes));
    let Some(driver) = driver.and_then(|lanes| Driver::new(scene, &lanes, agent_idx)) else { return Vec::new() };
    let now_mps = driver.state.speed_mps();
    let paces = SPEEDS_MPS.into_iter().flat_map(|then_mps| {
        let rates = RATES_MPS2.into_iter().map(move |rate_mps2| (then_mps, rate_mps2.copysign(then_mps - now_mps)));
        rates.filter(|(_, rate_mps2)| *rate_mps2 <= HARDEST_MPS2)
    });
    let paces: Vec<(usize, f64, Pace)> = std::iter::once((0, 0.0, Pace::steady(0.0)))
        .chain(paces.map(|(then_mps, rate_mps2)| {
            let pace = Pace::steady(rate_mps2).then((then_mps - now_mps) / rate_mps2, 0.0);
            (then_mps as usize, effort(rate_mps2), pace)
        }))
        .collect();
    let mut maneuvers = Vec::new();
    for rail in 0..driver.rails.len() {
        for (kind, effort, pace) in &paces {
            maneuvers.push(Maneuver {
                kind: [rail, *kind],
                effort: *effort,
                parameters: &["mean_speed_mps"],
                in_the_way: Some(InTheWay::Ahead),
                positions: vec![driver.positions(rail, &driver.progress(pace).driven_m)],
            });
        }
    }
    maneuvers
}
