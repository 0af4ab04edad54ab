//! Leaves out lanes of a map that cannot be lanes, and turns lines around that run against their lane.

use super::map_report::MapReport;
use crate::geometry::{Path, Polyline, Projection, Vec2};
use crate::scene::Lane;
use std::collections::BTreeSet;

/// The least width of a lane half way along it, meters: lanes may begin and end in a point.
const MIN_WIDTH_M: f64 = 1.0;
/// The largest width of a lane anywhere, meters.
const MAX_WIDTH_M: f64 = 20.0;
/// A centerline has at least this share of the length of the shorter bound, and the longer bound this share of the
/// centerline's.
const MIN_LENGTH_SHARE: f64 = 0.5;
/// A line that turns by more than the angle of this cosine, 170 degrees, between two segments doubles back.
const COS_MAX_TURN: f64 = -0.984_807_753_012_208;
/// Segments shorter than this may turn in any way, meters.
const MIN_SEGMENT_M: f64 = 0.5;
/// The tolerance for lines where lanes begin and end in a point, meters.
const SLACK_M: f64 = 0.3;
/// The fewest points at which a lane is judged, and about the most: each is compared with all of the bounds.
const MIN_POINTS: usize = 5;
const MAX_POINTS: usize = 1000;
/// Points closer than this to each other are not all judged, meters: some maps have one at every half a meter.
const JUDGED_EVERY_M: f64 = 4.0;
/// From this many points on, an index of a line saves more than it takes.
const MIN_INDEXED_POINTS: usize = 32;

