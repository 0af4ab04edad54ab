"""Roundabouts with one lane or two: a ring that runs counterclockwise, and arms that meet it on curves."""

import numpy as np

from simulation.curves import arc, bezier, left_of, shifted, straight, unit
from simulation.plan import Plan

ARM_M = 150.0


def roundabout(name, rng, angles, radius_m, ring_lanes=1, half_view_m=60.0, busy=1.0):
    """A ring of `ring_lanes` lanes whose inner border has the given radius, with arms at the given angles in degrees.

    All arms have as many lanes each way as the ring. On a ring of two lanes, the outer lane ends in each exit, as on turbo
    roundabouts: nobody crosses it to leave, and whoever wants farther enters on the inner lane. People cross each arm.
    """
    plan = Plan(name, rng.uniform(-np.pi, np.pi), (half_view_m, half_view_m), 40)
    plan.cyclists = 0.05 if ring_lanes == 1 else 0.0
    ring_width = rng.uniform(4.2, 5.0) if ring_lanes == 1 else rng.uniform(3.9, 4.3)
    width = rng.uniform(3.3, 3.7)
    outer = radius_m + ring_lanes * ring_width
    n = len(angles)
    middle = (radius_m + outer) / 2
    # Half the angle between exit and entry: there is an island between them as they meet the ring.
    spread = [(ring_lanes * width / 2 + rng.uniform(2.0, 2.8)) / middle for _ in angles]
    thetas = np.radians(angles)
    for i, theta in enumerate(thetas):
        arm(plan, rng, i, theta, spread[i], radius_m, outer, ring_lanes, width)
    for i, theta in enumerate(thetas):
        j = (i + 1) % n
        after = thetas[j] + (2 * np.pi if j == 0 else 0.0)
        ring = dict(width=ring_width, priority=9)
        gap = arc((0, 0), radius_m, theta - spread[i], theta + spread[i])
        plan.edge(f"gap{i}", f"x{i}", f"y{i}", gap, 1, **ring)
        along = arc((0, 0), radius_m, theta + spread[i], after - spread[j])
        plan.edge(f"ring{i}", f"y{i}", f"x{j}", along, ring_lanes, **ring, **WALKED)
        plan.connect(f"gap{i}", f"ring{i}", (0, ring_lanes - 1))
        plan.connect(f"ring{i}", f"gap{j}", (ring_lanes - 1, 0))
        plan.connect(f"ring{i}", f"exit{j}", *[(k, k) for k in range(ring_lanes)])
        plan.connect(f"entry{i}", f"ring{i}", *[(k, k) for k in range(ring_lanes)])
    members = [f"gap{i}" for i in range(n)] + [f"ring{i}" for i in range(n)]
    nodes = [f"x{i}" for i in range(n)] + [f"y{i}" for i in range(n)]
    plan.edges.append(f'<roundabout nodes="{" ".join(nodes)}" edges="{" ".join(members)}"/>')
    demand(plan, rng, n, busy * (1.0 if ring_lanes == 1 else 1.8))
    return plan


WALKED = {"sidewalkWidth": 2.0}


def arm(plan, rng, i, theta, spread, radius, outer, n_lanes, width):
    """The two-way road from far out to node `a`, and from there an entry and an exit on either side of an island."""
    out, side = unit(theta), left_of(unit(theta))
    split = outer + rng.uniform(13.0, 17.0)
    island = rng.uniform(1.2, 2.2)
    plan.node(f"x{i}", radius * unit(theta - spread))
    plan.node(f"y{i}", radius * unit(theta + spread))
    plan.node(f"a{i}", split * out)
    plan.node(f"t{i}", ARM_M * out)
    flat = np.radians(rng.uniform(38.0, 50.0) - 8.0 * (n_lanes - 1))
    # Who enters comes from far out on the side of larger angles: that is to the right of the way in.
    middle = (radius + outer) / 2
    end = middle * unit(theta + spread)
    toward = np.cos(flat) * left_of(unit(theta + spread)) - np.sin(flat) * unit(theta + spread)
    half = n_lanes * width / 2
    path = bezier(split * out + (island + half) * side, -out, end, toward)
    plan.edge(f"entry{i}", f"a{i}", f"y{i}", shifted(path, -half), n_lanes, width, 30, priority=3, **WALKED)
    start = middle * unit(theta - spread)
    toward = np.cos(flat) * left_of(unit(theta - spread)) + np.sin(flat) * unit(theta - spread)
    path = bezier(start, toward, split * out - (island + half) * side, out)
    plan.edge(f"exit{i}", f"x{i}", f"a{i}", shifted(path, -half), n_lanes, width, 30, priority=3, **WALKED)
    lead = straight(ARM_M * out, split * out)
    plan.edge(f"in{i}", f"t{i}", f"a{i}", lead + island * side, n_lanes, width, priority=3, **WALKED)
    plan.edge(f"out{i}", f"a{i}", f"t{i}", lead[::-1] - island * side, n_lanes, width, priority=3, **WALKED)
    plan.connect(f"in{i}", f"entry{i}", *[(k, k) for k in range(n_lanes)])
    plan.connect(f"exit{i}", f"out{i}", *[(k, k) for k in range(n_lanes)])
    plan.crossing(f"a{i}", [f"in{i}", f"out{i}"], 3.0)


def demand(plan, rng, n, busy):
    """Vehicles from each arm to each, seldom back to where they came from, and people who cross arms or walk around."""
    weights = rng.uniform(0.5, 1.5, n)
    for i in range(n):
        per_hour = busy * 360.0 * rng.uniform(0.8, 1.2)
        turns = np.array([0.06 if j == i else weights[j] for j in range(n)])
        for j, share in enumerate(turns / turns.sum()):
            edges = [f"in{i}", f"entry{i}"]
            k = i
            while True:
                edges.append(f"ring{k}")
                k = (k + 1) % n
                if k == j:
                    break
                edges.append(f"gap{k}")
            plan.flow(" ".join([*edges, f"exit{j}", f"out{j}"]), per_hour * share)
        plan.walk(f"in{i}", f"out{i}", 40.0, (10.0, 60.0), (5.0, 40.0))
        plan.walk(f"in{i}", f"out{(i + 1) % n}", 15.0, (10.0, 60.0), (5.0, 40.0))
