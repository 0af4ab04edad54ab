//! The box of an agent over time, and a quick search for the timesteps at which two agents' boxes meet.
//!
//! Every search is exact. Rectangles around the boxes of a few consecutive timesteps only rule out what cannot be.

use super::footprint::{Bounds, Footprint};
use crate::scene::Track;
use std::ops::Range;

/// Timesteps that share one rectangle: few enough for it to be tight, enough to save tests.
const BLOCK_LEN: usize = 5;

/// The boxes of one agent, one entry a timestep.
#[derive(Debug, Clone)]
pub(crate) struct SweptBoxes {
    footprints: Vec<Option<Footprint>>,
    blocks: Vec<Option<Bounds>>,
    bounds: Bounds,
}

impl SweptBoxes {
    /// The boxes of `track` at all timesteps at which it is tracked with finite numbers. `None` when there are none.
    pub(crate) fn new(track: &Track) -> Option<Self> {
        let footprint = |state: &crate::scene::State| Footprint::new(&track.footprint(state));
        let footprints: Vec<Option<Footprint>> = track
            .trajectory
            .entries()
            .iter()
            .map(|state| state.as_ref().filter(|s| s.is_finite()).map(footprint))
            .collect();
        let blocks: Vec<Option<Bounds>> = footprints
            .chunks(BLOCK_LEN)
            .map(|block| block.iter().flatten().map(|f| f.bounds).reduce(Bounds::union))
            .collect();
        let bounds = blocks.iter().flatten().copied().reduce(Bounds::union)?;
        Some(Self { footprints, blocks, bounds })
    }

    /// The box at `timestep`.
    pub(crate) fn at(&self, timestep: usize) -> Option<&Footprint> {
        self.footprints.get(timestep).and_then(Option::as_ref)
    }

    /// Whether the agents may at any two timesteps come within `gap_m`; false only if they certainly do not.
    pub(crate) fn may_come_within(&self, other: &Self, gap_m: f64) -> bool {
        self.bounds.is_within(&other.bounds, gap_m)
    }

    /// The boxes at `timesteps` that may lie within `gap_m` of `bounds`, with their timesteps, in order.
    fn near(
        &self,
        timesteps: Range<usize>,
        bounds: Bounds,
        gap_m: f64,
    ) -> impl Iterator<Item = (usize, &Footprint)> + '_ {
        let end = timesteps.end.min(self.footprints.len());
        let first_block = timesteps.start / BLOCK_LEN;
        (first_block..end.div_ceil(BLOCK_LEN).max(first_block))
            .filter(move |block| self.blocks[*block].is_some_and(|b| b.is_within(&bounds, gap_m)))
            .flat_map(move |block| (block * BLOCK_LEN).max(timesteps.start)..((block + 1) * BLOCK_LEN).min(end))
            .filter_map(|timestep| self.footprints[timestep].as_ref().map(|footprint| (timestep, footprint)))
    }

    /// Whether `footprint` overlaps the agent's box at any of `timesteps`.
    pub(crate) fn overlaps_any(&self, footprint: &Footprint, timesteps: Range<usize>) -> bool {
        self.bounds.is_within(&footprint.bounds, 0.0)
            && self.near(timesteps, footprint.bounds, 0.0).any(|(_, own)| own.overlaps(footprint))
    }

    /// The timesteps (`leader`'s, the own one) at which the own box covers ground that `leader` covered 1 to
    /// `max_delay` timesteps earlier, both within `timesteps` and `accept`ed: the pair with the earliest timestep of
    /// `leader`, and among those with the earliest own timestep.
    pub(crate) fn first_overlap_after(
        &self,
        leader: &Self,
        timesteps: Range<usize>,
        max_delay: usize,
        accept: impl Fn(usize, usize) -> bool,
    ) -> Option<(usize, usize)> {
        leader.near(timesteps.clone(), self.bounds, 0.0).find_map(|(leader_timestep, footprint)| {
            let later = leader_timestep + 1..timesteps.end.min(leader_timestep + max_delay + 1);
            self.near(later, footprint.bounds, 0.0)
                .find(|(timestep, own)| own.overlaps(footprint) && accept(leader_timestep, *timestep))
                .map(|(timestep, _)| (leader_timestep, timestep))
        })
    }

    /// Whether the boxes are less than `limit_m` apart at any two of `timesteps`, equal or not.
    pub(crate) fn comes_within(&self, other: &Self, timesteps: Range<usize>, limit_m: f64) -> bool {
        if !self.may_come_within(other, limit_m) {
            return false;
        }
        // Pairs that are close at all are usually close at the same time, which is faster to test.
        self.comes_within_at_same_time(other, timesteps.clone(), limit_m)
            || self.near(timesteps.clone(), other.bounds, limit_m).any(|(_, own)| {
                other
                    .near(timesteps.clone(), own.bounds, limit_m)
                    .any(|(_, theirs)| own.is_closer_than(theirs, limit_m))
            })
    }

    /// Whether the boxes are less than `limit_m` apart at the same one of `timesteps`.
    pub(crate) fn comes_within_at_same_time(&self, other: &Self, timesteps: Range<usize>, limit_m: f64) -> bool {
        self.may_come_within(other, limit_m)
            && self.both_at(other, timesteps).any(|(_, own, theirs)| own.is_closer_than(theirs, limit_m))
    }

    /// The boxes of both agents at the `timesteps` at which both are tracked.
    pub(crate) fn both_at<'a>(
        &'a self,
        other: &'a Self,
        timesteps: Range<usize>,
    ) -> impl Iterator<Item = (usize, &'a Footprint, &'a Footprint)> {
        timesteps.filter_map(|timestep| Some((timestep, self.at(timestep)?, other.at(timestep)?)))
    }

    /// Smallest distance between the boxes at the same one of `timesteps`, meters, with the first timestep at which
    /// it is reached. `None` when the agents are never tracked together.
    pub(crate) fn min_distance_m(&self, other: &Self, timesteps: Range<usize>) -> Option<(f64, usize)> {
        let mut closest: Option<(f64, usize)> = None;
        for (timestep, own, theirs) in self.both_at(other, timesteps) {
            if closest.is_none_or(|(least, _)| own.distance_lower_bound_m(theirs) < least) {
                let distance_m = own.distance_m(theirs);
                if closest.is_none_or(|(least, _)| distance_m < least) {
                    closest = Some((distance_m, timestep));
                }
            }
        }
        closest
    }
}
