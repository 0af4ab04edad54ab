"""From SUMO's front bumpers to centers, velocities and headings as a tracker over the place would report them.

A vehicle's center lies half a length behind its front bumper: halfway between the path that the bumper took and the line
that SUMO points it along. Either alone lets more boxes overlap: on the path, the rear of who changes lanes lags behind what
SUMO has made room for; on the line, long trucks cut corners. The heading is that of the line from the rear axle to the
center, and the rear axle is dragged behind: it never slips sideways.
"""

import math

import numpy as np

from fixtures.traffic import DT_S, smooth

# Standard deviation of the smoothing over time, in frames; the average then reaches over about a second.
SMOOTHING_FRAMES = 3.0
# From the center to the rear axle: share of the length, and at most so many meters, as long trucks have two rear axles.
REAR_AXLE_SHARE, MAX_REAR_AXLE_M = 0.26, 2.2


def states(front, angle, length):
    """Rows of x, y, vx, vy, heading (SI units, radians) from the front bumper's positions and SUMO's headings.

    People on foot have no length: their position is their center.
    """
    center = front
    if not math.isnan(length):
        pointed = front - length / 2 * np.stack([np.cos(angle), np.sin(angle)], axis=1)
        center = (behind(front, angle[0], length / 2) + pointed) / 2
    center = smooth(center, SMOOTHING_FRAMES)
    velocity = np.gradient(center, DT_S, axis=0)
    heading = angle if math.isnan(length) else dragged(center, angle[0], min(REAR_AXLE_SHARE * length, MAX_REAR_AXLE_M))
    return np.column_stack([center, velocity, heading])


def behind(front, angle, distance):
    """The points a distance in meters back along the path; before its beginning, along the given angle."""
    steps = np.hypot(*np.diff(front, axis=0).T)
    along = np.append(0.0, np.cumsum(steps))
    at = along - distance
    keep = np.append(True, steps > 1e-6)
    points = np.stack([np.interp(at, along[keep], front[keep, axis]) for axis in range(2)], axis=1)
    return points + np.minimum(at, 0.0)[:, None] * np.array([math.cos(angle), math.sin(angle)])


def dragged(center, angle, reach):
    """Headings of an axis of the given length whose front end is moved along `center` and whose rear end follows."""
    headings = np.empty(len(center))
    x, y = center[0]
    rear_x, rear_y = x - reach * math.cos(angle), y - reach * math.sin(angle)
    for i, (x, y) in enumerate(center.tolist()):
        dx, dy = x - rear_x, y - rear_y
        scale = reach / math.hypot(dx, dy)
        headings[i] = math.atan2(dy, dx)
        rear_x, rear_y = x - dx * scale, y - dy * scale
    return headings
