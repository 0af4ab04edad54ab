//! Which of many segments is nearest to a point?

use super::Vec2;
use std::ops::Range;

/// Entries that one rectangle holds.
const N_TOGETHER: usize = 8;

/// Rectangles around runs of segments, runs of these rectangles, and so on, with which a search skips what is too far.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct SegmentIndex {
    n_segments: usize,
    /// The rectangles (least x and y, greatest x and y), around segments first.
    levels: Vec<Vec<[f64; 4]>>,
}

impl SegmentIndex {
    /// An index of segments, each given by its ends. Search is quick if neighbors in the list are near each other.
    pub fn new(segments: impl IntoIterator<Item = [Vec2; 2]>) -> Self {
        let around = |[a, b]: [Vec2; 2]| [a.x.min(b.x), a.y.min(b.y), a.x.max(b.x), a.y.max(b.y)];
        let mut boxes: Vec<[f64; 4]> = segments.into_iter().map(around).collect();
        let (n_segments, mut levels) = (boxes.len(), Vec::new());
        while boxes.len() > 1 || levels.is_empty() {
            boxes = boxes.chunks(N_TOGETHER).map(union).collect();
            levels.push(boxes.clone());
        }
        Self { n_segments, levels }
    }

    /// Whether a segment may be within `reach_m` of `point`.
    pub fn may_come_within(&self, point: Vec2, reach_m: f64) -> bool {
        let below_top = self.levels.len().saturating_sub(2);
        let is_near = |around: &[f64; 4]| distance_squared(around, point) <= reach_m * reach_m;
        self.levels.get(below_top).is_some_and(|boxes| boxes.iter().any(is_near))
    }

    /// The segment of the least `cost`, the first of equal ones, and that cost: as if all were tried. `None` if none
    /// has a cost. `at_least` turns a squared distance from `point` into the least cost of a segment so far away.
    pub fn nearest(
        &self,
        point: Vec2,
        at_least: impl Fn(f64) -> f64,
        mut cost: impl FnMut(usize) -> Option<f64>,
    ) -> Option<(usize, f64)> {
        if self.n_segments == 0 {
            return None;
        }
        let (mut best, mut least) = (None, f64::INFINITY);
        let mut try_all = |segments: Range<usize>, best: &mut Option<usize>, least: &mut f64| {
            for i in segments {
                let Some(cost) = cost(i) else { continue };
                if cost < *least || best.is_none_or(|first| cost == *least && i < first) {
                    (*best, *least) = (Some(i), cost);
                }
            }
        };
        let within = |level: usize, i: usize| {
            let n = if level == 0 { self.n_segments } else { self.levels[level - 1].len() };
            i * N_TOGETHER..n.min((i + 1) * N_TOGETHER)
        };
        // What is probably near comes first, so that little of the rest needs a look.
        let top = self.levels.len() - 1;
        let mut nearest = 0;
        for level in (0..top).rev() {
            let mut least_squared = f64::INFINITY;
            for i in within(level + 1, nearest) {
                let squared = distance_squared(&self.levels[level][i], point);
                if squared < least_squared {
                    (nearest, least_squared) = (i, squared);
                }
            }
        }
        try_all(within(0, nearest), &mut best, &mut least);
        let (mut level, mut i) = (top, 0);
        loop {
            // Some room is left for rounding.
            let squared = distance_squared(&self.levels[level][i], point);
            if best.is_none() || at_least((squared - 1e-6 * (1.0 + squared)).max(0.0)) <= least {
                if level > 0 {
                    (level, i) = (level - 1, i * N_TOGETHER);
                    continue;
                }
                if i != nearest {
                    try_all(within(0, i), &mut best, &mut least);
                }
            }
            i += 1;
            while level < top && (i.is_multiple_of(N_TOGETHER) || i == self.levels[level].len()) {
                (level, i) = (level + 1, i.div_ceil(N_TOGETHER));
            }
            if level == top {
                return best.map(|i| (i, least));
            }
        }
    }
}

fn union(boxes: &[[f64; 4]]) -> [f64; 4] {
    let [mut x, mut y, mut to_x, mut to_y] = boxes[0];
    for other in &boxes[1..] {
        (x, y, to_x, to_y) = (x.min(other[0]), y.min(other[1]), to_x.max(other[2]), to_y.max(other[3]));
    }
    [x, y, to_x, to_y]
}

fn distance_squared([x, y, to_x, to_y]: &[f64; 4], point: Vec2) -> f64 {
    // Not `f64::max`, which takes care of what is no number.
    let larger = |a: f64, b: f64| if a > b { a } else { b };
    let beside = |from: f64, at: f64, to: f64| larger(larger(from - at, at - to), 0.0);
    Vec2::new(beside(*x, point.x, *to_x), beside(*y, point.y, *to_y)).norm_squared()
}
