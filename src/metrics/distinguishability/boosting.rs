//! Gradient-boosted trees that distinguish two classes: histograms of binned features, leaves grown best first.
//!
//! The algorithm is that of scikit-learn's `HistGradientBoostingClassifier` (after LightGBM, Ke et al. 2017), without
//! early stopping, categories and constraints: `scripts/golden_boosting.py` writes the values that tests compare with.
//! Nothing is drawn at random and every sum has one order, so that the same rows give the same trees anywhere.

const N_TREES: usize = 70;
/// The factor of the values of leaves.
const LEARNING_RATE: f64 = 0.12;
/// Largest number of leaves of a tree.
const MAX_LEAVES: usize = 10;
/// Largest number of bins of a feature, without that of missing values.
const MAX_BINS: usize = 64;
/// Least number of training rows of a leaf.
const MIN_LEAF_ROWS: usize = 15;
/// λ of the penalty λ v² / 2 on the value v of a leaf.
const L2: f64 = 1.0;
/// Least sum of second derivatives of a leaf.
const MIN_HESSIAN: f64 = 1e-3;

/// A feature of all training rows, binned.
struct BinnedFeature {
    /// Row i is in bin b if `thresholds[b - 1] < x <= thresholds[b]`, and in [`BinnedFeature::missing_bin`] if it is
    /// NaN.
    bins: Vec<u8>,
    /// Increasing, one fewer than there are bins of numbers.
    thresholds: Vec<f64>,
    has_missing: bool,
    /// The place of its first bin among those of all features.
    first: usize,
}

impl BinnedFeature {
    /// Bins by quantiles; one for each value if there are no more values than bins. `first` is the number of bins of
    /// the features before it.
    fn new(column: &[f64], first: usize) -> Self {
        let mut sorted: Vec<f64> = column.iter().copied().filter(|x| !x.is_nan()).collect();
        sorted.sort_by(f64::total_cmp);
        let mut distinct = sorted.clone();
        distinct.dedup();
        let thresholds = if distinct.len() <= MAX_BINS {
            distinct.windows(2).map(|pair| (pair[0] + pair[1]) / 2.0).collect()
        } else {
            let n = sorted.len();
            let quantile = |k: usize| {
                let at = n * k / MAX_BINS;
                if (n * k).is_multiple_of(MAX_BINS) { (sorted[at - 1] + sorted[at]) / 2.0 } else { sorted[at] }
            };
            let mut thresholds: Vec<f64> = (1..MAX_BINS).map(quantile).collect();
            thresholds.dedup();
            thresholds
        };
        let missing = thresholds.len() as u8 + 1;
        let bin = |x: &f64| if x.is_nan() { missing } else { thresholds.partition_point(|t| t < x) as u8 };
        let bins = column.iter().map(bin).collect();
        Self { bins, thresholds, has_missing: sorted.len() < column.len(), first }
    }

    const fn missing_bin(&self) -> usize {
        self.thresholds.len() + 1
    }

    /// The place after its last bin.
    const fn end(&self) -> usize {
        self.first + self.missing_bin() + 1
    }
}

/// The sums over the rows of a bin, or of a node.
#[derive(Clone, Copy, Default)]
struct Sums {
    gradient: f64,
    hessian: f64,
    n: u32,
}

impl Sums {
    const fn plus(self, other: Self) -> Self {
        Self { gradient: self.gradient + other.gradient, hessian: self.hessian + other.hessian, n: self.n + other.n }
    }

    const fn minus(self, other: Self) -> Self {
        Self { gradient: self.gradient - other.gradient, hessian: self.hessian - other.hessian, n: self.n - other.n }
    }

    /// The value of a leaf with these rows, which minimizes the second-order loss G v + (H + λ) v² / 2.
    fn value(self) -> f64 {
        -self.gradient / (self.hessian + L2 + 1e-15)
    }

    const fn can_be_leaf(self) -> bool {
        self.n as usize >= MIN_LEAF_ROWS && self.hessian >= MIN_HESSIAN
    }
}

