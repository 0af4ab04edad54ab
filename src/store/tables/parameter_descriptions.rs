//! The meaning of the parameters of events, for the descriptions of their columns in files, cards and schemas.
//!
//! The definitions are with the behaviors; some names occur in several behaviors and mean the same in all of them.

/// The parameters by name, sorted.
pub(crate) const DESCRIPTIONS: &[(&str, &str)] = &[
    (
        "bearing_rad",
        "Where the second is as seen from the first before they touch, from 0 to π: ahead, beside, behind.",
    ),
    ("crossing_timestep", "Timestep at which the agent has crossed into the new lane."),
    ("duration_s", "From the event's start to its end."),
    ("ego_length_m", "Length of the ego; nominal where no size is recorded."),
    ("ego_shift_m", "How far the ego moves sideways toward the other, across the lane that it keeps."),
    (
        "ego_speed_mps",
        "Speed of the ego when the other reaches its path (cut-in) or at the reveal (cut-out), or along its lane at \
         the step (pedestrian).",
    ),
    ("end_speed_mps", "Speed at the end."),
    ("entering_speed_mps", "Speed of the entering vehicle when it gets into the way of the one with the right of way."),
    ("first_speed_mps", "Speed of the first of the two when they are closest, or before they touch."),
    (
        "gap_m",
        "Along the ego's path, from its front to the nearest part of the other when that one reaches the path, or of \
         the revealed vehicle at the reveal, or of the pedestrian at the step; negative alongside.",
    ),
    ("heading_change_rad", "How far the agent turns in all; positive to the left."),
    (
        "heading_difference_rad",
        "Difference of the headings when the two are closest, or before they touch, from 0 to π: following, crossing, \
         oncoming.",
    ),
    ("intrusion_timestep", "Timestep at which the other reaches the ego's path."),
    ("lateral_acceleration_mps2", "Mean speed squared per radius of the turn."),
    (
        "lateral_speed_mps",
        "Speed across the ego's path (cut-in) or toward the new lane (lane change), at the crossing.",
    ),
    ("margin_m", "Smallest distance to the side of the lane, of agents that stay in it."),
    (
        "max_deceleration_mps2",
        "Largest smoothed deceleration: of the agent (hard braking), or of the one that is crossed ahead of, from then \
         on.",
    ),
    ("mean_deceleration_mps2", "Mean deceleration from the event's start to its end."),
    ("mean_speed_mps", "Mean speed from the event's start to its end."),
    ("min_distance_m", "Smallest distance of the two boxes at the same time."),
    ("min_speed_mps", "Lowest speed over the last 10 m before the line."),
    ("min_ttc_s", "Smallest time to collision of the two; missing where their courses do not meet within 10 s."),
    ("oncoming_speed_mps", "Speed of the oncoming vehicle when the turner gets into its way."),
    ("other_length_m", "Length of the other; nominal where no size is recorded."),
    ("other_speed_mps", "Speed of the other when it reaches the ego's path."),
    ("path_m", "Length of the path from the event's start to its end."),
    ("pedestrian_speed_mps", "Speed of the pedestrian when it enters the lane."),
    (
        "pet_s",
        "Post-encroachment time. Near miss: the least time between the two being in one place; missing if they never \
         are. Left turn across traffic, failure to yield: from when the first is out of the way to when the other gets \
         there, negative if that is earlier; missing if it stops before.",
    ),
    ("priority_speed_mps", "Speed of the vehicle with the right of way when the other gets into its way."),
    ("radius_m", "Path per change of heading of the turn."),
    (
        "relative_speed_mps",
        "Cut-in and cut-out: the ego's speed less the other's or the revealed one's along the path, positive when \
         closing. Near miss and collision: speed of one seen from the other, when closest or before they touch.",
    ),
    ("revealed_speed_mps", "Speed of the revealed vehicle along the lane at the reveal."),
    ("second_speed_mps", "Speed of the second of the two when they are closest, or before they touch."),
    ("shift_m", "How far the other moves sideways toward the ego's path."),
    (
        "side",
        "Where the other or the pedestrian comes from (cut-in, stepping out), the new lane lies (lane change) or the \
         leader goes (cut-out): +1 left, -1 right.",
    ),
    ("speed_mps", "Speed at the crossing (lane change), at the start (hard braking) or at the line (running a stop)."),
    ("t_ego_s", "When the ego gets to where the other reached its path, since timestep 0."),
    ("t_other_s", "When the other reaches the ego's path, since timestep 0."),
    (
        "time_headway_s",
        "Gap per speed of the ego, missing if it stands or is alongside (cut-in); of the follower, mean over the event \
         (tailgating).",
    ),
    (
        "time_to_arrival_s",
        "Gap per speed of the ego when the pedestrian enters the lane, or of the vehicle that is crossed ahead of when \
         the other gets into its way; missing if it stands.",
    ),
    ("ttc_s", "Gap per relative speed; missing where the two do not close in or are alongside."),
    ("turner_speed_mps", "Speed of the turner when it gets into the way of the oncoming vehicle."),
];

/// The description of a parameter.
pub(crate) fn describe(name: &str) -> &'static str {
    let found = DESCRIPTIONS.iter().find(|(known, _)| *known == name);
    found.map_or("Parameter of an event of a behavior that this version does not know.", |(_, description)| description)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_parameter_of_every_behavior_is_described_and_no_other() {
        let mut names: Vec<&str> =
            crate::behavior::ALL.iter().flat_map(|behavior| behavior.parameters).copied().collect();
        names.sort_unstable();
        names.dedup();
        assert_eq!(DESCRIPTIONS.iter().map(|(name, _)| *name).collect::<Vec<_>>(), names);
    }
}
