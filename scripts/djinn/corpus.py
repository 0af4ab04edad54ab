"""A corpus as numpy arrays, for notebooks and training. It needs pyarrow and numpy, and nothing of the program.

    from djinn.corpus import Corpus, collate, field
    corpus = Corpus("output/quickstart/main/corpus")
    tight = corpus.where(field("accepted") & (field("gap_m") < 5))
    scenario = tight[0]                 # or corpus["fcdfb9"]: an id, or its beginning
    scenario.states[scenario.roles["other"], scenario.present :]
    loader = torch.utils.data.DataLoader(tight, batch_size=8, shuffle=True, collate_fn=collate)

Columns, units and frames are described in schemas/ and in the files. Everything is in the scene frame: origin at the
center's position at present, x axis along its heading there. `Scenario.to_world` leads to the frame of the recording.
"""

import dataclasses
import functools
import pathlib
import urllib.parse

try:
    import numpy as np
    import pyarrow as pa
    import pyarrow.parquet as pq
    from pyarrow.dataset import field
except ImportError as error:
    raise ImportError(f"djinn.corpus needs pyarrow and numpy ({error}): pip install pyarrow numpy") from error

__all__ = ["Corpus", "Lane", "Scenario", "collate", "field", "resampled"]

STATES = ["x_m", "y_m", "heading_rad", "vx_mps", "vy_mps"]
CLASSES = ["vehicle", "bus", "motorcyclist", "cyclist", "pedestrian", "pedestrian_or_cyclist", "static", "unknown"]
OF_TRACKS = ["track_id", "class", "event_role", "timestep", "observed", *STATES, "length_m", "width_m"]


@dataclasses.dataclass
class Lane:
    """Lines are [points, 2] in driving direction; left and right may be empty. Links are ids, neighbors one or None."""

    id: int
    kind: str
    turn: str
    is_intersection: bool
    centerline: np.ndarray
    left: np.ndarray
    right: np.ndarray
    successors: list
    predecessors: list
    left_neighbor: object
    right_neighbor: object


@dataclasses.dataclass
class Scenario:
    """One scenario with A agents and T timesteps. `columns` is its row of the scenario table: behavior, events,
    metrics, provenance."""

    id: str
    columns: dict
    states: np.ndarray  # [A, T, 5], float32: STATES; zeros where not valid
    valid: np.ndarray  # [A, T]
    observed: np.ndarray  # [A, T]: as recorded or edited, the others are generated
    sizes: np.ndarray  # [A, 2], length and width; NaN where not recorded
    classes: list  # [A], of CLASSES
    track_ids: list  # [A]
    roles: dict  # role in the requested event -> agent
    world_lanes: list

    dt_s = property(lambda self: self.columns["dt_s"])
    behavior = property(lambda self: self.columns["behavior"])

    @property
    def present(self):
        """The last observed timestep."""
        return self.columns["n_history"] - 1

    @property
    def ego(self):
        """The agent to which the requested event happens; without such an event, the center of the scene."""
        return self.track_ids.index(self.columns["subject_track_id"] or self.columns["center_track_id"])

    @functools.cached_property
    def lanes(self):
        """The lanes near the scene, in its frame."""
        lines = ["centerline", "left", "right"]
        turned = [{name: self.to_scene(getattr(lane, name)) for name in lines} for lane in self.world_lanes]
        return [dataclasses.replace(lane, **lines) for lane, lines in zip(self.world_lanes, turned)]

    @property
    def world_from_scene(self):
        """The scene's origin in the frame of the recording, and the rotation of its axes there."""
        x, y, turn = (self.columns["world_from_scene"][name] for name in ["x_m", "y_m", "rotation_rad"])
        return np.array([x, y]), np.array([[np.cos(turn), -np.sin(turn)], [np.sin(turn), np.cos(turn)]])

    def to_world(self, points):
        """Points [..., 2] of the scene in the frame of the recording."""
        origin, turn = self.world_from_scene
        return np.asarray(points, np.float64) @ turn.T + origin

    def to_scene(self, points):
        """The way back."""
        origin, turn = self.world_from_scene
        return (np.asarray(points, np.float64) - origin) @ turn


