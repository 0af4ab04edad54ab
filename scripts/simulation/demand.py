"""When who starts: vehicles on the routes of a place and people on foot, at rates that are drawn anew again and again."""

import numpy as np

from simulation import drivers


def intervals(rng, duration_s, low_s=45.0, high_s=110.0):
    """Start and end of consecutive intervals of random lengths, seconds."""
    cuts = [0.0]
    while cuts[-1] < duration_s:
        cuts.append(cuts[-1] + rng.uniform(low_s, high_s))
    return list(zip(cuts, cuts[1:]))


def draw(plan, rng, duration_s):
    """SUMO's route file for one run, and the size of every vehicle by id: (type in INTERACTION, length, width)."""
    kinds = drivers.kinds(rng, plan)
    busy = rng.uniform(0.75, 1.15)
    starts = []
    for route, flow in enumerate(plan.flows):
        for begin, end in intervals(rng, duration_s):
            per_hour = flow.per_hour * busy * rng.uniform(0.4, 1.6)
            time = begin + rng.exponential(3600.0 / per_hour)
            while time < min(end, duration_s):
                starts.append((time, "vehicle", route))
                time += 0.8 + rng.exponential(max(3600.0 / per_hour - 0.8, 0.3))
    for i, walk in enumerate(plan.walks):
        time = rng.exponential(3600.0 / walk.per_hour)
        while time < duration_s:
            starts.append((time, "person", i))
            time += rng.exponential(3600.0 / walk.per_hour)
    starts.sort()
    body = [kind.xml for group in kinds.values() for kind in group]
    body += [f'<route id="r{i}" edges="{flow.edges}"/>' for i, flow in enumerate(plan.flows)]
    extents = {}
    for number, (time, what, i) in enumerate(starts):
        if what == "person":
            body.append(person(rng, f"p{number}", time, plan.walks[i]))
            extents[f"p{number}"] = ("pedestrian/bicycle", np.nan, np.nan)
        else:
            kind, text = vehicle(plan, rng, f"v{number}", time, i, kinds)
            body.append(text)
            rides = kind.id.startswith("cyclist")
            extents[f"v{number}"] = ("pedestrian/bicycle" if rides else "car", kind.length, kind.width)
    return "\n".join(["<routes>", *body, "</routes>", ""]), extents


def vehicle(plan, rng, id, time, route, kinds):
    share = rng.random()
    group = "cyclist" if share < plan.cyclists else "truck" if share < plan.cyclists + plan.trucks else "car"
    kind = kinds[group][rng.integers(len(kinds[group]))]
    lane = "best" if group == "cyclist" else plan.flows[route].lane
    return kind, f'<vehicle id="{id}" type="{kind.id}" route="r{route}" depart="{time:.1f}" departLane="{lane}" departSpeed="max"/>'


def person(rng, id, time, walk):
    start, end = rng.uniform(*walk.start_m), rng.uniform(*walk.end_m)
    return (
        f'<person id="{id}" depart="{time:.1f}" departPos="{start:.1f}" speedFactor="{np.clip(rng.normal(0.98, 0.13), 0.6, 1.4):.3f}">'
        f'<walk from="{walk.start}" to="{walk.end}" arrivalPos="-{end:.1f}"/></person>'
    )


def slow_downs(plan, net, rng, duration_s):
    """Speed limits that drop for a while where traffic leaves the place, as if there were a queue ahead; SUMO's XML."""
    body = []
    for i, edge in enumerate(plan.slow_edges):
        lanes = net.lanes(net.edges[edge])
        normal = float(lanes[0].get("speed"))
        steps = []
        for begin, _ in intervals(rng, duration_s, *plan.slow_s):
            factor = rng.uniform(*plan.slow_factor) if rng.random() < plan.slow_share else 1.0
            steps.append(f'<step time="{begin:.1f}" speed="{factor * normal:.2f}"/>')
        names = " ".join(lane.get("id") for lane in lanes)
        body += [f'<variableSpeedSign id="slow{i}" lanes="{names}">', *steps, "</variableSpeedSign>"]
    return "\n".join(["<additional>", *body, "</additional>", ""])
