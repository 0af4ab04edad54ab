"""An export's own tables, and the corpus that its states are compared with."""

import csv
import json
import math

import numpy as np

TOLERANCE = 1e-6  # meters, radians, meters per second


def rows(path):
    with open(path, newline="") as file:
        return list(csv.DictReader(file, delimiter="\t"))


class Export:
    """An export, and where the corpus says that its tracks are."""

    def __init__(self, folder, corpus, judged=None):
        self.folder = folder
        self.report = json.loads((folder / "export.json").read_text())
        self.scenarios = rows(folder / "index.tsv")
        self.tracks = {}
        for row in rows(folder / "tracks.tsv"):
            self.tracks.setdefault(row["scenario_id"], []).append(row)
        self.corpus, self.judged = corpus, judged
        self.found = set()
        self.worst = 0.0
        assert len(self.scenarios) == self.report["n_scenarios"] > 0, "index.tsv and export.json differ"
        assert (folder / "NOTICE.txt").read_text().count("Sources and terms") == 1, "NOTICE.txt names no terms"

    def assumed(self, what):
        return self.report["assumed"].get(what, 0)

    def ego(self, scenario):
        return next(row for row in self.tracks[scenario["scenario_id"]] if row["is_ego"] == "true")

    def compare(self, scenario, name, timestep, singles=(), **said):
        """Demands of a state of the track that is called `name` in the file that all that is said of it is as in the corpus; `singles` are
        of single precision."""
        if self.corpus is None:
            return
        track = next(row for row in self.tracks[scenario["scenario_id"]] if row["name"] == name)
        self.compare_track(scenario["scenario_id"], track["track_id"], timestep, said, singles)

    def compare_track(self, scenario_id, track_id, timestep, said, singles=()):
        where = f"{track_id} of {scenario_id} at {timestep}"
        expected = self.corpus.states.get((scenario_id, track_id, timestep))
        assert expected is not None, f"{where} is not in the corpus"
        for what, value in said.items():
            if expected[what] is None:
                continue  # a size that is not recorded
            error = abs(value - expected[what])
            if what == "heading":
                error = abs((error + math.pi) % (2 * math.pi) - math.pi)
            tolerance = max(TOLERANCE, 1e-7 * abs(expected[what])) if what in singles else TOLERANCE
            assert error < tolerance, f"{where}: {what} is {value}, and {expected[what]} in the corpus"
            self.worst = max(self.worst, error)
        self.found.add((scenario_id, track_id, timestep))

    def demand_all(self, is_shown=lambda scenario, row, timestep: True, n_left_out=0):
        """Demands that of the tracks that are in the files, all states are for which `is_shown`, but for `n_left_out`."""
        if self.corpus is None:
            return
        n_missing = 0
        for scenario in self.scenarios:
            for row in self.tracks[scenario["scenario_id"]]:
                timesteps = self.corpus.timesteps[scenario["scenario_id"], row["track_id"]] if row["name"] else []
                shown = [t for t in timesteps if t >= int(scenario["first_timestep"]) and is_shown(scenario, row, t)]
                missing = [t for t in shown if (scenario["scenario_id"], row["track_id"], t) not in self.found]
                n_missing += len(missing)
        assert n_missing == n_left_out, f"{n_missing} states of the corpus are missing, not the {n_left_out} that export.json tells of"

    def compared(self, what):
        if self.corpus is None:
            return ""
        return f", {len(self.found)} states as in the corpus ({what}; largest difference {self.worst:.1e})"


class Corpus:
    """States in the recording's frame by (scenario, track, timestep), and the timesteps of each track of a scenario."""

    def __init__(self, folder, dataset):
        columns = ["scenario_id", "track_id", "timestep", "world_x_m", "world_y_m", "world_heading_rad", "vx_mps", "vy_mps"]
        columns += ["length_m", "width_m"]
        table = part(folder, "tracks", dataset).to_table(columns=columns).to_pydict()
        scenarios = part(folder, "scenarios", dataset).to_table(
            columns=["scenario_id", "world_from_scene", "dt_s", "n_history", "n_timesteps", "map_id", "lane_ids"]
        )
        self.scenarios = {row["scenario_id"]: row for row in scenarios.to_pylist()}
        rotation = {key: row["world_from_scene"]["rotation_rad"] for key, row in self.scenarios.items()}
        columns_of_lanes = [f"{side}_{axis}_m" for side in ("left", "right") for axis in "xy"]
        links = ["centerline_x_m", "centerline_y_m", "successors", "predecessors", "left_neighbor", "right_neighbor"]
        lanes = part(folder, "lanes", dataset).to_table(columns=["map_id", "lane_id", *links, *columns_of_lanes]).to_pylist()
        self.links = {(row["map_id"], row["lane_id"]): row for row in lanes}
        self.lanes = {}  # left and right edge in the recording's frame
        for row in lanes:
            edges = [np.array([row[f"{side}_x_m"] or [], row[f"{side}_y_m"] or []], float).T for side in ("left", "right")]
            self.lanes[row["map_id"], row["lane_id"]] = edges
        self.states, self.timesteps = {}, {}
        for s, t, k, x, y, heading, vx, vy, length, width in zip(*(table[name] for name in columns)):
            cos, sin = math.cos(rotation[s]), math.sin(rotation[s])
            state = {"x": x, "y": y, "heading": heading, "vx": cos * vx - sin * vy, "vy": sin * vx + cos * vy}
            state |= {"speed": math.hypot(vx, vy), "length": length, "width": width}
            state["along"] = state["vx"] * math.cos(heading) + state["vy"] * math.sin(heading)
            state["across"] = state["vy"] * math.cos(heading) - state["vx"] * math.sin(heading)
            self.states[s, t, k] = state
            self.timesteps.setdefault((s, t), []).append(k)


def part(folder, name, dataset):
    path = folder / name if (folder / name).exists() else folder / f"{name}.parquet"
    return dataset.dataset(path, format="parquet", partitioning="hive")
