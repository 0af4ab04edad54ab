"""Sheets of events to be looked at: accepted scenarios and recorded events of a behavior, drawn at random.

    pip install matplotlib numpy pyarrow
    python scripts/draw_behaviors.py output/cut_in_corpus/main --behaviors cut_in hard_brake --out sheets

A folder is a run: its events.parquet and scenes/ give recorded events, its corpus/ accepted scenarios; what several runs hold is drawn from
together. A panel shows the lanes, the way of those who take part (the first role blue, the second orange, a third green) with their boxes at the start (dotted),
in the middle and at the end (filled) of the event, everybody else at its start in gray; the first role drives to the right. Below are speeds (m/s) over the time of the scene, with
the event shaded and the present dashed. Panels of accepted scenarios come first. The list of what was drawn goes to standard output.
"""

import argparse
import io
import pathlib
import random

import matplotlib
import numpy as np
import pyarrow as pa
import pyarrow.dataset as ds
import pyarrow.ipc as ipc
import pyarrow.parquet as pq

matplotlib.use("Agg")
import matplotlib.pyplot as plt
from PIL import Image

COLORS = ["#1f5fbf", "#e07b00", "#2a8a3a"]
NOMINAL = {"bus": (12.0, 2.6), "motorcyclist": (2.0, 0.8), "cyclist": (1.8, 0.6), "pedestrian": (0.6, 0.6), "pedestrian_or_cyclist": (0.6, 0.6)}  # where a dataset gives no size
STATE = ["x_m", "y_m", "heading_rad", "vx_mps", "vy_mps"]
LINES = ["centerline", "left", "right"]
COLUMNS, ASPECT, MOST_BYTES = 8, 1.5, 150_000


def line(row, name):
    return np.stack([row[f"{name}_x_m"] or [], row[f"{name}_y_m"] or []], -1).astype(float)


def lanes_in_scene(rows, frame):
    """The lines of lanes in the scene frame."""
    cos, sin = np.cos(frame["rotation_rad"]), np.sin(frame["rotation_rad"])
    turn = np.array([[cos, -sin], [sin, cos]])
    return [{name: (line(row, name) - [frame["x_m"], frame["y_m"]]) @ turn for name in LINES} for row in rows]


def agent(track_id, kind, length_m, states):
    """States as (timestep, 5), NaN where it is not tracked."""
    size = length_m if length_m[0] else NOMINAL.get(kind, (4.6, 1.9))
    return {"id": track_id, "size": size, "states": states}


def recorded(run, behavior, wanted):
    """Panels of recorded events by (scene, index of the event); `wanted` is a list of events."""
    by_scene = {}
    for event in wanted:
        by_scene.setdefault(event["scene_id"], []).append(event)
    lanes = {}
    for path in sorted(run.glob("scenes/maps-*.arrow")):
        for row in ipc.open_file(pa.memory_map(str(path))).read_all().to_pylist():
            lanes[row["map_id"], row["lane_id"]] = row
    for path in sorted(run.glob("scenes/scenes-*.arrow")):
        table = ipc.open_file(pa.memory_map(str(path))).read_all()
        for i in np.flatnonzero([scene in by_scene for scene in table["scene_id"].to_pylist()]):
            row = table.slice(i, 1).to_pylist()[0]
            agents = []
            for track in row["tracks"]:
                states = np.stack([track[name] for name in STATE], -1).astype(float)
                states[~np.array(track["valid"])] = np.nan
                agents.append(agent(track["track_id"], track["class"], (track["length_m"], track["width_m"]), states))
            own = [lanes[row["map_id"], lane] for lane in row["lane_ids"]] if row["map_id"] else []
            for event in by_scene[row["scene_id"]]:
                yield panel(row["scene_id"], row, event, agents, own)


def panel(name, row, event, agents, lanes):
    """What is drawn of an event."""
    return {
        "name": name,
        "roles": [role["track_id"] for role in event["roles"]],
        "span": (event["start_timestep"], event["end_timestep"]),
        "agents": agents,
        "lanes": lanes_in_scene(lanes, row["world_from_scene"]),
        "n_history": row["n_history"],
        "dt_s": row["dt_s"],
    }


