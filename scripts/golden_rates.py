#!/usr/bin/env python3
"""Writes tests/golden/rates.json: quantiles and intervals of rates, computed with scipy.

Usage: python scripts/golden_rates.py [OUTPUT]      (pip install numpy scipy)

The code in src/statistics is compared with these.
"""

import json
import sys
from pathlib import Path

import numpy as np
from scipy import optimize, special, stats

CLUSTERS = {
    "one recording": [(7, 2.5)],
    "none found": [(0, 1.0), (0, 3.0)],
    "none found in one": [(0, 4.0)],
    "independent": [(4, 1.0), (9, 2.0), (13, 3.0), (5, 1.0)],
    "clustered": [(0, 1.0), (31, 1.5), (2, 1.0), (0, 0.5), (12, 2.0)],
    "without exposure": [(3, 1.0), (0, 0.0), (9, 1.5)],
    "an event where next to none is expected": [(1, 0.001), (0, 1.0), (2, 1.0), (0, 1.5)],
}


def interval(clusters):
    """Rate, low, high and dispersion; the quantiles are those of chi-squared variables."""
    clusters = [(n, exposure) for n, exposure in clusters if exposure > 0]
    n, exposure = map(np.array, zip(*clusters))
    rate = n.sum() / exposure.sum()
    dispersion = None
    if len(n) > 1:
        # The variance of a ratio over that of a Poisson variable.
        dispersion = max(1.0, len(n) * np.var(n - rate * exposure, ddof=1) / n.sum()) if n.sum() else 1.0
    alike, scale = n.sum() / (dispersion or 1.0), (dispersion or 1.0) / exposure.sum()
    low = stats.chi2.ppf(0.025, 2 * alike) / 2 * scale if alike else 0.0
    return [rate, low, stats.chi2.ppf(0.975, 2 * alike + 2) / 2 * scale, dispersion]


def weighted(weights, exposure):
    """Weights, exposure, and the rate with the interval of Fay and Feuer (1997), their mean weight as the largest one."""
    y, v = sum(weights), sum(w * w for w in weights)
    most = v / y
    low = v / (2 * y) * stats.chi2.ppf(0.025, 2 * y**2 / v)
    high = (v + most**2) / (2 * (y + most)) * stats.chi2.ppf(0.975, 2 * (y + most) ** 2 / (v + most**2))
    return [weights, exposure, [y / exposure, low / exposure, high / exposure]]


def log_likelihood(y, shape, scale):
    return stats.genpareto.logpdf(y, shape, scale=scale).sum() if scale > 0 else -np.inf


def fitted(y):
    """The most likely shape and scale, from several starts."""
    def loss(at):
        value = -log_likelihood(y, at[0], np.exp(at[1]))
        return value if np.isfinite(value) else 1e12

    starts = [(shape, np.log(y.mean() * (1 - min(shape, 0.9)))) for shape in (-0.2, 0.05, 0.4)]
    best = min((optimize.minimize(loss, start, method="Nelder-Mead", options={"xatol": 1e-8, "fatol": 1e-10, "maxiter": 4000})
                for start in starts), key=lambda found: found.fun)  # fmt: skip
    return best.x[0], float(np.exp(best.x[1]))


def anderson_darling(y, shape, scale):
    u, n = np.sort(stats.genpareto.cdf(y, shape, scale=scale)), len(y)
    i = np.arange(1, n + 1)
    return -n - ((2 * i - 1) * (np.log(u) + np.log1p(-u[::-1]))).mean()


def profile_interval(y, at, shape, scale, dispersion=1.0, n_shapes=4001):
    """Where the profile likelihood of the survival at `at`, over the dispersion, is within half a quantile of chi-squared of the largest."""
    shapes = np.linspace(-0.5, 1.0, n_shapes)
    shapes[np.abs(shapes) < 1e-9] = 1e-9

    def drop(ln_p):
        scales = shapes * at / np.expm1(-shapes * ln_p)
        inside = 1 + shapes[:, None] * y / scales[:, None]
        with np.errstate(invalid="ignore", divide="ignore"):
            each = np.where((inside > 0).all(1), -(1 + 1 / shapes) * np.log(inside).sum(1) - len(y) * np.log(scales), -np.inf)
        return log_likelihood(y, shape, scale) - each.max() - dispersion * stats.chi2.ppf(0.95, 1) / 2

    estimate = stats.genpareto.logsf(at, shape, scale=scale)
    low = 0.0 if drop(-40) < 0 else np.exp(optimize.brentq(drop, -40, max(estimate, -39.9)))
    return low, np.exp(optimize.brentq(drop, max(estimate, -39.9), -1e-9))


def tail_dispersion(y, at, shape, scale, clusters, n_quantiles=200_000):
    """By how much the variance of the log of the survival at `at` grows if exceedances of a cluster are alike, from numerical slopes."""
    def slopes(of, step=1e-5):
        return np.array([of(shape + step, scale) - of(shape - step, scale), of(shape, scale * np.exp(step)) - of(shape, scale * np.exp(-step))]) / (2 * step)

    def scores(y):
        return slopes(lambda shape, scale: stats.genpareto.logpdf(y, shape, scale=scale))

    # The expected information, over quantiles of the fitted distribution.
    of_all = scores(stats.genpareto.ppf((np.arange(n_quantiles) + 0.5) / n_quantiles, shape, scale=scale))
    added = slopes(lambda shape, scale: stats.genpareto.logsf(at, shape, scale=scale)) @ np.linalg.solve(of_all @ of_all.T, scores(y))
    added -= added.mean()
    sums = np.bincount(clusters, added)
    return max(1.0, (sums**2).sum() / (added**2).sum() * len(sums) / (len(sums) - 1))


