//! Scenes as other recordings would have them, so that a network learns to do with less than simulators give.
//!
//! Some datasets have no maps, and some no sizes. A network that has always seen both brakes and turns at random where
//! one is missing. Errors of observed states are taken away before a network sees them: trained on scenes with errors,
//! it begins every sample with a jolt, because it cannot tell which pasts were exact.

use crate::scene::{LaneGraph, Scene};
use crate::seed::SeededRng;
use std::sync::Arc;

/// Share of scenes seen without their map, and without the sizes of agents.
const WITHOUT_MAP: f64 = 0.1;
const WITHOUT_SIZES: f64 = 0.1;

/// `scene` as drawn: most stay as they are.
pub(super) fn degraded(mut scene: Scene, rng: &mut SeededRng) -> Scene {
    if rng.uniform() < WITHOUT_MAP {
        scene.lanes = Arc::new(LaneGraph::default());
    }
    if rng.uniform() < WITHOUT_SIZES {
        scene.tracks.iter_mut().for_each(|track| track.extent = None);
    }
    scene
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::scene::testing::{Drive, scene};
    use crate::seed::Seed;

    #[test]
    fn some_scenes_lack_something_and_motion_stays_as_recorded() {
        let recorded = scene(&[Drive::straight(0.0, 0.0, 0.0, 10.0), Drive::straight(10.0, 4.0, 0.0, 8.0)]);
        let mut rng = Seed(1).rng();
        let drawn: Vec<Scene> = (0..400).map(|_| degraded(recorded.clone(), &mut rng)).collect();
        let share = |lacks: &dyn Fn(&Scene) -> bool| drawn.iter().filter(|scene| lacks(scene)).count() as f64 / 400.0;
        for (found, expected) in [
            (share(&|scene| !Arc::ptr_eq(&scene.lanes, &recorded.lanes)), WITHOUT_MAP),
            (share(&|scene| scene.tracks[0].extent.is_none()), WITHOUT_SIZES),
        ] {
            assert!((found - expected).abs() < 0.06, "{found}, expected {expected}");
        }
        for other in &drawn {
            for (a, b) in recorded.tracks.iter().zip(&other.tracks) {
                assert_eq!(a.trajectory, b.trajectory);
            }
        }
    }
}
