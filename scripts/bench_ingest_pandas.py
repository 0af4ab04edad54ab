"""Recordings to arrays with pandas: what a user would write instead of `djinn ingest`, and what the benchmark compares with.

    pip install numpy pandas pyarrow
    python scripts/bench_ingest_pandas.py interaction ARCHIVE.zip OUT.npz
    python scripts/bench_ingest_pandas.py argoverse1 ARCHIVE.tar.gz OUT.npz
    python scripts/bench_ingest_pandas.py argoverse2 FOLDER OUT.npz [--style av2]

Of every scene the agents that are tracked at present, at most the 64 nearest to the ego: states in the ego's frame, validity,
classes and sizes, in one npz of flat arrays. `--style vectorized` (default) reads each table once and fills dense arrays by
integer codes, without a Python loop over scenes or tracks; `loop` is the usual pair of nested groupbys (INTERACTION); `av2`
reads with Argoverse's own package. `--egos FILE` takes the egos from a table scene_id,track_id instead of drawing them where
the recording marks none. Argoverse 1 has no headings: only the ego's is derived, which the frame needs.
Ends by printing what it took once the libraries were loaded, as JSON.
"""

import argparse
import csv
import io
import pathlib
import re
import tarfile
import zipfile

import numpy as np
import pandas as pd
from bench_common import Work

MAX_AGENTS = 64
MIN_HEADING_SPEED_MPS = 0.5  # slower than this, the direction of a velocity is noise
MIN_DISPLACEMENT_M = 1.0  # Argoverse 1: shorter displacements tell no direction
FILES_AT_ONCE = 200  # Argoverse 1: parsed as one table
INTERACTION_CLASSES = {
    "car": "vehicle",
    "truck": "vehicle",
    "bus": "bus",
    "motorcycle": "motorcyclist",
    "bicycle": "cyclist",
    "pedestrian": "pedestrian",
    "pedestrian/bicycle": "pedestrian_or_cyclist",
}
MOTORIZED = ("vehicle", "bus", "motorcyclist", "unknown")
AV2_CLASSES = {name: name for name in ("vehicle", "bus", "motorcyclist", "cyclist", "pedestrian", "unknown")} | {
    name: "static" for name in ("static", "background", "construction", "riderless_bicycle")
}


def wrap(angle):
    return np.pi - np.mod(np.pi - angle, 2 * np.pi)


def previous(usable):
    """(N, T) flags to the index of the last usable timestep before each, -1 where there is none."""
    last = np.maximum.accumulate(np.where(usable, np.arange(usable.shape[1]), -1), 1)
    return np.pad(last[:, :-1], ((0, 0), (1, 0)), constant_values=-1)


class Dense:
    """Agents of many scenes: scene (A,), track (A,), kind (A,), size (A, 2), is_ego (A,), states (A, T, 5), valid (A, T)."""

    def __init__(self, scene_ids, **arrays):
        self.scene_ids = scene_ids
        self.__dict__.update(arrays)

    def select(self, kept):
        arrays = {key: value[kept] for key, value in self.__dict__.items() if key != "scene_ids"}
        return Dense(self.scene_ids, **arrays)

    def assemble(self, present):
        """Drops who is not there at present or too far, and goes to the frame of each scene's ego. One ego a scene."""
        self = self.select(self.valid[:, present])
        ego_of = np.full(len(self.scene_ids), -1)
        ego_of[self.scene[self.is_ego]] = np.flatnonzero(self.is_ego)
        self = self.select(ego_of[self.scene] >= 0)
        ego_of = np.zeros(len(self.scene_ids), int)
        ego_of[self.scene[self.is_ego]] = np.flatnonzero(self.is_ego)
        origin = self.states[ego_of, present][self.scene]
        if np.bincount(self.scene).max() > MAX_AGENTS:
            offset = self.states[:, present, :2] - origin[:, :2]
            distance = np.where(self.is_ego, -1.0, np.hypot(offset[:, 0], offset[:, 1]))
            order = np.lexsort((distance, self.scene))
            rank = np.empty(len(order), int)
            starts = np.r_[0, np.cumsum(np.bincount(self.scene, minlength=len(self.scene_ids)))]
            rank[order] = np.arange(len(order)) - starts[self.scene[order]]
            near = rank < MAX_AGENTS
            self, origin = self.select(near), origin[near]
        cos, sin = np.cos(origin[:, 2])[:, None], np.sin(origin[:, 2])[:, None]
        x, y = (self.states[..., k] - origin[:, k, None] for k in (0, 1))
        vx, vy = self.states[..., 3], self.states[..., 4]
        heading = wrap(self.states[..., 2] - origin[:, 2, None])
        states = np.stack([cos * x + sin * y, cos * y - sin * x, heading, cos * vx + sin * vy, cos * vy - sin * vx], -1)
        self.states = np.where(self.valid[..., None], states, 0.0).astype(np.float32)
        return self


