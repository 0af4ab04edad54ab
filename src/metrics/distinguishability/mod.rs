//! Can generated traffic be told from recordings? Tests a classifier that sees single tracks.
//!
//! The classifier two-sample test (Lopez-Paz and Oquab 2017): gradient-boosted trees learn to tell the generated future
//! of a vehicle from the recorded future of the same agent, by the features of [`features`], and are tested on scenes
//! that they have not seen. The measure is the area under the ROC curve, which is the probability that the trees pick
//! the generated one of a recorded and a generated track: 0.5 is indistinguishable.

mod auc;
mod boosting;
mod features;
mod motion;
#[cfg(test)]
mod tests;
mod two_sample;

pub use auc::Auc;
pub use features::{Feature, FeatureSet, Surroundings, TrackFeatures, features};
pub use two_sample::{MIN_TRACKS, SetAuc, TellingFeature, TrackPair, TwoSampleTest};
