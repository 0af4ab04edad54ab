#!/usr/bin/env python3
"""What scikit-learn's gradient boosting makes of some rows: tests/golden/boosting.json.

The rows have missing values, ties and constant features. Run it again only if the settings in
src/metrics/distinguishability/boosting.rs change:

    pip install numpy==2.4.6 scikit-learn==1.9.1
    python scripts/golden_boosting.py
"""

import json
from pathlib import Path

import numpy as np
from sklearn.ensemble import HistGradientBoostingClassifier

GOLDEN = Path(__file__).parents[1] / "tests/golden/boosting.json"


def rows(n, rng):
    """Features of `n` rows, in thousandths, and their classes."""
    second = rng.random(n) < 0.4
    x = np.stack([
        rng.normal(size=n) + 0.7 * second,
        rng.normal(size=n) * np.where(second, 1.6, 1.0),
        rng.integers(0, 5, size=n) + 1.0 * second,
        rng.exponential(size=n),
        np.full(n, 2.0),
        rng.normal(size=n) + 0.5 * second,
    ], axis=1)
    x[:, 3] += np.where(x[:, 0] > 0, second, -1.0 * second)
    x = np.round(x, 3)
    x[rng.random(n) < np.where(second, 0.3, 0.1), 5] = np.nan
    x[rng.random(n) < 0.05, 0] = np.nan
    return x, second.astype(int)


def main():
    rng = np.random.default_rng(5)
    x, y = rows(400, rng)
    unseen, _ = rows(60, rng)
    # A feature that misses values only where none did in training.
    unseen[::7, 1] = np.nan
    model = HistGradientBoostingClassifier(
        max_iter=70, learning_rate=0.12, max_leaf_nodes=10, max_bins=64, min_samples_leaf=15,
        l2_regularization=1.0, early_stopping=False).fit(x, y)
    columns = lambda table: [[None if np.isnan(v) else float(v) for v in column] for column in table.T]
    golden = {
        "columns": columns(x),
        "is_second": [bool(v) for v in y],
        "log_odds": [float(v) for v in model.decision_function(x)],
        "unseen_columns": columns(unseen),
        "unseen_log_odds": [float(v) for v in model.decision_function(unseen)],
    }
    GOLDEN.write_text(json.dumps(golden) + "\n")


if __name__ == "__main__":
    main()