def write(path, parts, n_timesteps):
    """One npz: scene_id (S,), n_agents (S,), and of all agents track_id, class, is_ego, size, states, valid."""
    pad = lambda a: np.pad(a, [(0, 0), (0, n_timesteps - a.shape[1])] + [(0, 0)] * (a.ndim - 2))
    join = lambda get: np.concatenate([get(part) for part in parts])
    np.savez(
        path,
        scene_id=join(lambda p: np.asarray(p.scene_ids)),
        n_agents=join(lambda p: np.bincount(p.scene, minlength=len(p.scene_ids))),
        track_id=join(lambda p: np.asarray(p.track, dtype=str)),
        class_name=join(lambda p: np.asarray(p.kind, dtype=str)),
        is_ego=join(lambda p: p.is_ego),
        size=join(lambda p: p.size.astype(np.float32)),
        states=join(lambda p: pad(p.states)),
        valid=join(lambda p: pad(p.valid)),
    )
    return {"n_scenes": sum(len(part.scene_ids) for part in parts)}


def choose_egos(scene, focal, whole, eligible, rng):
    """The focal agent, or else a random one among those tracked throughout, or else among all that are eligible."""
    score = np.where(eligible, 4 * focal + 2 * whole + rng.random(len(scene)), -1.0)
    order = np.lexsort((score, scene))
    last = np.r_[scene[order][1:] != scene[order][:-1], True]
    is_ego = np.zeros(len(scene), bool)
    is_ego[order[last]] = score[order[last]] >= 0
    return is_ego


def given_egos(scene_ids, scene, track, egos):
    return np.array([egos.get(scene_ids[s]) == t for s, t in zip(scene, track)], bool)


INTERACTION_SPLITS = (("_train", "train"), ("_val", "val"), ("_obs", "test"))


def interaction_tables(path):
    """Split, place and table of each file of a v1.2 archive."""
    with zipfile.ZipFile(path) as archive:
        for name in archive.namelist():
            stem = pathlib.PurePath(name).stem
            for suffix, split in INTERACTION_SPLITS:
                if name.endswith(".csv") and stem.endswith(suffix):
                    with archive.open(name) as file:
                        # Floats as the C parser reads them fastest: correct to the last digit but one.
                        types = {"track_id": "category", "agent_type": "category"}
                        yield split, stem.removesuffix(suffix), pd.read_csv(file, dtype=types)


def interaction(path, egos, rng):
    parts = []
    for split, place, table in interaction_tables(path):
        case, cases = pd.factorize(table.case_id)
        scene_ids = [f"interaction/{split}/{place}/{int(number)}" for number in cases]
        key = case * len(table.track_id.cat.categories) + table.track_id.cat.codes.to_numpy(np.int64)
        agent, keys = pd.factorize(key)
        n_agents, n_timesteps = len(keys), int(table.frame_id.max())
        first = np.full(n_agents, len(table))
        np.minimum.at(first, agent, np.arange(len(table)))
        step = table.frame_id.to_numpy(int) - 1
        states = np.zeros((n_agents, n_timesteps, 5))
        valid = np.zeros((n_agents, n_timesteps), bool)
        states[agent, step] = table[["x", "y", "psi_rad", "vx", "vy"]].to_numpy(float)
        valid[agent, step] = True
        states[..., 2] = filled_headings(states, valid)
        kinds = np.array([INTERACTION_CLASSES[name] for name in table.agent_type.cat.categories])
        kind = kinds[table.agent_type.cat.codes.to_numpy()[first]]
        track = table.track_id.cat.categories.to_numpy(str)[table.track_id.cat.codes.to_numpy()[first]]
        focal = np.zeros(n_agents, bool)
        if "interesting_agent" in table:
            focal[agent[table.interesting_agent.to_numpy() != 0]] = True
        scene = case[first]
        eligible = np.isin(kind, MOTORIZED) & valid[:, 9]
        if egos is None:
            is_ego = choose_egos(scene, focal, valid.all(1), eligible, rng)
        else:
            is_ego = given_egos(scene_ids, scene, track, egos)
        size = table[["length", "width"]].to_numpy(float)[first]
        dense = Dense(scene_ids, scene=scene, track=track, kind=kind, size=size, is_ego=is_ego, states=states, valid=valid)
        parts.append(dense.assemble(present=9))
    return parts, 40


