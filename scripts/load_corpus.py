"""A corpus in numpy or PyTorch: one page over its Parquet tables, to use or to start from. Nothing of djinn is needed.

    pip install pyarrow numpy           # torch, too, for CorpusDataset in a DataLoader
    python scripts/load_corpus.py output/quickstart/main/corpus

    corpus = Corpus("output/quickstart/main/corpus", verified=True)
    sample = corpus[0]                  # a dict of numpy arrays, see Corpus.__getitem__
    loader = torch.utils.data.DataLoader(corpus, batch_size=8, shuffle=True, collate_fn=collate)

Columns, units and frames are described in schemas/ and in the files. Everything is in the scene frame: origin at the ego's
position at present, x axis along its heading there. World coordinates: rotate by world_from_scene[2], then add its first two.
"""

import pathlib
import sys

import numpy as np
import pyarrow.compute as pc
import pyarrow.dataset as ds

STATES = ["x_m", "y_m", "heading_rad", "vx_mps", "vy_mps"]
CLASSES = ["vehicle", "bus", "motorcyclist", "cyclist", "pedestrian", "pedestrian_or_cyclist", "static", "unknown"]
LANE_POINTS = 20


def table(folder, name):
    """A table of the corpus, whether it is one file or a folder of parts."""
    path = folder / name if (folder / name).exists() else folder / f"{name}.parquet"
    return ds.dataset(path, format="parquet", partitioning="hive")


class Corpus:
    """Scenarios by position. The table of scenarios and the lanes are held in memory, tracks are read when asked for."""

    def __init__(self, folder, verified=None, behavior=None, sweep=None):
        folder = pathlib.Path(folder)
        scenarios = table(folder, "scenarios").to_table()
        for column, wanted in [("verified", verified), ("requested_behavior", behavior), ("sweep", sweep)]:
            if wanted is not None:
                scenarios = scenarios.filter(pc.equal(scenarios[column], wanted))
        self.scenarios = scenarios.to_pylist()
        self.tracks = table(folder, "tracks")
        self.lanes = {}  # (map, lane) -> points of the centerline, in the recording's frame
        columns = ["map_id", "lane_id", "centerline_x_m", "centerline_y_m"]
        for row in table(folder, "lanes").to_table(columns=columns).to_pylist():
            points = np.stack([row["centerline_x_m"], row["centerline_y_m"]], -1).astype(np.float64)
            self.lanes[row["map_id"], row["lane_id"]] = resampled(points, LANE_POINTS)

    def __len__(self):
        return len(self.scenarios)

    def __getitem__(self, i):
        """A dict of: states [A, T, 5] (STATES), valid [A, T], observed [A, T], size [A, 2] (length and width, NaN where not
        recorded), agent_class [A] (CLASSES), is_subject [A] (to whom the requested
        event happens), lanes [L, LANE_POINTS, 2], roles {event role: agent}, track_ids,
        world_from_scene [3], dt_s, n_history, and provenance: the whole row of the scenario table."""
        row = self.scenarios[i]
        states = self.tracks.to_table(filter=ds.field("scenario_id") == row["scenario_id"])
        ids = list(dict.fromkeys(states["track_id"].to_pylist()))  # in the order of the table, which is the scene's
        agent = np.array([ids.index(track_id) for track_id in states["track_id"].to_pylist()])
        timestep = states["timestep"].to_numpy()
        shape = len(ids), row["n_timesteps"]
        values, valid, observed = np.zeros((*shape, 5), np.float32), np.zeros(shape, bool), np.zeros(shape, bool)
        for k, name in enumerate(STATES):
            values[agent, timestep, k] = states[name].to_numpy()
        valid[agent, timestep] = True
        observed[agent, timestep] = states["observed"].to_numpy()
        first = np.unique(agent, return_index=True)[1]  # what belongs to a track is in each of its rows
        take = lambda name: states[name].take(first).to_pylist()
        number = lambda value: np.nan if value is None else value
        size = np.array([[number(a), number(b)] for a, b in zip(take("length_m"), take("width_m"))], np.float32)
        return {
            "states": values,
            "valid": valid,
            "observed": observed,
            "size": size.reshape(-1, 2),
            "agent_class": np.array([CLASSES.index(name) for name in take("class")]),
            "is_subject": np.array([track_id == row.get("subject_track_id") for track_id in ids]),
            "lanes": self.lanes_of(row),
            "roles": {role: a for a, role in enumerate(take("event_role")) if role},
            "track_ids": ids,
            "world_from_scene": world_from_scene(row),
            "dt_s": row["dt_s"],
            "n_history": row["n_history"],
            "provenance": row,
        }

    def lanes_of(self, row):
        """The centerlines of a scenario's lanes in its scene frame, [L, LANE_POINTS, 2]; L may be 0."""
        lines = [self.lanes[row["map_id"], lane] for lane in row["lane_ids"] or []]
        x, y, heading = world_from_scene(row)
        points = np.array(lines).reshape(-1, LANE_POINTS, 2) - [x, y]
        cos, sin = np.cos(heading), np.sin(heading)
        return (points @ np.array([[cos, -sin], [sin, cos]])).astype(np.float32)


def world_from_scene(row):
    """x and y of the scene's origin in the recording's frame, and the direction of its x axis there."""
    return np.array([row["world_from_scene"][name] for name in ["x_m", "y_m", "rotation_rad"]])


def resampled(points, n):
    """n points at equal distances along a line."""
    station = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(points, axis=0), axis=1))])
    at = np.linspace(0.0, station[-1], n)
    return np.stack([np.interp(at, station, points[:, k]) for k in range(2)], -1)


def collate(samples):
    """Scenarios of different sizes as one batch, padded with zeros (False in masks), for a torch DataLoader: states
    [B, A, T, 5], valid, observed and is_agent [B, A, T or A], lanes [B, L, LANE_POINTS, 2], is_lane [B, L]."""
    import torch

    def padded(name):
        arrays = [sample[name] for sample in samples]
        shape = np.max([array.shape for array in arrays], axis=0)
        return torch.from_numpy(np.stack([np.pad(a, [(0, n - k) for n, k in zip(shape, a.shape)]) for a in arrays]))

    batch = {name: padded(name) for name in ["states", "valid", "observed", "size", "agent_class", "is_subject", "lanes"]}
    batch["is_agent"] = batch["valid"].any(-1)
    batch["is_lane"] = torch.stack([torch.arange(batch["lanes"].shape[1]) < len(sample["lanes"]) for sample in samples])
    for name in ["roles", "track_ids", "world_from_scene", "dt_s", "n_history", "provenance"]:
        batch[name] = [sample[name] for sample in samples]
    return batch


def main(folder):
    corpus = Corpus(folder)
    print(f"{len(corpus)} scenarios")
    for i in range(min(3, len(corpus))):
        sample = corpus[i]
        shapes = {name: value.shape for name, value in sample.items() if isinstance(value, np.ndarray)}
        print(sample["provenance"]["scenario_id"], shapes, "roles", sample["roles"])
    try:
        batch = collate([corpus[i] for i in range(min(8, len(corpus)))])
        print("batch", {name: tuple(value.shape) for name, value in batch.items() if hasattr(value, "shape")})
    except ImportError:
        print("batches of tensors: skipped, torch is not installed")


if __name__ == "__main__":
    main(*sys.argv[1:])
