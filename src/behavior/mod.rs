//! Behaviors worth finding in traffic: does this scene hold a cut-in, and who took part?

mod event;

pub use event::{BehaviorEvent, EventLabel};

use crate::scene::Scene;

/// A behavior with a definition that can be checked on any scene, recorded or generated.
pub trait Behavior: Send + Sync {
    /// Its name in configs and tables, such as `cut_in`.
    fn id(&self) -> &'static str;
    /// The roles of an event, in the order in which events list them.
    fn roles(&self) -> &'static [&'static str];
    /// All events of the scene, positive and (where the behavior defines them) hard negative, in a fixed order.
    fn detect(&self, scene: &Scene) -> Vec<BehaviorEvent>;
}
