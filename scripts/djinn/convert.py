"""Recordings that others converted, for `djinn ingest`: ScenarioNet's files, which hold nuPlan, nuScenes, Lyft and more,
as scenarios in CommonRoad's XML with their lanes.

    python -m djinn.convert scenarionet SCENARIONET_FOLDER converted
    djinn ingest converted --dataset commonroad -o output/converted

Needs numpy. A scenario becomes a file; `ingest.n_history`, `n_future` and `window_stride` cut it into scenes. Ids are numbers,
which converted/names.csv explains. Where a lane has no outline, it is taken to be 3.8 m wide. Left out, counted and
named are scenarios that are not at 10 Hz, road users of other kinds, and lanes for bicycles. Lights are not converted. The terms are
those of the dataset: state them in `evaluate.terms`.
"""

import collections
import csv
import pathlib
import pickle
import re
import sys
from xml.sax.saxutils import quoteattr

try:
    import numpy as np
except ImportError:
    sys.exit("djinn.convert needs numpy: pip install numpy")

KINDS = {"VEHICLE": "car", "PEDESTRIAN": "pedestrian", "CYCLIST": "bicycle"}
WIDTH_M, LEAST_WIDTH_M, MOST_WIDTH_M = 3.8, 2.0, 6.0
STEP_S, MOST_OFF_S = 0.1, 0.01
SINGAPORE = ("sg-", "singapore")


class Plain(pickle.Unpickler):
    """Reads arrays and collections alone: a pickle can name any function of any module, to be called."""

    ALLOWED = {
        "numpy": ("ndarray", "dtype"),
        "numpy.core.multiarray": ("_reconstruct", "scalar"),
        "numpy._core.multiarray": ("_reconstruct", "scalar"),
        "numpy.core.numeric": ("_frombuffer",),
        "numpy._core.numeric": ("_frombuffer",),
        "collections": ("OrderedDict", "defaultdict"),
        "builtins": ("set", "frozenset", "dict", "list", "int", "float", "str", "bytearray"),
        "_codecs": ("encode",),
    }

    def find_class(self, module, name):
        if name not in self.ALLOWED.get(module, ()):
            raise pickle.UnpicklingError(f"it names {module}.{name}, expected arrays and collections alone")
        if module.startswith("numpy.") and not hasattr(np, "_core"):
            module = module.replace("_core", "core")
        elif module.startswith("numpy.core"):
            module = module.replace("numpy.core", "numpy._core")
        return super().find_class(module, name)


def scenarionet(source, folder):
    """Writes a file for each scenario of a folder of ScenarioNet's, and counts what was left out."""
    source, folder = pathlib.Path(source), pathlib.Path(folder)
    files = [source] if source.is_file() else sorted(source.rglob("*.pkl"))
    files = [path for path in files if path.name not in ("dataset_summary.pkl", "dataset_mapping.pkl")]
    if not files:
        sys.exit(f"{source} has no scenario: expected files named *.pkl")
    folder.mkdir(parents=True)
    counts = collections.Counter()
    with open(folder / "names.csv", "w", newline="") as names:
        names = csv.writer(names)
        names.writerow(["file", "scenario", "kind", "id", "name"])
        for number, path in enumerate(files, 1):
            try:
                with open(path, "rb") as file:
                    scenario = Plain(file).load()
                text, ids = commonroad(scenario, number, counts)
            except (pickle.UnpicklingError, EOFError, KeyError, TypeError, ValueError, IndexError) as error:
                counts["scenarios_left_out"] += 1
                print(f"{path} is left out: {error!r}", file=sys.stderr)
                continue
            name = f"{number:06}.xml"
            (folder / name).write_text(text, encoding="utf-8")
            names.writerows([name, scenario["id"], kind, id, of] for (kind, of), id in ids.items())
            counts["scenarios"] += 1
    return dict(counts)


def commonroad(scenario, number, counts):
    """The text of a file, and the numbers of lanes and road users by kind and name."""
    metadata, ids = scenario["metadata"], {}
    times = np.asarray(metadata["ts"], float).ravel()
    off_s = np.abs(np.diff(times) - STEP_S).max(initial=0.0)
    if len(times) < 2 or not off_s <= MOST_OFF_S:
        raise ValueError(f"its times are up to {off_s:.3f} s from steps of {STEP_S} s; convert it at 10 Hz")
    number_of = lambda kind, name: ids.setdefault((kind, str(name)), len(ids) + 1)
    lanes = {
        str(id): feature
        for id, feature in scenario["map_features"].items()
        if str(feature.get("type", "")).startswith("LANE_") and "BIKE" not in feature["type"] and len(feature.get("polyline", ())) > 1
    }
    parts = [lanelet(id, lanes, number_of) for id in lanes]
    for id, track in scenario["tracks"].items():
        kind, part = KINDS.get(track["type"]), None
        if kind is not None:
            part = obstacle(number_of("road user", id), kind, track["state"])
        counts["road_users_left_out"] += part is None
        parts += [part] if part else []
    map_name = str(metadata.get("map") or metadata.get("location") or metadata.get("dataset") or "unknown")
    country = "SGP" if map_name.lower().startswith(SINGAPORE) else "USA"
    place = re.sub("[^A-Za-z0-9]", "", map_name) or "unknown"
    head = {
        "commonRoadVersion": "2020a",
        "benchmarkID": f"{country}_{place}-1_{number}_T-1",
        "timeStepSize": "0.1",
        "source": f"{metadata.get('dataset', 'unknown')}, {scenario['id']}, converted from ScenarioNet",
    }
    attributes = " ".join(f"{name}={quoteattr(value)}" for name, value in head.items())
    return f"<?xml version='1.0' encoding='UTF-8'?>\n<commonRoad {attributes}>\n" + "\n".join(parts) + "\n</commonRoad>\n", ids


