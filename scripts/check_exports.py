"""Reads folders that `djinn export` wrote with the readers that others use for these formats. Installs nothing.

    python3 -m venv readers
    readers/bin/pip install --no-deps -r scripts/requirements-readers.txt
    readers/bin/python scripts/check_exports.py output/xosc output/commonroad ...

What is not installed is skipped, and said so; `--may-skip NAME` makes it a failure for all but the named ones. With `--corpus DIR`,
positions and judgments are compared with the corpus, too (pyarrow). `scenario_gym` plays OpenSCENARIO where it is installed
(`pip install scenario-gym`, in an environment of its own: it needs an older NumPy). `--schema FILE` names an XSD of OpenSCENARIO 1.2 where
no package brings it. Ends with 1 when a check fails.
"""

import argparse
import csv
import importlib
import importlib.util
import json
import math
import pathlib
import sys

TOLERANCE_M = 5e-6  # files have six decimals, corpora single precision

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
        assert len(self.scenarios) == self.report["n_scenarios"] > 0, "index.tsv and export.json differ"
        assert (folder / "NOTICE.txt").read_text().count("Sources and terms") == 1, "NOTICE.txt names no terms"

    def compare(self, scenario, name, timestep, x, y):
        """Demands that the track that is called `name` is at (x, y) at a timestep. True where there is something to compare."""
        if self.corpus is None:
            return False
        track = next(row for row in self.tracks[scenario["scenario_id"]] if row["name"] == name)
        key = scenario["scenario_id"], track["track_id"], timestep
        assert key in self.corpus, f"{key} is not in the corpus"
        distance = math.dist(self.corpus[key], (x, y))
        assert distance < TOLERANCE_M, f"{key} is {distance} m away from where the corpus has it"
        return True

    def compared(self, n):
        return "" if self.corpus is None else f", {n} positions compared with the corpus"


def world_positions(folder):
    """(scenario, track, timestep) -> position in the recording's frame."""
    dataset = available("pyarrow.dataset")
    if folder is None or dataset is None:
        return None
    path = folder / "tracks" if (folder / "tracks").exists() else folder / "tracks.parquet"
    columns = ["scenario_id", "track_id", "timestep", "world_x_m", "world_y_m"]
    table = dataset.dataset(path, format="parquet", partitioning="hive").to_table(columns=columns).to_pydict()
    return {(s, t, k): (x, y) for s, t, k, x, y in zip(*(table[name] for name in columns))}


def judgments(folder):
    """scenario -> its row of the scenario table, without nested columns."""
    dataset = available("pyarrow.dataset")
    if folder is None or dataset is None:
        return None
    path = folder / "scenarios" if (folder / "scenarios").exists() else folder / "scenarios.parquet"
    table = dataset.dataset(path, format="parquet", partitioning="hive").to_table()
    return {row["scenario_id"]: row for row in table.to_pylist()}


def check_interaction(export):
    pandas = available("pandas")
    if pandas is None:
        return []
    n_compared, tables = 0, {}
    for scenario in export.scenarios:
        if scenario["file"] not in tables:
            tables[scenario["file"]] = pandas.read_csv(export.folder / scenario["file"], dtype={"track_id": str})
        table = tables[scenario["file"]]
        case = table[table.case_id == float(scenario["name"])]
        assert len(case) and (case.timestamp_ms == 100 * case.frame_id).all() and case.frame_id.between(1, 40).all()
        first_frame = case.frame_id.min()
        for row in case.itertuples():
            timestep = int(scenario["first_timestep"]) + row.frame_id - first_frame
            n_compared += export.compare(scenario, row.track_id, timestep, row.x, row.y)
    for name, table in tables.items():
        ids = table.case_id.drop_duplicates().tolist()
        assert ids == [float(i + 1) for i in range(len(ids))], f"cases of {name} are not consecutive"
        cars = table[table.agent_type == "car"]
        assert not cars.isna().any().any(), f"{name}: a car lacks a value"
    return [f"pandas read {len(tables)} tables{export.compared(n_compared)}"]


