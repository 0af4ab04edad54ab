"""The lanes of a network as lanelets: bounds as points in driving direction that successors and neighbors share."""

import dataclasses
import math

import numpy as np

from fixtures.lanes import cut_evenly, length, offset, points_of, resampled

SEGMENT_M = 25.0
SPACING_M = 1.5
# Ends of lanes that are no farther apart are one.
WELD_M = 0.6
# Left borders of opposing directions that are no farther apart are one center line, not two curbs.
CENTER_LINE_M = 1.0


@dataclasses.dataclass
class Lanelet:
    """One lanelet; `left` and `right` are lists of (x, y) in meters, in driving direction."""

    left: list
    right: list
    left_kind: str
    right_kind: str
    subtype: str = "road"
    turn: str = ""
    speed_kmh: int = 0
    # The edge whose stop line or yield line is at the end, if any.
    approach: str = ""

    def points(self):
        return np.array(self.left + self.right)


@dataclasses.dataclass
class Ends:
    """The first and the last lanelet of a lane of an edge, and what bounds it on the sides."""

    first: Lanelet
    last: Lanelet


def lanelets_of(net, plan):
    """The lanelets for vehicles that reach into view, then crosswalks and walkways."""
    made, ends = [], {}
    for edge in net.roads():
        pieces = edge_lanelets(net, edge, plan.highway)
        for lane, chain in pieces.items():
            ends[lane] = Ends(chain[0], chain[-1])
            made += chain
    made += inner_lanelets(net, ends, plan.highway)
    made += walked_lanelets(net)
    seen = [lanelet for lanelet in made if plan.in_view(lanelet.points(), 3.0).any()]
    return seen


def edge_lanelets(net, edge, highway):
    """The lanelets of an edge by (edge id, lane index), in pieces of equal length; neighbors share their bounds."""
    lanes = net.lanes(edge)
    width = float(lanes[0].get("width"))
    shapes = [points_of(lane) for lane in lanes]
    borders = [offset(shape, -width / 2) for shape in shapes] + [offset(shapes[-1], width / 2)]
    n_pieces = max(1, round(length(shapes[0]) / SEGMENT_M))
    cut = [cut_evenly(border, n_pieces) for border in borders]
    kinds = ["border"] + ["dashed"] * (len(lanes) - 1) + [left_kind(net, edge, borders[-1])]
    result = {}
    for i, lane in enumerate(lanes):
        speed_kmh = round(float(lane.get("speed")) * 3.6 / 5) * 5
        chain = [
            Lanelet(cut[i + 1][k], cut[i][k], kinds[i + 1], kinds[i], "highway" if highway else "road", "", speed_kmh)
            for k in range(n_pieces)
        ]
        chain[-1].approach = edge.get("id")
        result[edge.get("id"), lane.get("index")] = chain
    return result


def left_kind(net, edge, border):
    """A curb, or the center line where the other direction lies beside this one."""
    middle = resampled(border, 3)[1]
    for other in net.roads():
        if (other.get("from"), other.get("to")) == (edge.get("to"), edge.get("from")):
            lane = net.lanes(other)[-1]
            beside = resampled(offset(points_of(lane), float(lane.get("width")) / 2), 200)
            if np.hypot(*(beside - middle).T).min() < CENTER_LINE_M:
                return "solid"
    return "border"


def inner_lanelets(net, ends, highway):
    """The lanelets inside of junctions. Where there is no room between two lanes, their ends are made one instead."""
    connections = [c for c in net.connections if key(c, "from") in ends and key(c, "to") in ends]
    curbs = {"right": curb_connections(connections, ends, "right"), "left": curb_connections(connections, ends, "left")}
    made, paths = [], {}
    for connection in connections:
        before, after = ends[key(connection, "from")].last, ends[key(connection, "to")].first
        if max(math.dist(before.left[-1], after.left[0]), math.dist(before.right[-1], after.right[0])) < WELD_M:
            # Neighbors hold the same points, and are welded to the same ones in turn.
            after.left[0], after.right[0] = before.left[-1], before.right[-1]
            continue
        paths[id(connection)] = inner_bounds(net, connection, before, after)
    for connection in connections:
        if id(connection) not in paths:
            continue
        left, right = paths[id(connection)]
        beside = neighbor(connection, connections, -1)
        if beside is not None and id(beside) in paths and len(paths[id(beside)][0]) == len(right):
            right = paths[id(beside)][0]
        both = beside is not None, neighbor(connection, connections, 1) is not None
        right_kind = "border" if id(connection) in curbs["right"] else "dashed" if both[0] else "virtual"
        left_kind = "border" if id(connection) in curbs["left"] else "dashed" if both[1] else "virtual"
        before, after = ends[key(connection, "from")].last, ends[key(connection, "to")].first
        turn = {"s": "straight", "l": "left", "L": "left", "r": "right", "R": "right"}.get(connection.get("dir"), "")
        speed = min(before.speed_kmh, after.speed_kmh)
        made.append(Lanelet(left, right, left_kind, right_kind, "highway" if highway else "road", "" if highway else turn, speed))
    return made


