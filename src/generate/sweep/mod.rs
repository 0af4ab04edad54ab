//! The settings of a sweep: as written ([`SweepConfig`], and [`ArmConfig`] without what a request decides), and
//! resolved into what can be sampled ([`ResolvedSweep`]).

mod config;
mod keys;
mod level;
mod resolve;
mod resolved;
mod settings;

pub use config::{
    Aim, ArmConfig, ClassifierInput, ClassifierScope, DiffusionConfig, ModelConfig, SamplingConfig, SweepConfig,
    SweepGuidance,
};
pub(super) use resolve::mined;
pub use resolved::{Diffusion, ResolvedSweep, SweepModel};