def filled_headings(states, valid):
    """As recorded; else the direction of the velocity, held while slow; else that of the small velocity."""
    moving = np.arctan2(states[..., 4], states[..., 3])
    fast = np.hypot(states[..., 3], states[..., 4]) >= MIN_HEADING_SPEED_MPS
    known = wrap(np.where(np.isnan(states[..., 2]) & fast, moving, states[..., 2]))
    known[~valid] = np.nan
    held = np.maximum.accumulate(np.where(np.isnan(known), -1, np.arange(known.shape[1])), 1)
    filled = np.take_along_axis(known, np.maximum(held, 0), 1)
    return np.where(held >= 0, filled, moving)


def interaction_loop(path, egos, rng):
    """The same with a groupby over cases and one over their tracks, as loaders of this dataset are mostly written."""
    parts = []
    for split, place, table in interaction_tables(path):
        for number, case in table.groupby("case_id"):
            scene_id, n_timesteps = f"interaction/{split}/{place}/{int(number)}", 40 if split != "test" else 10
            rows = {key: [] for key in ("track", "kind", "size", "states", "valid", "focal")}
            for track, group in case.groupby("track_id", observed=True, sort=False):
                states, valid = np.zeros((n_timesteps, 5)), np.zeros(n_timesteps, bool)
                step = group.frame_id.to_numpy(int) - 1
                states[step] = group[["x", "y", "psi_rad", "vx", "vy"]].to_numpy(float)
                valid[step] = True
                rows["track"].append(track)
                rows["kind"].append(INTERACTION_CLASSES[group.agent_type.iloc[0]])
                rows["size"].append(group[["length", "width"]].iloc[0].to_numpy(float))
                rows["focal"].append(bool(group.get("interesting_agent", pd.Series([0])).any()))
                rows["states"].append(states)
                rows["valid"].append(valid)
            rows = {key: np.array(value) for key, value in rows.items()}
            focal, scene = rows.pop("focal"), np.zeros(len(rows["track"]), int)
            rows["states"][..., 2] = filled_headings(rows["states"], rows["valid"])
            eligible = np.isin(rows["kind"], MOTORIZED) & rows["valid"][:, 9]
            if egos is None:
                is_ego = choose_egos(scene, focal, rows["valid"].all(1), eligible, rng)
            else:
                is_ego = given_egos([scene_id], scene, rows["track"], egos)
            parts.append(Dense([scene_id], scene=scene, is_ego=is_ego, **rows).assemble(present=9))
    return parts, 40


def argoverse1(path, egos, rng):
    parts, names, files = [], [], []
    with tarfile.open(path, "r|gz") as archive:
        for member in archive:
            if member.isfile() and member.name.endswith(".csv"):
                names.append(member.name)
                files.append(archive.extractfile(member).read())
            if len(files) == FILES_AT_ONCE:
                parts.append(argoverse1_part(names, files))
                names, files = [], []
    if files:
        parts.append(argoverse1_part(names, files))
    return parts, 50


