//! The settings of a sweep: as written ([`SweepConfig`]; arms lack the keys that are up to a request), and resolved
//! into what can be sampled ([`ResolvedSweep`]).

mod conditions;
mod config;
mod level;
mod resolve;
mod resolved;
mod settings;

pub use conditions::{ClassifierFreeConfig, EditConfig};
pub use config::{Aim, ClassifierScope, SampledModel, SweepConfig};
pub(super) use resolve::mined;
pub use resolved::{Diffusion, ResolvedSweep, SweepGuidance, SweepModel};