/// The sums of each bin of each feature, feature by feature. Nodes that are too small to be split have none.
type Histograms = Vec<Sums>;

/// The best split of a node.
struct Split {
    gain: f64,
    feature: usize,
    /// The last bin that goes left.
    bin: usize,
    missing_left: bool,
    left: Sums,
}

/// The training rows in a node of a tree that grows.
struct Growing {
    at: usize,
    rows: Vec<u32>,
    sums: Sums,
    /// Before shrinkage.
    value: f64,
}

impl Growing {
    const fn can_be_split(&self) -> bool {
        self.rows.len() >= 2 * MIN_LEAF_ROWS
    }
}

/// A node that can be split.
struct Splittable {
    node: Growing,
    histograms: Histograms,
    split: Split,
}

enum Node {
    Leaf(f64),
    /// Numbers up to `threshold` go left.
    Inner {
        feature: usize,
        threshold: f64,
        missing_left: bool,
        left: usize,
        right: usize,
    },
}

pub(super) struct BoostedTrees {
    intercept: f64,
    /// Each tree begins at its first node.
    trees: Vec<Vec<Node>>,
}

impl BoostedTrees {
    /// Fits trees to `columns` (one for each feature, NaN where it is missing) of rows; `is_second` tells which are in
    /// the second class. Minimizes the mean of -log p(class).
    pub(super) fn fit(columns: &[Vec<f64>], is_second: &[bool]) -> Self {
        let mut features: Vec<BinnedFeature> = Vec::with_capacity(columns.len());
        for column in columns {
            features.push(BinnedFeature::new(column, features.last().map_or(0, BinnedFeature::end)));
        }
        let n = is_second.len();
        let share = is_second.iter().filter(|second| **second).count() as f64 / n as f64;
        let share = share.clamp(f64::EPSILON, 1.0 - f64::EPSILON);
        let intercept = (share / (1.0 - share)).ln();
        let mut scores = vec![intercept; n];
        let mut trees = Vec::with_capacity(N_TREES);
        for _ in 0..N_TREES {
            // Single precision, as scikit-learn keeps them; sums are double.
            let derivatives: Vec<[f32; 2]> = scores
                .iter()
                .zip(is_second)
                .map(|(score, second)| {
                    let p = 1.0 / (1.0 + (-score).exp());
                    [(p - f64::from(u8::from(*second))) as f32, (p * (1.0 - p)) as f32]
                })
                .collect();
            trees.push(grow(&features, &derivatives, &mut scores));
        }
        Self { intercept, trees }
    }

    /// The log odds of the second class for a row with the features that `feature` gives.
    pub(super) fn log_odds(&self, feature: impl Fn(usize) -> f64) -> f64 {
        let of_tree = |nodes: &Vec<Node>| {
            let mut at = 0;
            loop {
                match nodes[at] {
                    Node::Leaf(value) => return value,
                    Node::Inner { feature: idx, threshold, missing_left, left, right } => {
                        let x = feature(idx);
                        at = if x <= threshold || (missing_left && x.is_nan()) { left } else { right };
                    }
                }
            }
        };
        self.trees.iter().fold(self.intercept, |sum, nodes| sum + of_tree(nodes))
    }
}