def argoverse1_part(names, files):
    """Many files parsed as one table: a call of the parser costs as much as some hundred rows."""
    header = files[0].index(b"\n") + 1
    bodies = [file[header:] if file.endswith(b"\n") else file[header:] + b"\n" for file in files]
    types = {"TRACK_ID": "category", "OBJECT_TYPE": "category", "CITY_NAME": "category"}
    table = pd.read_csv(io.BytesIO(files[0][:header] + b"".join(bodies)), dtype=types)
    scene_of_row = np.repeat(np.arange(len(files)), [body.count(b"\n") for body in bodies])
    time = table.TIMESTAMP.to_numpy()
    step = (table.TIMESTAMP.groupby(scene_of_row).rank("dense") - 1).to_numpy(int)
    times = np.zeros((len(files), 50))
    times[scene_of_row, step] = time
    key = scene_of_row * len(table.TRACK_ID.cat.categories) + table.TRACK_ID.cat.codes.to_numpy(np.int64)
    agent, keys = pd.factorize(key)
    first = np.full(len(keys), len(table))
    np.minimum.at(first, agent, np.arange(len(table)))
    position = np.zeros((len(keys), 50, 2))
    valid = np.zeros((len(keys), 50), bool)
    position[agent, step] = table[["X", "Y"]].to_numpy()
    valid[agent, step] = True
    is_focal = table.OBJECT_TYPE.cat.categories[table.OBJECT_TYPE.cat.codes.to_numpy()[first]] == "AGENT"
    there = valid[:, 19]
    first, position, valid, is_focal = first[there], position[there], valid[there], np.asarray(is_focal)[there]
    scene = scene_of_row[first]

    before = previous(valid)
    index = np.maximum(before, 0)
    delta = position - np.take_along_axis(position, index[..., None], 1)
    t = times[scene]
    dt = t - np.take_along_axis(t, index, 1)
    velocity = np.where((valid & (before >= 0))[..., None], delta / np.where(dt == 0, 1.0, dt)[..., None], 0.0)
    # The first state has the velocity of the second, but not where that would look from the past into the future.
    start = valid.argmax(1)
    second = np.where(valid & (np.arange(50) > start[:, None]), np.arange(50), 50).min(1)
    forward = (second < 50) & ((start > 19) | (valid[:, :20].sum(1) > 1))
    rows = np.flatnonzero(forward)
    velocity[rows, start[rows]] = velocity[rows, second[rows]]

    states = np.concatenate([position, np.full((*valid.shape, 1), np.nan), velocity], -1)
    ego = np.flatnonzero(is_focal)
    states[ego, 19, 2] = ego_headings(position[ego, :20], valid[ego, :20])
    scene_ids = []
    cities = table.CITY_NAME.cat.categories[table.CITY_NAME.cat.codes.to_numpy()]
    city_of = dict(zip(scene_of_row[first], np.asarray(cities)[first]))
    for i, name in enumerate(names):
        name = pathlib.PurePath(name)
        scene_ids.append(f"argoverse1/{name.parts[0]}/{city_of[i]}/{name.stem}")
    tracks = table.TRACK_ID.cat.categories.to_numpy(str)[table.TRACK_ID.cat.codes.to_numpy()[first]]
    dense = Dense(
        scene_ids,
        scene=scene,
        track=tracks,
        kind=np.full(len(first), "unknown"),
        size=np.full((len(first), 2), np.nan),
        is_ego=is_focal,
        states=states,
        valid=valid,
    )
    return dense.assemble(present=19)


def ego_headings(position, valid):
    """(E, 20, 2) to (E,): the direction since the ego was last 1 m away, held while there is none, 0 if there never was."""
    n, t = valid.shape
    distance = np.linalg.norm(position[:, :, None] - position[:, None], axis=-1)
    earlier = np.arange(t)[None, :] < np.arange(t)[:, None]
    far = (distance >= MIN_DISPLACEMENT_M) & earlier & valid[:, None, :] & valid[:, :, None]
    source = np.where(far, np.arange(t), -1).max(-1)
    offset = position - np.take_along_axis(position, np.maximum(source, 0)[..., None], 1)
    heading = np.arctan2(offset[..., 1], offset[..., 0])
    last = np.where(source >= 0, np.arange(t), -1).max(-1)
    return np.where(last >= 0, heading[np.arange(n), np.maximum(last, 0)], 0.0)


