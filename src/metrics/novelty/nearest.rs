//! Nearest-neighbor search for any distance with the triangle inequality.

use std::collections::BTreeSet;

/// A key that sorts like the number.
#[derive(Debug, Clone, Copy, PartialEq)]
struct Key(f64);

impl Eq for Key {}

impl PartialOrd for Key {
    fn partial_cmp(&self, other: &Self) -> Option<std::cmp::Ordering> {
        Some(self.cmp(other))
    }
}

impl Ord for Key {
    fn cmp(&self, other: &Self) -> std::cmp::Ordering {
        self.0.total_cmp(&other.0)
    }
}

/// Points in the order of their distance from the first of them, the pivot. By the triangle inequality |d(a, pivot) -
/// d(b, pivot)| is at most d(a, b), so only points at a similar distance from the pivot are compared. A search is exact
/// and computes a distance for each point in that band: few if points are spread out, all of them in the worst case.
#[derive(Debug, Clone, PartialEq, Eq)]
pub(super) struct NearestIndex<P> {
    points: Vec<P>,
    by_key: BTreeSet<(Key, usize)>,
}

impl<P> Default for NearestIndex<P> {
    fn default() -> Self {
        Self { points: Vec::new(), by_key: BTreeSet::new() }
    }
}

impl<P> NearestIndex<P> {
    /// Adds a point and returns its number; points are numbered in the order in which they are added.
    pub(super) fn insert(&mut self, point: P, distance: impl Fn(&P, &P) -> f64) -> usize {
        let idx = self.points.len();
        let key = self.points.first().map_or(0.0, |pivot| distance(pivot, &point));
        self.points.push(point);
        self.by_key.insert((Key(key), idx));
        idx
    }

    /// The number and distance of the nearest point, the first among equals; `None` without points.
    pub(super) fn nearest(&self, point: &P, distance: impl Fn(&P, &P) -> f64) -> Option<(usize, f64)> {
        let pivot = self.points.first()?;
        let key = distance(pivot, point);
        let start = (Key(key), 0);
        let mut above = self.by_key.range(start..).copied().peekable();
        let mut below = self.by_key.range(..start).rev().copied().peekable();
        let mut best: Option<(f64, usize)> = None;
        loop {
            // The side whose next point differs less from the key.
            let apart = |entry: Option<&(Key, usize)>| entry.map_or(f64::INFINITY, |(other, _)| (other.0 - key).abs());
            let (up, down) = (apart(above.peek()), apart(below.peek()));
            let next = if up <= down { above.next() } else { below.next() };
            let Some((other, idx)) = next else { break };
            // Rounding must not exclude a point that is equally near.
            if best.is_some_and(|(least, _)| (other.0 - key).abs() > least + 1e-9) {
                break;
            }
            let candidate = (distance(&self.points[idx], point), idx);
            if best.is_none_or(|known| candidate < known) {
                best = Some(candidate);
            }
        }
        best.map(|(distance, idx)| (idx, distance))
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::seed::Seed;

    #[test]
    fn the_nearest_is_that_of_all_pairs_with_few_distances() {
        let mut rng = Seed(3).derive("nearest", &[]).rng();
        let mut draw = || [rng.uniform() * 100.0, rng.uniform() * 100.0];
        let distance = |a: &[f64; 2], b: &[f64; 2]| (a[0] - b[0]).hypot(a[1] - b[1]);
        let mut index = NearestIndex::default();
        assert_eq!(index.nearest(&[0.0, 0.0], distance), None);
        let points: Vec<[f64; 2]> = (0..500).map(|_| draw()).collect();
        for (i, point) in points.iter().enumerate() {
            assert_eq!(index.insert(*point, distance), i);
        }
        let n_distances = std::cell::Cell::new(0);
        for query in (0..100).map(|_| draw()) {
            let counted = |a: &[f64; 2], b: &[f64; 2]| {
                n_distances.set(n_distances.get() + 1);
                distance(a, b)
            };
            let expected = points.iter().enumerate().map(|(i, point)| (distance(point, &query), i));
            let (least, at) = expected.min_by(|a, b| a.0.total_cmp(&b.0)).expect("points");
            assert_eq!(index.nearest(&query, counted), Some((at, least)));
        }
        assert!(n_distances.get() < 100 * 500 / 4, "{} distances", n_distances.get());
    }

    #[test]
    fn of_equally_near_points_the_first_counts() {
        let distance = |a: &f64, b: &f64| (a - b).abs();
        let mut index = NearestIndex::default();
        for point in [5.0, 3.0, 1.0, 3.0] {
            index.insert(point, distance);
        }
        assert_eq!(index.nearest(&2.0, distance), Some((1, 1.0)));
        assert_eq!(index.nearest(&3.0, distance), Some((1, 0.0)));
    }
}