/// Grows a tree by repeatedly splitting the node whose split lowers the loss most. Adds its values to `scores`.
fn grow(features: &[BinnedFeature], derivatives: &[[f32; 2]], scores: &mut [f64]) -> Vec<Node> {
    let mut nodes = vec![Node::Leaf(0.0)];
    let (mut open, mut leaves): (Vec<Splittable>, Vec<Growing>) = (Vec::new(), Vec::new());
    let rows: Vec<u32> = (0..scores.len() as u32).collect();
    let histograms = histograms_of(features, derivatives, &rows);
    let of_first = &histograms[..features.first().map_or(0, BinnedFeature::end)];
    let sums = of_first.iter().fold(Sums::default(), |sum, bin| sum.plus(*bin));
    let root = Growing { at: 0, rows, sums, value: 0.0 };
    match best_split(features, &histograms, &root) {
        Some(split) => open.push(Splittable { node: root, histograms, split }),
        None => leaves.push(root),
    }
    while let Some(Splittable { node, histograms, split }) = most_gainful(&mut open) {
        let (left, right) = (nodes.len(), nodes.len() + 1);
        let children = divided(&node, &features[split.feature], &split, [left, right]);
        let feature = &features[split.feature];
        nodes[node.at] = Node::Inner {
            feature: split.feature,
            threshold: feature.thresholds.get(split.bin).copied().unwrap_or(f64::INFINITY),
            missing_left: if feature.has_missing {
                split.missing_left
            } else {
                children[0].rows.len() > children[1].rows.len()
            },
            left,
            right,
        };
        nodes.extend([Node::Leaf(0.0), Node::Leaf(0.0)]);
        if leaves.len() + open.len() + 2 == MAX_LEAVES {
            leaves.extend(children.into_iter().chain(open.drain(..).map(|open| open.node)));
            break;
        }
        let (of_left, of_right) = histograms_of_children(features, derivatives, histograms, &children);
        for (child, histograms) in children.into_iter().zip([of_left, of_right]) {
            match best_split(features, &histograms, &child) {
                Some(split) => open.push(Splittable { node: child, histograms, split }),
                None => leaves.push(child),
            }
        }
    }
    for Growing { at, rows, value, .. } in leaves {
        let value = LEARNING_RATE * value;
        nodes[at] = Node::Leaf(value);
        rows.iter().for_each(|row| scores[*row as usize] += value);
    }
    nodes
}

/// Takes the node whose split gains most.
fn most_gainful(open: &mut Vec<Splittable>) -> Option<Splittable> {
    let gain = |open: &Splittable| open.split.gain;
    let (at, _) = open.iter().enumerate().reduce(|best, next| if gain(next.1) > gain(best.1) { next } else { best })?;
    Some(open.remove(at))
}

fn divided(node: &Growing, feature: &BinnedFeature, split: &Split, [left, right]: [usize; 2]) -> [Growing; 2] {
    let goes_left = |row: &u32| {
        let bin = usize::from(feature.bins[*row as usize]);
        bin <= split.bin || (split.missing_left && bin == feature.missing_bin())
    };
    let (rows_left, rows_right) = node.rows.iter().partition(|row| goes_left(row));
    let child = |at, rows, sums: Sums| Growing { at, rows, sums, value: sums.value() };
    [child(left, rows_left, split.left), child(right, rows_right, node.sums.minus(split.left))]
}

/// The sums over `rows`, bin by bin.
fn histograms_of(features: &[BinnedFeature], derivatives: &[[f32; 2]], rows: &[u32]) -> Histograms {
    let ordered: Vec<[f32; 2]> = rows.iter().map(|row| derivatives[*row as usize]).collect();
    let mut histograms = vec![Sums::default(); features.last().map_or(0, BinnedFeature::end)];
    for feature in features {
        let sums = &mut histograms[feature.first..feature.end()];
        for (row, [gradient, hessian]) in rows.iter().zip(&ordered) {
            let bin = &mut sums[usize::from(feature.bins[*row as usize])];
            bin.gradient += f64::from(*gradient);
            bin.hessian += f64::from(*hessian);
            bin.n += 1;
        }
    }
    histograms
}

/// The sums over the rows of two children: only the smaller child is counted, the other has the rest.
fn histograms_of_children(
    features: &[BinnedFeature],
    derivatives: &[[f32; 2]],
    mut parent: Histograms,
    [left, right]: &[Growing; 2],
) -> (Histograms, Histograms) {
    if !left.can_be_split() && !right.can_be_split() {
        return Default::default();
    }
    let left_is_smaller = left.rows.len() < right.rows.len();
    let smaller = histograms_of(features, derivatives, if left_is_smaller { &left.rows } else { &right.rows });
    for (sum, counted) in parent.iter_mut().zip(&smaller) {
        *sum = sum.minus(*counted);
    }
    if left_is_smaller { (smaller, parent) } else { (parent, smaller) }
}

