"""Errors as trackers make them, in the observed past of cases; the future stays as it was.

A tracker that follows vehicles in images may hold their speed and correct it in steps when they have drifted off
(NGSIM's goes by 5 feet a second), or let it wander. Whoever takes that for acceleration is meters off three seconds later.
"""

import dataclasses

import numpy as np

from fixtures.traffic import DT_S

# The last observed frame of a case.
PRESENT = 9
# How fast errors of speed fade after the present, seconds.
FADE_S = (0.2, 0.5)
# Speeds below are less in error, in proportion, m/s.
SLOW_MPS = 5.0


def with_errors(case, rng):
    """The case as a tracker of a random kind sees it."""
    held = rng.random() < 0.6
    step_mps, drift_m, wander_mps = rng.uniform(0.8, 1.6), rng.uniform(0.1, 0.4), rng.uniform(0.15, 0.9)
    across_m, turns = rng.uniform(0.01, 0.1), rng.random() < 0.7
    fade_s = rng.uniform(*FADE_S)
    seen = []
    for track in case:
        present = PRESENT - track.first
        if track.kind != "car" or present < 2 or present >= len(track.rows):
            seen.append(track)
            continue
        speed = np.hypot(track.rows[:, 2], track.rows[:, 3])
        less = np.minimum(speed / SLOW_MPS, 1.0)
        along = steps(speed, step_mps, drift_m, rng) if held else np.cumsum(wander(rng, len(speed), wander_mps) * less) * DT_S
        across = wander(rng, len(speed), across_m) * less
        errors = [faded(error, present, fade_s) for error in (along, across)]
        seen.append(dataclasses.replace(track, rows=moved(track.rows, *errors, turns)))
    return seen


def steps(speed, step_mps, drift_m, rng):
    """The error along the way of a tracker that holds its speed until it is off by some distance, meters by frame."""
    n_before = 40  # frames in which it gets going
    speed = np.append(np.full(n_before, speed[0]), speed)
    held = wanted = round(speed[0] / step_mps) * step_mps
    rate, limit_m = step_mps * DT_S / rng.uniform(0.25, 0.5), drift_m * rng.uniform(0.6, 1.4)
    error, errors = rng.normal() * drift_m / 2, []
    for true in speed:
        found = error + rng.normal() * drift_m / 2
        if held == wanted and abs(found) > limit_m:
            # It catches up with what it seems to have lost in about a second.
            wanted = max(round((true - found / rng.uniform(0.4, 1.2)) / step_mps), 0) * step_mps
        held = min(max(wanted, held - rate), held + rate)
        error += (held - true) * DT_S
        errors.append(error)
    return np.convolve(np.pad(errors, 1, "edge"), [0.25, 0.5, 0.25], "valid")[n_before:]


def wander(rng, n, size):
    """Random values by frame that stay alike for some tenths of a second, of the given standard deviation."""
    width = rng.uniform(1.5, 4.0)
    kernel = np.exp(-0.5 * (np.arange(-12, 13) / width) ** 2)
    return np.convolve(rng.normal(size=n + 24), kernel / np.hypot.reduce(kernel), "valid") * size


def faded(error, present, fade_s):
    """The error relative to that at the present, after which it goes on with the speed that it has, which fades."""
    later_s = np.arange(1, len(error) - present) * DT_S
    growth = (error[present] - error[present - 1]) / DT_S
    return np.append(error[: present + 1] - error[present], growth * fade_s * (1.0 - np.exp(-later_s / fade_s)))


def moved(rows, along, across, turns):
    """Rows of a track moved along its own way and across it; with `turns`, headings follow the motion across."""
    before = np.append(0.0, np.cumsum(np.hypot(*np.diff(rows[:, :2], axis=0).T)))
    at, heading = before + along, np.unwrap(rows[:, 4])
    keep = np.append(True, np.diff(before) > 1e-6)
    columns = [np.interp(at, before[keep], values[keep]) for values in (rows[:, 0], rows[:, 1], heading)]
    ahead = np.stack([np.cos(columns[2]), np.sin(columns[2])], axis=1)
    beyond = np.minimum(at, 0.0) + np.maximum(at - before[-1], 0.0)
    position = np.stack(columns[:2], axis=1) + beyond[:, None] * ahead
    position += across[:, None] * np.stack([-ahead[:, 1], ahead[:, 0]], axis=1)
    velocity = np.gradient(position, DT_S, axis=0)
    slip = np.arctan2(np.gradient(across, DT_S), np.maximum(np.hypot(*velocity.T), 1.0)) if turns else 0.0
    return np.column_stack([position, velocity, np.angle(np.exp(1j * (columns[2] + slip)))])
