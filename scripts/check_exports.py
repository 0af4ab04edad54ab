"""Reads folders that `djinn export` wrote with the readers that others use for these formats. Installs nothing.

    python3 -m venv readers
    readers/bin/pip install --no-deps -r scripts/requirements-readers.txt
    readers/bin/python scripts/check_exports.py output/xosc output/commonroad ...

What is not installed is skipped, and said so; `--may-skip NAME` makes it a failure for all but the named ones. With `--corpus DIR`, every
state of every track is compared with the corpus (pyarrow): position, heading, velocity and size, as far as the format holds them, to a
millionth; and no state may be missing. Judgments are compared, too. Two readers want environments of their own: `scenario_gym` plays
OpenSCENARIO (`pip install scenario-gym "numpy<2" "shapely<2.1" pyarrow`), and the protos of Waymo Open Motion need Python 3.10 (see
check_womd.py). `--schema FILE` names an XSD of OpenSCENARIO 1.2 where no package brings it. Ends with 1 when a check fails.
"""

import argparse
import importlib
import importlib.util
import json
import math
import pathlib
import sys

from exports.asam import demand_clean
from exports.opendrive import compare_roads
from exports.openscenario import compare_trajectories, last_of_ego, play
from exports.tables import Corpus, Export, part
from exports.womd import compare_scenarios

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


def check_womd(export):
    modules = available("waymo_open_dataset", "waymo_open_dataset.protos.scenario_pb2")
    if modules is None:
        return []
    n_lanes, n_lights = compare_scenarios(modules[1], export)
    compared = export.compared("positions, headings, velocities, sizes")
    return [f"the dataset's package read {len(export.scenarios)} scenarios with {n_lanes} lanes and {n_lights} lights{compared}"]


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
        said.append(check_roads(etree, export))
        compared = export.compared("positions, headings, sizes; velocities are not in the format but at the start")
        said.append(f"lxml read {len(export.scenarios)} files{compared}")
    checkers = available("qc_openscenario.main", "qc_opendrive.main")
    if checkers is not None:
        files = [export.folder / scenario["file"] for scenario in export.scenarios], sorted(export.folder.glob("roads/*.xodr"))
        n_rules = [demand_clean(checker, of) for checker, of in zip(checkers, files)]
        said.append(f"ASAM's checkers found nothing by {n_rules[0]} and {n_rules[1]} rules in {len(files[0])} scenarios and {len(files[1])} files of roads")
    player = available("scenario_gym")
    if player is not None:
        n_poses = sum(play(player, export, scenario) for scenario in export.scenarios)
        compared = "" if export.corpus is None else f", {n_poses} poses as in the corpus"
        said.append(f"scenario_gym played {len(export.scenarios)} files{compared}")
    return said


def check_roads(etree, export):
    """Validates the roads, and compares them with the lanes of the corpus."""
    files, package = sorted(export.folder.glob("roads/*.xodr")), folder_of("qc_opendrive")
    said = f"{len(files)} files of roads"
    if package is not None:
        validate(etree, package / "schema/1.7.0/opendrive_17_core.xsd", files)
        said += " valid against the schema of OpenDRIVE 1.7"
    if export.corpus is not None:
        n_lanes, worst_m, share = compare_roads(etree, export)
        said += f", {n_lanes} lanes within {worst_m:.3f} m of those of the corpus ({share:.2%} of points at square ends left out)"
    return said


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
        "womd": check_womd,
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
