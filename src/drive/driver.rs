//! Who moves the ego?

use super::situation::Situation;
use super::world::World;
use crate::scene::{Scene, State};
use serde::{Deserialize, Serialize};
use std::fmt;

/// Samples this many futures of everybody, without advancing.
pub type Peeker<'a> = dyn Fn(usize) -> Result<Vec<Scene>, Failed> + 'a;

/// A driver of the ego. One may drive many scenarios, one after the other.
pub trait Driver: Send {
    /// Begins or continues a drive.
    ///
    /// # Errors
    /// When the driver cannot drive.
    fn begin(&mut self, situation: &Situation, world: &World) -> Result<(), Failed>;

    /// The others have planned; the next `n_steps` timesteps will be driven. The driver may `peek`.
    ///
    /// # Errors
    /// When the driver has no answer.
    fn plan(
        &mut self,
        _situation: &Situation,
        _world: &World,
        _n_steps: usize,
        _peek: &Peeker<'_>,
    ) -> Result<(), Failed> {
        Ok(())
    }

    /// The state of the ego at the next timestep; `sampled` is the one that the model sampled.
    ///
    /// # Errors
    /// When the driver has no answer.
    fn next(&mut self, situation: &Situation, world: &World, sampled: Option<State>) -> Result<State, Failed>;

    /// Whether it is the model, so that others are sampled together with the ego instead of around its expected motion.
    fn is_model(&self) -> bool {
        false
    }

    /// Whether it answers to others, so that they keep the event in aim: a replayed ego cannot undo it.
    fn answers(&self) -> bool {
        true
    }

    /// Ends the drive, with its outcome and the reason.
    fn end(&mut self, _outcome: super::Outcome, _why: Option<&str>) {}
}

/// The failure of a driver.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Failed {
    /// Whether it was too slow.
    pub fault: Fault,
    /// A description of the failure.
    pub why: String,
}

/// The kind of a failure.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Fault {
    /// Too slow.
    TimedOut,
    /// Anything else.
    Failed,
}

impl Failed {
    /// A failure with this reason.
    pub fn because(why: impl Into<String>) -> Self {
        Self { fault: Fault::Failed, why: why.into() }
    }
}

/// The drivers that have a name, and the command of any other.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum EgoDriver {
    /// The model, as for everybody else.
    Model,
    /// The states of the scenario; after its end, straight on along the lane at the last speed.
    Log,
    /// The path of the scenario at the present speed.
    ConstantVelocity,
    /// The path of the scenario by the intelligent driver model.
    Idm,
    /// The careful driver of UN Regulation No. 157 on the path of the scenario.
    Careful,
    /// A planner: a command that speaks the protocol.
    External(String),
}

impl EgoDriver {
    /// The drivers with a name.
    pub const NAMED: [Self; 5] = [Self::Model, Self::Log, Self::ConstantVelocity, Self::Idm, Self::Careful];

    /// The driver with this name; any other text is a command.
    pub fn from_name(name: &str) -> Self {
        let named = Self::NAMED.into_iter().find(|driver| driver.name() == name);
        named.unwrap_or_else(|| Self::External(name.to_owned()))
    }

    /// The name on the command line and in tables.
    pub fn name(&self) -> &str {
        match self {
            Self::Model => "model",
            Self::Log => "log",
            Self::ConstantVelocity => "constant_velocity",
            Self::Idm => "idm",
            Self::Careful => "careful",
            Self::External(command) => command,
        }
    }
}

impl fmt::Display for EgoDriver {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(self.name())
    }
}
