"""Junctions at one point: all-way stops, priority roads, signals. Arms differ in angle, lanes, widths and bends."""

import dataclasses

import numpy as np

from simulation.curves import bend, left_of, shifted, unit
from simulation.plan import Plan

ARM_M = 160.0


@dataclasses.dataclass
class Arm:
    """A road from the junction outward; angle in degrees, curvature in 1/m (positive bends to the left, going outward)."""

    angle: float
    lanes_in: int = 1
    lanes_out: int = 1
    priority: int = 1
    # A lane to the left of the others for those who turn left, that begins so many meters before the junction.
    pocket_m: float = 0.0
    curvature: float = 0.0
    median_m: float = 0.0
    speed_kmh: float = 50.0
    busy: float = 1.0
    width_m: float = 0.0
    walked: bool = True


def junction(name, rng, arms, kind, radius_m, half_view_m=50.0, per_hour=330.0, walkers=14.0, options=()):
    """A junction of the given SUMO kind where the arms meet; `radius_m` is that of its corners."""
    plan = Plan(name, rng.uniform(-np.pi, np.pi), (half_view_m, half_view_m), 50)
    plan.cyclists = 0.05
    width = rng.uniform(3.2, 3.7)
    plan.node("c", (0.0, 0.0), kind, radius=f"{radius_m:.1f}")
    for i, arm in enumerate(arms):
        road(plan, i, arm, arm.width_m or width)
        if arm.walked and walkers:
            plan.crossing("c", [near_in(i, arm), f"out{i}"], rng.uniform(3.0, 4.0))
    plan.options += options
    demand(plan, rng, arms, per_hour, walkers)
    return plan


def near_in(i, arm):
    return f"near{i}" if arm.pocket_m else f"in{i}"


def road(plan, i, arm, width):
    """Both directions of an arm; with a pocket, the way in has a median as wide as the pocket until this begins."""
    straight_m = 22.0
    path = bend([(straight_m, 0.0), (20.0, arm.curvature), (ARM_M - 42.0, arm.curvature)])
    turn = np.array([unit(np.radians(arm.angle)), left_of(unit(np.radians(arm.angle)))])
    path = path @ turn
    plan.node(f"t{i}", path[-1])
    common = dict(speed_kmh=arm.speed_kmh, priority=arm.priority)
    if arm.walked:
        common["sidewalkWidth"] = 2.2
    inward, half = path[::-1], arm.median_m / 2
    plan.edge(f"out{i}", "c", f"t{i}", shifted(path, half), arm.lanes_out, width, **common)
    if not arm.pocket_m:
        plan.edge(f"in{i}", f"t{i}", "c", shifted(inward, half), arm.lanes_in, width, **common)
        return
    cut = len(inward) - 1 - int(arm.pocket_m)
    plan.node(f"p{i}", inward[cut])
    plan.edge(f"in{i}", f"t{i}", f"p{i}", shifted(inward[: cut + 1], half + width), arm.lanes_in, width, **common)
    plan.edge(f"near{i}", f"p{i}", "c", shifted(inward[cut:], half), arm.lanes_in + 1, width, **common)
    plan.connect(f"in{i}", f"near{i}", *[(k, k) for k in range(arm.lanes_in)])


def demand(plan, rng, arms, per_hour, walkers):
    """Vehicles from each arm to each other one by how busy both are, and people between all arms that have sidewalks."""
    for i, a in enumerate(arms):
        shares = np.array([0.0 if j == i else b.busy * rng.uniform(0.6, 1.4) for j, b in enumerate(arms)])
        shares /= shares.sum()
        way_in = f"in{i} near{i}" if a.pocket_m else f"in{i}"
        for j, b in enumerate(arms):
            if j != i:
                plan.flow(f"{way_in} out{j}", per_hour * a.busy * shares[j])
            if walkers and a.walked and b.walked:
                plan.walk(f"in{i}", f"out{j}", walkers, (5.0, 50.0), (5.0, 50.0))


def all_way_stop(name, rng, angles, lanes, radius_m, **more):
    """Everyone stops and goes in turn; `lanes` has the lanes in and out of each arm."""
    arms = [Arm(angle, *n, curvature=rng.uniform(-1, 1) / 160.0, speed_kmh=40, busy=n[0]) for angle, n in zip(angles, lanes)]
    return junction(name, rng, arms, "allway_stop", radius_m, **{"per_hour": 260.0, **more})


def minor_road(name, rng, angles, lanes, radius_m, stop=True, bends=120.0, **more):
    """The first two arms are the major road; those on the others stop or give way."""
    arms = []
    for i, (angle, n) in enumerate(zip(angles, lanes)):
        major = i < 2
        arms.append(Arm(angle, *n, priority=5 if major else 1, curvature=rng.uniform(-1, 1) / bends,
                        speed_kmh=50 if major else 40, busy=1.5 if major else 0.7))  # fmt: skip
    return junction(name, rng, arms, "priority_stop" if stop else "priority", radius_m, **{"per_hour": 330.0, **more})


def signals(name, rng, angles, lanes, radius_m, cycle_s, pockets=(), actuated=False, **more):
    """Traffic lights; the arms whose indices are in `pockets` have a lane of their own for left turns."""
    arms = [
        Arm(angle, *n, curvature=rng.uniform(-1, 1) / 200.0, busy=0.6 + 0.55 * n[0], pocket_m=rng.uniform(45, 65) if i in pockets else 0.0)
        for i, (angle, n) in enumerate(zip(angles, lanes))
    ]
    options = ["--tls.cycle.time", str(cycle_s), "--tls.yellow.time", "3", "--tls.allred.time", "2"]
    options += ["--tls.default-type", "actuated" if actuated else "static"]
    return junction(name, rng, arms, "traffic_light", radius_m, options=options, **{"per_hour": 300.0, **more})
