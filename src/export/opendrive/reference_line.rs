//! A smooth curve along the middle of a road: straight pieces with rounded corners.
//!
//! The standard requires a curve without jumps of its direction, and the map has polylines. Each corner is rounded by a
//! parabola that stays within [`ROUNDED_BY_M`] of it, so the curve is within a centimeter of the polyline.

use crate::export::lane_bounds::paired;
use crate::geometry::{Polyline, Vec2, wrap_angle};

/// Largest distance of the curve from a corner, meters.
const ROUNDED_BY_M: f64 = 0.01;
/// Directions that differ by less are equal, radians: a millimeter over ten meters.
const STRAIGHT_RAD: f64 = 1e-4;
/// The curve begins and ends square to the ends of the road over this length, meters, so that roads meet there without
/// gaps: the edges of both end in the same points.
const SQUARE_M: f64 = 0.055;
/// Ends that are more oblique than this are not squared, radians.
const MOST_OBLIQUE_RAD: f64 = 1.0;
/// Points of the polyline that are closer together are merged, because shorter pieces have no reliable direction,
/// meters.
const MIN_SPACING_M: f64 = 0.05;

/// A piece of the curve.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Piece {
    /// Distance along the curve at which it begins, meters.
    pub(super) s_m: f64,
    /// Meters along the curve.
    pub(super) length_m: f64,
    pub(super) start: Vec2,
    pub(super) heading_rad: f64,
    pub(super) shape: Shape,
}

/// The shape of a piece.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) enum Shape {
    Line,
    /// From the start, with p from 0 to 1: u = `along_m` p + `u_m` p² ahead, v = `v_m` p² to the left.
    Parabola {
        along_m: f64,
        u_m: f64,
        v_m: f64,
    },
}

impl Piece {
    /// Position and direction a share `p` of the way along.
    fn at(&self, p: f64) -> (Vec2, f64) {
        let ((u, v), turned_rad) = match self.shape {
            Shape::Line => ((self.length_m * p, 0.0), 0.0),
            Shape::Parabola { along_m, u_m, v_m } => {
                ((along_m.mul_add(p, u_m * p * p), v_m * p * p), (2.0 * v_m * p).atan2((2.0 * u_m).mul_add(p, along_m)))
            }
        };
        (self.start + Vec2::new(u, v).rotated(self.heading_rad), self.heading_rad + turned_rad)
    }
}

/// A curve without jumps of position or direction.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct ReferenceLine {
    pub(super) pieces: Vec<Piece>,
}

impl ReferenceLine {
    /// The curve midway between the left and the right edge of a road; `None` if it has no length.
    pub(super) fn between(left: &Polyline, right: &Polyline) -> Option<Self> {
        let (left, right) = paired(left, right);
        let across: Vec<Vec2> = left.iter().zip(&right).map(|(left, right)| *left - *right).collect();
        let mut middle: Vec<Vec2> = left.iter().zip(&right).map(|(left, right)| left.lerp(*right, 0.5)).collect();
        square(&mut middle, *across.first()?);
        middle.reverse();
        square(&mut middle, *across.last()? * -1.0);
        middle.reverse();
        Self::along(&middle)
    }

    /// The curve along these points; `None` if it has no length.
    pub(super) fn along(points: &[Vec2]) -> Option<Self> {
        let points = corners(points)?;
        let mut pieces: Vec<Piece> = Vec::new();
        let mut at = points[0];
        for (i, pair) in points.windows(2).enumerate() {
            let along = pair[1] - pair[0];
            let heading_rad = along.angle();
            let next = points.get(i + 2).map(|next| *next - pair[1]);
            let turn_rad = next.map_or(0.0, |next| wrap_angle(next.angle() - heading_rad));
            // Half of the shorter side keeps rounded corners apart. The parabola passes the corner at a quarter of the
            // difference of the two directions, times this distance.
            let room_m = next.map_or(0.0, |next| 0.5 * along.norm().min(next.norm()));
            let cut_m = room_m.min(2.0 * ROUNDED_BY_M / (0.5 * turn_rad).sin().abs().max(1e-9));
            let end = pair[1] - Vec2::from_angle(heading_rad) * cut_m;
            push(&mut pieces, end.distance(at), at, heading_rad, Shape::Line);
            at = end;
            if next.is_some() {
                let (sin, cos) = turn_rad.sin_cos();
                let shape = Shape::Parabola { along_m: 2.0 * cut_m, u_m: cut_m * (cos - 1.0), v_m: cut_m * sin };
                push(&mut pieces, arc_length_m(cut_m, turn_rad), at, heading_rad, shape);
                at = pair[1] + Vec2::from_angle(heading_rad + turn_rad) * cut_m;
            }
        }
        Some(Self { pieces })
    }

    /// Meters.
    pub(super) fn length_m(&self) -> f64 {
        self.pieces.last().map_or(0.0, |last| last.s_m + last.length_m)
    }

    /// Position and direction at `s_m`, held at the ends.
    pub(super) fn at(&self, s_m: f64) -> Option<(Vec2, f64)> {
        let i = self.pieces.partition_point(|piece| piece.s_m <= s_m).saturating_sub(1);
        let piece = self.pieces.get(i)?;
        Some(piece.at(((s_m - piece.s_m) / piece.length_m).clamp(0.0, 1.0)))
    }
}

