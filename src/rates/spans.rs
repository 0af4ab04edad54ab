//! Which frames of a recording are known?

use std::ops::Range;

/// A set of frames, as ranges that neither overlap nor touch, by time.
#[derive(Debug, Clone, Default, PartialEq, Eq)]
pub(super) struct Spans(Vec<Range<i64>>);

impl Spans {
    pub(super) fn contains(&self, frame: i64) -> bool {
        let after = self.0.partition_point(|span| span.start <= frame);
        after.checked_sub(1).is_some_and(|at| frame < self.0[at].end)
    }

    /// Adds frames; those that are known may be among them.
    pub(super) fn add(&mut self, frames: Range<i64>) {
        let from = self.0.partition_point(|span| span.end < frames.start);
        let to = self.0.partition_point(|span| span.start <= frames.end);
        let start = self.0.get(from).map_or(frames.start, |first| first.start.min(frames.start));
        let end =
            to.checked_sub(1).and_then(|last| self.0.get(last)).map_or(frames.end, |last| last.end.max(frames.end));
        if from >= to {
            self.0.insert(from, frames);
        } else {
            self.0.drain(from + 1..to);
            self.0[from] = start..end;
        }
    }
}

#[cfg(test)]
#[expect(clippy::single_range_in_vec_init, reason = "the set is one range")]
mod tests {
    use super::*;

    #[test]
    fn ranges_that_overlap_or_touch_become_one() {
        for (added, expected) in [
            (vec![0..4, 4..6], vec![0..6]),
            (vec![10..20, 0..4], vec![0..4, 10..20]),
            (vec![0..4, 10..20, 30..40, 3..35], vec![0..40]),
            (vec![0..40, 5..6], vec![0..40]),
            (vec![0..4, 10..20, 6..8], vec![0..4, 6..8, 10..20]),
        ] {
            let mut spans = Spans::default();
            added.into_iter().for_each(|frames| spans.add(frames));
            assert_eq!(spans.0, expected);
            for frame in -1..45 {
                assert_eq!(spans.contains(frame), expected.iter().any(|span| span.contains(&frame)), "{frame}");
            }
        }
    }
}
