#!/usr/bin/env python3
"""Writes tests/golden/mixture.json: iterations of EM for a mixture of diagonal Gaussians, computed with numpy.

Usage: python scripts/golden_mixture.py [OUTPUT]

Densities are multiplied out rather than added up as logarithms, and variances come from second moments, so that the code
in src/metrics/mixture.rs is compared with another way of computing the same. One dimension hardly varies: its variance is
held up by the floor.
"""

import json
import sys
from pathlib import Path

import numpy as np

MIN_STD, N_ITERATIONS = 0.2, 8


def main() -> None:
    default = Path(__file__).parent.parent / "tests" / "golden" / "mixture.json"
    output = Path(sys.argv[1]) if len(sys.argv) > 1 else default
    rng = np.random.default_rng(5)
    centers = np.array([[0.0, 0.0, 1.0], [2.0, 1.0, 1.0], [1.0, 3.0, 1.0]])
    points = np.concatenate([c + rng.normal(size=(n, 3)) * [1.0, 0.7, 0.05] for c, n in zip(centers, [12, 9, 6])]).round(4)
    starts = points[[0, 13, 22]]

    distances = ((points[:, None] - starts[None]) ** 2).sum(axis=2)
    shares = np.eye(3)[distances.argmin(axis=1)]
    log_likelihoods = []
    for _ in range(N_ITERATIONS):
        mass = shares.sum(axis=0)
        weights = mass / len(points)
        means = shares.T @ points / mass[:, None]
        variances = np.maximum(shares.T @ points**2 / mass[:, None] - means**2, MIN_STD**2)
        z = (points[:, None] - means[None]) / np.sqrt(variances)[None]
        densities = np.prod(np.exp(-0.5 * z**2) / np.sqrt(2 * np.pi * variances)[None], axis=2) * weights
        shares = densities / densities.sum(axis=1, keepdims=True)
        log_likelihoods.append(float(np.log(densities.sum(axis=1)).sum()))
    golden = {
        "min_std": MIN_STD,
        "points": points.tolist(),
        "starts": starts.tolist(),
        "n_iterations": N_ITERATIONS,
        "weights": weights.tolist(),
        "means": means.tolist(),
        "variances": variances.tolist(),
        "log_likelihoods": log_likelihoods,
    }
    output.write_text(json.dumps(golden, indent=1) + "\n")


if __name__ == "__main__":
    main()
