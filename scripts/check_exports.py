"""Reads folders that `djinn export` wrote with the readers that others use for these formats. Installs nothing.

    python3 -m venv readers
    readers/bin/pip install --no-deps -r scripts/requirements-readers.txt
    readers/bin/python scripts/check_exports.py output/xosc output/commonroad ...

What is not installed is skipped, and said so; `--may-skip NAME` makes it a failure for all but the named ones. With `--corpus DIR`,
every state of every track is compared with the corpus (pyarrow): position, heading, velocity and size, as far as the format holds them, to
a millionth; and no state may be missing. Judgments are compared, too. `scenario_gym` plays OpenSCENARIO where it is installed (`pip install
scenario-gym "numpy<2" "shapely<2.1" pyarrow`, in an environment of its own). `--schema FILE` names an XSD of OpenSCENARIO 1.2 where no
package brings it. Ends with 1 when a check fails.
"""

import argparse
import csv
import importlib
import importlib.util
import json
import math
import pathlib
import sys

TOLERANCE = 1e-6  # metres, radians, metres per second

skipped = {}


def available(*names):
    """The modules, or None with a note where one of them cannot be imported."""
    try:
        modules = [importlib.import_module(name) for name in names]
    except ImportError as error:
        skipped[names[0]] = str(error)
        return None
    return modules[0] if len(names) == 1 else modules


def folder_of(package):
    spec = importlib.util.find_spec(package)
    if spec is None or not spec.submodule_search_locations:
        skipped[package] = "not installed"
        return None
    return pathlib.Path(list(spec.submodule_search_locations)[0])


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

    def compare(self, scenario, name, timestep, **said):
        """Demands of a state of the track that is called `name` in the file that all that is said of it is as in the corpus."""
        if self.corpus is None:
            return
        track = next(row for row in self.tracks[scenario["scenario_id"]] if row["name"] == name)
        self.compare_track(scenario["scenario_id"], track["track_id"], timestep, said)

    def compare_track(self, scenario_id, track_id, timestep, said):
        where = f"{track_id} of {scenario_id} at {timestep}"
        expected = self.corpus.states.get((scenario_id, track_id, timestep))
        assert expected is not None, f"{where} is not in the corpus"
        for what, value in said.items():
            if expected[what] is None:
                continue  # a size that is not recorded
            error = abs(value - expected[what])
            if what == "heading":
                error = abs((error + math.pi) % (2 * math.pi) - math.pi)
            assert error < TOLERANCE, f"{where}: {what} is {value}, and {expected[what]} in the corpus"
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
            columns=["scenario_id", "world_from_scene", "dt_s", "n_history", "n_timesteps"]
        )
        self.scenarios = {row["scenario_id"]: row for row in scenarios.to_pylist()}
        rotation = {key: row["world_from_scene"]["rotation_rad"] for key, row in self.scenarios.items()}
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


def states(folder):
    dataset = available("pyarrow.dataset")
    return None if folder is None or dataset is None else Corpus(folder, dataset)


def judgments(folder):
    """scenario -> its row of the scenario table."""
    dataset = available("pyarrow.dataset")
    if folder is None or dataset is None:
        return None
    return {row["scenario_id"]: row for row in part(folder, "scenarios", dataset).to_table().to_pylist()}


def check_interaction(export):
    pandas = available("pandas")
    if pandas is None:
        return []
    tables = {}
    for scenario in export.scenarios:
        if scenario["file"] not in tables:
            tables[scenario["file"]] = pandas.read_csv(export.folder / scenario["file"], dtype={"track_id": str})
        table = tables[scenario["file"]]
        case = table[table.case_id == float(scenario["name"])]
        assert len(case) and (case.timestamp_ms == 100 * case.frame_id).all() and case.frame_id.between(1, 40).all()
        first_frame = case.frame_id.min()
        for row in case.itertuples():
            timestep = int(scenario["first_timestep"]) + row.frame_id - first_frame
            said = {"x": row.x, "y": row.y, "vx": row.vx, "vy": row.vy}
            if row.agent_type == "car":
                said |= {"heading": row.psi_rad, "length": row.length, "width": row.width}
            export.compare(scenario, row.track_id, timestep, **said)
    export.demand_all(lambda scenario, row, timestep: timestep < int(scenario["first_timestep"]) + 40)
    for name, table in tables.items():
        ids = table.case_id.drop_duplicates().tolist()
        assert ids == [float(i + 1) for i in range(len(ids))], f"cases of {name} are not consecutive"
        cars = table[table.agent_type == "car"]
        assert not cars.isna().any().any(), f"{name}: a car lacks a value"
    return [f"pandas read {len(tables)} tables{export.compared('positions, velocities; headings and sizes of vehicles')}"]


