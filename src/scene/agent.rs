//! Classes of road users, and their sizes.

use crate::settings::named;
use serde::{Deserialize, Serialize};

/// The classes of road users that the source datasets distinguish.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, PartialOrd, Ord, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum AgentClass {
    /// A car or truck; INTERACTION's `car`, Argoverse 2's `vehicle`.
    Vehicle,
    /// Argoverse 2's `bus`.
    Bus,
    /// Argoverse 2's `motorcyclist`.
    Motorcyclist,
    /// Argoverse 2's `cyclist`.
    Cyclist,
    /// Argoverse 2's `pedestrian`.
    Pedestrian,
    /// INTERACTION does not distinguish pedestrians from cyclists.
    PedestrianOrCyclist,
    /// Something that does not move by itself: Argoverse 2's `static`, `background`, `construction`,
    /// `riderless_bicycle`.
    Static,
    /// Not known: all of Argoverse 1.
    Unknown,
}

named! { AgentClass {
    Vehicle = "vehicle", Bus = "bus", Motorcyclist = "motorcyclist", Cyclist = "cyclist", Pedestrian = "pedestrian",
    PedestrianOrCyclist = "pedestrian_or_cyclist", Static = "static", Unknown = "unknown",
} }

impl AgentClass {
    /// Whether the agent drives on lanes, as far as known. Unknown agents count: in Argoverse 1 nearly all are
    /// vehicles.
    pub const fn is_motorized(self) -> bool {
        matches!(self, Self::Vehicle | Self::Bus | Self::Motorcyclist | Self::Unknown)
    }

    /// Whether it takes part in traffic.
    pub const fn is_road_user(self) -> bool {
        !matches!(self, Self::Static)
    }

    /// Whether its heading is recorded. Only INTERACTION has this class, and it records no headings of pedestrians and
    /// cyclists: they are derived from motion, and noise while the agent stands.
    pub const fn has_recorded_heading(self) -> bool {
        !matches!(self, Self::PedestrianOrCyclist)
    }

    /// Whether it is a pedestrian or a rider.
    pub const fn is_vulnerable(self) -> bool {
        matches!(self, Self::Pedestrian | Self::Cyclist | Self::PedestrianOrCyclist)
    }

    /// The nominal extent, if a recording gives none.
    pub const fn nominal_extent(self) -> Extent {
        let (length_m, width_m) = match self {
            Self::Vehicle | Self::Unknown => (4.6, 1.9),
            Self::Bus => (12.0, 2.6),
            Self::Motorcyclist | Self::Cyclist => (2.0, 0.8),
            Self::Pedestrian | Self::PedestrianOrCyclist => (0.75, 0.75),
            Self::Static => (1.0, 1.0),
        };
        Extent { length_m, width_m }
    }

    /// The least extent of the class, if a recording gives none: that of a smart fortwo of 1998 (2.50 by 1.51 m), a
    /// minibus such as the Karsan Jest (5.8 by 2.05 m), a Vespa (1.86 by 0.74 m), a folding bicycle, the trunk of a
    /// small adult, 0.2 m deep and 0.4 m broad, who may look anywhere, and a traffic cone. Unknown agents may be
    /// pedestrians.
    pub const fn least_extent(self) -> Extent {
        let (length_m, width_m) = match self {
            Self::Vehicle => (2.5, 1.5),
            Self::Bus => (5.5, 2.0),
            Self::Motorcyclist => (1.8, 0.7),
            Self::Cyclist => (1.4, 0.4),
            Self::Pedestrian | Self::PedestrianOrCyclist | Self::Static | Self::Unknown => (0.3, 0.3),
        };
        Extent { length_m, width_m }
    }
}

/// Length and width of a road user seen from above.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct Extent {
    /// Along the heading, meters.
    pub length_m: f64,
    /// Across the heading, meters.
    pub width_m: f64,
}
