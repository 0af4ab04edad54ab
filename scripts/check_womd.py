"""Compares what djinn ingested from Waymo Open Motion with another reading of the same files, and writes such files.

    python scripts/check_womd.py write random.tfrecord --scenarios 500
    djinn ingest random.tfrecord --dataset womd -o output/random --set ingest.max_agents=10000 --set ingest.map_radius_m=1e6
    python scripts/check_womd.py compare random.tfrecord output/random

Needs numpy and pyarrow, and to compare the dataset's own `scenario_pb2`: `pip install --no-deps
waymo-open-dataset-tf-2-12-0==1.6.7 protobuf==3.20.3` with Python 3.10 does without TensorFlow. Compared are positions, headings
and sizes of all states and which there are, the roles of tracks, center lines, links, neighbors, speed limits, boundaries, lights
and crosswalks of lanes. Written scenarios have random content of every kind that is read. What `compare` printed for the fixture
is in tests/fixtures/recordings/womd_compared.txt. Ends with 1 if anything differs.
"""

import argparse
import collections
import gzip
import pathlib
import struct
import sys

import numpy as np
import pyarrow as pa
import pyarrow.ipc as ipc

LINES = ["edge", "broken_single_white", "solid_single_white", "solid_double_white", "broken_single_yellow",
         "broken_double_yellow", "solid_single_yellow", "solid_double_yellow", "passing_double_yellow"]  # fmt: skip
LIGHTS = ["unknown", "arrow_stop", "arrow_caution", "arrow_go", "stop", "caution", "go", "flashing_stop", "flashing_caution"]
KINDS = {1: "vehicle", 2: "pedestrian", 3: "cyclist"}
MOST_M, MOST_RAD, BIKE_LANE, WIDTH_M = 2e-3, 1e-5, 3, 3.8


def records(path):
    data = gzip.decompress(path.read_bytes()) if path.suffix == ".gz" else path.read_bytes()
    begin = 0
    while begin < len(data):
        (length,) = struct.unpack_from("<Q", data, begin)
        yield data[begin + 12 : begin + 12 + length]
        begin += length + 16


def ingested(run):
    """Scenes by the scenario that they are of, each with its lanes in the recording's frame."""
    tables = lambda kind: [ipc.open_file(pa.memory_map(str(path))).read_all() for path in sorted(run.glob(f"scenes/{kind}-*.arrow"))]
    lanes = {(row["map_id"], row["lane_id"]): row for table in tables("maps") for row in table.to_pylist()}
    for table in tables("scenes"):
        for scene in table.to_pylist():
            yield scene["case_id"], scene, {id: lanes[scene["map_id"], id] for id in scene["lane_ids"]}


class Differences(collections.Counter):
    def note(self, what, same, where):
        self[what, "compared"] += 1
        if not same:
            self[what, "different"] += 1
            if self[what, "different"] <= 3:
                print(f"{what}: {where}")