/// The split that lowers the loss most, the first among equals; `None` if none lowers it.
fn best_split(features: &[BinnedFeature], histograms: &[Sums], node: &Growing) -> Option<Split> {
    if !node.can_be_split() {
        return None;
    }
    let mut best: Option<Split> = None;
    let mut offer = |feature: usize, bin: usize, missing_left: bool, left: Sums| {
        let right = node.sums.minus(left);
        if !left.can_be_leaf() || !right.can_be_leaf() {
            return;
        }
        let loss = |sums: Sums| sums.gradient * sums.value();
        let gain = node.sums.gradient * node.value - loss(left) - loss(right);
        if gain > best.as_ref().map_or(0.0, |best| best.gain) {
            best = Some(Split { gain, feature, bin, missing_left, left });
        }
    };
    // The part that grows from bin to bin leaves the other too few rows.
    let is_too_large = |part: Sums| node.rows.len() < part.n as usize + MIN_LEAF_ROWS;
    for (idx, feature) in features.iter().enumerate() {
        let bins = &histograms[feature.first..feature.end()];
        let n_thresholds = feature.thresholds.len();
        let mut left = Sums::default();
        for (bin, sums) in bins.iter().enumerate().take(n_thresholds + usize::from(feature.has_missing)) {
            // After an empty bin the split is the same.
            if sums.n > 0 {
                left = left.plus(*sums);
                if is_too_large(left) {
                    break;
                }
                offer(idx, bin, false, left);
            }
        }
        if feature.has_missing {
            let mut right = Sums::default();
            for bin in (0..n_thresholds).rev() {
                if bins[bin + 1].n > 0 {
                    right = right.plus(bins[bin + 1]);
                    if is_too_large(right) {
                        break;
                    }
                    offer(idx, bin, true, node.sums.minus(right));
                }
            }
        }
    }
    best
}

#[cfg(test)]
mod tests {
    use super::*;
    use serde::Deserialize;

    #[derive(Deserialize)]
    struct Golden {
        columns: Vec<Vec<Option<f64>>>,
        is_second: Vec<bool>,
        log_odds: Vec<f64>,
        unseen_columns: Vec<Vec<Option<f64>>>,
        unseen_log_odds: Vec<f64>,
    }

    #[test]
    fn trees_are_those_of_scikit_learn() {
        let golden: Golden =
            serde_json::from_str(include_str!("../../../tests/golden/boosting.json")).expect("a golden file");
        let numbers = |columns: &[Vec<Option<f64>>]| -> Vec<Vec<f64>> {
            columns.iter().map(|column| column.iter().map(|x| x.unwrap_or(f64::NAN)).collect()).collect()
        };
        let (seen, unseen) = (numbers(&golden.columns), numbers(&golden.unseen_columns));
        let trees = BoostedTrees::fit(&seen, &golden.is_second);
        for (columns, expected) in [(seen, golden.log_odds), (unseen, golden.unseen_log_odds)] {
            for (row, expected) in expected.into_iter().enumerate() {
                let found = trees.log_odds(|feature| columns[feature][row]);
                assert!((found - expected).abs() < 1e-9, "row {row}: {found}, not {expected}");
            }
        }
    }

    #[test]
    fn without_features_or_with_few_rows_every_row_has_the_share_of_its_class() {
        let is_second = [true, false, false, false];
        for columns in [vec![], vec![vec![1.0, f64::NAN, 2.0, 3.0]], vec![vec![f64::NAN; 4]]] {
            let found = BoostedTrees::fit(&columns, &is_second).log_odds(|feature| columns[feature][0]);
            assert!((found - (1.0_f64 / 3.0).ln()).abs() < 1e-12, "{found}");
        }
    }
}
