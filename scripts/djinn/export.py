"""Scenarios of a corpus in formats for Python: ScenarioNet's pickles (MetaDrive) and, in `djinn.womd`, tf.Example
as the Waymo Open Motion Dataset has it. For more formats there is `djinn export`.

    python -m djinn.export scenarionet output/quickstart/main/corpus output/scenarionet
    python -m djinn.export womd output/quickstart/main/corpus output/cut_ins.tfrecord

Both are in the frame of each scene. Both writers return counts of what they left out or made up.
"""

import collections
import pathlib
import pickle
import sys

from djinn.corpus import Corpus  # First: it says what to install.

import numpy as np

# Class of a corpus -> type in either format, and a size for road users whose size was not recorded.
KINDS = {
    "vehicle": ("VEHICLE", 1, 4.6, 1.9),
    "bus": ("VEHICLE", 1, 12.0, 2.6),
    "motorcyclist": ("CYCLIST", 3, 2.2, 0.8),
    "cyclist": ("CYCLIST", 3, 1.8, 0.6),
    "pedestrian": ("PEDESTRIAN", 2, 0.6, 0.6),
    "pedestrian_or_cyclist": ("PEDESTRIAN", 2, 0.6, 0.6),
    "static": ("OTHER", 4, 1.0, 1.0),
    "unknown": ("OTHER", 4, 1.0, 1.0),
}
HEIGHT_M = 1.6  # Corpora have no heights.
FREEWAYS = ("freeway", "highway", "motorway")


def sizes_of(scenario, counts):
    """Length and width of everybody."""
    is_known = np.isfinite(scenario.sizes)
    counts["sizes_assumed"] += int((~is_known.all(-1)).sum())
    return np.where(is_known, scenario.sizes, [KINDS[name][2:] for name in scenario.classes])


def scenarionet(scenarios, folder):
    """A folder of scenario descriptions as of MetaDrive 0.4, with summary and mapping. Pickles of numpy 2 can be read
    with numpy 1.26 and later."""
    folder, counts = pathlib.Path(folder), collections.Counter()
    folder.mkdir(parents=True)
    summaries = {}
    for scenario in scenarios:
        found = description(scenario, counts)
        name = f"sd_djinn_{scenario.columns['dataset']}_{scenario.id}.pkl"
        (folder / name).write_bytes(pickle.dumps(found, protocol=4))
        summaries[name] = found["metadata"]
        counts["scenarios"] += 1
    (folder / "dataset_mapping.pkl").write_bytes(pickle.dumps(dict.fromkeys(summaries, ""), protocol=4))
    (folder / "dataset_summary.pkl").write_bytes(pickle.dumps(summaries, protocol=4))
    return dict(counts)


def description(scenario, counts):
    n_timesteps, sizes = scenario.valid.shape[1], sizes_of(scenario, counts)
    tracks, objects = {}, {}
    for agent, track_id in enumerate(scenario.track_ids):
        valid, kind = scenario.valid[agent], KINDS[scenario.classes[agent]][0]
        x, y, heading, vx, vy = scenario.states[agent].T
        size = np.outer([*sizes[agent], HEIGHT_M], valid).astype(np.float32)
        tracks[track_id] = {
            "type": kind,
            "state": {
                "position": np.stack([x, y, 0 * x], -1),
                "heading": heading,
                "velocity": np.stack([vx, vy], -1),
                "valid": valid,
                "length": size[0],
                "width": size[1],
                "height": size[2],
            },
            "metadata": {
                "type": kind,
                "object_id": track_id,
                "track_length": n_timesteps,
                "dataset": "djinn",
                "class": scenario.classes[agent],
            },
        }
        at = np.flatnonzero(valid)
        gap = np.flatnonzero(~valid[at[0] :])
        objects[track_id] = {
            "type": kind,
            "object_id": track_id,
            "track_length": n_timesteps,
            "valid_length": len(at),
            "moving_distance": float(np.linalg.norm(np.diff(np.stack([x, y], -1)[at], axis=0), axis=-1).sum()),
            "continuous_valid_length": int(gap[0]) if len(gap) else n_timesteps - int(at[0]),
        }
    lanes = {str(lane.id): lane for lane in scenario.lanes}
    names = lambda ids: [str(lane) for lane in ids if str(lane) in lanes]
    features = {}
    for name, lane in lanes.items():
        features[name] = {
            "type": "LANE_FREEWAY" if lane.kind in FREEWAYS else "LANE_SURFACE_STREET",
            "polyline": lane.centerline,
            "entry_lanes": names(lane.predecessors),
            "exit_lanes": names(lane.successors),
            "left_neighbor": names([lane.left_neighbor]),
            "right_neighbor": names([lane.right_neighbor]),
        }
        if len(lane.left) and len(lane.right):
            features[name]["polygon"] = np.concatenate([lane.left, lane.right[::-1]])
    kinds = [track["type"] for track in tracks.values()]
    moving = [found["type"] for found in objects.values() if found["moving_distance"] > 1.0]
    event = sorted(scenario.roles.values())
    metadata = {
        "metadrive_processed": False,
        "coordinate": "metadrive",
        "dataset": "djinn",
        "scenario_id": scenario.id,
        "ts": np.arange(n_timesteps, dtype=np.float32) * np.float32(scenario.dt_s),
        "track_length": n_timesteps,
        "current_time_index": scenario.present,
        "sdc_id": scenario.track_ids[scenario.ego],
        "objects_of_interest": [scenario.track_ids[agent] for agent in event],
        "tracks_to_predict": {
            scenario.track_ids[agent]: {
                "track_index": agent,
                "track_id": scenario.track_ids[agent],
                "object_type": kinds[agent],
                "difficulty": 0,
            }
            for agent in event
        },
        "source_file": scenario.columns["file"],
        "object_summary": objects,
        "djinn": scenario.columns,
        "number_summary": {
            "num_objects": len(tracks),
            "object_types": set(kinds),
            "num_objects_each_type": dict(collections.Counter(kinds)),
            "num_moving_objects": len(moving),
            "num_moving_objects_each_type": dict(collections.Counter(moving)),
            "num_traffic_lights": 0,
            "num_traffic_light_types": set(),
            "num_traffic_light_each_step": {},
            "num_map_features": len(features),
            "map_height_diff": 0.0,
        },
    }
    return {
        "id": scenario.id,
        "version": "djinn",
        "length": n_timesteps,
        "metadata": metadata,
        "tracks": tracks,
        "dynamic_map_states": {},
        "map_features": features,
    }


def main(name, corpus, out):
    from djinn.womd import womd

    writers = {"scenarionet": scenarionet, "womd": womd}
    if name not in writers:
        sys.exit(f"no format {name}, expected one of {', '.join(writers)}")
    print(writers[name](Corpus(corpus), out))


if __name__ == "__main__":
    main(*sys.argv[1:])
