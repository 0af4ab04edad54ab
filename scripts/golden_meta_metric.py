#!/usr/bin/env python3
"""What the Waymo Open Sim Agents Challenge's own program finds for made-up scenes: tests/golden/meta_metric.json.

The package wants other versions than those that exist for newer Pythons; these work with Python 3.11:

    pip install numpy==1.23.5 tensorflow-cpu==2.12.0 tensorflow-probability==0.19.0 scikit-learn==1.2.2
    pip install --no-deps waymo-open-dataset-tf-2-12-0==1.6.7
    python scripts/golden_meta_metric.py

The challenge's horizon (11 observed timesteps and 80 more) is replaced by a shorter one. Headings stay away from π: the
challenge compares raw differences of headings, djinn wraps them. It computes in single precision, so that of many such
scenes some have a value so near to the edge of a bin that it counts beside it; these have none.
"""

import contextlib
import json
from pathlib import Path

import numpy as np
import waymo_open_dataset
from waymo_open_dataset.protos import map_pb2, scenario_pb2, sim_agents_submission_pb2
from waymo_open_dataset.utils.sim_agents import submission_specs
from waymo_open_dataset.wdl_limited.sim_agents_metrics import metrics

GOLDEN = Path(__file__).resolve().parents[1] / "tests/golden/meta_metric.json"
N_HISTORY, N_FUTURE, N_SAMPLES, DT_S = 5, 14, 4, 0.1
TYPES = {"vehicle": 1, "pedestrian": 2, "cyclist": 3}
# Class, length, width, and x, y, heading and speed at the present: two cars follow a third, one comes toward them past
# an island, a cyclist rides beside them, and somebody walks off the road.
AGENTS = [
    ("vehicle", 4.6, 1.9, 0.0, 0.0, 0.0, 9.0),
    ("vehicle", 4.2, 1.8, 12.0, 0.3, 0.05, 6.0),
    ("vehicle", 10.0, 2.5, 26.0, -0.2, -0.1, 3.0),
    ("vehicle", 4.5, 1.8, 58.0, 0.6, 2.9, 8.0),
    ("cyclist", 1.8, 0.7, 6.0, -2.6, 0.1, 5.0),
    ("pedestrian", 0.8, 0.7, 15.0, -5.0, 1.4, 1.2),
]
EDGES = [
    # The right edge, with a sharp driveway, and the left one: the road is on the left of either.
    [[-30, -3.6], [8, -3.8], [9, -9], [12, -9], [13, -3.8], [40, -4.2], [80, -9]],
    [[80, 4.5], [30, 6.4], [-30, 6.0]],
    # An island, which is closed. It has the most points, because the challenge closes only the longest lines.
    [[50, -1], [50, 0], [50, 1], [52, 1], [54, 1], [54, 0], [54, -1], [52, -1], [50, -1]],
]


def driven(rng, start, noise):
    """Positions and headings of one future, or of the past if `noise` is 0, from a start at the present."""
    x, y, heading, speed = start
    n = N_FUTURE + 1
    acceleration = rng.normal(0, noise) + np.cumsum(rng.normal(0, 0.5 * noise, n))
    turn = rng.normal(0, 0.06 * noise) + np.cumsum(rng.normal(0, 0.03 * noise, n))
    speeds = np.maximum(speed + np.cumsum(acceleration) * DT_S, 0)
    headings = np.clip(heading + np.cumsum(turn) * DT_S, -3.1, 3.1)
    steps = speeds * DT_S
    return np.stack([
        x + np.cumsum(steps * np.cos(headings)), y + np.cumsum(steps * np.sin(headings)), headings], axis=1)[:N_FUTURE]


def futures(rng, noise):
    return np.round([driven(rng, agent[3:], noise) for agent in AGENTS], 3)