def compare_tracks(scenario, scene, found):
    """What is missing in the scene is of an unknown type, or not there at present."""
    frame, present = scene["world_from_scene"], scenario.current_time_index
    cos, sin = np.cos(frame["rotation_rad"]), np.sin(frame["rotation_rad"])
    own = {track["track_id"]: track for track in scene["tracks"]}
    scored = {of.track_index for of in scenario.tracks_to_predict}
    for i, track in enumerate(scenario.tracks):
        where = f"{scenario.scenario_id}, track {track.id}"
        expected = track.object_type in KINDS and track.states[present].valid
        found.note("tracks", expected == (str(track.id) in own), where)
        if str(track.id) not in own:
            continue
        ours = own[str(track.id)]
        valid = np.array([state.valid for state in track.states])
        states = np.array([[s.center_x, s.center_y, s.heading, s.length, s.width] for s in track.states], float)
        found.note("validity", list(valid) == ours["valid"], where)
        x, y = np.array(ours["x_m"], float), np.array(ours["y_m"], float)
        world = np.stack([frame["x_m"] + cos * x - sin * y, frame["y_m"] + sin * x + cos * y], -1)
        off_m = np.abs(world - states[:, :2])[valid].max()
        found.note("positions", off_m < MOST_M, f"{where}: {off_m} m")
        turned = np.array(ours["heading_rad"]) + frame["rotation_rad"] - states[:, 2]
        off_rad = np.abs((turned + np.pi) % (2 * np.pi) - np.pi)[valid].max()
        found.note("headings", off_rad < MOST_RAD, f"{where}: {off_rad} rad")
        size = [ours["length_m"], ours["width_m"]]
        found.note("sizes", np.allclose(size, states[present, 3:], atol=1e-6), f"{where}: {size}")
        role = "recorder" if i == scenario.sdc_track_index else "context"
        if role == "context" and (i in scored or track.id in scenario.objects_of_interest):
            role = "scored"
        found.note("classes and roles", (KINDS[track.object_type], role) == (ours["class"], ours["role"]), where)
    found.note("egos", scene["center_track_id"] == str(scenario.tracks[scenario.sdc_track_index].id), scenario.scenario_id)


def compare_lanes(scenario, lanes, found):
    features = {feature.id: feature for feature in scenario.map_features}
    theirs = {id: of.lane for id, of in features.items() if of.HasField("lane") and of.lane.type != BIKE_LANE}
    theirs = {id: lane for id, lane in theirs.items() if len(lane.polyline) > 1}
    found.note("lanes", set(lanes) == set(theirs), f"{scenario.scenario_id}: {set(lanes) ^ set(theirs)}")
    lights = collections.defaultdict(list)
    for step, shown in enumerate(scenario.dynamic_map_states):
        for light in shown.lane_states:
            lights[light.lane].append((step, light.state))
    signs = {lane for of in features.values() if of.HasField("stop_sign") for lane in of.stop_sign.lane}
    for id in set(lanes) & set(theirs):
        lane, ours, where = theirs[id], lanes[id], f"{scenario.scenario_id}, lane {id}"
        tags = {tag["key"]: tag["value"] for tag in ours["tags"]}
        line = np.array([(point.x, point.y) for point in lane.polyline])
        center = line_of(ours, "centerline")
        found.note("center lines", center.shape == line.shape and np.abs(center - line).max() < MOST_M, where)
        links = [sorted(set(of) & set(theirs) - {id}) for of in (lane.exit_lanes, lane.entry_lanes)]
        found.note("links", links == [sorted(ours["successors"]), sorted(ours["predecessors"])], where)
        found.note("speed limits", abs(float(tags.get("speed_limit_mps", 0)) - lane.speed_limit_mph * 0.44704) < 1e-3, where)
        found.note("controls", ours["has_traffic_control"] == (id in signs or id in lights), where)
        walks = {int(key.split(":")[1]): corners(value) for key, value in tags.items() if key.startswith("crosswalk:")}
        found.note("crosswalks", walks == crossed(features, line), where)
        shown = [(step, LIGHTS.index(name)) for name, steps in parted(tags.get("traffic_light")) for step in steps]
        found.note("lights", shown == lights[id], where)
        for name, neighbors, bounds in [
            ("left", lane.left_neighbors, lane.left_boundaries),
            ("right", lane.right_neighbors, lane.right_boundaries),
        ]:
            written = [f"{of.feature_id}:{of.self_start_index}-{of.self_end_index}/{of.neighbor_start_index}-{of.neighbor_end_index}" for of in neighbors]
            found.note("neighbors with indices", ";".join(written) == tags.get(f"{name}_neighbors", ""), where)
            spans = [of.self_end_index - of.self_start_index for of in neighbors]
            longest = neighbors[int(np.argmax(spans))].feature_id if spans else None
            found.note("neighbors", ours[f"{name}_neighbor"] == (longest if longest in theirs else None), where)
            written = [f"{of.boundary_feature_id}:{of.lane_start_index}-{of.lane_end_index}/{LINES[of.boundary_type]}" for of in bounds]
            found.note("boundaries", ";".join(written) == tags.get(f"{name}_boundaries", ""), where)
            compare_side(line_of(ours, name), line, bounds, features, found, f"{where}, {name}")


