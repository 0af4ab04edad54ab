"""SUMO's network of a place, and what the maps and the traffic need of it."""

import xml.etree.ElementTree as ET

from fixtures.traffic import tool

OPTIONS = [
    "--offset.disable-normalization", "--precision", "4", "--rectangular-lane-cut", "--no-turnarounds",
    "--junctions.internal-link-detail", "16", "--junctions.corner-detail", "8", "--junctions.limit-turn-speed", "2.5", "--junctions.limit-turn-speed.min-angle", "5",
]  # fmt: skip


def build(plan, scratch):
    """netconvert's network of a plan; returns the path of the file."""
    parts = {"nod": ("nodes", plan.nodes), "edg": ("edges", plan.edges), "con": ("connections", plan.connections())}
    args = []
    for kind, (root, elements) in parts.items():
        path = scratch / f"{plan.name}.{kind}.xml"
        path.write_text("\n".join([f"<{root}>", *elements, f"</{root}>", ""]))
        args += [{"nod": "-n", "edg": "-e", "con": "-x"}[kind], path]
    net = scratch / f"{plan.name}.net.xml"
    tool("netconvert", *args, "-o", net, *OPTIONS, *plan.options)
    return net


class Network:
    """A parsed network: edges by id, and the connections out of each lane."""

    def __init__(self, path):
        root = ET.parse(path).getroot()
        self.edges = {edge.get("id"): edge for edge in root.iter("edge")}
        self.connections = list(root.iter("connection"))
        self.junctions = {junction.get("id"): junction for junction in root.iter("junction")}
        self.onward = {}
        for connection in self.connections:
            self.onward.setdefault((connection.get("from"), connection.get("fromLane")), []).append(connection)

    def roads(self):
        """The edges outside of junctions."""
        return [edge for edge in self.edges.values() if edge.get("function") is None]

    def lanes(self, edge, walked=False):
        """The lanes of an edge for vehicles, or those for people on foot."""
        return [lane for lane in edge.findall("lane") if (lane.get("allow") == "pedestrian") == walked]

    def lane(self, id):
        edge, index = id.rsplit("_", 1)
        return next(lane for lane in self.edges[edge].findall("lane") if lane.get("index") == index)

    def through(self, connection):
        """The lanes inside the junction that a connection runs over, in order; SUMO splits some where vehicles wait."""
        lanes, via = [], connection.get("via")
        while via is not None:
            lanes.append(self.lane(via))
            edge, index = via.rsplit("_", 1)
            after = self.onward.get((edge, index), [])
            via = after[0].get("via") if after else None
        return lanes
