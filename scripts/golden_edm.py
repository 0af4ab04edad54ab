#!/usr/bin/env python3
"""Writes tests/golden/edm.json: EDM's preconditioning, schedule and one Heun step, computed independently with numpy.

Usage: python scripts/golden_edm.py [OUTPUT]

The formulas are those of Karras et al. 2022 (table 1, equation 5, algorithm 2) for sigma_data = 0.5, sigma_min = 0.002,
rho = 7. The denoiser of the Heun step is the posterior mean of a Gaussian mixture, integrated numerically on a grid
rather than taken from its closed form, so that the closed form in src/diffusion/analytic.rs is checked as well.
"""

import json
import sys
from pathlib import Path

import numpy as np

SIGMA_DATA, SIGMA_MIN, SIGMA_MAX, RHO = 0.5, 0.002, 80.0, 7.0
MIXTURE = {
    "weights": [0.3, 0.7],
    "means": [[-0.6, 0.2], [0.4, -0.1]],
    "variances": [[0.04, 0.02], [0.03, 0.09]],
}


def preconditioning(sigma: float) -> dict[str, float]:
    """Table 1's factors, written as the variances they are derived from."""
    c_in = np.hypot(sigma, SIGMA_DATA) ** -1
    c_out = sigma * SIGMA_DATA * c_in
    return {
        "sigma": sigma,
        "c_skip": (SIGMA_DATA * c_in) ** 2,
        "c_out": c_out,
        "c_in": c_in,
        "c_noise": 0.25 * np.log(sigma),
        "loss_weight": c_out**-2,
    }


def schedule(sigma_start: float, n_steps: int) -> list[float]:
    """Equation 5: evenly spaced in sigma^(1/rho), then 0."""
    roots = np.linspace(sigma_start ** (1 / RHO), SIGMA_MIN ** (1 / RHO), n_steps)
    return [*(roots**RHO).tolist(), 0.0]


def posterior_mean(x: np.ndarray, sigma: float) -> np.ndarray:
    """E[x0 | x0 + sigma n = x] by quadrature, one dimension after the other: components factorize over dimensions."""
    grid = np.linspace(-4.0, 4.0, 400_001)
    step = grid[1] - grid[0]

    def gaussian(mean: float, variance: float) -> np.ndarray:
        return np.exp(-0.5 * (grid - mean) ** 2 / variance) / np.sqrt(2 * np.pi * variance)

    evidence, first_moment = 0.0, np.zeros_like(x)
    for weight, mean, variance in zip(*MIXTURE.values(), strict=True):
        joint = [gaussian(m, v) * gaussian(xi, sigma**2) for m, v, xi in zip(mean, variance, x, strict=True)]
        mass = np.array([np.sum(j) * step for j in joint])
        moment = np.array([np.sum(j * grid) * step for j in joint])
        evidence += weight * mass.prod()
        first_moment += weight * moment * mass.prod() / mass
    return first_moment / evidence


def heun_step(x: np.ndarray, sigma: float, sigma_next: float) -> np.ndarray:
    """Algorithm 2 for one step without churn."""
    slope = (x - posterior_mean(x, sigma)) / sigma
    x_euler = x + (sigma_next - sigma) * slope
    slope_next = (x_euler - posterior_mean(x_euler, sigma_next)) / sigma_next
    return x + (sigma_next - sigma) * (slope + slope_next) / 2


def main() -> None:
    default = Path(__file__).parent.parent / "tests" / "golden" / "edm.json"
    output = Path(sys.argv[1]) if len(sys.argv) > 1 else default
    sigma, sigma_next = 0.8, 0.3
    points = [np.array([0.9, -0.4]), np.array([-0.3, 0.1]), np.array([0.0, 1.2])]
    golden = {
        "preconditioning": [preconditioning(s) for s in [0.002, 0.05, 0.3, 0.5, 1.0, 7.5, 80.0]],
        "schedules": [
            {"sigma_start": start, "n_steps": n, "sigmas": schedule(start, n)}
            for start, n in [(SIGMA_MAX, 5), (SIGMA_MAX, 18), (SIGMA_MAX, 50), (0.8, 20)]
        ],
        "mixture": MIXTURE,
        "heun_step": {
            "sigma": sigma,
            "sigma_next": sigma_next,
            "x": [p.tolist() for p in points],
            "x0_hat": [posterior_mean(p, sigma).tolist() for p in points],
            "x_next": [heun_step(p, sigma, sigma_next).tolist() for p in points],
        },
    }
    output.write_text(json.dumps(golden, indent=1) + "\n")


if __name__ == "__main__":
    main()
