"""Evaluates roads by the formulas of OpenDRIVE 1.7, and compares them with the lanes of the corpus."""

import math

import numpy as np

STEP_M = 0.05  # along roads, between the points at which they are evaluated
EDGE_M = 0.05  # how far the edges of a lane may be from those of its road
MIDDLE_M = 0.1  # how far the middle may be from midway, which is not one line where edges converge
MOST_LEFT_OUT = 0.5  # share of a lane's points that may lie beyond an end


def compare_roads(etree, export):
    """Demands that points along the edges of all lanes lie on those of their roads, and that the middles of roads lie midway between the
    edges of their lanes. Roads end square and lanes need not: points beyond the end of what they are compared with are left out.
    Returns how many lanes there are, the largest distance, and the share of points that were left out."""
    n_lanes, worst_m, n_points, n_left_out, seen = 0, 0.0, 0, 0, set()
    for scenario in export.scenarios:
        file = etree.parse(str(export.folder / scenario["file"])).getroot().find("RoadNetwork/LogicFile")
        if file is None or file.get("filepath") in seen:
            continue
        seen.add(file.get("filepath"))
        about = export.corpus.scenarios[scenario["scenario_id"]]
        root = etree.parse(str(export.folder / file.get("filepath"))).getroot()
        places = {int(lane_id): (road, i) for road in root.iter("road") for i, lane_id in enumerate(road.get("name").split()[1:])}
        assert set(places) <= set(about["lane_ids"]), f"{file.get('filepath')} has roads that are no lanes of the scenario"
        for lane_id, place in places.items():
            left, right = export.corpus.lanes[about["map_id"], lane_id]
            if len(left) < 2 or len(right) < 2:
                continue  # the map has no edges; usual ones are written
            n_lanes += 1
            drawn = evaluated(*place)
            n_of_lane, n_beyond = 0, 0
            for line, others in ((left, [drawn[:, 0]]), (right, [drawn[:, 2]]), (drawn[:, 1], [left, right])):
                for point in along(line, np.linspace(0.0, 1.0, 101)):
                    n_of_lane += 1
                    nearest = [to_line(point, other) for other in others]
                    if any(is_beyond for _, is_beyond in nearest):
                        n_beyond += 1
                        continue
                    is_edge = len(nearest) == 1
                    distance = nearest[0][0] if is_edge else 0.5 * abs(nearest[0][0] - nearest[1][0])
                    assert distance < (EDGE_M if is_edge else MIDDLE_M), f"{file.get('filepath')}: lane {lane_id} is {distance:.3f} m off its road at {point}"
                    worst_m = max(worst_m, distance)
            assert n_beyond <= MOST_LEFT_OUT * n_of_lane, f"{file.get('filepath')}: most of lane {lane_id} lies beyond its road"
            n_points, n_left_out = n_points + n_of_lane, n_left_out + n_beyond
    return n_lanes, worst_m, n_left_out / max(n_points, 1)


def along(line, share):
    """Points at these shares of the length of a line."""
    station = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(line, axis=0), axis=1))])
    return np.stack([np.interp(share * station[-1], station, line[:, i]) for i in range(2)], -1)


def to_line(point, line):
    """The distance from a point to a line, and whether the line's nearest point is one of its ends."""
    start, step = line[:-1], np.diff(line, axis=0)
    share = ((point - start) * step).sum(1) / np.maximum((step**2).sum(1), 1e-12)
    off = np.linalg.norm(start + np.clip(share, 0.0, 1.0)[:, None] * step - point, axis=1)
    nearest = int(np.argmin(off))
    is_beyond = (nearest == 0 and share[0] < 0.0) or (nearest == len(share) - 1 and share[-1] > 1.0)
    return off[nearest], is_beyond


def evaluated(road, i):
    """Left edge, middle and right edge of a lane of a road, counted from its left, [n, 3, 2]."""
    length = float(road.get("length"))
    geometries = road.findall("planView/geometry")
    starts = [float(geometry.get("s")) for geometry in geometries]
    offsets = records(road.findall("lanes/laneOffset"), "s")
    lanes = sorted(road.findall("lanes/laneSection/right/lane"), key=lambda lane: -int(lane.get("id")))
    widths = [records(lane.findall("width"), "sOffset") for lane in lanes[: i + 1]]
    points = []
    for s in np.linspace(0.0, length, max(int(length / STEP_M), 2)):
        geometry = geometries[max(np.searchsorted(starts, s + 1e-9) - 1, 0)]
        x, y, heading = pose(geometry, s - float(geometry.get("s")))
        *before, width = (value(of_lane, s) for of_lane in widths)
        assert width >= -1e-9, f"{road.get('name')} has a negative width at {s}"
        offset = value(offsets, s) - sum(before)
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
