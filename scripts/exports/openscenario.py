"""Reads and plays OpenSCENARIO, and compares who is where when with the corpus."""

import math


def last_of_ego(export, scenario):
    """The last timestep at which the ego is moved by the file."""
    about = export.corpus.scenarios[scenario["scenario_id"]]
    return about["n_history"] - 1 if export.report.get("ego_motion") == "free" else about["n_timesteps"] - 1


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
