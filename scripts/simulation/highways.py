"""Highways: an on-ramp that merges, a weaving section between two ramps, lanes that end."""

import numpy as np

from simulation.curves import bend, eased, shifted, slice_of
from simulation.plan import Plan

# How far the highway and its ramps reach from (0, 0), meters.
AROUND_M, RAMP_M = 220.0, 210.0


def reference(rng, straightness, around=AROUND_M):
    """The left border of the highway: a long bend through (0, 0), eastward there, and how far along it that is."""
    before, after = rng.uniform(-1.0, 1.0, 2) / straightness
    half = around + 60.0
    behind = bend([(half, -before)])
    behind = np.stack([-behind[:, 0], behind[:, 1]], axis=1)[::-1]
    return np.concatenate([behind, bend([(half, after)])[1:]]), half


def mainline(plan, path, half, cuts, middle, lanes, width):
    """Three edges one after another: `in`, the one named `middle` between the two cuts, and `out`; `lanes` has a number for each."""
    ends = [-AROUND_M, *cuts, AROUND_M]
    parts = [slice_of(path, half + a, half + b) for a, b in zip(ends, ends[1:])]
    for id, point in zip("wabe", [*(part[0] for part in parts), parts[-1][-1]]):
        plan.node(id, point)
    for id, start, end, part, n in zip(("in", middle, "out"), "wab", "abe", parts, lanes):
        plan.edge(id, start, end, part, n, width, priority=3)


def merge(name, rng, lanes, half_view_m=75.0, ramp_lanes=1, straightness=350.0):
    """`lanes` lanes and an on-ramp whose lane ends after an acceleration lane of 70 to 120 m."""
    plan = Plan(name, rng.uniform(-np.pi, np.pi), (half_view_m, 45.0), int(rng.choice([50, 60, 70])), highway=True)
    width, (path, half) = rng.uniform(3.3, 3.8), reference(rng, straightness)
    start, end = -rng.uniform(35.0, 55.0), rng.uniform(25.0, 50.0)
    mainline(plan, path, half, (start, end), "merge", (lanes, lanes + ramp_lanes, lanes), width)
    ramp = slice_of(path, half - RAMP_M, half + start)
    away = 1.0 - eased(np.linspace(-RAMP_M, start, len(ramp)), -rng.uniform(180.0, 205.0), start - 4.0)
    ramp = shifted(ramp, lanes * width + rng.uniform(35.0, 80.0) * away)
    plan.node("r", ramp[0])
    plan.edge("ramp", "r", "a", ramp, ramp_lanes, width, plan.speed_kmh * rng.uniform(0.75, 1.0), priority=2)
    plan.connect("in", "merge", *[(i, i + ramp_lanes) for i in range(lanes)])
    plan.connect("ramp", "merge", *[(i, i) for i in range(ramp_lanes)])
    plan.connect("merge", "out", *[(i + ramp_lanes, i) for i in range(lanes)])
    plan.flow("in merge out", rng.uniform(850.0, 1050.0) * lanes, "random")
    plan.flow("ramp merge out", rng.uniform(420.0, 600.0) * ramp_lanes, "random")
    plan.slow("out")
    return plan


def weave(name, rng, lanes, half_view_m=80.0):
    """An on-ramp and an off-ramp joined by an auxiliary lane of 90 to 130 m: those who enter cross those who leave."""
    plan = Plan(name, rng.uniform(-np.pi, np.pi), (half_view_m, 45.0), int(rng.choice([50, 60, 70])), highway=True)
    width, (path, half) = rng.uniform(3.3, 3.8), reference(rng, 450.0)
    start, end = -rng.uniform(42.0, 62.0), rng.uniform(45.0, 65.0)
    mainline(plan, path, half, (start, end), "weave", (lanes, lanes + 1, lanes), width)
    for id, sign in (("on", -1.0), ("off", 1.0)):
        low, high = (-RAMP_M, start) if sign < 0 else (end, RAMP_M)
        ramp = slice_of(path, half + low, half + high)
        where = np.linspace(low, high, len(ramp))
        away = eased(sign * where, min(abs(low), abs(high)) + 4.0, rng.uniform(180.0, 205.0))
        ramp = shifted(ramp, lanes * width + rng.uniform(35.0, 80.0) * away)
        speed = plan.speed_kmh * rng.uniform(0.75, 1.0)
        plan.node(id, ramp[0] if sign < 0 else ramp[-1])
        ends = (id, "a") if sign < 0 else ("b", id)
        plan.edge(f"{id}_ramp", *ends, ramp, 1, width, speed, priority=2)
    plan.connect("in", "weave", *[(i, i + 1) for i in range(lanes)])
    plan.connect("on_ramp", "weave", (0, 0))
    plan.connect("weave", "off_ramp", (0, 0))
    plan.connect("weave", "out", *[(i + 1, i) for i in range(lanes)])
    plan.flow("in weave out", rng.uniform(650.0, 850.0) * lanes, "random")
    plan.flow("in weave off_ramp", rng.uniform(350.0, 550.0), "random")
    plan.flow("on_ramp weave out", rng.uniform(380.0, 560.0))
    plan.flow("on_ramp weave off_ramp", 60.0)
    plan.slow("out")
    return plan


def lane_drop(name, rng, lanes, half_view_m=75.0):
    """`lanes` lanes of which one ends on a side, and farther on, where there are still three, another on the other side."""
    plan = Plan(name, rng.uniform(-np.pi, np.pi), (half_view_m, 40.0), int(rng.choice([50, 60, 70])), highway=True)
    width, (path, half) = rng.uniform(3.3, 3.8), reference(rng, 300.0)
    first, second = rng.uniform(-30.0, -10.0), rng.uniform(40.0, 55.0)
    left_ends = rng.random() < 0.5
    cuts, counts = [-AROUND_M, first, AROUND_M], [lanes, lanes - 1]
    if lanes > 3:
        cuts, counts = [-AROUND_M, first, second, AROUND_M], [lanes, lanes - 1, lanes - 2]
    for i, at in enumerate(cuts):
        plan.node(f"n{i}", slice_of(path, half + min(at, AROUND_M - 1), half + AROUND_M)[0])
    right_m, names = 0.0, []
    for i, n in enumerate(counts):
        if i > 0:
            on_left = left_ends == (i == 1)
            right_m += width * on_left
            plan.connect(f"e{i - 1}", f"e{i}", *[(k if on_left else k + 1, k) for k in range(n)])
        shape = shifted(slice_of(path, half + cuts[i], half + cuts[i + 1]), right_m)
        plan.edge(f"e{i}", f"n{i}", f"n{i + 1}", shape, n, width, priority=3)
        names.append(f"e{i}")
    plan.flow(" ".join(names), rng.uniform(1050.0, 1300.0) * counts[-1], "random")
    plan.slow(names[-1])
    return plan