def generated(corpus, wanted):
    """Panels of these rows of the table of scenarios."""
    lanes = {(row["map_id"], row["lane_id"]): row for row in pq.read_table(corpus / "lanes.parquet").to_pylist()}
    ids = pa.array([row["scenario_id"] for row in wanted])
    tracks = {}
    table = ds.dataset(corpus / "tracks", format="parquet", partitioning="hive").to_table(filter=ds.field("scenario_id").isin(ids))
    for state in table.to_pylist():
        tracks.setdefault(state["scenario_id"], {}).setdefault(state["track_id"], []).append(state)
    for row in wanted:
        agents = []
        for track_id, states in tracks[row["scenario_id"]].items():
            values = np.full((row["n_timesteps"], len(STATE)), np.nan)
            for state in states:
                values[state["timestep"]] = [state[name] for name in STATE]
            agents.append(agent(track_id, states[0]["class"], (states[0]["length_m"], states[0]["width_m"]), values))
        event = row["events"][0]
        own = [lanes[row["map_id"], lane] for lane in row["lane_ids"] or []] if row["map_id"] else []
        yield panel(f"{row['scenario_id']} {row['scene_id']}", row, event, agents, own)


def outline(state, size):
    along = np.array([np.cos(state[2]), np.sin(state[2])]) * size[0] / 2
    across = np.array([-np.sin(state[2]), np.cos(state[2])]) * size[1] / 2
    return state[:2] + np.array([along + across, across - along, -along - across, along - across, along + across])


def draw(top, bottom, panel):
    start, end = panel["span"]
    middle = (start + end) // 2
    roles = [next(agent for agent in panel["agents"] if agent["id"] == role) for role in panel["roles"]]
    # The first role drives to the right.
    seen = np.concatenate([who["states"][max(0, start - 5) : end + 6, :2] for who in roles])
    heading = roles[0]["states"][start, 2]
    cos, sin = np.cos(heading), np.sin(heading)
    view = lambda points: points @ np.array([[cos, -sin], [sin, cos]])
    for lane in panel["lanes"]:
        for name in ["left", "right"] if len(lane["left"]) else ["centerline"]:
            top.plot(*view(lane[name]).T, color="#aaaaaa", lw=0.5)
    for other in panel["agents"]:
        if other["id"] not in panel["roles"] and np.isfinite(other["states"][start, 0]):
            top.fill(*view(outline(other["states"][start], other["size"])).T, color="#cccccc", lw=0)
    for who, color in zip(roles, COLORS):
        states = who["states"]
        top.plot(*view(states[:, :2]).T, color=color, lw=0.7)
        for timestep, style in ((start, ":"), (middle, "-")):
            if np.isfinite(states[timestep, 0]):
                top.plot(*view(outline(states[timestep], who["size"])).T, color=color, lw=0.8, ls=style)
        if np.isfinite(states[end, 0]):
            top.fill(*view(outline(states[end], who["size"])).T, color=color, alpha=0.6, lw=0)
        bottom.plot(np.arange(len(states)) * panel["dt_s"], np.hypot(states[:, 3], states[:, 4]), color=color, lw=0.8)
    low, high = np.nanmin(view(seen), 0), np.nanmax(view(seen), 0)
    center, half = (low + high) / 2, (high - low) / 2
    width = max(half[0] + 4, ASPECT * (half[1] + 4), 14)
    top.set(xlim=(center[0] - width, center[0] + width), xticks=[], yticks=[])
    top.set(ylim=(center[1] - width / ASPECT, center[1] + width / ASPECT))
    bottom.axvspan(start * panel["dt_s"], end * panel["dt_s"], color="#dddddd", lw=0)
    bottom.axvline((panel["n_history"] - 1) * panel["dt_s"], color="#888888", lw=0.5, ls="--")
    bottom.set(ylim=(0, None), xticks=[])
    bottom.tick_params(labelsize=4, length=1, pad=1)


