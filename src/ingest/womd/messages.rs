//! What is read and written of the protocol buffers of the dataset's `scenario.proto` and `map.proto`, by their field
//! numbers.
//!
//! Everything else in a message, such as heights and the features of sensors, is passed over.

use prost::{Message, Oneof};

/// The tracks, lights and map of some seconds.
#[derive(Clone, PartialEq, Message)]
pub(crate) struct Scenario {
    #[prost(double, repeated, packed = "false", tag = "1")]
    pub(crate) timestamps_seconds: Vec<f64>,
    #[prost(message, repeated, tag = "2")]
    pub(crate) tracks: Vec<Track>,
    /// Ids of tracks.
    #[prost(int32, repeated, packed = "false", tag = "4")]
    pub(crate) objects_of_interest: Vec<i32>,
    #[prost(string, tag = "5")]
    pub(crate) scenario_id: String,
    #[prost(int32, optional, tag = "6")]
    pub(crate) sdc_track_index: Option<i32>,
    /// One for each timestep.
    #[prost(message, repeated, tag = "7")]
    pub(crate) dynamic_map_states: Vec<DynamicMapState>,
    #[prost(message, repeated, tag = "8")]
    pub(crate) map_features: Vec<MapFeature>,
    /// The present.
    #[prost(int32, optional, tag = "10")]
    pub(crate) current_time_index: Option<i32>,
    #[prost(message, repeated, tag = "11")]
    pub(crate) tracks_to_predict: Vec<RequiredPrediction>,
}

/// A road user, with a state for each timestep.
#[derive(Clone, PartialEq, Message)]
pub(crate) struct Track {
    #[prost(int32, tag = "1")]
    pub(crate) id: i32,
    #[prost(int32, tag = "2")]
    pub(crate) object_type: i32,
    #[prost(message, repeated, tag = "3")]
    pub(crate) states: Vec<ObjectState>,
}

/// Meters, radians, m/s.
#[derive(Clone, Copy, PartialEq, Message)]
pub(crate) struct ObjectState {
    #[prost(double, tag = "2")]
    pub(crate) center_x: f64,
    #[prost(double, tag = "3")]
    pub(crate) center_y: f64,
    #[prost(float, tag = "5")]
    pub(crate) length: f32,
    #[prost(float, tag = "6")]
    pub(crate) width: f32,
    #[prost(float, tag = "8")]
    pub(crate) heading: f32,
    #[prost(float, tag = "9")]
    pub(crate) velocity_x: f32,
    #[prost(float, tag = "10")]
    pub(crate) velocity_y: f32,
    #[prost(bool, tag = "11")]
    pub(crate) valid: bool,
}

#[derive(Clone, Copy, PartialEq, Message)]
pub(crate) struct RequiredPrediction {
    #[prost(int32, tag = "1")]
    pub(crate) track_index: i32,
}

/// The lights at a timestep.
#[derive(Clone, PartialEq, Message)]
pub(crate) struct DynamicMapState {
    #[prost(message, repeated, tag = "1")]
    pub(crate) lane_states: Vec<TrafficSignalLaneState>,
}

#[derive(Clone, Copy, PartialEq, Message)]
pub(crate) struct TrafficSignalLaneState {
    #[prost(int64, tag = "1")]
    pub(crate) lane: i64,
    #[prost(int32, tag = "2")]
    pub(crate) state: i32,
    /// Where to stop: the dataset's maps have it at the beginning of the lane. Only written.
    #[prost(message, optional, tag = "3")]
    pub(crate) stop_point: Option<MapPoint>,
}

#[derive(Clone, PartialEq, Message)]
pub(crate) struct MapFeature {
    #[prost(int64, tag = "1")]
    pub(crate) id: i64,
    #[prost(oneof = "FeatureData", tags = "3, 4, 5, 7, 8")]
    pub(crate) feature_data: Option<FeatureData>,
}

