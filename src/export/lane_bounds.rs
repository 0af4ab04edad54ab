//! The left and right boundaries of lanes, also for maps with only centerlines.

use crate::geometry::{Polyline, Vec2};
use crate::ingest::assumed_bounds::{ASSUMED_LANE_WIDTH_M, beside};
use crate::scene::Lane;

/// The boundaries of a lane in driving direction, with at least two points and some length each.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct LaneBounds {
    pub(super) left: Polyline,
    pub(super) right: Polyline,
    /// Whether the map has no boundaries, so that the nominal width was used.
    pub(super) is_nominal: bool,
}

impl LaneBounds {
    /// The boundaries of `lane`, in its frame. `None` if it does not even have a centerline with some length.
    pub(super) fn of(lane: &Lane) -> Option<Self> {
        let has_length = |line: &Polyline| line.length_m() > 0.0;
        if has_length(&lane.left) && has_length(&lane.right) {
            return Some(Self { left: lane.left.clone(), right: lane.right.clone(), is_nominal: false });
        }
        let center = distinct(&lane.centerline);
        (center.0.len() >= 2).then(|| Self {
            left: beside(&center.0, ASSUMED_LANE_WIDTH_M / 2.0),
            right: beside(&center.0, -ASSUMED_LANE_WIDTH_M / 2.0),
            is_nominal: true,
        })
    }

    /// The boundaries with equally many points.
    pub(super) fn paired(&self) -> (Vec<Vec2>, Vec<Vec2>) {
        paired(&self.left, &self.right)
    }
}

/// Both lines with equally many points, which correspond: each line keeps its own points and gets points at the other's
/// shares of length.
pub(super) fn paired(left: &Polyline, right: &Polyline) -> (Vec<Vec2>, Vec<Vec2>) {
    /// Shares of length that differ by less are equal.
    const SAME_SHARE: f64 = 1e-6;
    let mut shares = [shares(left), shares(right)].concat();
    shares.sort_by(f64::total_cmp);
    shares.dedup_by(|later, earlier| *later - *earlier < SAME_SHARE);
    // The ends themselves, whatever was merged with them.
    if let Some(last) = shares.last_mut() {
        *last = 1.0;
    }
    let points = |line: &Polyline| {
        let length_m = line.length_m();
        shares.iter().filter_map(|share| line.point_at(share * length_m)).collect()
    };
    (points(left), points(right))
}

/// The shares of the line's length at its points, from 0 to 1.
fn shares(line: &Polyline) -> Vec<f64> {
    let length_m = line.length_m();
    let mut so_far_m = 0.0;
    let along = line.0.windows(2).map(|pair| {
        so_far_m += pair[0].distance(pair[1]);
        (so_far_m / length_m).min(1.0)
    });
    std::iter::once(0.0).chain(along).collect()
}

/// The line without repeated points.
fn distinct(line: &Polyline) -> Polyline {
    let mut points = line.0.clone();
    points.dedup_by(|later, earlier| later.distance(*earlier) < 1e-9);
    Polyline(points)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::export::testing::lane;

    fn line(points: &[(f64, f64)]) -> Polyline {
        Polyline(points.iter().map(|(x, y)| Vec2::new(*x, *y)).collect())
    }

    #[test]
    fn boundaries_of_the_map_are_kept_and_paired() {
        let mut lane = lane(1);
        lane.left = line(&[(0.0, 2.0), (5.0, 2.0), (20.0, 2.0)]);
        lane.right = line(&[(0.0, -2.0), (30.0, -2.0), (40.0, -2.0)]);
        let bounds = LaneBounds::of(&lane).unwrap();
        assert_eq!((&bounds.left, &bounds.right, bounds.is_nominal), (&lane.left, &lane.right, false));
        // Shares of length: 0, 1/4 of the left, 3/4 of the right, 1.
        let (left, right) = bounds.paired();
        let x = |points: &[Vec2]| points.iter().map(|p| (p.x * 1e6).round() / 1e6).collect::<Vec<_>>();
        assert_eq!((x(&left), x(&right)), (vec![0.0, 5.0, 15.0, 20.0], vec![0.0, 10.0, 30.0, 40.0]));
    }

    #[test]
    fn centerlines_alone_get_the_usual_width() {
        let mut lane = lane(1);
        (lane.left, lane.right) = (Polyline::default(), line(&[(1.0, 1.0)]));
        lane.centerline = line(&[(0.0, 0.0), (0.0, 0.0), (10.0, 0.0), (10.0, 10.0)]);
        let bounds = LaneBounds::of(&lane).unwrap();
        assert!(bounds.is_nominal);
        // The corner is passed half way between the two directions.
        let side = 1.9 / 2f64.sqrt();
        let expected = line(&[(0.0, 1.9), (10.0 - side, side), (8.1, 10.0)]);
        let near = |found: &Polyline, expected: &Polyline| {
            found.0.len() == expected.0.len() && found.0.iter().zip(&expected.0).all(|(a, b)| a.distance(*b) < 1e-9)
        };
        assert!(near(&bounds.left, &expected), "{:?}", bounds.left);
        assert!(near(&bounds.right, &line(&[(0.0, -1.9), (10.0 + side, -side), (11.9, 10.0)])), "{:?}", bounds.right);
        lane.centerline = line(&[(3.0, 3.0), (3.0, 3.0)]);
        assert_eq!(LaneBounds::of(&lane), None);
    }
}
