//! How often does something happen? Exposure and events of recordings, every moment and every event once, and rates.
//!
//! [`SceneExposure`] is what a scene shows of whom, [`ExposureTally`] adds up scenes that overlap, in windows of one
//! recording or in two recordings of the same minute. [`RecordedTraffic`] has what was counted, and gives rates.
//! [`ModeledTraffic`] is what closed loops of the unguided model show; [`ModeledRates`] compares both before it gives
//! any.

mod calibration;
mod exposure;
mod modeled;
mod occurrences;
mod rate;
mod recorded;
mod spans;
mod tail;

pub use calibration::{Calibration, ModeledRates};
pub use exposure::{ExposureTally, SceneExposure, ShownScene};
pub use modeled::{ModeledEvent, ModeledLoop, ModeledTraffic};
pub use occurrences::{Numbered, OccurrenceTally};
pub use rate::{BucketRate, RateMethod, RateRow, RateSource, Within};
pub use recorded::{Asked, RecordedTraffic};

use crate::scene::{AgentClass, Dataset, Split};

/// The classes of road users whose exposure is counted.
pub const CLASSES: [AgentClass; 7] = [
    AgentClass::Vehicle,
    AgentClass::Bus,
    AgentClass::Motorcyclist,
    AgentClass::Cyclist,
    AgentClass::Pedestrian,
    AgentClass::PedestrianOrCyclist,
    AgentClass::Unknown,
];

/// What a recording shows, moments that an earlier one shows as well left out.
#[derive(Debug, Clone, PartialEq)]
pub struct ExposureRow {
    /// Its dataset.
    pub dataset: Dataset,
    /// Its place.
    pub place: String,
    /// Its split; the splits of one file are recordings of their own.
    pub split: Split,
    /// Its name: that of its scenes without their first frame, or that of its only scene.
    pub recording: String,
    /// The first recording with which it shares moments, directly or through others: its events come with theirs.
    pub shares_with: Option<String>,
    /// Scenes that are windows of it.
    pub n_scenes: u64,
    /// Time in which a scene shows the place, hours.
    pub observed_h: f64,
    /// Time of all road users of each class, hours, in the order of [`CLASSES`].
    pub class_h: [f64; CLASSES.len()],
    /// Their ways, kilometers.
    pub class_km: [f64; CLASSES.len()],
}

impl ExposureRow {
    /// The way of all motorized road users, and of those who may be, kilometers.
    pub fn motorized_km(&self) -> f64 {
        CLASSES.iter().zip(self.class_km).filter(|(class, _)| class.is_motorized()).map(|(_, km)| km).sum()
    }
}
