#!/usr/bin/env python3
"""Check the smoother of Argoverse 1's tracks (src/ingest/argoverse1/smoother.rs), and find its constants.

The program's smoother goes through a track forth and back. Here the same model is solved for all states at once: the mean and
covariance of a Gaussian that is given by its precision matrix, without any recursion.

    scripts/check_track_smoother.py                        write the references that the program's test compares with
    scripts/check_track_smoother.py --fit train.tar.gz     how likely tracks of these recordings are under the constants tried

What --fit printed for the 1,990 scenes of Argoverse 1's train split that were at hand, in nats a recorded position (a sample of the tracks of
15 rows or more, the noise of each the likeliest of the grid), is in tests/fixtures/smoother/fit.txt. 0.3 was chosen: AGENTs alone would have
1, but there are ten times as many rows of others.

Needs numpy.
"""

import argparse
import csv
import io
import json
import math
import tarfile
from pathlib import Path

import numpy as np

FIXTURES = Path(__file__).parent.parent / "tests" / "fixtures" / "smoother"
DENSITY_M2PS3 = 0.3
NOISE_M = [0.02, 0.035, 0.06, 0.1, 0.17, 0.3, 0.5, 0.85]
NOISE_MEDIAN_M, NOISE_LOG_STD = 0.15, 0.9
START_STD = np.array([10.0, 10.0])


def process_noise(h, density):
    return density * np.array([[h**3 / 3, h**2 / 2], [h**2 / 2, h]])


def solve(times, recorded, noise_m, density=DENSITY_M2PS3):
    """Means (n, 2 states, 2 axes), covariance (2n, 2n), and log likelihood of the recorded positions, of the whole track at once."""
    n, rows = len(times), [i for i, p in enumerate(recorded) if p is not None]
    y = np.array([recorded[i] for i in rows])
    # The prior of all states: mean zero about the first position, and its covariance summed up from independent steps.
    lift = np.zeros((2 * n, 2 * n))
    blocks = np.zeros((2 * n, 2 * n))
    for i in range(n):
        h = times[i] - times[i - 1] if i else 0.0
        blocks[2 * i : 2 * i + 2, 2 * i : 2 * i + 2] = process_noise(h, density) if i else np.diag(START_STD**2)
        for j in range(i + 1):
            lift[2 * i : 2 * i + 2, 2 * j : 2 * j + 2] = [[1.0, times[i] - times[j]], [0.0, 1.0]]
    prior = lift @ blocks @ lift.T
    observe = np.zeros((len(rows), 2 * n))
    observe[range(len(rows)), [2 * i for i in rows]] = 1.0
    marginal = observe @ prior @ observe.T + noise_m**2 * np.eye(len(rows))
    offset = y - y[0]
    gain = np.linalg.solve(marginal, observe @ prior).T
    mean = gain @ offset
    mean[0::2] += y[0]
    covariance = prior - gain @ observe @ prior
    _, log_determinant = np.linalg.slogdet(2 * math.pi * marginal)
    quadratic = np.sum(offset * np.linalg.solve(marginal, offset))
    return mean.reshape(n, 2, 2), covariance, -log_determinant - quadratic / 2


def log_prior(noise_m):
    return -(((math.log(noise_m / NOISE_MEDIAN_M)) / NOISE_LOG_STD) ** 2) / 2


