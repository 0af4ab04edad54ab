//! The definition of near misses, and its options.

use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

/// Smallest difference of velocities of two that pass each other closely, m/s: less is overtaking in the next lane.
pub(super) const MIN_PASSING_MPS: f64 = 8.0;
/// Smallest deceleration that avoids the collision on a collision course, m/s²: less is ordinary stopping behind each
/// other.
const MIN_DRAC_MPS2: f64 = 3.4;
/// How far boxes must overlap on a collision course or in a crossing, meters; at most half their size. Less is grazing,
/// for which courses are not known precisely enough.
pub(super) const MIN_OVERLAP_M: f64 = 0.5;
/// Boxes that come closer than this without a near miss are a hard negative, meters.
const NEGATIVE_DISTANCE_M: f64 = 2.0;
/// Boxes on a collision course are a hard negative up to this multiple of the time to collision of a near miss.
const NEGATIVE_TTC_FACTOR: f64 = 2.0;

/// An agent slower than this stands, m/s: errors of tracks reach this speed.
pub(super) const MIN_SPEED_MPS: f64 = 1.0;

/// Two road users (`first` and `second`) barely avoid each other.
///
/// **Positive**: at some timestep of the scene, any of
///
/// - The boxes would overlap by 0.5 m if both kept their velocities and headings, and also if both continued at these
///   speeds along the paths that they drive (an agent that waits beside a bend is in nobody's way), and would touch in
///   less than 1.5 s. Avoiding it takes a deceleration of at least 3.4 m/s² (DRAC: the relative speed divided by twice
///   that time). Both are tracked until then, because the motion after the last state is unknown. At least one of the
///   two moves at 1 m/s or more.
/// - One is where the other was less than 0.5 s before: the boxes of these two timesteps overlap by 0.5 m, and both
///   move at 1 m/s or more. Their courses differ there by at least 30 degrees, and so does each course from the path
///   that the other drives through this place: an agent that follows another around a bend or merges behind it does not
///   cross it.
/// - The boxes are less than 0.2 m apart, their velocities differ by at least 8 m/s, and the sizes of both are
///   recorded.
///
/// The event *starts* at the first such timestep and is *complete* at the last one, with or without breaks between.
///
/// *What does not count*: pairs whose boxes overlap at any timestep, which are collisions; two standing agents; static
/// objects; following and driving side by side, however long; passing in the next lane; grazing courses; stopping in
/// good time, however close; agents of unrecorded size.
///
/// **Negative**: boxes that come closer than 2 m, or whose time to collision in the first sense is less than 3 s,
/// without meeting the stricter limits.
///
/// Parameters over the whole scene: `min_distance_m`, `min_ttc_s` (absent where the courses do not meet within 10 s),
/// `pet_s` (post-encroachment time: the shortest time between one and the other covering the same place; absent if they
/// never do). At the closest timestep: `relative_speed_mps`, `first_speed_mps`, `second_speed_mps`,
/// `heading_difference_rad` (0 to π: following, crossing, oncoming).
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(default, deny_unknown_fields)]
pub struct NearMiss {
    /// Whether only road users of recorded size take part. Default true. If false, the others take part with half their
    /// nominal length and width; their tracks usually cannot separate near misses from noise.
    pub recorded_sizes: bool,
    /// Boxes that pass each other closer than this are a near miss, meters. Default 0.2, at which mirrors touch; in
    /// dense traffic 1 m is usual. Applies only to road users of recorded size.
    #[schemars(range(min = 0.0))]
    pub max_distance_m: f64,
    /// Boxes on a collision course with less time to collision than this are a near miss, seconds. Default 1.5.
    #[schemars(range(min = 0.0, max = 100.0))]
    pub max_ttc_s: f64,
    /// Crossing a place less than this after the other, on a different course, is a near miss, seconds. Default 0.5:
    /// turning off a second behind an oncoming vehicle is usual.
    #[schemars(range(min = 0.0, max = 100.0))]
    pub max_pet_s: f64,
}

impl Default for NearMiss {
    fn default() -> Self {
        Self { recorded_sizes: true, max_distance_m: 0.2, max_ttc_s: 1.5, max_pet_s: 0.5 }
    }
}

impl NearMiss {
    /// Boxes that come closer than this are a hard negative at least, meters.
    pub(super) const fn negative_distance_m(&self) -> f64 {
        NEGATIVE_DISTANCE_M.max(self.max_distance_m)
    }

    /// Boxes on a collision course with less time than this to go are a hard negative at least, seconds.
    pub(super) fn negative_ttc_s(&self) -> f64 {
        NEGATIVE_TTC_FACTOR * self.max_ttc_s
    }

    /// Whether a collision in `time_s` is imminent, and hard to avoid at this relative speed.
    pub(in crate::behavior) fn is_urgent(&self, time_s: f64, relative_mps: f64) -> bool {
        time_s < self.max_ttc_s && relative_mps >= 2.0 * time_s * MIN_DRAC_MPS2
    }
}