def lanelet(id, lanes, number_of):
    lane = lanes[id]
    center = np.asarray(lane["polyline"], float)[:, :2]
    center = center[np.append(True, np.hypot(*np.diff(center, axis=0).T) > 1e-6)]
    ahead = np.gradient(center, axis=0) if len(center) > 1 else np.zeros_like(center)
    across = np.stack([-ahead[:, 1], ahead[:, 0]], -1) / np.maximum(np.hypot(*ahead.T), 1e-9)[:, None]
    half = width_of(lane, center) / 2
    links = [("predecessor", of) for of in lane.get("entry_lanes") or ()] + [("successor", of) for of in lane.get("exit_lanes") or ()]
    text = f"<lanelet id=\"{number_of('lane', id)}\">"
    for name, side in (("leftBound", 1), ("rightBound", -1)):
        text += f"<{name}>{''.join(map(point, center + side * half * across))}</{name}>"
    text += "".join(f"<{name} ref=\"{number_of('lane', of)}\"/>" for name, of in links if str(of) in lanes)
    for name, key in (("adjacentLeft", "left_neighbor"), ("adjacentRight", "right_neighbor")):
        beside = [str(of["feature_id"] if isinstance(of, dict) else of) for of in lane.get(key) or ()]
        text += "".join(f"<{name} ref=\"{number_of('lane', of)}\" drivingDir=\"same\"/>" for of in beside[:1] if of in lanes)
    kind = "highway" if lane["type"] == "LANE_FREEWAY" else "urban"
    return text + f"<laneletType>{kind}</laneletType><userOneWay>vehicle</userOneWay></lanelet>"


def width_of(lane, center):
    """The mean width of the outline, if there is one."""
    outline = np.asarray(lane.get("polygon", ()), float)
    length_m = np.hypot(*np.diff(center, axis=0).T).sum()
    if outline.ndim != 2 or len(outline) < 3 or length_m < 1:
        return WIDTH_M
    x, y = (outline[:, :2] - outline[0, :2]).T
    return float(np.clip(abs(np.dot(x, np.roll(y, -1)) - np.dot(y, np.roll(x, -1))) / 2 / length_m, LEAST_WIDTH_M, MOST_WIDTH_M))


def obstacle(id, kind, state):
    """None for a road user that is never there. Of sizes that vary, the median."""
    valid = np.asarray(state["valid"]).astype(bool).ravel()
    positions, headings = np.asarray(state["position"], float), np.asarray(state["heading"], float).ravel()
    velocities = np.asarray(state["velocity"], float)
    finite = np.isfinite(np.column_stack([positions[:, :2], headings, velocities[:, :2]])).all(1)
    steps = np.flatnonzero(valid & finite)
    if not len(steps):
        return None
    text = f'<dynamicObstacle id="{id}"><type>{kind}</type>'
    sizes = [np.median(np.asarray(state[name], float).ravel()[steps]) for name in ("length", "width") if name in state]
    if len(sizes) == 2 and min(sizes) > 0:
        text += f"<shape><rectangle><length>{sizes[0]:.3f}</length><width>{sizes[1]:.3f}</width></rectangle></shape>"
    for step in steps:
        cos, sin = np.cos(headings[step]), np.sin(headings[step])
        vx, vy = velocities[step, :2]
        values = {"time": step, "orientation": headings[step], "velocity": cos * vx + sin * vy, "velocityY": cos * vy - sin * vx}
        found = f"<position>{point(positions[step])}</position>"
        found += "".join(f"<{name}><exact>{value:.6g}</exact></{name}>" for name, value in values.items())
        name = "initialState" if step == steps[0] else "state"
        text += f"<{name}>{found}</{name}>" + ("<trajectory>" if step == steps[0] else "")
    return text + "</trajectory></dynamicObstacle>"


def point(at):
    return f"<point><x>{at[0]:.4f}</x><y>{at[1]:.4f}</y></point>"


def main(name="", source="", folder=""):
    if name != "scenarionet" or not folder:
        sys.exit("python -m djinn.convert scenarionet SCENARIONET_FOLDER NEW_FOLDER")
    print(scenarionet(source, folder))


if __name__ == "__main__":
    main(*sys.argv[1:])