def sheet(panels, title, n, path, dpi):
    rows = -(-len(panels) // COLUMNS)
    width, height = 1.9, 1.9 / ASPECT + 0.55
    figure = plt.figure(figsize=(width * COLUMNS, height * rows + 0.3))
    outer = figure.add_gridspec(rows, COLUMNS, left=0.01, right=0.995, top=1 - 0.42 / (height * rows + 0.3), bottom=0.01, wspace=0.1, hspace=0.16)
    for i, panel in enumerate(panels):
        top, bottom = outer[i].subgridspec(2, 1, height_ratios=[1.9 / ASPECT, 0.3], hspace=0.03).subplots()
        draw(top, bottom, panel)
        top.set_title(f"{'accepted' if i < n else 'recorded'} {i + 1 if i < n else i - n + 1}", fontsize=6, pad=1.5)
    figure.suptitle(title, fontsize=9, y=1 - 0.04 / rows)
    # Few colors and few bytes: a sheet is part of a page.
    while True:
        drawn = io.BytesIO()
        figure.savefig(drawn, dpi=dpi)
        image = Image.open(drawn).convert("RGB").quantize(24)
        image.save(path, optimize=True)
        if path.stat().st_size <= MOST_BYTES:
            break
        dpi = int(dpi * 0.92)
    plt.close(figure)


def of_behavior(runs, behavior, n, seed):
    """n panels each of accepted scenarios and recorded events, or all there are."""
    accepted, events = [], []
    for run in runs:
        if (run / "corpus" / "scenarios").exists():
            rows = ds.dataset(run / "corpus" / "scenarios", format="parquet", partitioning="hive").to_table().to_pylist()
            accepted += [(run, row) for row in rows if row["accepted"] and row["requested_behavior"] == behavior]
        if (run / "events.parquet").exists():
            rows = pq.read_table(run / "events.parquet").to_pylist()
            events += [(run, row) for row in rows if row["behavior"] == behavior and row["label"] == "positive"]
    accepted.sort(key=lambda item: item[1]["scenario_id"])
    events.sort(key=lambda item: (item[1]["scene_id"], item[1]["event_id"]))
    numbers = len(accepted), len(events)
    generator = random.Random(seed)
    accepted, events = (generator.sample(items, min(n, len(items))) for items in (accepted, events))
    panels = []
    for run in runs:
        panels.append([p for p in generated(run / "corpus", [row for own, row in accepted if own == run])] if any(own == run for own, _ in accepted) else [])
    first = [panel for of_run in panels for panel in of_run]
    second = [panel for run in runs for panel in recorded(run, behavior, [row for own, row in events if own == run])]
    return first, second, numbers


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("runs", nargs="+", type=pathlib.Path, help="run folders")
    parser.add_argument("--behaviors", nargs="+", required=True, help="which behaviors, a sheet each")
    parser.add_argument("--out", type=pathlib.Path, required=True, help="folder for the sheets")
    parser.add_argument("-n", type=int, default=20, help="how many of each kind")
    parser.add_argument("--seed", type=int, default=1, help="seed of the draw")
    parser.add_argument("--dpi", type=int, default=110, help="dots per inch; fewer where a sheet would be too large")
    arguments = parser.parse_args()
    arguments.out.mkdir(parents=True, exist_ok=True)
    for behavior in arguments.behaviors:
        accepted, events, (n_accepted, n_events) = of_behavior(arguments.runs, behavior, arguments.n, arguments.seed)
        title = f"{behavior}: {len(accepted)} of {n_accepted} accepted scenarios, {len(events)} of {n_events} recorded events"
        sheet(accepted + events, title, len(accepted), arguments.out / f"{behavior}.png", arguments.dpi)
        print(title)
        for i, panel in enumerate(accepted + events):
            kind, number = ("accepted", i + 1) if i < len(accepted) else ("recorded", i - len(accepted) + 1)
            print(f"  {kind} {number}: {panel['name']}, {' and '.join(panel['roles'])}, timesteps {panel['span'][0]} to {panel['span'][1]}")


if __name__ == "__main__":
    main()
