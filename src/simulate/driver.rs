//! Who moves the ego?

use super::situation::Situation;
use super::world::World;
use super::{Error, Outcome};
use crate::scene::{Scene, State};

/// Samples this many futures of everybody, without advancing.
pub type Peeker<'a> = dyn Fn(usize) -> Result<Vec<Scene>, Failed> + 'a;

/// A driver of the ego. One may drive many scenarios, one after the other.
pub trait Driver: Send {
    /// Begins or continues a drive.
    fn begin(&mut self, situation: &Situation, world: &World) -> Result<(), Failed>;

    /// The others have planned; the next `n_steps` timesteps will be driven. The driver may `peek`.
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
    fn next(&mut self, situation: &Situation, world: &World, sampled: Option<State>) -> Result<State, Failed>;

    /// Whether it is the model, so that others are sampled together with the ego instead of around its expected motion.
    fn is_model(&self) -> bool {
        false
    }

    /// Whether it answers to others, so that they keep the event in aim: a replayed ego cannot undo it.
    fn answers(&self) -> bool {
        true
    }

    /// Ends the drive, with its outcome and the reason. Returns what the driver has said to people meanwhile.
    fn end(&mut self, _outcome: Outcome, _why: Option<&str>) -> String {
        String::new()
    }
}

/// Why a driver does not drive on, with the reason for people.
#[derive(Debug)]
pub enum Failed {
    /// It is too slow.
    TimedOut(String),
    /// Anything else that it does wrong.
    Driver(String),
    /// The model has no future that it asks for.
    NotSampled(String),
    /// What ends the drives of all scenarios.
    Error(Error),
}

impl Failed {
    /// A failure of the driver.
    pub fn because(why: impl Into<String>) -> Self {
        Self::Driver(why.into())
    }
}

impl From<Error> for Failed {
    fn from(error: Error) -> Self {
        Self::Error(error)
    }
}