/// Why a lane is left out: reason and detail.
pub(super) type Flaw = (&'static str, String);

/// The lanes that can be lanes, in their order: the first with each id, whose lines have a length and do not double
/// back, and whose centerline lies between its bounds, if there are any. The others are reported.
pub(super) fn plausible(mut lanes: Vec<Lane>, report: &mut MapReport) -> Vec<Lane> {
    let mut seen = BTreeSet::new();
    lanes.retain(|lane| {
        let verdict = match seen.insert(lane.id) {
            true => flaw(lane),
            false => Err(("lanes_of_repeated_ids", "the first of this id is kept".to_owned())),
        };
        verdict.map_err(|(reason, detail)| report.warn(reason, format!("lane {}: {detail}", lane.id.0))).is_ok()
    });
    lanes
}

/// Why a lane cannot be one, if it cannot.
pub(super) fn flaw(lane: &Lane) -> Result<(), Flaw> {
    check_lines(lane).and_then(|()| check_bounds(lane))
}

fn check_lines(lane: &Lane) -> Result<(), Flaw> {
    let has_bounds = !(lane.left.0.is_empty() && lane.right.0.is_empty());
    let bounds = [("left bound", &lane.left), ("right bound", &lane.right)].into_iter().filter(|_| has_bounds);
    for (name, line) in std::iter::once(("centerline", &lane.centerline)).chain(bounds) {
        let length_m = line.length_m();
        // A length that is not a number does not count.
        if !(length_m > 1e-3 && length_m.is_finite()) {
            return Err(("lanes_without_length", format!("its {name} has fewer than 2 distinct points")));
        }
        if let Some(Vec2 { x, y }) = fold(line) {
            return Err(("lanes_that_double_back", format!("its {name} goes back at ({x:.1}, {y:.1})")));
        }
    }
    Ok(())
}

/// The place at which a line doubles back.
fn fold(line: &Polyline) -> Option<Vec2> {
    line.0.windows(3).find_map(|points| {
        let (arriving, leaving) = (points[1] - points[0], points[2] - points[1]);
        let dot = arriving.dot(leaving);
        let turns = dot < 0.0 && {
            let (arriving_m, leaving_m) = (arriving.norm(), leaving.norm());
            arriving_m.min(leaving_m) >= MIN_SEGMENT_M && dot < COS_MAX_TURN * arriving_m * leaving_m
        };
        turns.then_some(points[1])
    })
}

fn check_bounds(lane: &Lane) -> Result<(), Flaw> {
    let resampled = (lane.centerline.0.len() < MIN_POINTS).then(|| lane.centerline.resampled(MIN_POINTS));
    let points = &resampled.as_ref().unwrap_or(&lane.centerline).0;
    let [on_left, on_right] = [&lane.left, &lane.right].map(projector);
    let (mut widths_m, mut n_on_wrong_side) = (Vec::with_capacity(points.len()), 0);
    let center_m = lane.centerline.length_m();
    let n_judged = ((center_m / JUDGED_EVERY_M) as usize).clamp(MIN_POINTS, MAX_POINTS);
    for (i, point) in points.iter().enumerate().step_by((points.len() / n_judged).max(1)) {
        let (Some(left), Some(right)) = (on_left(*point), on_right(*point)) else { return Ok(()) };
        let (to_left, to_right) = (left.point - *point, right.point - *point);
        let (left_m, right_m) = (to_left.norm(), to_right.norm());
        if left_m.min(right_m) > SLACK_M && to_left.dot(to_right) > left_m * right_m / 2.0 {
            let detail = format!("its centerline leaves its bounds at ({:.1}, {:.1})", point.x, point.y);
            return Err(("lanes_with_a_centerline_outside", detail));
        }
        let along = points[(i + 1).min(points.len() - 1)] - points[i.saturating_sub(1)];
        n_on_wrong_side += usize::from(along.cross(to_left) < along.cross(to_right));
        widths_m.push(left_m + right_m);
    }
    widths_m.sort_by(f64::total_cmp);
    let (usual_m, greatest_m) = (widths_m[widths_m.len() / 2], widths_m[widths_m.len() - 1]);
    if usual_m < MIN_WIDTH_M || greatest_m > MAX_WIDTH_M {
        let detail = format!("it is {usual_m:.1} m wide in the middle and {greatest_m:.1} m at most");
        return Err(("lanes_of_implausible_width", detail));
    }
    if n_on_wrong_side > widths_m.len() / 2 {
        return Err(("lanes_of_contradictory_lines", "its left bound is right of its right one".to_owned()));
    }
    let [left_m, right_m] = [&lane.left, &lane.right].map(Polyline::length_m);
    let (shorter_m, longer_m) = (left_m.min(right_m), left_m.max(right_m));
    if center_m < MIN_LENGTH_SHARE * shorter_m || longer_m + MAX_WIDTH_M < MIN_LENGTH_SHARE * center_m {
        let detail = format!("its centerline has {center_m:.1} m, its bounds {left_m:.1} and {right_m:.1} m");
        return Err(("lanes_of_contradictory_lengths", detail));
    }
    Ok(())
}

/// [`Polyline::project`] for many points.
fn projector(line: &Polyline) -> impl Fn(Vec2) -> Option<Projection> {
    let path = (line.0.len() >= MIN_INDEXED_POINTS).then(|| Path::new(line.clone()));
    move |point| path.as_ref().map_or_else(|| line.project(point), |path| path.project(point))
}

/// Whether the left and the right bound of a lane must be turned for the left one to lie left of the right one, as in
/// Lanelet2: bounds are drawn in any direction.
pub(super) fn to_turn(left: &Polyline, right: &Polyline) -> [bool; 2] {
    let turns_left = offset_m(left, middle(right, false)) >= 0.0;
    [turns_left, offset_m(right, middle(left, turns_left)) <= 0.0]
}

/// The middle point of a line, or of its single segment.
fn middle(line: &Polyline, is_turned: bool) -> Vec2 {
    let (points, half) = (&line.0, line.0.len() / 2);
    match points.as_slice() {
        [] => Vec2::ZERO,
        [first, .., last] if points.len() == 2 => first.lerp(*last, 0.5),
        _ => points[if is_turned { points.len() - 1 - half } else { half }],
    }
}

/// Signed distance of `point`, positive to the left.
fn offset_m(line: &Polyline, point: Vec2) -> f64 {
    line.project(point).map_or(0.0, |projection| projection.offset_m)
}

/// Turns lines of a lane around that run against the others, and returns whether there were any. Lanes whose lines
/// agree stay as they are.
pub(super) fn turn_around(left: &mut Polyline, right: &mut Polyline, centerline: Option<&mut Polyline>) -> bool {
    let mut is_turned = runs_against(left, right);
    if is_turned {
        let turned = to_turn(left, right);
        [left as &mut Polyline, right].into_iter().zip(turned).filter(|(_, turns)| *turns).for_each(|(line, _)| {
            line.0.reverse();
        });
    }
    if let Some(centerline) = centerline.filter(|centerline| runs_against(centerline, left)) {
        centerline.0.reverse();
        is_turned = true;
        // Both bounds ran the other way, not the centerline.
        if offset_m(left, middle(right, false)) > 0.0 {
            [left, right, centerline].into_iter().for_each(|line| line.0.reverse());
        }
    }
    is_turned
}

/// Whether the beginning of one line is near the end of the other.
fn runs_against(one: &Polyline, other: &Polyline) -> bool {
    let ends = |line: &Polyline| line.0.first().copied().zip(line.0.last().copied());
    let (Some((a, b)), Some((c, d))) = (ends(one), ends(other)) else { return false };
    a.distance(c) + b.distance(d) > a.distance(d) + b.distance(c)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn line(points: &[(f64, f64)]) -> Polyline {
        Polyline(points.iter().map(|(x, y)| Vec2::new(*x, *y)).collect())
    }

    fn lane(id: i64, center: &[(f64, f64)], left: &[(f64, f64)], right: &[(f64, f64)]) -> Lane {
        Lane::unconnected(id, line(center), [line(left), line(right)])
    }

    const CENTER: [(f64, f64); 2] = [(0.0, 0.0), (40.0, 0.0)];
    const LEFT: [(f64, f64); 2] = [(0.0, 2.0), (40.0, 2.0)];
    const RIGHT: [(f64, f64); 2] = [(0.0, -2.0), (40.0, -2.0)];

    #[test]
    fn lanes_that_cannot_be_are_left_out_and_named() {
        let arc = |radius: f64| (0..=8).map(|i| Vec2::from_angle(f64::from(i) * 0.3) * radius).collect::<Vec<_>>();
        let bend = Lane::unconnected(3, Polyline(arc(3.0)), [Polyline(arc(1.0)), Polyline(arc(5.0))]);
        let faulty = [
            ("lanes_of_repeated_ids", lane(1, &CENTER, &LEFT, &RIGHT)),
            ("lanes_without_length", lane(10, &CENTER[..1], &LEFT, &RIGHT)),
            ("lanes_without_length", lane(11, &CENTER, &LEFT[..1], &RIGHT)),
            ("lanes_without_length", lane(12, &[(0.0, f64::NAN), (1.0, 0.0)], &LEFT, &RIGHT)),
            ("lanes_that_double_back", lane(13, &CENTER, &[LEFT[0], LEFT[1], LEFT[0]], &RIGHT)),
            ("lanes_with_a_centerline_outside", lane(14, &[(0.0, 9.0), (40.0, 9.0)], &LEFT, &RIGHT)),
            ("lanes_of_implausible_width", lane(15, &CENTER, &CENTER, &CENTER)),
            ("lanes_of_implausible_width", lane(16, &CENTER, &[(0.0, 25.0), (40.0, 25.0)], &RIGHT)),
            ("lanes_of_contradictory_lines", lane(17, &CENTER, &RIGHT, &LEFT)),
            ("lanes_of_contradictory_lengths", lane(18, &[(18.0, 0.0), (22.0, 0.0)], &LEFT, &RIGHT)),
        ];
        let sound = [
            lane(1, &CENTER, &LEFT, &RIGHT),
            // Without bounds, and starting from a point.
            lane(2, &CENTER, &[], &[]),
            bend,
            lane(4, &CENTER, &[(0.0, 0.0), (40.0, 2.0)], &[(0.0, 0.0), (40.0, -2.0)]),
        ];
        let all = sound.iter().chain(faulty.iter().map(|(_, lane)| lane)).cloned().collect();
        let mut report = MapReport::default();
        assert_eq!(plausible(all, &mut report), sound, "{}", report.summary());
        for (reason, lane) in &faulty {
            let expected = format!("lane {}: ", lane.id.0);
            let examples = &report.warnings[reason].examples;
            assert!(examples.iter().any(|example| example.starts_with(&expected)), "{reason}: {examples:?}");
        }
        assert_eq!(report.warnings.values().map(|found| found.count).sum::<u64>(), faulty.len() as u64);
    }

    #[test]
    fn long_lanes_are_judged_in_time() {
        // Comparing all points with all others would take minutes.
        let lane = |width_m: f64| {
            let line = |y: f64| Polyline((0..200_000).map(|x| Vec2::new(f64::from(x) * 0.01, y)).collect());
            Lane::unconnected(1, line(0.0), [line(width_m / 2.0), line(-width_m / 2.0)])
        };
        let mut report = MapReport::default();
        assert_eq!(plausible(vec![lane(3.0)], &mut report).len(), 1);
        assert_eq!(plausible(vec![lane(0.5)], &mut report).len(), 0);
    }

    #[test]
    fn lines_are_turned_until_they_agree() {
        let reversed = |points: [(f64, f64); 2], is_reversed: bool| {
            let mut line = line(&points);
            if is_reversed {
                line.0.reverse();
            }
            line
        };
        for turned in 0..8 {
            let is_turned = |bit: u32| turned >> bit & 1 == 1;
            let (mut left, mut right) = (reversed(LEFT, is_turned(0)), reversed(RIGHT, is_turned(1)));
            let mut center = reversed(CENTER, is_turned(2));
            // Lines that agree stay, whatever their sides are.
            let agree = turned == 0 || turned == 7;
            assert_eq!(turn_around(&mut left, &mut right, Some(&mut center)), !agree, "{turned}");
            if turned != 7 {
                assert_eq!([left, right, center], [line(&LEFT), line(&RIGHT), line(&CENTER)], "{turned}");
            }
        }
    }
}
