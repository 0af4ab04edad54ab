//! The drivers that need no planner.

mod ahead;
mod careful;
mod idm;
mod replay;
mod way;

pub(super) use ahead::ahead;
pub(crate) use careful::Careful;
pub(super) use idm::{Idm, free_m};
pub(crate) use replay::Log;
pub(super) use replay::{AtConstantVelocity, Model};
pub(super) use way::expected;

use super::Driver;
use crate::generate::NamedDriver;

/// The driver of this name, at the start of a drive.
pub(crate) fn named(driver: NamedDriver) -> Box<dyn Driver> {
    match driver {
        NamedDriver::Model => Box::new(Model),
        NamedDriver::Log => Box::new(Log),
        NamedDriver::ConstantVelocity => Box::new(AtConstantVelocity),
        NamedDriver::Idm => Box::new(Idm),
        NamedDriver::Careful => Box::new(Careful::default()),
    }
}
