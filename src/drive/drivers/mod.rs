//! The drivers that need no planner.

mod careful;
mod idm;
mod replay;
mod way;

pub(super) use careful::Careful;
pub(super) use idm::{Idm, free_m, reacting};
pub(super) use replay::{AtConstantVelocity, Log, Model, follow_log};
pub(super) use way::expected;