def tail(name, shape, n, levels, rng):
    y = stats.genpareto.rvs(shape, scale=1.5, size=n, random_state=rng).round(4) + 1e-4
    found = fitted(y)
    rows = [[at, phi, stats.genpareto.sf(at, found[0], scale=found[1]), *profile_interval(y, at, *found, phi)] for at in levels for phi in (1.0, 3.5)]
    # Exceedances that follow each other are alike.
    y = np.concatenate([np.sort(y[: n // 2]), y[n // 2 :]])
    clustered = [[at, k, tail_dispersion(y, at, *found, np.arange(n) * k // n)] for at in levels for k in (4, 15)]
    return {"name": name, "exceedances": list(y), "clustered": clustered, "fit": found, "anderson_darling": anderson_darling(y, *found),
            "crowding": crowding(y, *found), "survival": rows}  # fmt: skip


def critical(shape, n=200, n_samples=4000):
    """The statistic that 10 % of samples of a shape exceed, each judged by its own fit."""
    rng = np.random.default_rng([7, round(100 * shape + 1000)])
    values = []
    for _ in range(n_samples):
        y = stats.genpareto.rvs(shape, size=n, random_state=rng)
        values.append(anderson_darling(y, *quick_fit(y)))
    return round(float(np.quantile(values, 0.9)), 3)


def crowding(y, shape, scale):
    """The least probability, over k, that the k largest are together so close to the next one: sums of the distances of the order
    statistics of exponential variables are gamma variables (Renyi 1953)."""
    x = np.sort(-stats.genpareto.logsf(y, shape, scale=scale))[::-1]
    k = np.arange(2, len(y) // 2 + 1)
    return special.gammainc(k, np.cumsum(x)[k - 1] - k * x[k]).min()


def crowding_critical(shape, n, n_samples=2000):
    """The least probability that 5 % of samples fall below, each judged by its own fit."""
    rng = np.random.default_rng([8, n, round(100 * shape + 1000)])
    values = []
    while len(values) < n_samples:
        y = stats.genpareto.rvs(shape, size=n, random_state=rng)
        found = quick_fit(y)
        if -0.499 < found[0] < 0.999:
            values.append(crowding(y, *found))
    return float(f"{np.quantile(values, 0.05):.2g}")


def quick_fit(y):
    """The most likely shape and scale by Grimshaw's profile over their ratio, on a grid and refined."""
    def profile(ratio):
        shape = np.log1p(ratio * y).mean()
        return np.log(shape / ratio) + shape, shape

    ratios = np.concatenate([-np.linspace(0.9999, 0.01, 60) / y.max(), np.geomspace(0.001, 1000, 90) / np.median(y)])
    best = ratios[np.argmin([profile(ratio)[0] for ratio in ratios])]
    width = 0.05 * abs(best) + 0.02 / y.max()
    bounds = max(best - width, -0.99999 / y.max()), best + width
    found = optimize.minimize_scalar(lambda ratio: profile(ratio)[0] if abs(ratio) > 1e-9 else np.inf, bounds=bounds, method="bounded")
    shape = profile(found.x)[1]
    return shape, shape / found.x


def main():
    default = Path(__file__).parent.parent / "tests" / "golden" / "rates.json"
    output = Path(sys.argv[1]) if len(sys.argv) > 1 else default
    shapes = [0.05, 0.5, 1.0, 3.7, 4.7, 40.0, 41.0, 1234.5, 1e5]
    golden = {
        "gamma": [[p, shape, stats.gamma.ppf(p, shape)] for shape in shapes for p in (0.025, 0.5, 0.975)],
        "clusters": [{"name": name, "clusters": clusters, "expected": interval(clusters)} for name, clusters in CLUSTERS.items()],
    }
    golden["weighted"] = [
        weighted([1.0] * 7, 2.5),
        weighted([0.25, 0.25, 0.0625, 1.0, 0.25, 0.015625], 40.0),
        weighted([0.001], 12.0),
    ]
    rng = np.random.default_rng(11)
    golden["tails"] = [
        tail("light", -0.2, 60, [1.0, 3.0, 6.0, 9.0], rng),
        tail("exponential", 1e-6, 120, [2.0, 8.0, 15.0], rng),
        tail("heavy", 0.3, 90, [2.0, 10.0, 50.0], rng),
    ]
    golden["critical"] = [critical(shape) for shape in np.arange(-0.5, 1.01, 0.25)]
    golden["crowding_critical"] = [[crowding_critical(shape, n) for shape in (-0.5, -0.25, 0, 0.25, 0.5)] for n in (30, 95, 300, 949)]
    lines = [f"{json.dumps(name)}: {json.dumps(values)}" for name, values in golden.items()]
    output.write_text("{\n" + ",\n".join(lines) + "\n}\n")


if __name__ == "__main__":
    main()
