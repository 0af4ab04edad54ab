//! What do the tags of lanes tell of lights and crosswalks?

use super::{Lane, LaneAttributes, Scene, SituationKind};
use crate::geometry::Vec2;
use std::ops::RangeInclusive;

impl LaneAttributes {
    /// The tag of the light at the beginning of a lane: `stop:0-40;go:41-90`, from timestep to timestep of the scene.
    pub const LIGHT: &str = "traffic_light";
    /// Prefix of the names of tags of crosswalks that a lane leads over: their corners, `x,y x,y …`, in meters in the
    /// recording's frame.
    pub const CROSSWALK: &str = "crosswalk:";

    /// The crosswalks that the lane leads over: the map's name and the corners, in the recording's frame, of each.
    pub fn crosswalks(&self) -> impl Iterator<Item = (i64, Vec<Vec2>)> {
        self.tags.iter().filter_map(|(key, corners)| {
            let corner = |text: &str| {
                let (x, y) = text.split_once(',')?;
                Some(Vec2::new(x.parse().ok()?, y.parse().ok()?)).filter(|at| at.is_finite())
            };
            let id = key.strip_prefix(Self::CROSSWALK)?.parse().ok()?;
            Some((id, corners.split(' ').map(corner).collect::<Option<Vec<_>>>()?))
        })
    }
}

impl Scene {
    /// The states of the light at the beginning of a lane of the scene, each with its first and last timestep; the last
    /// ones may come after the scene. Empty for situations of closed loops, whose timesteps are others.
    pub fn lights<'l>(&self, lane: &'l Lane) -> impl Iterator<Item = (&'l str, RangeInclusive<usize>)> {
        let is_recorded = self.source.situation == SituationKind::Recorded;
        let shown = lane.attributes.tags.get(LaneAttributes::LIGHT).filter(|_| is_recorded);
        shown.map_or("", String::as_str).split(';').filter_map(|run| {
            let (state, steps) = run.split_once(':')?;
            let (first, last) = steps.split_once('-')?;
            Some((state, first.parse().ok()?..=last.parse().ok()?))
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::geometry::Polyline;
    use crate::scene::testing::{Drive, scene};

    #[test]
    fn lights_and_crosswalks_are_read_and_what_is_none_is_passed_over() {
        let lane = |tags: &[(&str, &str)]| Lane {
            attributes: std::sync::Arc::new(LaneAttributes {
                tags: tags.iter().map(|(key, value)| ((*key).to_owned(), (*value).to_owned())).collect(),
                ..LaneAttributes::default()
            }),
            ..Lane::unconnected(1, Polyline::default(), Default::default())
        };
        let mut scene = scene(&[Drive::straight(0.0, 0.0, 0.0, 1.0)]);
        let shown = lane(&[("traffic_light", "stop:0-40;go;go:41-x;arrow_go:50-90")]);
        assert_eq!(scene.lights(&shown).collect::<Vec<_>>(), [("stop", 0..=40), ("arrow_go", 50..=90)]);
        assert_eq!(scene.lights(&lane(&[])).count(), 0);
        let corners = [("crosswalk:7", "-10.5,50 1,5e1 2,3"), ("crosswalk:8", "1,2 3,NaN"), ("crosswalk:x", "1,2")];
        let found: Vec<_> = lane(&corners).attributes.crosswalks().collect();
        assert_eq!(found, [(7, vec![Vec2::new(-10.5, 50.0), Vec2::new(1.0, 50.0), Vec2::new(2.0, 3.0)])]);
        scene.source.situation = SituationKind::Continued;
        assert_eq!(scene.lights(&shown).count(), 0);
    }
}