def check_argoverse2(export):
    reader = available("av2.datasets.motion_forecasting.scenario_serialization")
    maps = available("av2.map.map_api", "av2.map.lane_segment")
    said = []
    if reader is not None:
        for scenario in export.scenarios:
            folder = export.folder / scenario["file"]
            read = reader.load_argoverse_scenario_parquet(folder / f"scenario_{scenario['name']}.parquet")
            tracks = {row["name"]: row for row in export.tracks[scenario["scenario_id"]] if row["name"]}
            assert {track.track_id for track in read.tracks} == set(tracks) and read.scenario_id == scenario["name"]
            assert tracks[read.focal_track_id]["is_ego"] == "true"
            for track in read.tracks:
                for state in track.object_states:
                    (x, y), (vx, vy) = state.position, state.velocity
                    export.compare(scenario, track.track_id, state.timestep, x=x, y=y, heading=state.heading, vx=vx, vy=vy)
        export.demand_all()
        said.append(f"av2 read {len(export.scenarios)} scenarios{export.compared('positions, headings, velocities')}")
    if maps is not None:
        n_lanes = 0
        for scenario in export.scenarios:
            path = export.folder / scenario["file"] / f"log_map_archive_{scenario['name']}.json"
            static = maps[0].ArgoverseStaticMap.from_json(path)
            n_lanes += len(static.vector_lane_segments)
            assert len(static.vector_drivable_areas) == len(static.vector_lane_segments), "lanes without drivable areas"
            for lane in static.vector_lane_segments.values():
                assert static.get_lane_segment_centerline(lane.id).shape[0] > 1
                assert static.vector_drivable_areas[lane.id].xyz.shape[0] > 3
        said.append(f"av2 read maps with {n_lanes} lanes and as many drivable areas")
    return said


def check_commonroad(export):
    reader, etree = available("commonroad.common.file_reader"), available("lxml.etree")
    said, package = [], folder_of("commonroad")
    schema = package / "common/xml_definition_files/XML_commonRoad_XSD.xsd" if package else None
    if etree is not None and schema is not None and schema.exists():
        validate(etree, schema, [export.folder / scenario["file"] for scenario in export.scenarios])
        said.append("valid against the schema of commonroad-io")
    if reader is None:
        return said
    n_lanelets = 0
    for scenario in export.scenarios:
        path, first = export.folder / scenario["file"], int(scenario["first_timestep"])
        read, problems = reader.CommonRoadFileReader(str(path)).open()
        assert str(read.scenario_id) == scenario["name"], f"{read.scenario_id} is not {scenario['name']}"
        names = [row["name"] for row in export.tracks[scenario["scenario_id"]] if row["name"]]
        assert sorted(str(o.obstacle_id) for o in read.dynamic_obstacles) == sorted(names)
        (problem,) = problems.planning_problem_dict.values()
        assert problem.goal.state_list[0].time_step.end >= 1
        if export.corpus is not None:
            (x, y), start = problem.initial_state.position, problem.initial_state
            said_of_ego = {"x": x, "y": y, "heading": start.orientation, "along": start.velocity}
            export.compare_track(scenario["scenario_id"], export.ego(scenario)["track_id"], first + start.time_step, said_of_ego)
        n_lanelets += len(read.lanelet_network.lanelets)
        for obstacle in read.dynamic_obstacles:
            shape = obstacle.obstacle_shape
            for state in [obstacle.initial_state, *obstacle.prediction.trajectory.state_list]:
                (x, y), of_state = state.position, {"heading": state.orientation, "along": state.velocity}
                if state.time_step > 0:  # the reader's initial states have no such member
                    of_state["across"] = state.velocity_y
                of_state |= {"length": shape.length, "width": shape.width}
                export.compare(scenario, str(obstacle.obstacle_id), first + state.time_step, x=x, y=y, **of_state)
    export.demand_all(n_left_out=export.assumed("states_after_gap"))
    compared = export.compared("positions, headings, velocities, sizes")
    said.append(f"commonroad-io read {len(export.scenarios)} files with {n_lanelets} lanelets{compared}")
    return said


