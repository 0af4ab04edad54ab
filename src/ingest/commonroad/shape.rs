//! The box around the shapes of an obstacle.

use super::map::point;
use crate::geometry::Vec2;
use crate::ingest::error::Malformed;
use crate::ingest::xml_tree::Element;
use crate::scene::Extent;
use crate::settings::in_words;

/// The largest obstacle, meters.
const MAX_SIZE_M: f64 = 1e3;

/// The box, along the heading of an obstacle, around all its shapes: rectangles, circles and polygons. Its center is in
/// the frame of the obstacle, x ahead. `None` if it has no shape.
pub(super) fn enclosing(obstacle: &Element) -> Result<Option<(Extent, Vec2)>, Malformed> {
    let shapes = obstacle.find(&["shape"]).into_iter().flat_map(Element::children);
    let mut corners = Vec::new();
    for shape in shapes {
        corners.extend(corners_of(shape)?);
    }
    let Some((least, greatest)) = bounds(&corners) else { return Ok(None) };
    let Vec2 { x: length_m, y: width_m } = greatest - least;
    sized(length_m, width_m)?;
    let center = least.lerp(greatest, 0.5);
    match center.norm() <= MAX_SIZE_M {
        true => Ok(Some((Extent { length_m, width_m }, center))),
        false => Err(format!("has its shape {} m from its position", in_words(center.norm())).into()),
    }
}

/// The corners of a shape, or of the box around it.
fn corners_of(shape: &Element) -> Result<Vec<Vec2>, Malformed> {
    let number = |name: &str| shape.find(&[name]).map_or(Ok(0.0), |_| shape.number(&[name]));
    let (length_m, width_m) = match shape.name.as_str() {
        "rectangle" => (shape.number(&["length"])?, shape.number(&["width"])?),
        "circle" => [2.0 * shape.number(&["radius"])?; 2].into(),
        "polygon" => return shape.all("point").map(point).collect(),
        other => return Err(format!("is a <{other}>, which the format does not list as a shape").into()),
    };
    sized(length_m, width_m)?;
    let center = shape.find(&["center"]).map_or(Ok(Vec2::ZERO), point)?;
    let turned_rad = number("orientation")?;
    let corner = |(x, y): (f64, f64)| center + Vec2::new(x * length_m / 2.0, y * width_m / 2.0).rotated(turned_rad);
    Ok([(1.0, 1.0), (1.0, -1.0), (-1.0, -1.0), (-1.0, 1.0)].map(corner).to_vec())
}

/// Least and greatest coordinates.
fn bounds(points: &[Vec2]) -> Option<(Vec2, Vec2)> {
    points.iter().map(|point| (*point, *point)).reduce(|(least, greatest), (point, _)| {
        let least = Vec2::new(least.x.min(point.x), least.y.min(point.y));
        (least, Vec2::new(greatest.x.max(point.x), greatest.y.max(point.y)))
    })
}

fn sized(length_m: f64, width_m: f64) -> Result<(), Malformed> {
    let is_size = |size_m: f64| size_m > 0.0 && size_m <= MAX_SIZE_M;
    match is_size(length_m) && is_size(width_m) {
        true => Ok(()),
        false => {
            let size = format!("{} by {} m", in_words(length_m), in_words(width_m));
            Err(format!("is {size} in size, expected more than 0 and at most {MAX_SIZE_M}").into())
        }
    }
}
