//! The check that somebody is left in a scene.

use super::{Check, Judged, Violation};

/// How long nobody may be there at the end, seconds. Only closed loops are long enough.
const MAX_DESERTED_S: f64 = 2.0;

/// The time for which nobody is there at the end, if there was somebody before.
pub(super) fn worst(judged: &Judged<'_>) -> Option<Violation> {
    let scene = judged.scene;
    let somebody = |timestep: usize| (0..scene.tracks.len()).find(|idx| scene.state(*idx, timestep).is_some());
    let (last, agent_idx) = (0..scene.n_timesteps).rev().find_map(|t| Some((t, somebody(t)?)))?;
    let deserted_s = (scene.n_timesteps - 1 - last) as f64 * scene.dt_s;
    let limits = (deserted_s, MAX_DESERTED_S);
    (deserted_s > MAX_DESERTED_S).then(|| Violation::new(Check::Deserted, scene, agent_idx, last, limits))
}
