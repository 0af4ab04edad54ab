"""Measures what an archive holds, from its files alone: overlaps, vehicles off the road, motion, by place and split."""

import io
import itertools
import pathlib
import xml.etree.ElementTree as ET
import zipfile

import numpy as np

from fixtures.traffic import DT_S, Track
from simulation import cases

# Who is farther from all lanes than this is off the road, meters.
SLACK_M = 0.3
COLUMNS = (
    ("cases", "{:.0f}"), ("agents", "{:.1f}"), ("on foot", "{:.1f}"), ("km/h", "{:.0f}"), ("overlap %", "{:.2f}"), ("center off %", "{:.3f}"),
    ("corner off %", "{:.3f}"), ("accel", "{:.1f}"), ("brake", "{:.1f}"), ("across", "{:.1f}"), ("jerk", "{:.1f}"), ("yaw rate", "{:.2f}"),
    ("slip", "{:.2f}"),
)  # fmt: skip


def print_table(path, n_cases):
    """A row a table: the first `n_cases` cases of it."""
    print("agents and people or bicycles a case; percent of cases with overlapping boxes; percent of vehicle states with the center or any")
    print(f"corner more than {SLACK_M} m off the lanes; the rest is the 99th percentile over vehicles of their largest value, SI units\n")
    print(f"{'place':<24}{'split':<7}" + "".join(f"{name:>14}" for name, _ in COLUMNS))
    with zipfile.ZipFile(path) as archive:
        tables = [name for name in archive.namelist() if name.endswith(".csv")]
        for name in tables:
            place, split = pathlib.Path(name).stem.rsplit("_", 1)
            top = name.split("/")[0]
            road = drivable(archive.read(f"{top}/maps/{place}.osm_xy"))
            with archive.open(name) as file:
                values = measured(list(itertools.islice(read_cases(file), n_cases)), road)
            print(f"{place:<24}{split:<7}" + "".join(form.format(value).rjust(14) for (_, form), value in zip(COLUMNS, values)), flush=True)


def read_cases(file):
    """The cases of a table, each a list of tracks."""
    rows = (line.rstrip("\n").split(",") for line in itertools.islice(io.TextIOWrapper(file), 1, None))
    for _, case in itertools.groupby(rows, key=lambda row: row[0]):
        tracks = []
        for _, track in itertools.groupby(case, key=lambda row: row[1]):
            track = list(track)
            length, width = (float(track[0][i] or "nan") for i in (10, 11))
            states = np.array([[float(row[i] or "nan") for i in (5, 6, 7, 8, 9)] for row in track])
            tracks.append(Track(int(track[0][1]), track[0][4], length, width, int(track[0][2]) - 1, states))
        yield tracks


def drivable(text):
    """The outlines of the lanelets for vehicles of a map with x and y, as arrays of points."""
    root = ET.fromstring(text)
    nodes = {node.get("id"): (float(node.get("x")), float(node.get("y"))) for node in root.iter("node")}
    ways = {way.get("id"): [nodes[nd.get("ref")] for nd in way.iter("nd")] for way in root.iter("way")}
    outlines = []
    for relation in root.iter("relation"):
        tags = {tag.get("k"): tag.get("v") for tag in relation.iter("tag")}
        if tags.get("type") == "lanelet" and tags.get("subtype") in ("road", "highway"):
            sides = {member.get("role"): ways[member.get("ref")] for member in relation.iter("member") if member.get("type") == "way"}
            left, right = sides["left"], sides["right"]
            # Ways that two directions share run along only one of them.
            if np.hypot(*np.subtract(left[0], right[0])) > np.hypot(*np.subtract(left[0], right[-1])):
                left = left[::-1]
            outlines.append(np.array(left + right[::-1]))
    return outlines


def off_road(points, outlines):
    """Which points lie more than the slack off all outlines."""
    off = np.ones(len(points), bool)
    for outline in outlines:
        low, high = outline.min(axis=0) - SLACK_M, outline.max(axis=0) + SLACK_M
        near = np.flatnonzero(off & (points > low).all(axis=1) & (points < high).all(axis=1))
        if len(near):
            off[near] = ~covers(outline, points[near])
    return off


def covers(outline, points):
    """Which points lie inside an outline or no farther than the slack from it."""
    start, end = outline, np.roll(outline, -1, axis=0)
    x, y = points[:, :1], points[:, 1:]
    rises = (start[:, 1] > y) != (end[:, 1] > y)
    height = np.where(end[:, 1] == start[:, 1], 1.0, end[:, 1] - start[:, 1])
    crossing = start[:, 0] + (y - start[:, 1]) / height * (end[:, 0] - start[:, 0])
    inside = (rises & (x < crossing)).sum(axis=1) % 2 == 1
    along = end - start
    to = points[:, None] - start
    share = np.clip((to * along).sum(axis=2) / np.maximum((along**2).sum(axis=1), 1e-12), 0.0, 1.0)
    distance = np.hypot(*np.moveaxis(to - share[..., None] * along, 2, 0)).min(axis=1)
    return inside | (distance < SLACK_M)


def measured(found, road):
    """The values of a row of the table."""
    vehicles = [track for case in found for track in case if track.kind == "car"]
    states = np.concatenate([track.rows for track in vehicles])
    half = np.concatenate([np.tile([track.length / 2, track.width / 2], (len(track.rows), 1)) for track in vehicles])
    long, wide = cases.axes_of(states[:, 4])
    corner_off = np.zeros(len(states), bool)
    for ahead, left in ((1, 1), (1, -1), (-1, -1), (-1, 1)):
        corner_off |= off_road(states[:, :2] + ahead * half[:, :1] * long + left * half[:, 1:] * wide, road)
    motion = np.array([extremes(track) for track in vehicles if len(track.rows) >= 8])
    return (
        len(found), np.mean([len(case) for case in found]), np.mean([sum(track.kind != "car" for track in case) for case in found]),
        3.6 * np.hypot(states[:, 2], states[:, 3]).mean(), 100.0 * np.mean([cases.overlap_m(case) > 0.0 for case in found]),
        100.0 * off_road(states[:, :2], road).mean(), 100.0 * corner_off.mean(), *np.percentile(motion, 99, axis=0),
    )  # fmt: skip


def extremes(track):
    """A vehicle's largest acceleration, deceleration, acceleration across, jerk, yaw rate and slip angle."""
    velocity, heading = track.rows[:, 2:4], np.unwrap(track.rows[:, 4])
    acceleration = np.gradient(velocity, DT_S, axis=0)
    jerk = np.gradient(acceleration, DT_S, axis=0)
    ahead = np.stack([np.cos(heading), np.sin(heading)], axis=1)
    along = (acceleration * ahead).sum(axis=1)
    across = acceleration[:, 1] * ahead[:, 0] - acceleration[:, 0] * ahead[:, 1]
    fast = np.hypot(*velocity.T) > 2.0
    slip = np.arctan2(velocity[:, 1], velocity[:, 0]) - heading
    slip = np.abs(np.angle(np.exp(1j * slip)))[fast].max() if fast.any() else 0.0
    return along.max(), -along.min(), np.abs(across).max(), np.hypot(*jerk.T).max(), np.abs(np.gradient(heading, DT_S)).max(), slip
