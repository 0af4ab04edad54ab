"""Streets along which little junctions lie: arterials with bends and lane changes, exits of parking lots."""

import numpy as np

from simulation.curves import at, bend, left_of, shifted, slice_of, straight
from simulation.plan import Plan

# Half the length of a street, meters.
HALF_M = 200.0
# Radius of the corners where roads leave the street, meters.
CORNER_M = 6.5


def street(plan, path, cuts, lanes, width, half_median_m, walked, speed_kmh):
    """Both directions of a road along `path`, cut into pieces at distances along it; nodes are `s0`, `s1`, and so on."""
    for k, cut in enumerate(cuts):
        plan.node(f"s{k}", at(path, cut), radius=CORNER_M)
    extra = {"sidewalkWidth": 2.2} if walked else {}
    for k in range(len(cuts) - 1):
        piece = slice_of(path, cuts[k], cuts[k + 1])
        plan.edge(f"e{k}", f"s{k}", f"s{k + 1}", shifted(piece, half_median_m), lanes[0], width, speed_kmh, priority=7, **extra)
        back = piece[::-1]
        plan.edge(f"w{k}", f"s{k + 1}", f"s{k}", shifted(back, half_median_m), lanes[1], width, speed_kmh, priority=7, **extra)


def side_road(plan, id, node, path, where, on_right, angle, length_m, width, speed_kmh, walked, lanes=(1, 1)):
    """A road that leaves the street at a node, on the right or the left of `path`, at an angle in degrees to it."""
    along = slice_of(path, where - 0.5, where + 0.5)
    tangent = (along[-1] - along[0]) / np.hypot(*(along[-1] - along[0]))
    normal = -left_of(tangent) if on_right else left_of(tangent)
    turn = np.radians(angle)
    out = np.cos(turn) * tangent + np.sin(turn) * normal
    base = along.mean(axis=0)
    line = straight(base, base + length_m * out)
    plan.node(f"{id}_end", line[-1])
    extra = {"sidewalkWidth": 2.0} if walked else {}
    plan.edge(f"{id}_out", node, f"{id}_end", line, lanes[1], width, speed_kmh, priority=1, **extra)
    plan.edge(f"{id}_in", f"{id}_end", node, line[::-1], lanes[0], width, speed_kmh, priority=1, **extra)


def routes(n_pieces):
    """The edges of both directions of a street, from end to end."""
    return [f"e{k}" for k in range(n_pieces)], [f"w{k}" for k in reversed(range(n_pieces))]


def arterial(name, rng, lanes, bend_m, turns, half_view_m=62.0, side_angle=80.0):
    """A street of several lanes each way through bends of radius `bend_m`, with a side street; lanes are changed to overtake and to turn."""
    plan = Plan(name, rng.uniform(-np.pi, np.pi), (half_view_m, half_view_m), int(rng.choice([50, 60])))
    plan.cyclists = 0.04
    path = bent(turns, bend_m)
    width, half = rng.uniform(3.2, 3.6), rng.uniform(0.0, 1.2)
    where = HALF_M + rng.uniform(-18.0, 18.0)
    on_right = bool(rng.random() < 0.5)
    street(plan, path, [0.0, where, 2 * HALF_M], lanes, width, half, True, None)
    side_road(plan, "side", "s1", path, where, on_right, side_angle, 150.0, rng.uniform(3.2, 3.6), 40, True)
    east, west = routes(2)
    first, second = (east, west) if on_right else (west, east)
    for way, n in ((east, lanes[0]), (west, lanes[1])):
        plan.flow(" ".join(way), rng.uniform(310.0, 410.0) * n, "random")
    into, out_of = 90.0, 80.0
    plan.flow(f"{first[0]} side_out", into)
    plan.flow(f"{second[0]} side_out", 0.7 * into)
    plan.flow(f"side_in {first[1]}", out_of)
    plan.flow(f"side_in {second[1]}", 0.6 * out_of)
    plan.crossing("s1", ["side_in", "side_out"], 3.0)
    plan.walk(first[0], first[1], 60.0, (5.0, 80.0), (5.0, 80.0))
    plan.walk(second[0], second[1], 30.0, (5.0, 80.0), (5.0, 80.0))
    plan.slow(east[-1], west[-1])
    return plan


def driveway(name, rng, lanes, exits, bend_m=300.0, turns=(0.3, -0.3), half_view_m=55.0):
    """A street with exits of parking lots: each a (distance along the view, on the right?, angle in degrees)."""
    plan = Plan(name, rng.uniform(-np.pi, np.pi), (half_view_m, half_view_m), 40)
    plan.cyclists = 0.08
    path = bent(turns, bend_m)
    width = rng.uniform(3.2, 3.6)
    cuts = [0.0, *[HALF_M + where for where, _, _ in exits], 2 * HALF_M]
    street(plan, path, cuts, lanes, width, 0.0, True, None)
    east, west = routes(len(exits) + 1)
    for way, n_lanes in ((east, lanes[0]), (west, lanes[1])):
        plan.flow(" ".join(way), rng.uniform(420.0, 520.0) * n_lanes**0.5)
        plan.walk(way[0], way[-1], 70.0, (5.0, 80.0), (5.0, 80.0))
    n = len(exits) + 1
    for k, (where, on_right, angle) in enumerate(exits):
        id = f"lot{k}"
        side_road(plan, id, f"s{k + 1}", path, HALF_M + where, on_right, angle, half_view_m + 70.0, rng.uniform(3.0, 3.3), 20, False)
        for way in (east, west):
            # The street's pieces up to the exit, and those after it, in the direction of travel.
            cut = k + 1 if way is east else n - 1 - k
            plan.flow(" ".join([*way[:cut], f"{id}_out"]), rng.uniform(70.0, 120.0) / n)
            plan.flow(" ".join([f"{id}_in", *way[cut:]]), rng.uniform(90.0, 130.0) / n)
        plan.crossing(f"s{k + 1}", [f"{id}_in", f"{id}_out"], 2.4)
    return plan


def bent(turns, bend_m):
    """A path of 2 * HALF_M meters whose middle is at (0, 0); it turns by each of `turns` radians in and around the view."""
    sides = [abs(turn) * bend_m for turn in turns]
    lead = HALF_M - sum(sides) / 2 - 10.0 * len(turns)
    stretches = [(lead, 0.0)]
    for turn, meters in zip(turns, sides):
        # Ten meters to take up the curvature and ten to lose it turn by as much as ten at full curvature.
        curvature = np.sign(turn) / bend_m
        stretches += [(10.0, curvature), (max(meters - 10.0, 1.0), curvature), (10.0, 0.0)]
    used = sum(meters for meters, _ in stretches)
    path = bend([*stretches, (2 * HALF_M - used, 0.0)])
    middle = len(path) // 2
    heading = path[middle + 1] - path[middle - 1]
    heading /= np.hypot(*heading)
    return (path - path[middle]) @ np.array([heading, left_of(heading)]).T