def corners(text):
    return [[float(number) for number in corner.split(",")] for corner in text.split(" ")]


def crossed(features, line):
    """The crosswalks of which a point of the line, every centimeter, is inside."""
    stations = np.r_[0, np.cumsum(np.hypot(*np.diff(line, axis=0).T))]
    at, walks = np.arange(0, stations[-1], 0.01), {}
    points = np.stack([np.interp(at, stations, line[:, axis]) for axis in (0, 1)], -1)
    for id, of in features.items():
        corners = np.array([(point.x, point.y) for point in of.crosswalk.polygon])
        if len(corners) > 2:
            near = points[((points >= corners.min(0)) & (points <= corners.max(0))).all(1)]
            if inside(near, corners).any():
                walks[id] = corners.tolist()
    return walks


def inside(points, corners):
    is_odd = np.zeros(len(points), bool)
    for (ax, ay), (bx, by) in zip(corners, np.roll(corners, -1, 0)):
        rises = (ay > points[:, 1]) != (by > points[:, 1])
        with np.errstate(divide="ignore", invalid="ignore"):
            is_odd ^= rises & (points[:, 0] < ax + (points[:, 1] - ay) / (by - ay) * (bx - ax))
    return is_odd


def line_of(row, name):
    return np.stack([row[f"{name}_x_m"] or [], row[f"{name}_y_m"] or []], -1).astype(float)


def parted(text):
    for part in (text or "").split(";"):
        if part:
            name, steps = part.split(":")
            first, last = map(int, steps.split("-"))
            yield name, range(first, last + 1)


