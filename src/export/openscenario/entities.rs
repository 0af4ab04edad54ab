//! Road users as entities: category, box, axles.

use crate::export::text::number;
use crate::export::xml::{Element, element};
use crate::geometry::Vec2;
use crate::scene::{AgentClass, Extent, State, Track};

/// The wheelbase of a vehicle as a share of its length; axles are symmetric.
const WHEELBASE_SHARE: f64 = 0.6;
const WHEEL_DIAMETER_M: f64 = 0.65;
const MAX_STEERING_RAD: f64 = 0.6;
/// Beyond any trajectory, so that players do not slow vehicles down.
const MAX_SPEED_MPS: f64 = 100.0;
const MAX_ACCELERATION_MPS2: f64 = 20.0;

/// The body of an entity.
#[derive(Debug, Clone)]
pub(super) struct Body {
    class: AgentClass,
    extent: Extent,
    track_id: String,
}

/// The category of an entity.
enum Kind {
    Vehicle(&'static str),
    Pedestrian,
    Object,
}

impl Body {
    pub(super) fn of(track: &Track) -> Self {
        Self { class: track.class, extent: track.extent_or_nominal(), track_id: track.id.0.clone() }
    }

    /// The position of the entity's reference point when its center is in `state`: the middle of the rear axle of a
    /// vehicle, the center of others.
    pub(super) fn reference_point(&self, state: &State) -> Vec2 {
        state.position - Vec2::from_angle(state.heading_rad) * self.center_ahead_m()
    }

    /// The distance of the center ahead of the reference point.
    fn center_ahead_m(&self) -> f64 {
        match self.kind() {
            Kind::Vehicle(_) => 0.5 * WHEELBASE_SHARE * self.extent.length_m,
            Kind::Pedestrian | Kind::Object => 0.0,
        }
    }

    const fn kind(&self) -> Kind {
        match self.class {
            AgentClass::Vehicle | AgentClass::Unknown => Kind::Vehicle("car"),
            AgentClass::Bus => Kind::Vehicle("bus"),
            AgentClass::Motorcyclist => Kind::Vehicle("motorbike"),
            AgentClass::Cyclist => Kind::Vehicle("bicycle"),
            AgentClass::Pedestrian | AgentClass::PedestrianOrCyclist => Kind::Pedestrian,
            AgentClass::Static => Kind::Object,
        }
    }

    /// The nominal height of its class; none is recorded.
    const fn height_m(&self) -> f64 {
        match self.class {
            AgentClass::Vehicle | AgentClass::Unknown => 1.5,
            AgentClass::Bus => 3.0,
            AgentClass::Motorcyclist | AgentClass::Cyclist => 1.7,
            AgentClass::Pedestrian | AgentClass::PedestrianOrCyclist => 1.75,
            AgentClass::Static => 1.0,
        }
    }

    /// The description of an entity of this name.
    pub(super) fn element(&self, name: &str) -> Element {
        let property = |name: &str, value: &str| element("Property").attr("name", name).attr("value", value);
        let properties = element("Properties")
            .child(property("track_id", &self.track_id))
            .child(property("class", self.class.name()));
        match self.kind() {
            Kind::Vehicle(category) => element("Vehicle")
                .attr("name", name)
                .attr("vehicleCategory", category)
                .child(self.bounding_box())
                .child(performance())
                .child(self.axles())
                .child(properties),
            Kind::Pedestrian => element("Pedestrian")
                .attr("name", name)
                .attr("mass", 75)
                .attr("pedestrianCategory", "pedestrian")
                .child(self.bounding_box())
                .child(properties),
            Kind::Object => element("MiscObject")
                .attr("name", name)
                .attr("mass", 100)
                .attr("miscObjectCategory", "obstacle")
                .child(self.bounding_box())
                .child(properties),
        }
    }

    fn bounding_box(&self) -> Element {
        let height_m = self.height_m();
        let center =
            element("Center").attr("x", number(self.center_ahead_m())).attr("y", "0").attr("z", number(0.5 * height_m));
        let dimensions = element("Dimensions")
            .attr("width", number(self.extent.width_m))
            .attr("length", number(self.extent.length_m))
            .attr("height", number(height_m));
        element("BoundingBox").child(center).child(dimensions)
    }

    fn axles(&self) -> Element {
        let axle = |name, ahead_m: f64, max_steering_rad: f64| {
            element(name)
                .attr("maxSteering", number(max_steering_rad))
                .attr("wheelDiameter", number(WHEEL_DIAMETER_M))
                .attr("trackWidth", number(self.extent.width_m))
                .attr("positionX", number(ahead_m))
                .attr("positionZ", number(0.5 * WHEEL_DIAMETER_M))
        };
        element("Axles")
            .child(axle("FrontAxle", 2.0 * self.center_ahead_m(), MAX_STEERING_RAD))
            .child(axle("RearAxle", 0.0, 0.0))
    }
}

fn performance() -> Element {
    element("Performance")
        .attr("maxSpeed", number(MAX_SPEED_MPS))
        .attr("maxAcceleration", number(MAX_ACCELERATION_MPS2))
        .attr("maxDeceleration", number(MAX_ACCELERATION_MPS2))
}
