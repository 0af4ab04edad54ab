//! The check for departures from the road.

use super::check::exceeds;
use super::{Check, Judged, MapGaps, ValidityConfig, Violation, keep_worse};
use crate::geometry::Vec2;
use crate::metrics::road::Road;
use crate::scene::Scene;

/// The distance of positions in a scene from its lanes and from where recorded vehicles drive at its place, meters.
pub(super) fn off_road_m<'a>(scene: &'a Scene, map_gaps: &'a MapGaps) -> impl Fn(Vec2) -> f64 + 'a {
    let road = Road::new(&scene.lanes);
    let area = map_gaps.driven_area(scene);
    move |position| {
        let off_m = road.distance_m(position);
        match area {
            Some(area) if off_m > 0.0 => off_m.min(area.distance_m(scene.world_from_scene.point(position))),
            _ => off_m,
        }
    }
}

/// The farthest departure of the center of a vehicle that is on the road at present. Scenes without lanes are not
/// checked.
pub(super) fn worst(judged: &Judged<'_>, config: &ValidityConfig) -> Option<Violation> {
    let scene = judged.scene;
    if scene.lanes.is_empty() {
        return None;
    }
    let off_road_m = off_road_m(scene, judged.map_gaps);
    let outside_m =
        |agent_idx: usize, timestep: usize| scene.state(agent_idx, timestep).map(|state| off_road_m(state.position));
    let mut worst = None;
    for agent_idx in judged.generated_agents().filter(|agent_idx| judged.is_vehicle(*agent_idx)) {
        let starts_on_road = outside_m(agent_idx, scene.current_timestep())
            .is_some_and(|outside_m| !exceeds(outside_m, config.offroad_slack_m));
        if !starts_on_road {
            continue;
        }
        for timestep in (0..scene.n_timesteps).filter(|timestep| judged.is_generated(agent_idx, *timestep)) {
            let Some(value) = outside_m(agent_idx, timestep) else { continue };
            if exceeds(value, config.offroad_slack_m) {
                let found = (value, config.offroad_slack_m);
                keep_worse(&mut worst, Violation::new(Check::Offroad, scene, agent_idx, timestep, found));
            }
        }
    }
    worst
}
