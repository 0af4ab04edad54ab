"""One run of SUMO: ten minutes of traffic at a place, and the tracks that are seen of it."""

import numpy as np

from fixtures.traffic import DT_S, Track, tool
from simulation import demand, motion

WARM_UP_S = 80.0
DURATION_S = 600.0
# Frames that are simulated before the first case so that smoothing knows what came before, and after the last.
MARGIN_FRAMES = 20
MIN_FRAMES = 5


def simulate(plan, net, net_file, rng, seed, scratch):
    """The tracks of one run in view, by first frame; frame 0 is the end of the warm-up."""
    end = WARM_UP_S + DURATION_S
    routes, extents = demand.draw(plan, rng, end)
    files = {kind: scratch / f"{plan.name}.{kind}" for kind in ("rou.xml", "add.xml", "fcd.csv")}
    files["rou.xml"].write_text(routes)
    files["add.xml"].write_text(demand.slow_downs(plan, net, rng, end))
    tool(
        "sumo", "-n", net_file, "-r", files["rou.xml"], "-a", files["add.xml"], "--fcd-output", files["fcd.csv"],
        "--fcd-output.attributes", "x,y,angle", "--device.fcd.begin", WARM_UP_S - DT_S * MARGIN_FRAMES,
        "--precision", "4", "--step-length", DT_S, "--default.action-step-length", "0.2", "--lateral-resolution", "0.6", "--begin", 0, "--end", end, "--seed", seed,
        "--collision.action", "none", "--time-to-teleport", "-1", "--time-to-teleport.disconnected", "-1", "--max-depart-delay", "15",
        "--no-step-log", "true", "--no-warnings", "true", "--step-method.ballistic", "true", "--xml-validation", "never",
    )  # fmt: skip
    tracks = []
    for name, rows in recorded(files["fcd.csv"]).items():
        tracks += seen(plan, name, rows, extents[name], len(tracks))
    tracks.sort(key=lambda track: (track.first, track.id))
    return tracks


def recorded(path):
    """Rows of frame, x, y, angle (compass, degrees) by id from SUMO's table of positions."""
    rows = {}
    with open(path) as file:
        columns = next(file).rstrip().split(";")
        if columns[1:] != ["vehicle_id", "vehicle_x", "vehicle_y", "vehicle_angle"]:
            raise SystemExit(f"SUMO wrote the columns {columns}; eclipse-sumo 1.28 is expected")
        for line in file:
            time, name, x, y, angle = line.split(";")
            if not name:  # nobody is there at this time
                continue
            frame = round((float(time) - WARM_UP_S) / DT_S)
            rows.setdefault(name, []).append((frame, float(x), float(y), float(angle)))
    return {name: np.array(values) for name, values in rows.items()}


def seen(plan, name, rows, extent, n_before):
    """The stretches of an actor's path that lie in view, each a track."""
    kind, length, width = extent
    if len(rows) < MIN_FRAMES:
        return []
    frames = rows[:, 0].astype(int)
    angle = np.radians(90.0 - rows[:, 3])
    states = motion.states(rows[:, 1:3], angle, length)
    inside = np.concatenate([[False], plan.in_view(states[:, :2]), [False]])
    starts, ends = (np.flatnonzero(np.diff(inside.astype(int)) == step) for step in (1, -1))
    tracks = []
    for start, end in zip(starts, ends):
        if end - start >= MIN_FRAMES:
            tracks.append(Track(n_before + len(tracks), kind, length, width, int(frames[start]), states[start:end]))
    return tracks
