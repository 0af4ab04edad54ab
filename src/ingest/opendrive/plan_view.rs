//! The reference line of a road.

use super::cubic::{cubic, cubic_slope};
use crate::geometry::Vec2;
use crate::ingest::error::Malformed;
use crate::ingest::xml_tree::Element;

/// Nodes and weights of Gauss's quadrature with five points on -1 to 1.
const GAUSS: [(f64, f64); 5] = [
    (0.0, 0.568_888_888_888_888_9),
    (-0.538_469_310_105_683_1, 0.478_628_670_499_366_47),
    (0.538_469_310_105_683_1, 0.478_628_670_499_366_47),
    (-0.906_179_845_938_664, 0.236_926_885_056_189_08),
    (0.906_179_845_938_664, 0.236_926_885_056_189_08),
];
/// A spiral is integrated in pieces that turn by no more than this, radians.
const PIECE_RAD: f64 = 0.5;
/// The most pieces of a spiral.
const MAX_PIECES: f64 = 10_000.0;
/// Pieces in which the length of a polynomial is measured.
const N_PIECES: usize = 16;

/// A piece of the reference line.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Piece {
    /// Distance along the road at which it begins.
    pub(super) start_m: f64,
    pub(super) length_m: f64,
    pub(super) origin: Vec2,
    heading_rad: f64,
    shape: Shape,
}

#[derive(Debug, Clone, Copy, PartialEq)]
enum Shape {
    Line,
    /// Curvature at the start, and its change along the piece.
    Spiral {
        start_per_m: f64,
        change_per_m2: f64,
    },
    /// v(u), u along the heading at the start.
    Cubic([f64; 4]),
    /// u(p) and v(p), and p per meter.
    ParametricCubic {
        u: [f64; 4],
        v: [f64; 4],
        per_m: f64,
    },
}

impl Piece {
    pub(super) fn of(element: &Element) -> Result<Self, Malformed> {
        let length_m = element.float("length", None)?;
        let kind = element.children().find(|child| child.name != "userData").ok_or("<geometry> is empty")?;
        let coefficients = |names: [&str; 4]| -> Result<[f64; 4], Malformed> {
            let mut found = [0.0; 4];
            for (coefficient, name) in found.iter_mut().zip(names) {
                *coefficient = kind.float(name, None)?;
            }
            Ok(found)
        };
        let shape = match kind.name.as_str() {
            "line" => Shape::Line,
            "arc" => Shape::Spiral { start_per_m: kind.float("curvature", None)?, change_per_m2: 0.0 },
            "spiral" => {
                let [start_per_m, end_per_m] = [kind.float("curvStart", None)?, kind.float("curvEnd", None)?];
                let change_per_m2 = if length_m > 0.0 { (end_per_m - start_per_m) / length_m } else { 0.0 };
                Shape::Spiral { start_per_m, change_per_m2 }
            }
            "poly3" => Shape::Cubic(coefficients(["a", "b", "c", "d"])?),
            "paramPoly3" => Shape::ParametricCubic {
                u: coefficients(["aU", "bU", "cU", "dU"])?,
                v: coefficients(["aV", "bV", "cV", "dV"])?,
                per_m: match kind.attribute("pRange") {
                    Some("arcLength") => 1.0,
                    Some("normalized") | None if length_m > 0.0 => 1.0 / length_m,
                    Some("normalized") | None => 0.0,
                    Some(other) => {
                        return Err(format!("has pRange \"{other}\", expected arcLength or normalized").into());
                    }
                },
            },
            other => return Err(format!("<geometry> holds <{other}>, which the format does not list").into()),
        };
        Ok(Self {
            start_m: element.float("s", None)?,
            length_m,
            origin: Vec2::new(element.float("x", None)?, element.float("y", None)?),
            heading_rad: element.float("hdg", None)?,
            shape,
        })
    }

    /// Position and heading at a distance from its start.
    fn at(&self, along_m: f64) -> (Vec2, f64) {
        let (local, turned_rad) = match self.shape {
            Shape::Line => (Vec2::new(along_m, 0.0), 0.0),
            Shape::Spiral { start_per_m, change_per_m2 } => {
                let turned_rad = |d: f64| d * (start_per_m + 0.5 * change_per_m2 * d);
                (spiral_point(along_m, turned_rad), turned_rad(along_m))
            }
            Shape::Cubic(v) => {
                let u = u_at_length(v, along_m);
                (Vec2::new(u, cubic(v, u)), cubic_slope(v, u).atan())
            }
            Shape::ParametricCubic { u, v, per_m } => {
                let p = along_m * per_m;
                let heading = Vec2::new(cubic_slope(u, p), cubic_slope(v, p));
                (Vec2::new(cubic(u, p), cubic(v, p)), heading.angle())
            }
        };
        (self.origin + local.rotated(self.heading_rad), self.heading_rad + turned_rad)
    }
}

/// Position and heading of the reference line at `s_m`.
pub(super) fn pose_at(pieces: &[Piece], s_m: f64) -> Option<(Vec2, f64)> {
    let n_begun = pieces.partition_point(|piece| piece.start_m <= s_m).max(1);
    let piece = pieces.get(n_begun - 1)?;
    Some(piece.at((s_m - piece.start_m).max(0.0)))
}

