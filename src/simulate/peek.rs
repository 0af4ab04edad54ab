//! Samples possible futures of everybody, without advancing.

use super::reaction::brake;
use super::{Error, Failed, Result, Situation, World};
use crate::generate::{Continued, Futures};
use crate::scene::Scene;
use std::ops::Range;

/// The most futures of one request, and the most requests before an action.
pub(crate) const MOST_FUTURES: usize = 64;
pub(crate) const MOST_PEEKS: usize = 8;

/// Futures from the last second, without knowledge of the plans of the event, and with noise that no real replanning
/// uses: those with these numbers among all that are drawn now.
pub(super) fn peek(
    situation: &Situation,
    world: &World,
    futures: &Futures<'_>,
    numbers: Range<usize>,
) -> Result<Vec<Scene>, Failed> {
    let (scene, mask) = situation.window(world, None, false, [futures.n_history(), futures.n_timesteps()]);
    let name = format!("{} peek", world.stream(futures.seed()));
    let (center_idx, step) = (situation.ego_idx, world.now() * MOST_FUTURES * MOST_PEEKS + numbers.start);
    let asked = Continued { scene: &scene, mask: &mask, center_idx, name: &name, step };
    let drawn = futures.several(&asked, numbers.len()).map_err(Error::from)?;
    let everybody: Vec<usize> = (0..world.n_tracks()).collect();
    let braked = drawn.into_iter().map(|future| {
        let unfit = |unfit| Failed::NotSampled(format!("the model has no futures to peek into: {unfit}"));
        let mut future = future.map_err(unfit)?;
        brake(situation, &mut future, &everybody);
        Ok(future)
    });
    braked.collect()
}
