"""Scenarios in TFRecords of Waymo Open Motion, read with the dataset's own package and compared with the corpus."""

import numpy as np

OF_SINGLE_PRECISION = ("heading", "vx", "vy", "length", "width")
MOST_M = 1e-6


def compare_scenarios(protos, export):
    """Demands that states, roles and lanes are those of the corpus. Returns the number of lanes, and of lights at a timestep."""
    from check_womd import records  # It needs pyarrow.

    read, n_lanes, n_lights = {}, 0, 0
    for file in sorted({row["file"] for row in export.scenarios}):
        for data in records(export.folder / file):
            scenario = protos.Scenario.FromString(data)
            assert scenario.scenario_id not in read, f"{scenario.scenario_id} comes twice"
            read[scenario.scenario_id] = scenario
    for row in export.scenarios:
        scenario, id = read.pop(row["name"]), row["scenario_id"]
        tracks = [track for track in export.tracks[id] if track["name"]]
        n_timesteps, present = len(scenario.timestamps_seconds), scenario.current_time_index
        assert [str(track.id) for track in scenario.tracks] == [track["name"] for track in tracks], f"{id}: other tracks"
        assert {n_timesteps} == {len(of.states) for of in scenario.tracks} == {len(scenario.dynamic_map_states)}, f"{id}: uneven"
        assert np.allclose(np.diff(scenario.timestamps_seconds), 0.1), f"{id}: not 10 Hz"
        assert tracks[scenario.sdc_track_index]["is_ego"] == "true", f"{id}: another ego"
        of_event = [i for i, track in enumerate(tracks) if track["event_role"] and scenario.tracks[i].states[present].valid]
        predicted = [of.track_index for of in scenario.tracks_to_predict]
        assert predicted == of_event or not of_event, f"{id}: predicted are {predicted}"
        assert [scenario.tracks[i].id for i in predicted] == list(scenario.objects_of_interest), f"{id}: others are of interest"
        for track in scenario.tracks:
            for timestep, state in enumerate(track.states):
                if state.valid:
                    said = {"x": state.center_x, "y": state.center_y, "heading": state.heading, "vx": state.velocity_x}
                    said |= {"vy": state.velocity_y, "length": state.length, "width": state.width}
                    export.compare(row, str(track.id), timestep, OF_SINGLE_PRECISION, **said)
        lanes = {of.id: of.lane for of in scenario.map_features if of.HasField("lane")}
        features = {of.id for of in scenario.map_features}
        assert len(features) == len(scenario.map_features), f"{id}: features of one id"
        lights = [light for shown in scenario.dynamic_map_states for light in shown.lane_states]
        assert all(light.lane in lanes for light in lights), f"{id}: lights of no lane"
        if export.corpus is not None:
            assert n_timesteps == export.corpus.scenarios[id]["n_timesteps"] and present + 1 == export.corpus.scenarios[id]["n_history"]
            compare_lanes(export, id, lanes, features)
        n_lanes, n_lights = n_lanes + len(lanes), n_lights + len(lights)
    assert not read, f"{list(read)} are not in index.tsv"
    export.demand_all()
    return n_lanes, n_lights


def compare_lanes(export, id, lanes, features):
    of_scenario = export.corpus.scenarios[id]
    ids = set(of_scenario["lane_ids"])
    assert len(lanes) == len(ids) - export.assumed("lane_without_extent"), f"{id}: {len(lanes)} lanes, not {len(ids)}"
    for name, lane in lanes.items():
        own, where = export.corpus.links[of_scenario["map_id"], name], f"{id}, lane {name}"
        line = np.array([(point.x, point.y) for point in lane.polyline])
        center = np.array([own["centerline_x_m"], own["centerline_y_m"]], float).T
        assert line.shape == center.shape and np.abs(line - center).max() < MOST_M, f"{where}: another center line"
        assert sorted(lane.exit_lanes) == sorted(ids & set(own["successors"])), f"{where}: other exits"
        assert sorted(lane.entry_lanes) == sorted(ids & set(own["predecessors"])), f"{where}: other entries"
        for side, neighbors, boundaries in [("left", lane.left_neighbors, lane.left_boundaries), ("right", lane.right_neighbors, lane.right_boundaries)]:
            beside = {of.feature_id for of in neighbors}
            assert ids & {own[f"{side}_neighbor"]} <= beside <= ids, f"{where}: other neighbors on the {side}"
            assert {of.boundary_feature_id for of in boundaries} <= features, f"{where}: boundaries that are no features"
