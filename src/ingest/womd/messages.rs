//! What is read of the protocol buffers of the dataset's `scenario.proto` and `map.proto`, by their field numbers.
//!
//! Everything else in a message, such as heights, crosswalks and the features of sensors, is passed over.

use prost::{Message, Oneof};

/// The tracks, lights and map of some seconds.
#[derive(Clone, PartialEq, Message)]
pub(super) struct Scenario {
    #[prost(double, repeated, packed = "false", tag = "1")]
    pub(super) timestamps_seconds: Vec<f64>,
    #[prost(message, repeated, tag = "2")]
    pub(super) tracks: Vec<Track>,
    /// Ids of tracks.
    #[prost(int32, repeated, packed = "false", tag = "4")]
    pub(super) objects_of_interest: Vec<i32>,
    #[prost(string, tag = "5")]
    pub(super) scenario_id: String,
    #[prost(int32, optional, tag = "6")]
    pub(super) sdc_track_index: Option<i32>,
    /// One for each timestep.
    #[prost(message, repeated, tag = "7")]
    pub(super) dynamic_map_states: Vec<DynamicMapState>,
    #[prost(message, repeated, tag = "8")]
    pub(super) map_features: Vec<MapFeature>,
    /// The present.
    #[prost(int32, optional, tag = "10")]
    pub(super) current_time_index: Option<i32>,
    #[prost(message, repeated, tag = "11")]
    pub(super) tracks_to_predict: Vec<RequiredPrediction>,
}

/// A road user, with a state for each timestep.
#[derive(Clone, PartialEq, Message)]
pub(super) struct Track {
    #[prost(int32, tag = "1")]
    pub(super) id: i32,
    #[prost(int32, tag = "2")]
    pub(super) object_type: i32,
    #[prost(message, repeated, tag = "3")]
    pub(super) states: Vec<ObjectState>,
}

/// Meters, radians, m/s.
#[derive(Clone, Copy, PartialEq, Message)]
pub(super) struct ObjectState {
    #[prost(double, tag = "2")]
    pub(super) center_x: f64,
    #[prost(double, tag = "3")]
    pub(super) center_y: f64,
    #[prost(float, tag = "5")]
    pub(super) length: f32,
    #[prost(float, tag = "6")]
    pub(super) width: f32,
    #[prost(float, tag = "8")]
    pub(super) heading: f32,
    #[prost(float, tag = "9")]
    pub(super) velocity_x: f32,
    #[prost(float, tag = "10")]
    pub(super) velocity_y: f32,
    #[prost(bool, tag = "11")]
    pub(super) valid: bool,
}

#[derive(Clone, Copy, PartialEq, Message)]
pub(super) struct RequiredPrediction {
    #[prost(int32, tag = "1")]
    pub(super) track_index: i32,
}

/// The lights at a timestep.
#[derive(Clone, PartialEq, Message)]
pub(super) struct DynamicMapState {
    #[prost(message, repeated, tag = "1")]
    pub(super) lane_states: Vec<TrafficSignalLaneState>,
}

#[derive(Clone, Copy, PartialEq, Message)]
pub(super) struct TrafficSignalLaneState {
    #[prost(int64, tag = "1")]
    pub(super) lane: i64,
    #[prost(int32, tag = "2")]
    pub(super) state: i32,
}

#[derive(Clone, PartialEq, Message)]
pub(super) struct MapFeature {
    #[prost(int64, tag = "1")]
    pub(super) id: i64,
    #[prost(oneof = "FeatureData", tags = "3, 4, 5, 7")]
    pub(super) feature_data: Option<FeatureData>,
}

#[derive(Clone, PartialEq, Oneof)]
pub(super) enum FeatureData {
    #[prost(message, tag = "3")]
    Lane(Box<LaneCenter>),
    #[prost(message, tag = "4")]
    RoadLine(RoadSide),
    #[prost(message, tag = "5")]
    RoadEdge(RoadSide),
    #[prost(message, tag = "7")]
    StopSign(StopSign),
}

#[derive(Clone, PartialEq, Message)]
pub(super) struct LaneCenter {
    #[prost(double, tag = "1")]
    pub(super) speed_limit_mph: f64,
    #[prost(int32, tag = "2")]
    pub(super) kind: i32,
    /// Whether it joins two others.
    #[prost(bool, tag = "3")]
    pub(super) interpolating: bool,
    #[prost(message, repeated, tag = "8")]
    pub(super) polyline: Vec<MapPoint>,
    #[prost(int64, repeated, tag = "9")]
    pub(super) entry_lanes: Vec<i64>,
    #[prost(int64, repeated, tag = "10")]
    pub(super) exit_lanes: Vec<i64>,
    #[prost(message, repeated, tag = "11")]
    pub(super) left_neighbors: Vec<LaneNeighbor>,
    #[prost(message, repeated, tag = "12")]
    pub(super) right_neighbors: Vec<LaneNeighbor>,
    #[prost(message, repeated, tag = "13")]
    pub(super) left_boundaries: Vec<BoundarySegment>,
    #[prost(message, repeated, tag = "14")]
    pub(super) right_boundaries: Vec<BoundarySegment>,
}

/// A line or an edge of the road.
#[derive(Clone, PartialEq, Message)]
pub(super) struct RoadSide {
    #[prost(message, repeated, tag = "2")]
    pub(super) polyline: Vec<MapPoint>,
}

#[derive(Clone, PartialEq, Message)]
pub(super) struct StopSign {
    #[prost(int64, repeated, packed = "false", tag = "1")]
    pub(super) lane: Vec<i64>,
}

/// A lane in the same direction beside a part of a lane, from point to point of both polylines.
#[derive(Clone, Copy, PartialEq, Message)]
pub(super) struct LaneNeighbor {
    #[prost(int64, tag = "1")]
    pub(super) feature_id: i64,
    #[prost(int32, tag = "2")]
    pub(super) self_start_index: i32,
    #[prost(int32, tag = "3")]
    pub(super) self_end_index: i32,
    #[prost(int32, tag = "4")]
    pub(super) neighbor_start_index: i32,
    #[prost(int32, tag = "5")]
    pub(super) neighbor_end_index: i32,
}

/// A line or an edge beside a part of a lane, from point to point of its polyline.
#[derive(Clone, Copy, PartialEq, Message)]
pub(super) struct BoundarySegment {
    #[prost(int32, tag = "1")]
    pub(super) lane_start_index: i32,
    #[prost(int32, tag = "2")]
    pub(super) lane_end_index: i32,
    #[prost(int64, tag = "3")]
    pub(super) boundary_feature_id: i64,
    /// 0 for edges.
    #[prost(int32, tag = "4")]
    pub(super) boundary_type: i32,
}

#[derive(Clone, Copy, PartialEq, Message)]
pub(super) struct MapPoint {
    #[prost(double, tag = "1")]
    pub(super) x: f64,
    #[prost(double, tag = "2")]
    pub(super) y: f64,
}
