//! Closed loops: what happens from the present of a scenario if everybody answers to what the others do?
//!
//! A [`Situation`] is a scenario as a start: its past, its map, and its event. A [`World`] is what was reached from
//! there: the states of everybody, timestep by timestep; it can be saved, and forked. [`roll_out`] drives on: at each
//! replanning the futures of everybody are sampled anew from the last second that was driven, and a part of them comes
//! true; meanwhile a [`Driver`] moves the ego. [`roll_out_samples`] lets the scenarios of a sweep go on so.
//!
//! *The event.* Until it has happened, its other agents follow the scenario's states as a plan, which the model
//! observes; then the model drives them, too. Where the event would not happen as planned, because the ego drives
//! otherwise or keeps its distance, one of these agents drives its path faster or slower from then on; none of them
//! dodges an ego that does not react. An agent that would, within two seconds, drive its front into an ego that is not
//! where the scenario has it gives up its plan for the model, unless the event is a collision. Collisions and near
//! misses stay as they are planned until their end: whether they happen is up to the ego.
//!
//! *What others know of the ego.* Where the model does not drive the ego, the others are sampled around its expected
//! motion: it goes on along its route at its speed, or keeps braking as in the last 0.3 s. They learn otherwise at the
//! next replanning.
//!
//! *Corrections.* An agent that would drive its front into another in the sampled future, or into the ego as expected,
//! brakes on its path instead, and one that strays across the lanes keeps to its own: the model knows little of agents
//! that stand or creep on the road. What a scenario goes on with is drawn again, a few times, where somebody still
//! drives into another or leaves the road; traffic around a planner is drawn once.
//!
//! *Randomness* comes from the seed, the scenario, the timestep of the replanning and the index of the agent: the same
//! world and the same motion of the ego give the same bytes, whatever other drivers are run beside it.
//!
//! *Entering and leaving.* Agents leave when they are more than 10 m from every lane of the map and were not so at
//! present, or, except the ego, when they go where scenes of the place see no traffic any more. Others arrive as in the
//! recording at times that other scenes of it cover, and at other times where traffic of the place comes into sight, as
//! often and as fast: where the gap allows.

mod aim;
mod arrivals;
mod draws;
mod driver;
mod drivers;
mod error;
mod event;
mod maps;
mod modeled;
mod motion;
mod new_scenes;
mod outcome;
mod peek;
mod reaction;
mod rollout;
#[cfg(test)]
mod rollout_tests;
mod situation;
mod sweep;
#[cfg(test)]
pub(crate) mod testing;
mod traffic;
mod workers;
mod world;

pub use driver::{Driver, Failed, Peeker};
pub use error::{Error, Result};
pub use modeled::{FAILURE, LoopFigures, Modeling, RatesConfig, Severity, TESTED_FAILURE};
pub use new_scenes::{AddedConfig, LoopCounts, NewScenes, SituationsConfig, TakeScenes};
pub use outcome::{Contact, Outcome, Side};
pub use rollout::{Driven, Others, RolloutConfig, roll_out};
pub use situation::Situation;
pub use sweep::roll_out_samples;
pub use traffic::{BANDS_S, Traffic};
pub use world::World;

pub(crate) use drivers::{Careful, Log, named};
pub(crate) use event::is_decided_by_ego;
pub(crate) use maps::{Maps, Places};
pub(crate) use modeled::LoopWorker;
pub(crate) use motion::{most_curvature_1pm, moved, plain};
pub(crate) use peek::{MOST_FUTURES, MOST_PEEKS};
pub(crate) use rollout::MOST_HORIZON_S;
pub(crate) use workers::{CHUNK, in_parallel, pool_of_worker};
