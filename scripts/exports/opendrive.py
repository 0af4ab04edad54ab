"""Evaluates roads by the formulas of OpenDRIVE 1.7, and compares them with the lanes of the corpus."""

import math

import numpy as np

STEP_M = 0.05  # along roads, between the points at which they are evaluated
NEAR_M = 0.05  # how far a lane may be from its road
END_M = 1.0  # along lines: roads end square, lanes need not, so that nothing is compared there


def compare_roads(etree, export):
    """Demands that points along the edges of all lanes lie on those of their roads, and that the middles of roads lie midway between the
    edges of their lanes. Returns how many lanes there are, the largest distance, and the share of points near ends that were left out."""
    n_lanes, worst_m, n_points, n_left_out, seen = 0, 0.0, 0, 0, set()
    for scenario in export.scenarios:
        file = etree.parse(str(export.folder / scenario["file"])).getroot().find("RoadNetwork/LogicFile")
        if file is None or file.get("filepath") in seen:
            continue
        seen.add(file.get("filepath"))
        about = export.corpus.scenarios[scenario["scenario_id"]]
        root = etree.parse(str(export.folder / file.get("filepath"))).getroot()
        roads = {int(road.get("name").removeprefix("lane ")): road for road in root.iter("road")}
        assert set(roads) <= set(about["lane_ids"]), f"{file.get('filepath')} has roads that are no lanes of the scenario"
        for lane_id, road in roads.items():
            left, right = export.corpus.lanes[about["map_id"], lane_id]
            if len(left) < 2 or len(right) < 2:
                continue  # the map has no edges; usual ones are written
            n_lanes += 1
            drawn = evaluated(road)
            for line, off in (
                (left, lambda point: np.min(distances(point, drawn[:, 0]))),
                (right, lambda point: np.min(distances(point, drawn[:, 2]))),
                (drawn[:, 1], lambda point: 0.5 * abs(np.min(distances(point, left)) - np.min(distances(point, right)))),
            ):
                share = np.linspace(0.0, 1.0, 101)
                is_compared = np.minimum(share, 1.0 - share) * np.linalg.norm(np.diff(line, axis=0), axis=1).sum() > END_M
                n_points, n_left_out = n_points + len(share), n_left_out + int((~is_compared).sum())
                for point in along(line, share)[is_compared]:
                    distance = off(point)
                    assert distance < NEAR_M, f"{file.get('filepath')}: lane {lane_id} is {distance:.3f} m off its road at {point}"
                    worst_m = max(worst_m, distance)
    return n_lanes, worst_m, n_left_out / max(n_points, 1)


def along(line, share):
    """Points at these shares of the length of a line."""
    station = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(line, axis=0), axis=1))])
    return np.stack([np.interp(share * station[-1], station, line[:, i]) for i in range(2)], -1)


def distances(point, line):
    """From a point to each piece of a line."""
    start, step = line[:-1], np.diff(line, axis=0)
    share = np.clip(((point - start) * step).sum(1) / np.maximum((step**2).sum(1), 1e-12), 0.0, 1.0)
    return np.linalg.norm(start + share[:, None] * step - point, axis=1)


def evaluated(road):
    """Left edge, middle and right edge of the lane of a road, [n, 3, 2]."""
    length = float(road.get("length"))
    geometries = road.findall("planView/geometry")
    starts = [float(geometry.get("s")) for geometry in geometries]
    lane = road.find("lanes/laneSection/right/lane")
    offsets, widths = records(road.findall("lanes/laneOffset"), "s"), records(lane.findall("width"), "sOffset")
    points = []
    for s in np.linspace(0.0, length, max(int(length / STEP_M), 2)):
        geometry = geometries[max(np.searchsorted(starts, s + 1e-9) - 1, 0)]
        x, y, heading = pose(geometry, s - float(geometry.get("s")))
        offset, width = value(offsets, s), value(widths, s)
        assert width >= -1e-9, f"{road.get('name')} has a negative width at {s}"
        normal = np.array([-math.sin(heading), math.cos(heading)])
        points.append([np.array([x, y]) + normal * t for t in (offset, offset - 0.5 * width, offset - width)])
    return np.array(points)


def pose(geometry, ds):
    x, y, heading = (float(geometry.get(name)) for name in ("x", "y", "hdg"))
    poly, u, v, slope = geometry.find("paramPoly3"), ds, 0.0, 0.0
    if poly is not None:
        p = ds / float(geometry.get("length"))
        (u, du), (v, dv) = (
            (a + p * (b + p * (c + p * d)), b + p * (2 * c + p * 3 * d))
            for a, b, c, d in ([float(poly.get(name + axis)) for name in "abcd"] for axis in "UV")
        )
        slope = math.atan2(dv, du)
    cos, sin = math.cos(heading), math.sin(heading)
    return x + cos * u - sin * v, y + sin * u + cos * v, heading + slope


def records(elements, place):
    return [[float(element.get(name)) for name in (place, "a", "b", "c", "d")] for element in elements]


def value(polynomials, s):
    start, a, b, c, d = [record for record in polynomials if record[0] <= s + 1e-9][-1]
    ds = s - start
    return a + ds * (b + ds * (c + ds * d))
