"""Motorways: three to five lanes a direction, seen over 300 to 440 m as by a drone, with ramps, trucks and jams."""

import dataclasses

import numpy as np

from simulation.curves import eased, shifted, slice_of
from simulation.highways import reference
from simulation.plan import Plan

# How far the roads reach beyond the view, meters: vehicles find their lane and speed there, and jams begin.
BEYOND_M, JAM_M = 380.0, 60.0
# How long ramps are, and how far from the motorway they begin or end, meters.
RAMP_M, APART_M = 320.0, (30.0, 60.0)
MEDIAN_M = (3.0, 8.0)


@dataclasses.dataclass
class Style:
    """What the roads and the drivers of a continent have in common; pairs are ranges."""

    lane_m: tuple
    limits_kmh: tuple
    trucks: tuple
    truck_m: tuple
    # What limits trucks, km/h, and the weight of the habit of driving on the right.
    truck_kmh: tuple
    keep_right: float


STYLES = {
    "european": Style((3.5, 3.75), (100, 120, 130), (0.12, 0.22), (7.0, 16.5), (82.0, 93.0), 1.0),
    "american": Style((3.5, 3.7), (90, 105, 115), (0.05, 0.12), (7.0, 18.0), (90.0, 110.0), 0.1),
}


def motorway(name, rng, lanes, style, ramp="", both=False, jams=0.0, half_view_m=200.0):
    """`lanes` lanes and a ramp: `on`, `off`, or both of them joined by a lane (`weave`).

    With `both`, the other direction is seen, too. `jams` is the share of time in which traffic queues up ahead.
    """
    style = STYLES[style]
    plan = Plan(name, rng.uniform(-np.pi, np.pi), (half_view_m, 50.0), int(rng.choice(style.limits_kmh)), highway=True)
    plan.trucks, plan.truck_m, plan.truck_kmh = rng.uniform(*style.trucks), style.truck_m, style.truck_kmh
    plan.keep_right, plan.most_agents = style.keep_right, 64
    plan.slow_share, plan.slow_factor, plan.slow_s = jams, (0.03, 0.35), (25.0, 90.0)
    width, around = rng.uniform(*style.lane_m), half_view_m + BEYOND_M
    path, half = reference(rng, rng.uniform(1200.0, 3000.0), around)
    flow = rng.uniform(1000.0, 1500.0) if jams == 0.0 else rng.uniform(1400.0, 1900.0)
    carriageway(plan, rng, path, half, lanes, width, ramp, flow, "")
    if both:
        opposite = shifted(path, -rng.uniform(*MEDIAN_M))[::-1]
        carriageway(plan, rng, opposite, half, lanes, width, "", flow * rng.uniform(0.6, 1.2), "back_")
    return plan


def carriageway(plan, rng, path, half, lanes, width, ramp, flow, prefix):
    """One direction: the edges `in`, `middle`, `out` and, where jams begin, `end`, with the lane of ramps beside `middle`."""
    view, around = plan.half_view[0], plan.half_view[0] + BEYOND_M
    start, end = -rng.uniform(0.45, 0.8) * view, rng.uniform(0.45, 0.8) * view
    extra = int(ramp != "")
    cuts = [-around, start, end, view + JAM_M, around]
    ids, nodes = ([prefix + id for id in names] for names in (("in", "middle", "out", "end"), "wabje"))
    parts = [slice_of(path, half + a, half + b) for a, b in zip(cuts, cuts[1:])]
    for node, point in zip(nodes, [*(part[0] for part in parts), parts[-1][-1]]):
        plan.node(node, point)
    for id, a, b, part, n in zip(ids, nodes, nodes[1:], parts, (lanes, lanes + extra, lanes, lanes)):
        plan.edge(id, a, b, part, n, width, priority=3)
    for before, after, a, b in zip(ids, ids[1:], (0, extra, 0), (extra, 0, 0)):
        plan.connect(before, after, *[(i + a, i + b) for i in range(lanes)])
    if ramp in ("on", "weave"):
        slip_road(plan, rng, path, half, (start, start - RAMP_M), lanes * width, width, prefix + "on_ramp", nodes[1])
        plan.connect(prefix + "on_ramp", ids[1], (0, 0))
        plan.flow(f"{prefix}on_ramp {' '.join(ids[1:])}", rng.uniform(350.0, 700.0), "random")
    if ramp in ("off", "weave"):
        slip_road(plan, rng, path, half, (end, end + RAMP_M), lanes * width, width, prefix + "off_ramp", nodes[2])
        plan.connect(ids[1], prefix + "off_ramp", (0, 0))
        plan.flow(f"{' '.join(ids[:2])} {prefix}off_ramp", rng.uniform(350.0, 700.0), "random")
    plan.flow(" ".join(ids), flow * lanes, "random")
    if plan.slow_share > 0.0:
        plan.slow(ids[3])


def slip_road(plan, rng, path, half, ends, right_m, width, id, node):
    """The lane of a ramp between the motorway's `node` and a place apart from it; `ends` are how far along they lie."""
    joins, leaves = ends
    entry = leaves < joins
    low, high = min(ends), max(ends)
    part = slice_of(path, half + low, half + high)
    away = eased(np.linspace(low, high, len(part)), joins + (-8.0 if entry else 8.0), leaves)
    line = shifted(part, right_m + rng.uniform(*APART_M) * away)
    plan.node(f"{id}_far", line[0] if entry else line[-1])
    between = (f"{id}_far", node) if entry else (node, f"{id}_far")
    plan.edge(id, *between, line, 1, width, plan.speed_kmh * rng.uniform(0.6, 0.85), priority=2)
