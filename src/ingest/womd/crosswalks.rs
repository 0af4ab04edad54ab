//! Which lanes lead over which crosswalks?

use super::messages::{FeatureData, Scenario};
use crate::geometry::footprint::Bounds;
use crate::geometry::{Polyline, Vec2};
use crate::ingest::map_report::MapReport;
use crate::ingest::vicinity::Vicinity;
use crate::scene::{Lane, LaneAttributes};
use std::sync::Arc;

/// More than maps have: the most corners of a crosswalk, and the most crosswalks, and crossings of lanes with them.
const MAX_CORNERS: usize = 100;
const MAX_CROSSWALKS: usize = 500;
const MAX_CROSSINGS: usize = 5000;

/// Tags the lanes with the crosswalks of a scenario that they lead over.
pub(super) fn tag(lanes: &mut [Lane], scenario: &Scenario, vicinity: Vicinity, report: &mut MapReport) {
    let reaches: Vec<_> = lanes.iter().map(|lane| Bounds::around(lane.centerline.0.iter().copied())).collect();
    let (mut n_crosswalks, mut n_crossings) = (0, 0);
    for feature in &scenario.map_features {
        let Some(FeatureData::Crosswalk(of)) = &feature.feature_data else { continue };
        n_crosswalks += 1;
        let corners: Vec<Vec2> = of.polygon.iter().map(super::map::point).collect();
        let is_area = (3..=MAX_CORNERS).contains(&corners.len()) && corners.iter().all(|at| vicinity.holds(*at));
        let Some(area) = Bounds::around(corners.iter().copied())
            .filter(|_| is_area && n_crosswalks <= MAX_CROSSWALKS && n_crossings < MAX_CROSSINGS)
        else {
            report.warn("broken_crosswalks", format!("crosswalk {} is left out", feature.id));
            continue;
        };
        let text: Vec<String> = corners.iter().map(|Vec2 { x, y }| format!("{x},{y}")).collect();
        let tag = (format!("{}{}", LaneAttributes::CROSSWALK, feature.id), text.join(" "));
        for (lane, reach) in lanes.iter_mut().zip(&reaches) {
            let is_near = reach.is_some_and(|reach| reach.is_within(&area, 0.0));
            if is_near && leads_over(&lane.centerline, &corners, &area) {
                n_crossings += 1;
                Arc::make_mut(&mut lane.attributes).tags.extend([tag.clone()]);
            }
        }
    }
}

/// Whether a line crosses a side of an area.
fn leads_over(line: &Polyline, corners: &[Vec2], area: &Bounds) -> bool {
    let is_near = |ends: &&[Vec2]| Bounds::around(ends.iter().copied()).is_some_and(|of| of.is_within(area, 0.0));
    line.0.windows(2).filter(is_near).any(|ends| {
        let mut sides = corners.iter().zip(corners.iter().cycle().skip(1));
        sides.any(|(a, b)| do_cross([ends[0], ends[1]], [*a, *b]))
    })
}

/// Whether two segments cross: the ends of each lie on both sides of the other.
fn do_cross([a, b]: [Vec2; 2], [c, d]: [Vec2; 2]) -> bool {
    let parts = |from: Vec2, to: Vec2, one: Vec2, other: Vec2| {
        (to - from).cross(one - from) * (to - from).cross(other - from) <= 0.0
    };
    parts(a, b, c, d) && parts(c, d, a, b)
}
