//! Cards of several drives from one scenario.

use super::{CardKey, DrawnLane, DrawnSample, SceneCard, ScenePanel, Verdict, ViewRect, pair};
use crate::metrics::closeness_over_time;
use crate::report::model::Fact;
use crate::scene::{GuidanceLevel, ObservationMask, Roles, Scene};

impl SceneCard {
    /// Draws drives from one scenario beside each other, each a scene with a title, with `roles` highlighted.
    pub fn of_drives(
        (id, title): (String, String),
        facts: Vec<Fact>,
        drives: &[(String, Scene)],
        roles: &Roles,
    ) -> Self {
        let scenes: Vec<&Scene> = drives.iter().map(|(_, scene)| scene).collect();
        let view = ViewRect::around(&scenes, roles);
        let panel = |(title, scene): &(String, Scene)| {
            let past = ObservationMask::predictive(scene.tracks.len(), scene.n_timesteps, scene.n_history);
            let samples = vec![DrawnSample::of(title, scene, &past, roles, &view)];
            ScenePanel {
                title: title.clone(),
                is_recorded: false,
                dt_s: scene.dt_s,
                n_history: scene.n_history,
                samples,
            }
        };
        let last = scenes.last();
        let closeness = last.and_then(|scene| closeness_over_time(scene, pair(scene, roles)?)).unwrap_or_default();
        Self {
            id,
            title,
            key: CardKey {
                sweep: String::new(),
                behavior: None,
                bucket: None,
                place: last.map(|scene| scene.source.place.clone()).unwrap_or_default(),
                verdict: Verdict::NotAsked,
                acceptance: None,
                level: GuidanceLevel::UNGUIDED,
                values: Vec::new(),
            },
            facts,
            view,
            lanes: scenes.first().map(|scene| DrawnLane::all(scene, &view)).unwrap_or_default(),
            panels: drives.iter().map(panel).collect(),
            closeness,
        }
    }
}