def check_openscenario(export, schema):
    said, etree = [], available("lxml.etree")
    if etree is not None:
        package = folder_of("qc_openscenario")
        schema = schema or (package / "schema/1.2.0/OpenSCENARIO.xsd" if package else None)
        if schema is not None:
            validate(etree, schema, [export.folder / scenario["file"] for scenario in export.scenarios])
            said.append("valid against the schema of OpenSCENARIO 1.2")
        for scenario in export.scenarios:
            compare_trajectories(etree, export, scenario)
        export.demand_all(lambda scenario, row, timestep: row["is_ego"] == "false" or timestep <= last_of_ego(export, scenario))
        compared = export.compared("positions, headings, sizes; velocities are not in the format but at the start")
        said.append(f"lxml read {len(export.scenarios)} files{compared}")
    player = available("scenario_gym")
    if player is not None:
        n_poses = sum(play(player, export, scenario) for scenario in export.scenarios)
        compared = "" if export.corpus is None else f", {n_poses} poses as in the corpus"
        said.append(f"scenario_gym played {len(export.scenarios)} files{compared}")
    return said


def last_of_ego(export, scenario):
    """The last timestep at which the ego is moved by the file."""
    about = export.corpus.scenarios[scenario["scenario_id"]]
    return about["n_history"] - 1 if export.report["ego"] == "free" else about["n_timesteps"] - 1


def compare_trajectories(etree, export, scenario):
    """Demands that the centers of all entities are where the corpus has them, at the times of the scenario, and that nobody is triggered
    after the first time of its trajectory."""
    root = etree.parse(str(export.folder / scenario["file"])).getroot()
    boxes = {o.get("name"): o.find(".//BoundingBox") for o in root.iter("ScenarioObject")}
    dt_s = 0.1 if export.corpus is None else export.corpus.scenarios[scenario["scenario_id"]]["dt_s"]

    def compare(name, timestep, position, **more):
        box, world = boxes[name], {key: float(value) for key, value in position.find(".//WorldPosition").attrib.items()}
        ahead, size = float(box.find("Center").get("x")), box.find("Dimensions")
        x, y = (world[k] + ahead * f(world["h"]) for k, f in (("x", math.cos), ("y", math.sin)))
        more |= {"heading": world["h"], "length": float(size.get("length")), "width": float(size.get("width"))}
        export.compare(scenario, name.split("_part")[0], timestep, x=x, y=y, **more)

    for private in root.iter("Private"):
        speed = float(private.find(".//AbsoluteTargetSpeed").get("value"))
        compare(private.get("entityRef"), 0, private.find(".//TeleportAction"), speed=speed)
    for event in root.iter("Event"):
        action = event.find(".//FollowTrajectoryAction")
        if action is None:
            continue
        name = action.find(".//Trajectory").get("name").removeprefix("trajectory_")
        timing = dict(action.find(".//Timing").attrib)
        assert timing == {"domainAbsoluteRelative": "absolute", "offset": "0.0", "scale": "1.0"}, f"{name}: {timing}"
        vertices = list(action.iter("Vertex"))
        first_s = float(vertices[0].get("time"))
        begin_s = float(event.find(".//SimulationTimeCondition").get("value"))
        assert first_s - 0.01 < begin_s <= first_s, f"{name} begins at {begin_s} s, not at {first_s} s"
        positions = [dict(vertex.find(".//WorldPosition").attrib) for vertex in vertices]
        if len(vertices) == 2 and positions[0] == positions[1] and round(first_s / dt_s) + 1 not in times_of(export, scenario, name):
            vertices.pop()  # there for one timestep alone
        for vertex in vertices:
            compare(name, round(float(vertex.get("time")) / dt_s), vertex)


def times_of(export, scenario, name):
    """The timesteps of the track of an entity in the corpus."""
    if export.corpus is None:
        return []
    track = next(row for row in export.tracks[scenario["scenario_id"]] if row["name"] == name.split("_part")[0])
    return export.corpus.timesteps[scenario["scenario_id"], track["track_id"]]