def check_argoverse2(export):
    reader = available("av2.datasets.motion_forecasting.scenario_serialization")
    maps = available("av2.map.map_api", "av2.map.lane_segment")
    said = []
    if reader is not None:
        n_compared = 0
        for scenario in export.scenarios:
            folder = export.folder / scenario["file"]
            read = reader.load_argoverse_scenario_parquet(folder / f"scenario_{scenario['name']}.parquet")
            tracks = {row["name"]: row for row in export.tracks[scenario["scenario_id"]] if row["name"]}
            assert {track.track_id for track in read.tracks} == set(tracks) and read.scenario_id == scenario["name"]
            assert tracks[read.focal_track_id]["is_ego"] == "true"
            for track in read.tracks:
                for state in track.object_states:
                    n_compared += export.compare(scenario, track.track_id, state.timestep, *state.position)
        said.append(f"av2 read {len(export.scenarios)} scenarios{export.compared(n_compared)}")
    if maps is not None:
        n_lanes = 0
        for scenario in export.scenarios:
            path = export.folder / scenario["file"] / f"log_map_archive_{scenario['name']}.json"
            static = maps[0].ArgoverseStaticMap.from_json(path)
            n_lanes += len(static.vector_lane_segments)
            for lane in static.vector_lane_segments.values():
                assert static.get_lane_segment_centerline(lane.id).shape[0] > 1
        said.append(f"av2 read maps with {n_lanes} lanes")
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
    n_compared = n_lanelets = 0
    for scenario in export.scenarios:
        read, problems = reader.CommonRoadFileReader(str(export.folder / scenario["file"])).open()
        assert str(read.scenario_id) == scenario["name"], f"{read.scenario_id} is not {scenario['name']}"
        names = [row["name"] for row in export.tracks[scenario["scenario_id"]] if row["name"]]
        assert sorted(str(o.obstacle_id) for o in read.dynamic_obstacles) == sorted(names)
        (problem,) = problems.planning_problem_dict.values()
        assert problem.goal.state_list[0].time_step.end >= 1
        n_lanelets += len(read.lanelet_network.lanelets)
        for obstacle in read.dynamic_obstacles:
            for state in [obstacle.initial_state, *obstacle.prediction.trajectory.state_list]:
                timestep = int(scenario["first_timestep"]) + state.time_step
                n_compared += export.compare(scenario, str(obstacle.obstacle_id), timestep, *state.position)
    said.append(f"commonroad-io read {len(export.scenarios)} files with {n_lanelets} lanelets{export.compared(n_compared)}")
    return said


def check_openscenario(export, schema):
    said, etree = [], available("lxml.etree")
    if etree is not None:
        package = folder_of("qc_openscenario")
        schema = schema or (package / "schema/1.2.0/OpenSCENARIO.xsd" if package else None)
        if schema is not None:
            validate(etree, schema, [export.folder / scenario["file"] for scenario in export.scenarios])
            said.append("valid against the schema of OpenSCENARIO 1.2")
        n_compared = sum(compare_trajectories(etree, export, scenario) for scenario in export.scenarios)
        said.append(f"lxml read {len(export.scenarios)} files{export.compared(n_compared)}")
    player = available("scenario_gym")
    if player is not None:
        for scenario in export.scenarios:
            gym = player.ScenarioGym(timestep=0.1)
            gym.load_scenario(str(export.folder / scenario["file"]))
            gym.rollout()
            ego, t = gym.state.scenario.entities[0], gym.state.t
            vertex = min(ego.trajectory.data, key=lambda vertex: abs(vertex[0] - t))
            distance = math.dist(gym.state.poses[ego][:2], vertex[1:3])
            assert t > gym.state.scenario.length - 0.2 and distance < 0.01, f"{scenario['file']} stopped at {t} s, {distance} m off"
        said.append(f"scenario_gym played {len(export.scenarios)} files")
    return said


def compare_trajectories(etree, export, scenario):
    """Demands that the centers of all entities are where the corpus has them. Returns how many were compared."""
    root = etree.parse(str(export.folder / scenario["file"])).getroot()
    ahead = {o.get("name"): float(o.find(".//Center").get("x")) for o in root.iter("ScenarioObject")}
    n_compared = 0
    for event in root.iter("Event"):
        action = event.find(".//FollowTrajectoryAction")
        if action is None:
            continue
        name = action.find(".//Trajectory").get("name").removeprefix("trajectory_")
        begin_s = float(event.find(".//SimulationTimeCondition").get("value"))
        vertices = list(action.iter("Vertex"))
        dt_s = float(vertices[1].get("time")) - float(vertices[0].get("time"))
        positions = [dict(vertex.find(".//WorldPosition").attrib) for vertex in vertices]
        if len(vertices) == 2 and positions[0] == positions[1]:
            vertices.pop()  # there for one timestep alone
        for vertex in vertices:
            world = {key: float(value) for key, value in vertex.find(".//WorldPosition").attrib.items()}
            timestep = round((begin_s + float(vertex.get("time"))) / dt_s)
            x, y = (world[k] + ahead[name] * f(world["h"]) for k, f in (("x", math.cos), ("y", math.sin)))
            n_compared += export.compare(scenario, name.split("_part")[0], timestep, x, y)
    return n_compared


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
    corpus, judged = world_positions(args.corpus), judgments(args.corpus)
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