def scene(seed, noise):
    """The scene as numbers: states are [x, y, heading], or null where nobody was recorded."""
    rng = np.random.default_rng(seed)
    past = []
    for _, _, _, x, y, heading, speed in AGENTS:
        back = -np.arange(N_HISTORY - 1, -1, -1) * speed * DT_S
        past.append(np.stack([x + back * np.cos(heading), y + back * np.sin(heading), np.full(N_HISTORY, heading)], 1))
    recorded = np.concatenate([np.round(past, 3), futures(rng, noise)], axis=1)
    valid = np.ones(recorded.shape[:2], bool)
    valid[1, N_HISTORY + 6:N_HISTORY + 8] = False
    valid[4, N_HISTORY + 10:] = False
    valid[2, :2] = False
    return recorded, valid, [futures(rng, 1.5 * noise) for _ in range(N_SAMPLES)]


def likelihoods(recorded, valid, samples):
    scenario = scenario_pb2.Scenario(scenario_id="golden", current_time_index=N_HISTORY - 1, sdc_track_index=0)
    for idx, (kind, length, width, *_) in enumerate(AGENTS):
        track = scenario.tracks.add(id=idx + 1, object_type=TYPES[kind])
        scenario.tracks_to_predict.add(track_index=idx)
        for (x, y, heading), is_valid in zip(recorded[idx], valid[idx]):
            # Nothing may depend on states that were not recorded.
            x = x if is_valid else np.nan
            track.states.add(center_x=x, center_y=y, center_z=0, length=length, width=width, height=1.5,
                             heading=heading, valid=bool(is_valid))
    points = lambda line: [map_pb2.MapPoint(x=x, y=y) for x, y in line]
    for idx, edge in enumerate(EDGES):
        scenario.map_features.add(id=idx).road_edge.polyline.extend(points(edge))
    # The traffic light's part needs a lane and goes without lights; djinn leaves it out.
    lane = scenario.map_features.add(id=9).lane
    lane.type = map_pb2.LaneCenter.TYPE_SURFACE_STREET
    lane.polyline.extend(points([[-30, 0], [80, 0]]))
    for _ in range(N_HISTORY + N_FUTURE):
        scenario.dynamic_map_states.add()
    rollouts = sim_agents_submission_pb2.ScenarioRollouts(scenario_id="golden")
    for sample in samples:
        joint = rollouts.joint_scenes.add()
        for idx, states in enumerate(sample):
            joint.simulated_trajectories.add(
                object_id=idx + 1, center_x=states[:, 0], center_y=states[:, 1], center_z=np.zeros(N_FUTURE),
                heading=states[:, 2])
    submission_specs._SIM_AGENTS_SUBMISSION_CONFIG = submission_specs.SubmissionConfig(
        current_time_index=N_HISTORY - 1, n_simulation_steps=N_FUTURE, n_rollouts=N_SAMPLES,
        step_duration_seconds=DT_S)
    # The package looks for its files below the working directory.
    with contextlib.chdir(Path(waymo_open_dataset.__path__[0]).parent):
        config = metrics.load_metrics_config(submission_specs.ChallengeType.SIM_AGENTS)
    found = metrics.compute_scenario_metrics_for_bundle(config, scenario, rollouts)
    return {field.name.removesuffix("_likelihood"): value for field, value in found.ListFields()
            if field.name.endswith("_likelihood") and not field.name.startswith("traffic_light")}


def main():
    cases = []
    for seed, noise in [(1, 1.0), (2, 3.0), (3, 0.3)]:
        recorded, valid, samples = scene(seed, noise)
        states = [[list(state) if ok else None for state, ok in zip(*agent)] for agent in zip(recorded, valid)]
        cases.append({
            "recorded": states, "samples": [sample.tolist() for sample in samples],
            "likelihoods": likelihoods(recorded, valid, samples)})
    agents = [{"class": kind, "length_m": length, "width_m": width} for kind, length, width, *_ in AGENTS]
    golden = {"dt_s": DT_S, "n_history": N_HISTORY, "agents": agents, "edges": EDGES, "cases": cases}
    GOLDEN.write_text(json.dumps(golden, separators=(",", ":")) + "\n")


if __name__ == "__main__":
    main()