def compare_side(side, center, bounds, features, found, where):
    """Every point of a boundary lies on a line that the map names, or at half the assumed width from the center line."""
    named = [features[of.boundary_feature_id] for of in bounds if of.boundary_feature_id in features]
    lines = [np.array([(point.x, point.y) for point in (of.road_line if of.HasField("road_line") else of.road_edge).polyline]) for of in named]
    lines = [line for line in lines if len(line) > 1]
    for point in side[:: max(1, len(side) // 5)]:
        on_line = min((distance(point, line) for line in lines), default=np.inf) < MOST_M
        found.note("points of sides", on_line or distance(point, center) < WIDTH_M / 2 + MOST_M, where)


def distance(point, line):
    start, along = line[:-1], np.diff(line, axis=0)
    squared = np.maximum((along**2).sum(1), 1e-18)
    share = np.clip(((point - start) * along).sum(1) / squared, 0, 1)
    return np.hypot(*(start + share[:, None] * along - point).T).min()


def compare(paths, run):
    try:
        from waymo_open_dataset.protos import scenario_pb2
    except ImportError as error:
        sys.exit(f"{error}: install the dataset's own package, as the head of this script says")
    theirs = [scenario_pb2.Scenario.FromString(data) for path in paths for data in records(path)]
    ours = {id: (scene, lanes) for id, scene, lanes in ingested(run)}
    found = Differences()
    for scenario in theirs:
        found.note("scenarios", scenario.scenario_id in ours, scenario.scenario_id)
        if scenario.scenario_id in ours:
            scene, lanes = ours[scenario.scenario_id]
            compare_tracks(scenario, scene, found)
            compare_lanes(scenario, lanes, found)
    for what in dict.fromkeys(what for what, _ in found):
        print(f"{found[what, 'compared']:>9} {what}, {found[what, 'different']} different")
    return any(n for (_, kind), n in found.items() if kind == "different")


def random_scenario(name, rng):
    """Vehicles along random arcs, with gaps and sizes that vary, and lanes along the same with all that they can have."""
    from fixtures import womd

    n_agents, n_lanes = rng.integers(20, 60), rng.integers(30, 120)
    tracks, lines = [], []
    for _ in range(max(n_agents, n_lanes)):
        n, bend = int(rng.integers(20, 120)), rng.uniform(-0.01, 0.01)
        headings = rng.uniform(-np.pi, np.pi) + bend * np.arange(n)
        steps = 0.5 * np.stack([np.cos(headings), np.sin(headings)], -1)
        lines.append((rng.uniform(-200, 200, 2) + womd.OFFSET + np.cumsum(steps, 0), headings))
    for id in range(n_agents):
        line, headings = lines[id]
        stations = np.clip(np.arange(womd.N_STEPS) * rng.uniform(0, 1.2), 0, len(line) - 1)
        at = [np.interp(stations, np.arange(len(line)), of) for of in (*line.T, headings)]
        length, width = rng.uniform(3.5, 8), rng.uniform(1.5, 2.2)
        states = []
        for step, (x, y, heading) in enumerate(zip(*at)):
            gone = id and (rng.random() < 0.02 or rng.random() < 0.3 and step == 10)
            states.append(None if gone else (x, y, length + rng.normal(0, 0.05), width, heading, 5 * np.cos(heading), 5 * np.sin(heading)))
        tracks.append(((1000 + 3 * id, int(rng.choice([1, 1, 1, 2, 3, 4] if id else [1]))), states))
    features, lights, some = [], [[] for _ in range(womd.N_STEPS)], lambda n: rng.choice(n_lanes, rng.integers(0, n), replace=False)
    exits = {id: some(3) for id in range(n_lanes)}
    entries = {id: [of for of in range(n_lanes) if id in exits[of]] for id in range(n_lanes)}
    for id in range(n_lanes):
        line, last = lines[id][0], len(lines[id][0]) - 1
        beside = [[(int(of), *sorted(map(int, rng.integers(0, last, 2))), 0, 9) for of in some(3) if of != id] for _ in "lr"]
        bounds = []
        for tag, turn in ((50000, 1), (60000, -1)):
            mark, cut = int(rng.integers(0, 9)), int(rng.integers(2, last))
            normals = turn * rng.uniform(1.4, 2.5) * np.stack([-np.sin(lines[id][1]), np.cos(lines[id][1])], -1)
            features.append(womd.side(tag + id, line + normals, mark))
            bounds.append([(tag + id, 0, cut, mark)] if rng.random() < 0.7 else [])
        kind, mph = int(rng.choice([0, 1, 2, 2, 3])), float(rng.choice([0, 15, 25, 45]))
        features.append(womd.lane(id, line, kind, mph, entries[id], [int(of) for of in exits[id]], beside, bounds, rng.random() < 0.2))
        if rng.random() < 0.1:
            for step, shown in enumerate(lights):
                shown.append((id, int(step // 25 * 3 + id) % 9))
    features.append(womd.stop_sign(90000, [int(of) for of in some(5)], womd.OFFSET))
    features.append(womd.crosswalk(90001, womd.OFFSET + rng.uniform(-5, 5, (4, 2))))
    order = rng.permutation(len(features))
    return womd.scenario(name, tracks, [features[i] for i in order], lights, 0, [1, 2], [1009])


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    commands = parser.add_subparsers(dest="command", required=True)
    writing = commands.add_parser("write")
    writing.add_argument("file", type=pathlib.Path)
    writing.add_argument("--scenarios", type=int, default=500)
    writing.add_argument("--seed", type=int, default=1)
    comparing = commands.add_parser("compare")
    comparing.add_argument("files", type=pathlib.Path, nargs="+")
    comparing.add_argument("run", type=pathlib.Path)
    arguments = parser.parse_args()
    if arguments.command == "compare":
        sys.exit(compare(arguments.files, arguments.run))
    from fixtures.womd import write_records

    rng = np.random.default_rng(arguments.seed)
    names = [f"{arguments.seed:04x}{i:012x}" for i in range(arguments.scenarios)]
    write_records(arguments.file, (random_scenario(name, rng) for name in names))


if __name__ == "__main__":
    main()