def reference(seed, n_rows, noise_m, drift, wanted):
    """A noisy walk at uneven times, with states wanted between its rows."""
    rng = np.random.default_rng(seed)
    rows = np.cumsum(rng.uniform(0.03, 0.35 if seed == 2 else 0.13, n_rows))
    velocity = np.cumsum(rng.normal(0, 0.3, (n_rows, 2)), axis=0) + drift
    path = np.cumsum(velocity * np.diff(rows, prepend=rows[0])[:, None], axis=0) + [1203.5, -871.25]
    points = {round(t, 6): list(np.round(p + rng.normal(0, noise_m, 2), 4)) for t, p in zip(rows, path)}
    times = sorted(set(points) | {round(t, 6) for t in wanted})
    recorded = [points.get(t) for t in times]
    mean, covariance, log_likelihood = solve(np.array(times), recorded, noise_m)
    by_posterior = {m: solve(np.array(times), recorded, m)[2] + log_prior(m) for m in NOISE_M}
    return {
        "noise_m": noise_m,
        "time_s": times,
        "recorded": recorded,
        "position_m": mean[:, 0].tolist(),
        "velocity_mps": mean[:, 1].tolist(),
        "velocity_std_mps": np.sqrt(np.diag(covariance)[1::2]).tolist(),
        "log_likelihood": log_likelihood,
        "likeliest_noise_m": max(by_posterior, key=by_posterior.get),
    }


def write_references():
    references = [
        reference(1, 20, 0.2, [8.0, 1.0], [0.5, 1.0]),
        reference(2, 30, 0.5, [0.0, 0.0], [0.01, 0.5, 6.0]),
        reference(3, 50, 0.02, [-15.0, 4.0], []),
        reference(4, 3, 0.1, [2.0, 2.0], [0.2]),
        reference(5, 1, 0.1, [0.0, 0.0], [0.2, 0.3]),
    ]
    FIXTURES.mkdir(parents=True, exist_ok=True)
    (FIXTURES / "references.json").write_text(json.dumps(references, indent=1) + "\n")


def tracks(archive, role):
    """Times and positions of the tracks of one role with 15 rows or more."""
    with tarfile.open(archive) as tar:
        for member in tar:
            if not member.name.endswith(".csv"):
                continue
            by_track = {}
            for row in csv.DictReader(io.TextIOWrapper(tar.extractfile(member))):
                if row["OBJECT_TYPE"] == role:
                    by_track.setdefault(row["TRACK_ID"], []).append([float(row[k]) for k in ("TIMESTAMP", "X", "Y")])
            yield from (np.array(sorted(rows)) for rows in by_track.values() if len(rows) >= 15)


def fit(archive):
    noises = np.array([0.01, *NOISE_M, 1.5])
    print("role    n_tracks " + "".join(f"  q={q:<5}" for q in (0.3, 1, 3, 10)) + "  noise at q=1: median, deviation of its logarithm")
    for role, every in (("AV", 4), ("AGENT", 2), ("OTHERS", 40)):
        chosen = list(tracks(archive, role))[::every]
        totals, logs = [], []
        for density in (0.3, 1.0, 3.0, 10.0):
            best = [
                max((filtered(track, m, density), m) for m in noises) for track in chosen
            ]
            totals.append(sum(b for b, _ in best) / sum(len(t) for t in chosen))
            if density == 1.0:
                logs = np.log([m for _, m in best])
        columns = "".join(f"  {total:<7.3f}" for total in totals)
        print(f"{role:<8}{len(chosen):<9}{columns}  median {math.exp(np.median(logs)):.3f} m, deviation {np.std(logs):.2f}")


def filtered(track, noise_m, density):
    """The log likelihood alone, by the forward recursion: solving for all is too slow for thousands of tracks."""
    x, p, total = np.zeros((2, 2)), np.diag(START_STD**2), 0.0
    x[0] = track[0, 1:]
    before = track[0, 0]
    for time, *point in track:
        f = np.array([[1.0, time - before], [0.0, 1.0]])
        x, p, before = f @ x, f @ p @ f.T + process_noise(time - before, density), time
        s, e = p[0, 0] + noise_m**2, point - x[0]
        total += -math.log(2 * math.pi * s) - e @ e / (2 * s)
        k = p[:, 0] / s
        x, p = x + np.outer(k, e), p - np.outer(k, p[0])
    return total


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--fit", metavar="ARCHIVE", help="the recordings, as they were downloaded")
    archive = parser.parse_args().fit
    fit(archive) if archive else write_references()
