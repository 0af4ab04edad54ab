//! Driving functions in the loop: what happens in a scenario if everybody answers to what the ego does?
//!
//! A [`Situation`] is a scenario of a corpus as a start: its past, its map, and its event. A [`World`] is what was
//! reached from there: the states of everybody, timestep by timestep; it can be saved, and forked. [`roll_out`] drives
//! on: at each replanning the futures of everybody are sampled anew from the last second that was driven, and a part of
//! them comes true; meanwhile a [`Driver`] moves the ego. [`drive_corpus`] does so for every scenario of a corpus, and
//! drives each with the careful driver of UN Regulation No. 157, too. [`score()`] takes trajectories instead, among
//! others that do not answer.
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
//! *Braking.* An agent that would drive its front into another in the sampled future, or into the ego as expected,
//! brakes on its path instead: the model knows little of agents that stand in the road.
//!
//! *Randomness* comes from the seed, the scenario, the timestep of the replanning and the index of the agent: the same
//! world and the same motion of the ego give the same bytes, whatever other drivers are run beside it.
//!
//! *Entering and leaving.* Agents leave when they are more than 10 m from every lane of the map and were not so at
//! present, or, except the ego, when they go where scenes of the place see no traffic any more. Others arrive as in the
//! recording at times that other scenes of it cover, and at other times where traffic of the place comes into sight, as
//! often and as fast: where the gap allows.

mod action;
mod aim;
mod arrivals;
mod bends;
mod driver;
mod drivers;
mod error;
mod event;
mod external;
mod kept;
mod maps;
mod margin;
mod outcome;
mod page;
mod peek;
mod process;
pub mod protocol;
mod reaction;
mod report;
mod rollout;
#[cfg(test)]
mod rollout_tests;
mod run;
mod score;
mod situation;
mod sweep;
#[cfg(test)]
mod testing;
mod told_apart;
mod traffic;
mod workers;
mod world;

pub use driver::{Driver, EgoDriver, Failed, Peeker};
pub use error::{Error, Result};
pub use margin::{DelaySurvived, Margin, Margins};
pub use outcome::{Contact, Outcome, Side};
pub use process::kill_planners;
pub use report::{DriveReport, Failures, Matters, Part};
pub use rollout::{Driven, Others, RolloutConfig, roll_out};
pub use run::{
    DRIVE_FILE, DRIVE_PAGE, DRIVEN_FILE, DRIVES_FILE, DriveConfig, Origin, PLANNER_LOG, STATES_DIR, SaveAt,
    drive_corpus,
};
pub use score::score;
pub use situation::Situation;
pub use sweep::roll_out_samples;
pub use told_apart::ToldApart;
pub use traffic::{BANDS_S, Traffic};
pub use world::World;
