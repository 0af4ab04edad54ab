"""A planner for `djinn drive`, as an example: it steers by pure pursuit and keeps its distance by the intelligent
driver model. Its options plant faults, to see whether a corpus finds them."""

import argparse
import math
from djinn.drive import along, find, serve

faults = argparse.ArgumentParser(description=__doc__)
faults.add_argument("--late", action="store_true", help="sees everything half a second late, itself included")
faults.add_argument("--weak", action="store_true", help="brakes with at most 2 m/s²")
faults.add_argument("--fast", action="store_true", help="wants to drive 20 %% faster")
faults.add_argument("--ahead-only", action="store_true", help="sees who is on its route, no sooner")
faults.add_argument("--no-merging", action="store_true", help="ignores who was not on its route from the beginning")
faults.add_argument("--right-of-way", action="store_true", help="trusts that crossing traffic yields")
faults.add_argument("--near-sighted", action="store_true", help="sees 15 m far")
faults.add_argument("--blind", action="store_true", help="sees nobody")
faults = faults.parse_args()
seen = {}  # The observations of the present scenario.


def half_a_second_before(observation, hello):
    n = round(0.5 / hello["dt_s"])
    agents = [{**agent, "states": agent["states"][:-n]} for agent in observation["agents"]]
    agents = [agent for agent in agents if agent["states"] and agent["states"][-1]]
    if all(agent["id"] != hello["ego_id"] for agent in agents):
        # An ego that was not there yet knows where it is now.
        agents.append(find(observation, hello["ego_id"]))
    return {**observation, "agents": agents}


def act(observation, hello):
    history = seen.setdefault(hello["scenario_id"], [])
    if observation["time_s"] == 0.0:
        seen.clear()
        seen[hello["scenario_id"]] = history = []
    # The first observation has the second before it, too.
    history += [observation] if history or not faults.late else [half_a_second_before(observation, hello), observation]
    observation = history[-2 if faults.late else -1]
    route, width = hello["route"], hello["width_m"]
    x, y, heading, vx, vy = find(observation, hello["ego_id"])["states"][-1]
    speed, (station, _) = math.hypot(vx, vy), along(route, x, y)
    # Steer for the point on the route that is a second and 4 m ahead.
    at = min(range(len(route)), key=lambda i: abs(station + speed + 4.0 - i))
    toward = math.atan2(route[at][1] - y, route[at][0] - x) - heading
    curvature = 2.0 * math.sin(toward) / max(math.dist((x, y), route[at]), 1.0)
    on_route = {a["id"] for a in observation["agents"] if abs(along(route, *a["states"][-1][:2])[1]) < width}
    leaders = seen.setdefault("leaders", on_route)
    # Keep the distance to whoever is on the route, or will be within two seconds.
    wanted = hello["target_speed_mps"] * (1.2 if faults.fast else 1.0)
    acceleration = 1.5 * (1.0 - (speed / max(wanted, 1.0)) ** 4)
    for agent in [] if faults.blind else observation["agents"]:
        if agent["id"] == hello["ego_id"]:
            continue
        ox, oy, oh, ovx, ovy = agent["states"][-1]
        half = (agent["width_m"] + width) / 2.0 + 0.3
        other, aside = along(route, ox, oy)
        then, aside_then = along(route, ox + 2.0 * ovx, oy + 2.0 * ovy)
        comes = not faults.ahead_only and aside * aside_then < half * abs(aside) and abs(aside) < 8.0
        on = min(int(other), len(route) - 2)
        along_route = math.atan2(route[on + 1][1] - route[on][1], route[on + 1][0] - route[on][0])
        crosses = math.cos(oh - along_route) < 0.7
        if faults.no_merging and agent["id"] not in leaders or faults.right_of_way and crosses:
            continue
        gap = other - station - (agent["length_m"] + hello["length_m"]) / 2.0
        if other < station or not (abs(aside) < half or comes) or (faults.near_sighted and gap > 15.0):
            continue
        closing = speed - (then - other) / 2.0
        keep = 2.0 + max(speed * 1.5 + speed * closing / (2.0 * math.sqrt(1.5 * 2.0)), 0.0)
        acceleration = min(acceleration, 1.5 * (1.0 - (keep / max(gap, 0.1)) ** 2))
    return {"acceleration_mps2": max(acceleration, -2.0 if faults.weak else -8.0), "curvature_1pm": curvature}


serve(act)