class Corpus:
    """Scenarios by position, or by the beginning of their id. The tables of scenarios and lanes are held in memory,
    states are read when asked for, from the part of their file that holds them. A Dataset of torch as it is."""

    def __init__(self, folder):
        folder = pathlib.Path(folder)
        parts = sorted((folder / "scenarios").glob("**/*.parquet"))
        if not parts:
            raise FileNotFoundError(f"{folder} is no corpus: no Parquet file in {folder / 'scenarios'}")
        tables = []
        for path in parts:
            table = pq.ParquetFile(path).read()
            for name, value in (part.split("=", 1) for part in path.relative_to(folder).parts[1:-1]):
                table = table.append_column(name, pa.array([urllib.parse.unquote(value)] * len(table), pa.string()))
            tables.append(table)
        self.scenarios = pa.concat_tables(tables, promote_options="default")
        self.parts = [folder / "tracks" / path.relative_to(folder / "scenarios") for path in parts]
        # Scenarios and states are in the same order, part by part.
        ends = [np.cumsum(table["n_states"].to_numpy()) for table in tables]
        self.places = [
            (part, end - n)
            for part, table, ends in zip(self.parts, tables, ends)
            for end, n in zip(ends.tolist(), table["n_states"].to_pylist())
        ]
        for path, ends in zip(self.parts, ends):
            n_rows, n_states = pq.read_metadata(path).num_rows, int(ends[-1]) if len(ends) else 0
            if n_rows != n_states:
                raise ValueError(f"{path}: {n_rows} rows, expected {n_states}: see djinn corpus validate")
        self.maps = {}
        for row in pq.ParquetFile(folder / "lanes.parquet").read().to_pylist():
            line = lambda name: np.stack([row[f"{name}_x_m"], row[f"{name}_y_m"]], -1).astype(np.float64)
            lines = {name: line(name) for name in ["centerline", "left", "right"]}
            names = {lane_field.name for lane_field in dataclasses.fields(Lane)} - {"id", *lines}
            lane = Lane(id=row["lane_id"], **lines, **{name: row[name] for name in names})
            self.maps.setdefault(row["map_id"], {})[row["lane_id"]] = lane
        self._group = None

    def where(self, condition):
        """The corpus of the scenarios that meet a condition on columns, such as `field("verified")`."""
        chosen = self.scenarios.append_column("_row", pa.array(range(len(self)))).filter(condition)
        part = object.__new__(Corpus)
        part.__dict__.update(self.__dict__, scenarios=chosen.drop_columns(["_row"]))
        part.places = [self.places[row] for row in chosen["_row"].to_pylist()]
        return part

    @property
    def ids(self):
        return self.scenarios["scenario_id"].to_pylist()

    def __len__(self):
        return len(self.scenarios)

    def __iter__(self):
        return (self[i] for i in range(len(self)))

    def __getitem__(self, which):
        if isinstance(which, str):
            found = [i for i, name in enumerate(self.ids) if name.startswith(which)]
            if len(found) != 1:
                some = ", ".join(self.ids[i] for i in found[:3])
                raise KeyError(f"{which} begins {len(found)} ids{': ' + some if found else ''}, expected one")
            which = found[0]
        which = range(len(self))[which]
        row = self.scenarios.slice(which, 1).to_pylist()[0]
        states = self._states(*self.places[which], row["n_states"])
        names = states["track_id"].to_pylist()
        if set(states["scenario_id"].to_pylist()) != {row["scenario_id"]}:
            raise ValueError(f"{self.places[which][0]}: not in the order of the scenarios: see djinn corpus validate")
        ids = list(dict.fromkeys(names))  # In the order of the table, which is the scene's.
        index = {name: agent for agent, name in enumerate(ids)}
        at = np.array([index[name] for name in names]), states["timestep"].to_numpy()
        shape = len(ids), row["n_timesteps"]
        values, valid, observed = np.zeros((*shape, 5), np.float32), np.zeros(shape, bool), np.zeros(shape, bool)
        values[at] = np.stack([states[name].to_numpy() for name in STATES], -1)
        valid[at], observed[at] = True, states["observed"].to_numpy()
        first = np.unique(at[0], return_index=True)[1]  # What belongs to a track is in each of its rows.
        of_track = lambda name: states[name].take(first)
        sizes = np.stack([of_track(name).to_numpy().astype(np.float32) for name in ["length_m", "width_m"]], -1)
        roles = {role: agent for agent, role in enumerate(of_track("event_role").to_pylist()) if role}
        lanes = self.maps.get(row["map_id"], {})
        return Scenario(
            row["scenario_id"],
            row,
            values,
            valid,
            observed,
            sizes,
            of_track("class").to_pylist(),
            ids,
            roles,
            [lanes[lane] for lane in row["lane_ids"] or []],
        )

    def _states(self, path, first, n_rows):
        """Rows of a file of tracks. The row group read last is kept: neighbors are in the same."""
        if (
            self._group is None
            or self._group[0] != path
            or not self._group[1] <= first <= first + n_rows <= self._group[2]
        ):
            file = pq.ParquetFile(path)
            ends = np.cumsum([0] + [file.metadata.row_group(i).num_rows for i in range(file.num_row_groups)])
            groups = [i for i in range(file.num_row_groups) if ends[i] < first + n_rows and first < ends[i + 1]]
            # Threads of pyarrow do not survive the fork of a DataLoader's workers.
            rows = file.read_row_groups(groups, columns=["scenario_id", *OF_TRACKS], use_threads=False)
            self._group = path, ends[groups[0]] if groups else 0, ends[groups[-1] + 1] if groups else 0, rows
        return self._group[3].slice(first - self._group[1], n_rows).combine_chunks()


def resampled(points, n):
    """n points at equal distances along a line."""
    station = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(points, axis=0), axis=1))])
    at = np.linspace(0.0, station[-1], n)
    return np.stack([np.interp(at, station, points[:, k]) for k in range(2)], -1)


def collate(scenarios, n_points=20):
    """Scenarios as one batch of torch tensors, padded with zeros (False in masks): states [B, A, T, 5], valid and
    observed [B, A, T], sizes [B, A, 2], classes (indices of CLASSES) and is_ego [B, A], lanes [B, L, n_points, 2],
    is_lane [B, L]; and the scenarios themselves."""
    import torch

    def arrays(scenario):
        lines = [resampled(lane.centerline, n_points) for lane in scenario.lanes]
        return {
            "states": scenario.states,
            "valid": scenario.valid,
            "observed": scenario.observed,
            "sizes": scenario.sizes,
            "classes": np.array([CLASSES.index(name) for name in scenario.classes]),
            "is_ego": np.arange(len(scenario.track_ids)) == scenario.ego,
            "lanes": np.array(lines, np.float32).reshape(-1, n_points, 2),
            "is_lane": np.ones(len(lines), bool),
        }

    def padded(values):
        shape = np.max([value.shape for value in values], axis=0)
        return torch.from_numpy(np.stack([np.pad(v, [(0, n - k) for n, k in zip(shape, v.shape)]) for v in values]))

    samples = [arrays(scenario) for scenario in scenarios]
    return {name: padded([sample[name] for sample in samples]) for name in samples[0]} | {"scenarios": scenarios}