#[derive(Clone, PartialEq, Oneof)]
pub(crate) enum FeatureData {
    #[prost(message, tag = "3")]
    Lane(Box<LaneCenter>),
    #[prost(message, tag = "4")]
    RoadLine(RoadSide),
    #[prost(message, tag = "5")]
    RoadEdge(RoadSide),
    #[prost(message, tag = "7")]
    StopSign(StopSign),
    #[prost(message, tag = "8")]
    Crosswalk(Crosswalk),
}

#[derive(Clone, PartialEq, Message)]
pub(crate) struct LaneCenter {
    #[prost(double, tag = "1")]
    pub(crate) speed_limit_mph: f64,
    #[prost(int32, tag = "2")]
    pub(crate) kind: i32,
    /// Whether it joins two others.
    #[prost(bool, tag = "3")]
    pub(crate) interpolating: bool,
    #[prost(message, repeated, tag = "8")]
    pub(crate) polyline: Vec<MapPoint>,
    #[prost(int64, repeated, tag = "9")]
    pub(crate) entry_lanes: Vec<i64>,
    #[prost(int64, repeated, tag = "10")]
    pub(crate) exit_lanes: Vec<i64>,
    #[prost(message, repeated, tag = "11")]
    pub(crate) left_neighbors: Vec<LaneNeighbor>,
    #[prost(message, repeated, tag = "12")]
    pub(crate) right_neighbors: Vec<LaneNeighbor>,
    #[prost(message, repeated, tag = "13")]
    pub(crate) left_boundaries: Vec<BoundarySegment>,
    #[prost(message, repeated, tag = "14")]
    pub(crate) right_boundaries: Vec<BoundarySegment>,
}

/// A line or an edge of the road.
#[derive(Clone, PartialEq, Message)]
pub(crate) struct RoadSide {
    /// Of a line its mark, of an edge what it is. Only written.
    #[prost(int32, tag = "1")]
    pub(crate) kind: i32,
    #[prost(message, repeated, tag = "2")]
    pub(crate) polyline: Vec<MapPoint>,
}

#[derive(Clone, PartialEq, Message)]
pub(crate) struct StopSign {
    #[prost(int64, repeated, packed = "false", tag = "1")]
    pub(crate) lane: Vec<i64>,
    /// Only written.
    #[prost(message, optional, tag = "2")]
    pub(crate) position: Option<MapPoint>,
}

#[derive(Clone, PartialEq, Message)]
pub(crate) struct Crosswalk {
    /// Its corners in order, the first one not repeated.
    #[prost(message, repeated, tag = "1")]
    pub(crate) polygon: Vec<MapPoint>,
}

/// A lane in the same direction beside a part of a lane, from point to point of both polylines.
#[derive(Clone, Copy, PartialEq, Message)]
pub(crate) struct LaneNeighbor {
    #[prost(int64, tag = "1")]
    pub(crate) feature_id: i64,
    #[prost(int32, tag = "2")]
    pub(crate) self_start_index: i32,
    #[prost(int32, tag = "3")]
    pub(crate) self_end_index: i32,
    #[prost(int32, tag = "4")]
    pub(crate) neighbor_start_index: i32,
    #[prost(int32, tag = "5")]
    pub(crate) neighbor_end_index: i32,
}

/// A line or an edge beside a part of a lane, from point to point of its polyline.
#[derive(Clone, Copy, PartialEq, Message)]
pub(crate) struct BoundarySegment {
    #[prost(int32, tag = "1")]
    pub(crate) lane_start_index: i32,
    #[prost(int32, tag = "2")]
    pub(crate) lane_end_index: i32,
    #[prost(int64, tag = "3")]
    pub(crate) boundary_feature_id: i64,
    /// 0 for edges.
    #[prost(int32, tag = "4")]
    pub(crate) boundary_type: i32,
}

#[derive(Clone, Copy, PartialEq, Message)]
pub(crate) struct MapPoint {
    #[prost(double, tag = "1")]
    pub(crate) x: f64,
    #[prost(double, tag = "2")]
    pub(crate) y: f64,
}
