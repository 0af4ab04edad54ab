"""Reads the scenes that `djinn ingest` wrote into arrays (pyarrow, numpy), for the checks and peers of the benchmarks."""

import dataclasses
import json
import pathlib

import numpy as np
import pyarrow as pa
import pyarrow.ipc

STATE_COLUMNS = ("x_m", "y_m", "heading_rad", "vx_mps", "vy_mps")
MOTORIZED = ("vehicle", "bus", "motorcyclist", "unknown")
NOMINAL_EXTENT_M = {
    "vehicle": (4.6, 1.9),
    "unknown": (4.6, 1.9),
    "bus": (12.0, 2.6),
    "motorcyclist": (2.0, 0.8),
    "cyclist": (2.0, 0.8),
    "pedestrian": (0.75, 0.75),
    "pedestrian_or_cyclist": (0.75, 0.75),
    "static": (1.0, 1.0),
}


@dataclasses.dataclass
class Scene:
    """One scene: N agents, T timesteps. `states` (N, T, 5) as STATE_COLUMNS, `valid` (N, T), `size` (N, 2), NaN if unknown."""

    id: str
    ego: str
    n_history: int
    tracks: list
    classes: list
    size: np.ndarray
    states: np.ndarray
    valid: np.ndarray


def read_scenes(folder):
    """Every scene of a scene store, in its order."""
    folder = pathlib.Path(folder)
    for shard in json.loads((folder / "manifest.json").read_text())["shards"]:
        with pa.memory_map(str(folder / shard["file"])) as file:
            reader = pa.ipc.open_file(file)
            for i in range(reader.num_record_batches):
                yield from scenes_of(reader.get_batch(i))


def scenes_of(batch):
    plain = {name: batch.column(name).to_pylist() for name in ("scene_id", "center_track_id", "n_history", "n_timesteps")}
    lists = batch.column("tracks")
    offsets, tracks = lists.offsets.to_numpy(), lists.values
    columns = {name: tracks.field(name) for name in ("track_id", "class")}
    size = np.stack([tracks.field(name).to_numpy(zero_copy_only=False) for name in ("length_m", "width_m")], -1)
    states = np.stack([tracks.field(name).values.to_numpy() for name in STATE_COLUMNS], -1)
    valid = tracks.field("valid").values.to_numpy(zero_copy_only=False)
    steps = tracks.field("x_m").offsets.to_numpy()
    for row in range(batch.num_rows):
        first, end = offsets[row], offsets[row + 1]
        shape = (end - first, plain["n_timesteps"][row])
        span = slice(steps[first], steps[end])
        yield Scene(
            id=plain["scene_id"][row],
            ego=plain["center_track_id"][row],
            n_history=plain["n_history"][row],
            tracks=columns["track_id"][first:end].to_pylist(),
            classes=columns["class"][first:end].to_pylist(),
            size=size[first:end].astype(np.float64),
            states=states[span].reshape(*shape, 5).astype(np.float64),
            valid=valid[span].reshape(shape).astype(bool),
        )
