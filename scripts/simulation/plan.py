"""What a place consists of: roads in SUMO's plain XML, the routes through it, and the part of it that is seen."""

import dataclasses

import numpy as np

from simulation.curves import length, unit

# Maps lie around this point of the plane, so that no coordinate is negative.
CENTER = np.array([1000.0, 1000.0])
# How far lanes of a piece of road may drift apart, and how short pieces may become, meters.
MAX_DRIFT_M, MIN_PIECE_M, END_PIECE_M = 0.2, 15.0, 36.0
# Acceleration across the motion that speed limits allow for in bends; some drive a third faster.
COMFORT_MPS2 = 2.2


@dataclasses.dataclass
class Flow:
    """Vehicles that take one route: edge ids, a mean rate, and SUMO's rule for the lane that they start on."""

    edges: str
    per_hour: float
    lane: str = "best"


@dataclasses.dataclass
class Walk:
    """People on foot between two edges; they start and end within the given distances from the outer ends of these, meters."""

    start: str
    end: str
    per_hour: float
    start_m: tuple
    end_m: tuple


class Plan:
    """A place under construction, in its own frame: meters around (0, 0), turned by `rotation` before it is written."""

    def __init__(self, name, rotation, half_view, speed_kmh, highway=False):
        self.name, self.rotation, self.half_view, self.speed_kmh = name, rotation, np.asarray(half_view, float), speed_kmh
        self.highway = highway
        self.nodes, self.edges, self.links, self.joints, self.crossings, self.options = [], [], [], [], [], []
        self.flows, self.walks, self.with_sidewalk = [], [], set()
        # By edge: the pieces that it is cut into, the node that it starts at, and the lengths of its first and last piece.
        self.pieces, self.starts, self.outer_m = {}, {}, {}
        # Shares of cyclists and of trucks among those who drive, lengths of trucks, what limits their speed beside the
        # road, and the weight of the habit of driving on the right.
        self.cyclists, self.trucks, self.truck_m, self.truck_kmh, self.keep_right = 0.0, 0.12, (6.5, 12.4), None, 1.0
        # Edges on which traffic slows down at times, so that queues grow back into view: how often, to what part of the
        # limit, and for how long.
        self.slow_edges, self.slow_share, self.slow_factor, self.slow_s = [], 0.3, (0.15, 0.6), (20.0, 60.0)
        # Cases with more agents are left out.
        self.most_agents = 32

    def placed(self, points):
        """Points of the place's own frame in the frame of the map."""
        turn = np.array([unit(self.rotation), unit(self.rotation + np.pi / 2)])
        return CENTER + np.asarray(points, float) @ turn

    def in_view(self, points, margin=0.0):
        """Whether points of the map's frame are seen; the view grows by a margin in meters."""
        turn = np.array([unit(self.rotation), unit(self.rotation + np.pi / 2)])
        return (np.abs((np.asarray(points) - CENTER) @ turn.T) < self.half_view + margin).all(axis=-1)

    def node(self, id, point, kind="priority", **attributes):
        x, y = self.placed(point)
        self.nodes.append(f'<node id="{id}" x="{x:.3f}" y="{y:.3f}" type="{kind}"{written(attributes)}/>')

    def edge(self, id, start, end, left_edge, lanes, width, speed_kmh=None, **attributes):
        """A one-way road of equal lanes; `left_edge` are the points of its left border in driving direction.

        Its speed limit is lower than wanted where the bends are tight.
        """
        speed = min((speed_kmh or self.speed_kmh) / 3.6, (COMFORT_MPS2 * smallest_radius(np.asarray(left_edge))) ** 0.5)
        parts = pieces(np.asarray(left_edge, float), (lanes - 1) * width)
        ids = [f"{id}.{k}" if k else id for k in range(len(parts))]
        nodes = [start, *ids[1:], end]
        for node, part in zip(ids[1:], parts[1:]):
            self.node(node, part[0])
        for k, (piece, part) in enumerate(zip(ids, parts)):
            shape = " ".join(f"{x:.3f},{y:.3f}" for x, y in self.placed(part))
            self.edges.append(
                f'<edge id="{piece}" from="{nodes[k]}" to="{nodes[k + 1]}" numLanes="{lanes}" width="{width:.2f}" '
                f'speed="{speed:.2f}" spreadType="right" shape="{shape}"{written(attributes)}/>'
            )
        self.pieces[id], self.starts[id], self.outer_m[id] = ids, start, [length(parts[0]), length(parts[-1])]
        if "sidewalkWidth" in attributes:
            self.with_sidewalk.update(ids)
        for before, after in zip(ids, ids[1:]):
            self.joints += [(before, after, k, k) for k in range(lanes)]

    def connect(self, start, end, *lanes):
        """Connects pairs of lanes of two edges; lane 0 is the rightmost one for vehicles."""
        self.links += [(start, end, a, b) for a, b in lanes]

    def connections(self):
        """The XML of all connections and crossings; SUMO counts a sidewalk as the rightmost lane."""

        def lane(edge, index):
            return index + (edge in self.with_sidewalk)

        links = [(self.pieces[start][-1], end, a, b) for start, end, a, b in self.links] + self.joints
        return [
            f'<connection from="{start}" to="{end}" fromLane="{lane(start, a)}" toLane="{lane(end, b)}"/>'
            for start, end, a, b in links
        ] + self.crossings

    def crossing(self, node, edges, width):
        """A crossing for people on foot over edges at a node, where vehicles give way to them."""
        ids = [edge if self.starts[edge] == node else self.pieces[edge][-1] for edge in edges]
        self.crossings.append(f'<crossing node="{node}" edges="{" ".join(ids)}" priority="true" width="{width:.1f}"/>')

    def flow(self, edges, per_hour, lane="best"):
        """Vehicles along edges, given by their ids with spaces between."""
        self.flows.append(Flow(" ".join(piece for edge in edges.split() for piece in self.pieces[edge]), per_hour, lane))

    def walk(self, start, end, per_hour, start_m, end_m):
        """People who walk between two edges; the ranges are distances from the outer ends, meters, cut to the outer pieces."""
        start_m, end_m = (np.minimum(span, room - 2.0) for span, room in ((start_m, self.outer_m[start][0]), (end_m, self.outer_m[end][1])))
        self.walks.append(Walk(start, self.pieces[end][-1], per_hour, tuple(start_m), tuple(end_m)))

    def slow(self, *edges):
        """Lets traffic slow down at times on these edges."""
        self.slow_edges += [piece for edge in edges for piece in self.pieces[edge]]