AV2_COLUMNS = ["track_id", "object_type", "timestep", "position_x", "position_y", "heading", "velocity_x", "velocity_y"]
AV2_COLUMNS += ["scenario_id", "focal_track_id", "city"]


def argoverse2(path, egos, rng):
    parts = []
    for file in sorted(pathlib.Path(path).rglob("scenario_*.parquet")):
        table = pd.read_parquet(file, columns=AV2_COLUMNS)
        agent, tracks = pd.factorize(table.track_id)
        step = table.timestep.to_numpy(int)
        states = np.zeros((len(tracks), 110, 5))
        valid = np.zeros((len(tracks), 110), bool)
        states[agent, step] = table[["position_x", "position_y", "heading", "velocity_x", "velocity_y"]].to_numpy()
        valid[agent, step] = True
        first = np.full(len(tracks), len(table))
        np.minimum.at(first, agent, np.arange(len(table)))
        kind = table.object_type.iloc[first].map(AV2_CLASSES).to_numpy(str)
        parts.append(argoverse2_scene(table.iloc[0], split_of(file), np.asarray(tracks, str), kind, states, valid))
    return parts, 110


def split_of(file):
    return next((part for part in reversed(file.parts[:-1]) if re.fullmatch("train|val|test", part)), "unsplit")


def argoverse2_scene(head, split, tracks, kind, states, valid):
    moving = (kind != "static") | (tracks == head.focal_track_id)
    dense = Dense(
        [f"argoverse2/{split}/{head.city}/{head.scenario_id}"],
        scene=np.zeros(len(tracks), int),
        track=tracks,
        kind=kind,
        size=np.full((len(tracks), 2), np.nan),
        is_ego=tracks == head.focal_track_id,
        states=states,
        valid=valid,
    )
    return dense.select(moving).assemble(present=49)


def argoverse2_official(path, egos, rng):
    """The same through `av2`, the dataset's own package: an object for every state."""
    from av2.datasets.motion_forecasting import scenario_serialization

    parts = []
    for file in sorted(pathlib.Path(path).rglob("scenario_*.parquet")):
        scenario = scenario_serialization.load_argoverse_scenario_parquet(file)
        states = np.zeros((len(scenario.tracks), 110, 5))
        valid = np.zeros((len(scenario.tracks), 110), bool)
        for i, track in enumerate(scenario.tracks):
            for state in track.object_states:
                states[i, state.timestep] = (*state.position, state.heading, *state.velocity)
                valid[i, state.timestep] = True
        tracks = np.array([track.track_id for track in scenario.tracks])
        kind = np.array([AV2_CLASSES[track.object_type.value] for track in scenario.tracks])
        head = argparse.Namespace(
            city=scenario.city_name, scenario_id=scenario.scenario_id, focal_track_id=scenario.focal_track_id
        )
        parts.append(argoverse2_scene(head, split_of(file), tracks, kind, states, valid))
    return parts, 110


READERS = {
    ("interaction", "vectorized"): interaction,
    ("interaction", "loop"): interaction_loop,
    ("argoverse1", "vectorized"): argoverse1,
    ("argoverse2", "vectorized"): argoverse2,
    ("argoverse2", "av2"): argoverse2_official,
}


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("dataset", choices=["interaction", "argoverse1", "argoverse2"])
    parser.add_argument("input", type=pathlib.Path)
    parser.add_argument("output", type=pathlib.Path)
    parser.add_argument("--style", default="vectorized", choices=["vectorized", "loop", "av2"])
    parser.add_argument("--egos", type=pathlib.Path)
    arguments = parser.parse_args()
    egos = None
    if arguments.egos:
        with open(arguments.egos, newline="") as file:
            egos = dict(csv.reader(file))
    if arguments.style == "av2":
        import av2.datasets.motion_forecasting.scenario_serialization  # noqa: F401, so that loading it is not timed
    work = Work()
    read = READERS[arguments.dataset, arguments.style]
    parts, n_timesteps = read(arguments.input, egos, np.random.default_rng(0))
    said = write(arguments.output, parts, n_timesteps)
    work.done(**said)


if __name__ == "__main__":
    main()