/// Makes the line begin square to its start, which extends `across`, to the left.
fn square(line: &mut Vec<Vec2>, across: Vec2) {
    let &[start, .., end] = &line[..] else { return };
    let ahead = Vec2::new(across.y, -across.x) * (1.0 / across.norm());
    let next = line.iter().find(|point| point.distance(start) > 2.0 * SQUARE_M).copied().unwrap_or(end);
    let turn_rad = wrap_angle((next - start).angle() - ahead.angle()).abs();
    if ahead.is_finite() && turn_rad < MOST_OBLIQUE_RAD && start.distance(end) > 4.0 * SQUARE_M {
        line.retain(|point| point.distance(start) > 2.0 * SQUARE_M);
        line.splice(0..0, [start, start + ahead * SQUARE_M]);
    }
}

/// Adds a piece, unless it is too short.
fn push(pieces: &mut Vec<Piece>, length_m: f64, start: Vec2, heading_rad: f64, shape: Shape) {
    if length_m > 1e-6 {
        let s_m = pieces.last().map_or(0.0, |last| last.s_m + last.length_m);
        pieces.push(Piece { s_m, length_m, start, heading_rad, shape });
    }
}

/// The points at which the polyline turns, and its ends.
fn corners(points: &[Vec2]) -> Option<Vec<Vec2>> {
    let last = *points.last()?;
    let mut spaced: Vec<Vec2> = Vec::new();
    for point in points {
        if spaced.last().is_none_or(|before| before.distance(*point) >= MIN_SPACING_M) {
            spaced.push(*point);
        }
    }
    // The end stays, even if the point before it must go.
    while spaced.len() > 1 && spaced.last().is_some_and(|point| point.distance(last) < MIN_SPACING_M) {
        spaced.pop();
    }
    spaced.push(last);
    let turns = |i: usize| -> bool {
        let Some([before, here, after]) = spaced.get(i.wrapping_sub(1)..i + 2) else { return true };
        wrap_angle((*after - *here).angle() - (*here - *before).angle()).abs() > STRAIGHT_RAD
    };
    let kept: Vec<Vec2> = (0..spaced.len()).filter(|i| turns(*i)).map(|i| spaced[i]).collect();
    (kept.len() >= 2 && kept[0].distance(kept[1]) >= MIN_SPACING_M).then_some(kept)
}

/// The length of the parabola that rounds a corner from `cut_m` before it to `cut_m` after it, by Simpson's rule.
fn arc_length_m(cut_m: f64, turn_rad: f64) -> f64 {
    const N_PANELS: usize = 16;
    let (sin, cos) = turn_rad.sin_cos();
    // The derivative is linear between the two directions.
    let speed = |i: usize| {
        let p = i as f64 / N_PANELS as f64;
        2.0 * cut_m * Vec2::new(1.0 + (cos - 1.0) * p, sin * p).norm()
    };
    let weight = |i: usize| {
        if i == 0 || i == N_PANELS {
            1.0
        } else if i % 2 == 1 {
            4.0
        } else {
            2.0
        }
    };
    (0..=N_PANELS).map(|i| weight(i) * speed(i)).sum::<f64>() / (3 * N_PANELS) as f64
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::f64::consts::FRAC_PI_2;

    #[test]
    fn corners_are_rounded_within_a_centimeter_and_nothing_jumps() {
        let points: Vec<Vec2> =
            [(0.0, 0.0), (10.0, 0.0), (20.0, 0.0), (20.0, 30.0), (21.0, 60.0)].map(|(x, y)| Vec2::new(x, y)).into();
        let line = ReferenceLine::along(&points).unwrap();
        assert_eq!(line.at(0.0), Some((points[0], 0.0)));
        let (end, heading_rad) = line.at(line.length_m()).unwrap();
        assert!(end.distance(points[4]) < 1e-9 && (heading_rad - (30f64).atan2(1.0)).abs() < 1e-9);
        // Three straight pieces (the point at x = 10 is no corner), two corners.
        assert_eq!(line.pieces.len(), 5);
        for pair in line.pieces.windows(2) {
            let (end, heading_rad) = pair[0].at(1.0);
            assert!(end.distance(pair[1].start) < 1e-9 && wrap_angle(heading_rad - pair[1].heading_rad).abs() < 1e-9);
        }
        // Half way round the right angle: 1/4 of the way from the corner to the middle of the parabola's ends, times
        // √2.
        let corner = line.pieces[1];
        let (middle, heading_rad) = corner.at(0.5);
        assert!((middle.distance(points[2]) - ROUNDED_BY_M).abs() < 1e-6, "{}", middle.distance(points[2]));
        assert!((heading_rad - 0.5 * FRAC_PI_2).abs() < 1e-9);
        // Finely, the length is that of many short chords.
        let chord = |i: usize| corner.at(i as f64 * 1e-3).0.distance(corner.at((i + 1) as f64 * 1e-3).0);
        assert!(((0..1000).map(chord).sum::<f64>() - corner.length_m).abs() < 1e-7);
    }

    #[test]
    fn what_has_no_length_is_no_curve() {
        let point = |x: f64| Vec2::new(x, 0.0);
        assert_eq!(ReferenceLine::along(&[]), None);
        assert_eq!(ReferenceLine::along(&[point(1.0), point(1.0), point(1.01)]), None);
        let line = ReferenceLine::along(&[point(0.0), point(0.0), point(9.99), point(10.0)]).unwrap();
        assert_eq!((line.pieces.len(), line.length_m()), (1, 10.0));
    }
}