/// The end of a line that has turned by `turned_rad` of the distance along it.
fn spiral_point(length_m: f64, turned_rad: impl Fn(f64) -> f64) -> Vec2 {
    let most_rad = turned_rad(length_m).abs().max(turned_rad(length_m / 2.0).abs());
    let n_pieces = (most_rad / PIECE_RAD).ceil().clamp(1.0, MAX_PIECES);
    let half_m = length_m / n_pieces / 2.0;
    let piece = |i: usize| {
        let middle_m = (2 * i + 1) as f64 * half_m;
        let part =
            |(node, weight): &(f64, f64)| Vec2::from_angle(turned_rad(middle_m + node * half_m)) * (weight * half_m);
        GAUSS.iter().map(part).fold(Vec2::ZERO, |sum, part| sum + part)
    };
    (0..n_pieces as usize).map(piece).fold(Vec2::ZERO, |sum, piece| sum + piece)
}

/// The u at which the cubic v(u) has this length.
fn u_at_length(v: [f64; 4], length_m: f64) -> f64 {
    let speed = |u: f64| cubic_slope(v, u).hypot(1.0);
    let length_to = |u: f64| {
        let half = u / N_PIECES as f64 / 2.0;
        let piece = |i: usize| {
            let middle = (2 * i + 1) as f64 * half;
            GAUSS.iter().map(|(node, weight)| weight * half * speed(middle + node * half)).sum::<f64>()
        };
        (0..N_PIECES).map(piece).sum::<f64>()
    };
    // Newton's method; the length grows by at least 1 with each unit of u.
    (0..20).fold(length_m, |u, _| u - (length_to(u) - length_m) / speed(u))
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::f64::consts::{FRAC_PI_2, PI};

    fn piece(kind: &str, length_m: f64) -> Piece {
        let text = format!("<geometry s='5' x='10' y='20' hdg='{FRAC_PI_2}' length='{length_m}'>{kind}</geometry>");
        Piece::of(&Element::parse(&text).unwrap()).unwrap()
    }

    fn near(found: (Vec2, f64), x: f64, y: f64, heading_rad: f64) {
        let (at, heading) = found;
        assert!(at.distance(Vec2::new(x, y)) < 1e-9 && (heading - heading_rad).abs() < 1e-9, "{at:?} {heading}");
    }

    #[test]
    fn lines_and_arcs_are_closed_forms() {
        let line = piece("<line/>", 30.0);
        near(pose_at(&[line], 8.0).unwrap(), 10.0, 23.0, FRAC_PI_2);
        // A half circle to the left of radius 4, starting north.
        let arc = piece("<arc curvature='0.25'/>", 4.0 * PI);
        near(pose_at(&[arc], 5.0 + 4.0 * PI).unwrap(), 2.0, 20.0, FRAC_PI_2 + PI);
        near(pose_at(&[arc], 5.0 + 2.0 * PI).unwrap(), 6.0, 24.0, PI);
    }

    #[test]
    fn spirals_are_fresnel_integrals() {
        // Curvature from 0 at 1/m²: x = ∫ cos(t²/2), y = ∫ sin(t²/2). Abramowitz and Stegun, table 7.7: C(1) and S(1)
        // of π t²/2 are 0.7798934 and 0.4382591, so scaled by √π at √π.
        let length_m = PI.sqrt();
        let spiral = piece(&format!("<spiral curvStart='0' curvEnd='{length_m}'/>"), length_m);
        let (at, heading_rad) = spiral.at(length_m);
        let (x, y) = (0.779_893_400_376_822_8 * length_m, 0.438_259_147_390_354_77 * length_m);
        assert!(at.distance(Vec2::new(10.0 - y, 20.0 + x)) < 1e-9, "{at:?}");
        assert!((heading_rad - PI).abs() < 1e-12);
    }

    #[test]
    fn polynomials_are_followed_by_their_length() {
        // The straight line v = u / 2, in all three forms.
        let [along, aside] = [2.0 / 5f64.sqrt(), 1.0 / 5f64.sqrt()];
        for kind in [
            "<poly3 a='0' b='0.5' c='0' d='0'/>".to_owned(),
            format!(
                "<paramPoly3 aU='0' bU='{along}' cU='0' dU='0' aV='0' bV='{aside}' cV='0' dV='0' pRange='arcLength'/>"
            ),
            format!(
                "<paramPoly3 aU='0' bU='{}' cU='0' dU='0' aV='0' bV='{}' cV='0' dV='0'/>",
                along * 10.0,
                aside * 10.0
            ),
        ] {
            let (at, heading_rad) = piece(&kind, 10.0).at(6.0);
            assert!(at.distance(Vec2::new(10.0 - 6.0 * aside, 20.0 + 6.0 * along)) < 1e-9, "{kind}: {at:?}");
            assert!((heading_rad - FRAC_PI_2 - 0.5f64.atan()).abs() < 1e-9);
        }
        // v = u² / 2 has the length (u √(1 + u²) + asinh u) / 2.
        let u = u_at_length([0.0, 0.0, 0.5, 0.0], (2.0 * 5f64.sqrt() + 2f64.asinh()) / 2.0);
        assert!((u - 2.0).abs() < 1e-9, "{u}");
    }

    #[test]
    fn other_shapes_are_refused() {
        let text = "<geometry s='0' x='0' y='0' hdg='0' length='1'><helix/></geometry>";
        let error = Piece::of(&Element::parse(text).unwrap()).unwrap_err().to_string();
        assert_eq!(error, "<geometry> holds <helix>, which the format does not list");
        let error = Piece::of(&Element::parse("<geometry s='0' x='a'><line/></geometry>").unwrap()).unwrap_err();
        assert_eq!(error.to_string(), "<geometry> on line 1 has no length, expected a number");
    }
}