def key(connection, end):
    return connection.get(end), connection.get(f"{end}Lane")


def neighbor(connection, connections, step):
    """The connection between the same edges, from and to the lanes that lie one to the left (1) or right (-1) of these."""
    wanted = tuple(int(connection.get(f"{end}Lane")) + step for end in ("from", "to"))
    for other in connections:
        same = other.get("from") == connection.get("from") and other.get("to") == connection.get("to")
        if same and tuple(int(other.get(f"{end}Lane")) for end in ("from", "to")) == wanted:
            return other
    return None


def curb_connections(connections, ends, side):
    """The connections along a curb on the given side: each is the outermost turn both from its lane and into its lane.

    A curb on the right is followed by whoever turns right the most, from the rightmost lane into the rightmost lane.
    """
    sign = 1.0 if side == "right" else -1.0
    best_from, best_to = {}, {}
    for c in connections:
        before, after = ends[key(c, "from")].last, ends[key(c, "to")].first
        if getattr(before, f"{side}_kind") != "border" or getattr(after, f"{side}_kind") != "border":
            continue
        turn = sign * math.remainder(direction(after, 0) - direction(before, -1), math.tau)
        for best, end in ((best_from, "from"), (best_to, "to")):
            if turn < best.get(c.get(end), (math.inf, None))[0]:
                best[c.get(end)] = (turn, id(c))
    return {id for _, id in best_from.values()} & {id for _, id in best_to.values()}


def direction(lanelet, end):
    """The driving direction at the first (0) or last (-1) points of a lanelet, radians."""
    left, right = np.array(lanelet.left[end]), np.array(lanelet.right[end])
    across = left - right
    return math.atan2(-across[0], across[1])


def inner_bounds(net, connection, before, after):
    """The left and the right bound of a connection: offsets of SUMO's path, from the ends before it to those after it."""
    path = np.concatenate([points_of(lane) for lane in net.through(connection)])
    turn = math.remainder(direction(after, 0) - direction(before, -1), math.tau)
    n = max(2, math.ceil(length(path) / SPACING_M) + 1) if abs(turn) > 0.02 or length(path) > 12.0 else 2
    path = resampled(path, n)
    tangent = np.gradient(path, axis=0)
    normal = np.stack([-tangent[:, 1], tangent[:, 0]], axis=1) / np.hypot(*tangent.T)[:, None]
    width = np.linspace(math.dist(before.left[-1], before.right[-1]), math.dist(after.left[0], after.right[0]), n)[:, None]
    bounds = []
    for side, first, last in ((0.5, before.left[-1], after.left[0]), (-0.5, before.right[-1], after.right[0])):
        line = path + side * width * normal
        # The path of SUMO begins and ends in the middle of the lanes up to rounding; their corners are what counts.
        share = np.linspace(0.0, 1.0, n)[:, None]
        line = line + (1.0 - share) * (np.array(first) - line[0]) + share * (np.array(last) - line[-1])
        bounds.append([first, *[tuple(point) for point in line[1:-1]], last])
    return bounds


def walked_lanelets(net):
    """Crosswalks, and sidewalks as walkways."""
    made = []
    for edge in net.edges.values():
        for lane in net.lanes(edge, walked=True):
            if edge.get("function") not in (None, "crossing"):
                continue
            crosses = edge.get("function") == "crossing"
            path, half = points_of(lane), float(lane.get("width")) / 2
            path = path[np.append(True, np.hypot(*np.diff(path, axis=0).T) > 1e-3)]
            n_pieces = 1 if crosses else max(1, round(length(path) / SEGMENT_M))
            kinds = ("crossing", "crossing") if crosses else ("border", "virtual")
            sides = [cut_evenly(offset(path, side), n_pieces) for side in (half, -half)]
            made += [Lanelet(left, right, *kinds, "crosswalk" if crosses else "walkway") for left, right in zip(*sides)]
    return made
