"""Curves that roads follow: polylines in meters, as arrays of shape [n, 2]."""

import numpy as np

STEP_M = 2.0


def unit(angle):
    """The unit vector at an angle in radians, counterclockwise from x."""
    return np.array([np.cos(angle), np.sin(angle)])


def left_of(direction):
    """The direction turned a quarter to the left."""
    return np.array([-direction[1], direction[0]])


def length(path):
    return float(np.hypot(*np.diff(path, axis=0).T).sum())


def straight(start, end):
    """A straight line with a point every two meters or less."""
    n = max(2, int(np.ceil(np.hypot(*(np.asarray(end) - start)) / STEP_M)) + 1)
    return np.linspace(start, end, n)


def arc(center, radius, start, end):
    """A part of a circle between two angles in radians; it runs clockwise where `end` is below `start`."""
    n = max(3, int(np.ceil(abs(end - start) * radius / STEP_M)) + 1)
    angles = np.linspace(start, end, n)
    return np.asarray(center) + radius * np.stack([np.cos(angles), np.sin(angles)], axis=1)


def bezier(start, start_direction, end, end_direction, pull=0.45):
    """A cubic curve that leaves and arrives in the given directions; `pull` is the share of the distance to the handles."""
    start, end = np.asarray(start, float), np.asarray(end, float)
    reach = pull * np.hypot(*(end - start))
    handles = start, start + reach * start_direction, end - reach * end_direction, end
    t = np.linspace(0.0, 1.0, 200)[:, None]
    weights = (1 - t) ** 3, 3 * t * (1 - t) ** 2, 3 * t**2 * (1 - t), t**3
    path = sum(weight * handle for weight, handle in zip(weights, handles))
    return evenly(path)


def bend(stretches, spacing=1.0):
    """A path from (0, 0) eastward through stretches of (length in meters, curvature at their end in 1/m).

    Between the ends the curvature changes linearly, as in the clothoids that roads are built of.
    """
    ends = np.cumsum([0.0] + [meters for meters, _ in stretches])
    curvatures = [0.0] + [curvature for _, curvature in stretches]
    at = np.arange(0.0, ends[-1] + spacing / 2, spacing)
    angle = np.cumsum(np.interp(at, ends, curvatures)) * spacing
    steps = np.stack([np.cos(angle), np.sin(angle)], axis=1)[:-1] * spacing
    return np.concatenate([np.zeros((1, 2)), np.cumsum(steps, axis=0)])


def evenly(path, spacing=STEP_M):
    """The path with points about `spacing` meters apart."""
    n = max(2, int(np.ceil(length(path) / spacing)) + 1)
    return at(path, np.linspace(0.0, length(path), n))


def at(path, distances):
    """The points at distances in meters along the path."""
    along = np.append(0.0, np.cumsum(np.hypot(*np.diff(path, axis=0).T)))
    return np.stack([np.interp(distances, along, path[:, axis]) for axis in range(2)], axis=-1)


def slice_of(path, start, end):
    """The part between two distances in meters along the path."""
    n = max(2, int(np.ceil((end - start) / STEP_M)) + 1)
    return at(path, np.linspace(start, end, n))


def shifted(path, right_m):
    """The path moved to its right by a distance, or by one for each of its points."""
    tangent = np.gradient(path, axis=0)
    tangent /= np.hypot(*tangent.T)[:, None]
    normal = np.stack([tangent[:, 1], -tangent[:, 0]], axis=1)
    return path + normal * np.reshape(np.broadcast_to(right_m, len(path)), (-1, 1))


def eased(values, start, end):
    """A smooth rise from 0 to 1 while `values` go from `start` to `end`."""
    t = np.clip((np.asarray(values) - start) / (end - start), 0.0, 1.0)
    return t**3 * (10.0 + t * (6.0 * t - 15.0))
