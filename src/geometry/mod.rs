//! Plane geometry in meters and radians, `f64`, without any input or output: how are points, frames, paths and boxes
//! related?

mod angle;
pub(crate) mod footprint;
mod oriented_box;
mod path;
mod polyline;
mod segment_index;
mod transform;
mod vec2;

pub use angle::{angle_difference, unwrap_angles, wrap_angle};
pub use oriented_box::OrientedBox;
pub use path::Path;
pub use polyline::{Polyline, Projection};
pub use segment_index::SegmentIndex;
pub use transform::Transform2;
pub use vec2::Vec2;