def pieces(path, spread_m):
    """Cuts a path where its curvature changes, so that within a piece it is nearly even; pieces share their end points.

    SUMO gives all lanes of an edge one length. A vehicle that changes lanes in a bend jumps ahead or back by what the lanes
    have drifted apart since the edge began; `spread_m` is the distance between the outermost lanes, meters.
    """
    turn = np.unwrap(np.arctan2(*np.diff(path, axis=0).T[::-1]))
    turn = np.append(turn, turn[-1])

    def drift_m(a, b):
        part = turn[a : b + 1] - turn[a]
        return spread_m * np.abs(part - np.linspace(0.0, part[-1], len(part))).max()

    along = np.append(0.0, np.cumsum(np.hypot(*np.diff(path, axis=0).T)))
    # Junctions cut off some meters of the first and the last piece.
    last = np.searchsorted(along, along[-1] - END_PIECE_M)
    cuts = [0]
    while cuts[-1] < len(path) - 1:
        least = along[cuts[-1]] + (MIN_PIECE_M if len(cuts) > 1 else END_PIECE_M)
        end = len(path) - 1
        while drift_m(cuts[-1], end) > MAX_DRIFT_M and along[end - 1] > least:
            end = end - 1 if end <= last else last
        cuts.append(end if along[end] >= least else len(path) - 1)
    return [path[a : b + 1] for a, b in zip(cuts, cuts[1:])]


def smallest_radius(path):
    """The radius of the tightest bend of a path, meters, over stretches of about five points; infinite for straight ones."""
    steps = np.diff(path, axis=0)
    turn = np.abs(np.diff(np.unwrap(np.arctan2(steps[:, 1], steps[:, 0]))))
    if len(turn) < 1 or turn.max() < 1e-6:
        return np.inf
    n = min(5, len(turn))
    turned = np.convolve(turn, np.ones(n), "valid").max()
    return n * length(path) / len(steps) / max(turned, 1e-9)


def written(attributes):
    return "".join(f' {key}="{value}"' for key, value in attributes.items())