def play(player, export, scenario):
    """Plays a file step by step, and demands that everybody is where the corpus says, when it says so. Returns how many poses there were."""
    dt_s = 0.1 if export.corpus is None else export.corpus.scenarios[scenario["scenario_id"]]["dt_s"]
    gym = player.ScenarioGym(timestep=dt_s)
    gym.load_scenario(str(export.folder / scenario["file"]), relabel=False)
    gym.reset_scenario()
    n_poses, seen = 0, set()
    while True:
        timestep = round(gym.state.t / dt_s)
        for entity, pose in gym.state.poses.items():
            ahead, heading = entity.bounding_box.center_x, pose[3]
            x, y = pose[0] + ahead * math.cos(heading), pose[1] + ahead * math.sin(heading)
            export.compare(scenario, entity.ref.split("_part")[0], timestep, x=x, y=y, heading=heading)
            seen.add((entity.ref.split("_part")[0], timestep))
            n_poses += 1
        if gym.state.is_done:
            break
        gym.step()
    assert gym.state.t > gym.state.scenario.length - 1.5 * dt_s, f"{scenario['file']} stopped at {gym.state.t} s"
    return n_poses


def check_openlabel(export):
    modules = available("vcd.schema", "jsonschema")
    n_tags = n_compared = 0
    for scenario in export.scenarios:
        document = json.loads((export.folder / scenario["file"]).read_text())
        n_tags += len(document["openlabel"]["tags"])
        if modules is not None:
            modules[1].validate(document, modules[0].openlabel_schema)
        judged = [tag for tag in document["openlabel"]["tags"].values() if tag["type"] == "assessment"]
        is_judged = export.judged is not None and export.judged[scenario["scenario_id"]].get("accepted") is not None
        assert len(judged) == 1 or not is_judged, f"{scenario['scenario_id']} has no judgment"
        n_compared += sum(compare_judgment(export, scenario, tag["tag_data"]) for tag in judged)
    ontology = json.loads((export.folder / "ontology.json").read_text())
    how = "valid against the schema of vcd" if modules else "read as JSON"
    compared = "" if export.judged is None else f", {n_compared} judgments compared with the corpus"
    return [f"{how}: {len(export.scenarios)} files with {n_tags} tags of {len(ontology['behaviors']['tags'])} behaviors{compared}"]


def compare_judgment(export, scenario, data):
    """Demands that numbers have units, and that judgments are those of the corpus. Returns how many were compared."""
    for number in data["num"]:
        assert number["attributes"]["text"][0]["name"] == "unit", f"{number['name']} has no unit"
    if export.judged is None:
        return 0
    row = export.judged[scenario["scenario_id"]]
    said = {entry["name"]: entry["val"] for kind in ("num", "boolean", "text") for entry in data[kind]}
    for name, value in said.items():
        same = math.isclose(row[name], value, rel_tol=1e-6, abs_tol=1e-6) if isinstance(value, float) else row[name] == value
        assert same, f"{scenario['scenario_id']}: {name} is {value}, and {row[name]} in the corpus"
    return len(said)


def validate(etree, schema, files):
    schema = etree.XMLSchema(etree.parse(str(schema)))
    for file in files:
        document = etree.parse(str(file))
        assert schema.validate(document), f"{file}: {schema.error_log.last_error}"


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("exports", nargs="+", type=pathlib.Path)
    parser.add_argument("--corpus", type=pathlib.Path)
    parser.add_argument("--schema", type=pathlib.Path)
    parser.add_argument("--may-skip", action="append", metavar="NAME")
    args = parser.parse_args()
    corpus, judged = states(args.corpus), judgments(args.corpus)
    checks = {
        "interaction": check_interaction,
        "argoverse2": check_argoverse2,
        "commonroad": check_commonroad,
        "openscenario": lambda export: check_openscenario(export, args.schema),
        "openlabel": check_openlabel,
    }
    failed = False
    for folder in args.exports:
        try:
            export = Export(folder, corpus, judged)
            said = checks[export.report["format"]](export)
            print(f"{folder}: {export.report['format']}: {'; '.join(said) or 'nothing checked'}")
        except Exception as error:  # Whatever a reader objects to is a failed check, and the next folder is still of interest.
            failed = True
            print(f"{folder}: FAILED: {type(error).__name__}: {error}")
    for name, why in skipped.items():
        is_failure = args.may_skip is not None and name not in args.may_skip
        failed = failed or is_failure
        print(f"{'FAILED: skipped' if is_failure else 'skipped'}: {name}: {why}")
    sys.exit(failed)


if __name__ == "__main__":
    main()
