"""Cases cut from the tracks of a run, and why some are left out."""

import math

import numpy as np

from fixtures import interaction
from fixtures.traffic import DT_S

N_FRAMES, MIN_FRAMES = interaction.N_FRAMES, 5
# Cases begin so many frames apart, plus or minus a random part: at most half of what one shows is in the next.
STRIDE_FRAMES, JITTER_FRAMES = 25, 5
MIN_AGENTS = 4
# Boxes that overlap by less are a graze, meters.
GRAZE_M = 0.05
# Boxes of those whose size is not recorded, meters: who walks, and who rides.
ON_FOOT_M, BICYCLE_M = (0.5, 0.5), (1.8, 0.5)
# What no vehicle does: limits of acceleration along and across the motion, and of jerk, in m/s2 and m/s3.
MAX_ALONG_MPS2, MAX_ACROSS_MPS2, MAX_JERK_MPS3 = 7.5, 5.5, 20.0
# Tracks begin and end within so many meters of the border of the view.
BORDER_M = 6.0
# Whoever moves less in a case stands, meters.
STANDS_M = 0.5


def windows(tracks, n_frames, rng):
    """The cases of a run: lists of tracks cut to 40 frames, in which everyone is seen for at least five."""
    start = int(rng.integers(0, JITTER_FRAMES))
    while start + N_FRAMES <= n_frames:
        # Tracks are ordered by their first frames, and cut ones keep that order.
        cut = [track.window(start, start + N_FRAMES) for track in tracks if track.first < start + N_FRAMES and track.last > start]
        yield [track for track in cut if len(track.rows) >= MIN_FRAMES]
        start += STRIDE_FRAMES + int(rng.integers(-JITTER_FRAMES, JITTER_FRAMES + 1))


def flaw(case, plan):
    """Why a case is left out, as a word; empty if it is kept."""
    n_cars = sum(track.kind == "car" and len(track.rows) == N_FRAMES for track in case)
    if n_cars < 2 or len(case) < MIN_AGENTS:
        return "few"
    if len(case) > plan.most_agents:
        return "many"
    if all(np.ptp(track.rows[:, :2], axis=0).max() < STANDS_M for track in case if track.kind == "car"):
        return "standstill"
    if any(appears_inside(track, plan) for track in case):
        return "appears"
    if any(moves_oddly(track) for track in case):
        return "motion"
    return "overlap" if overlap_m(case) > GRAZE_M else ""


def appears_inside(track, plan):
    """Whether a track begins or ends within the case away from the border of the view."""
    ends = ([track.rows[0, :2]] if track.first > 0 else []) + ([track.rows[-1, :2]] if track.last < N_FRAMES else [])
    return bool(ends) and bool(plan.in_view(np.array(ends), -BORDER_M).any())


def moves_oddly(track):
    """Whether a vehicle accelerates or jerks beyond the limits."""
    if track.kind != "car" or len(track.rows) < MIN_FRAMES:
        return False
    acceleration = np.gradient(track.rows[:, 2:4], DT_S, axis=0)
    jerk = np.gradient(acceleration, DT_S, axis=0)
    ahead = np.stack([np.cos(track.rows[:, 4]), np.sin(track.rows[:, 4])], axis=1)
    along = (acceleration * ahead).sum(axis=1)
    across = acceleration[:, 1] * ahead[:, 0] - acceleration[:, 0] * ahead[:, 1]
    worst = np.abs(along).max() / MAX_ALONG_MPS2, np.abs(across).max() / MAX_ACROSS_MPS2, np.hypot(*jerk.T).max() / MAX_JERK_MPS3
    return max(worst) > 1.0


def box_of(track):
    """Length and width that count for overlaps, meters."""
    if track.kind == "car":
        return track.length, track.width
    return ON_FOOT_M if math.isnan(track.length) else BICYCLE_M


def overlap_m(case):
    """The deepest overlap of two boxes at any frame of a case, meters; two people who meet do not count."""
    n = len(case)
    states = np.full((n, N_FRAMES, 5), np.nan)
    for i, track in enumerate(case):
        states[i, track.first : track.last] = track.rows
    half = np.array([box_of(track) for track in case]) / 2
    drives = np.array([track.kind == "car" for track in case])
    first, second = np.triu_indices(n, 1)
    matters = drives[first] | drives[second]
    first, second = first[matters], second[matters]
    between = states[second, :, :2] - states[first, :, :2]
    reach = np.hypot(*half[first].T) + np.hypot(*half[second].T)
    near = np.hypot(between[..., 0], between[..., 1]) < reach[:, None]
    pair, frame = np.nonzero(near)
    if len(pair) == 0:
        return 0.0
    return float(penetration(between[pair, frame], states[first[pair], frame, 4], states[second[pair], frame, 4],
                             half[first[pair]], half[second[pair]]).max())  # fmt: skip


def penetration(between, heading_a, heading_b, half_a, half_b):
    """How deep boxes overlap: the least way along one of their axes that parts them; 0 or less where they do not.

    `between` is the vector from the centers of a to those of b, [n, 2]; `half_a`, `half_b` are half lengths and widths, [n, 2].
    """
    deepest = np.full(len(between), np.inf)
    axes_a, axes_b = axes_of(heading_a), axes_of(heading_b)
    for axis in (*axes_a, *axes_b):
        spans = [half[:, 0] * np.abs((long * axis).sum(1)) + half[:, 1] * np.abs((wide * axis).sum(1))
                 for half, (long, wide) in ((half_a, axes_a), (half_b, axes_b))]  # fmt: skip
        deepest = np.minimum(deepest, spans[0] + spans[1] - np.abs((between * axis).sum(1)))
    return deepest


def axes_of(heading):
    long = np.stack([np.cos(heading), np.sin(heading)], axis=1)
    return long, np.stack([-long[:, 1], long[:, 0]], axis=1)


def rows(case_id, case):
    """The rows of a case in INTERACTION's v1.2 form; tracks and frames are numbered from 1."""
    lines = []
    for number, track in enumerate(case, start=1):
        for i, row in enumerate(track.rows):
            tail = interaction.shape(track, row) if track.kind == "car" else ",,"
            lines.append(f"{case_id:.1f},{interaction.fields(number, track.first + i + 1, track.kind, row)},{tail}\n")
    return "".join(lines)
