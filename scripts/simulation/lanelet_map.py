"""Lanelet2 maps of places: lanelets, and the rules at junctions as regulatory elements with their stop lines and lights."""

import numpy as np

from fixtures.lanelet2 import degrees, document, node_element, tags

KINDS = {
    "border": {"type": "curbstone", "subtype": "low"},
    "dashed": {"type": "line_thin", "subtype": "dashed"},
    "solid": {"type": "line_thin", "subtype": "solid"},
    "virtual": {"type": "virtual"},
    "crossing": {"type": "zebra_marking"},
    "stop_line": {"type": "stop_line"},
    "traffic_light": {"type": "traffic_light", "subtype": "red_yellow_green"},
}


class LaneletMap:
    """A map under construction. Points and ways that coincide are stored once, as Lanelet2 expects."""

    def __init__(self):
        self.nodes, self.ways, self.rules = {}, {}, []
        self.relations = []

    def way(self, points, kind):
        refs = tuple(self.nodes.setdefault((round(float(x), 4), round(float(y), 4)), 1001 + len(self.nodes)) for x, y in points)
        if refs[::-1] in self.ways:  # shared with a lanelet in the other direction
            refs = refs[::-1]
        return self.ways.setdefault(refs, (10001 + len(self.ways), kind))[0]

    def rule(self, members, pairs):
        """A regulatory element of (type, id, role) members; returns its id."""
        self.rules.append((60001 + len(self.rules), members, {**pairs, "type": "regulatory_element"}))
        return self.rules[-1][0]

    def document(self, node):
        """The map's text; `node` writes a node of the given id and position."""
        body = [node(id, x, y) for (x, y), id in self.nodes.items()]
        for refs, (id, kind) in self.ways.items():
            body.append(f'  <way id="{id}" visible="true" version="1">')
            body += [f'    <nd ref="{ref}" />' for ref in refs]
            body += [*tags(KINDS[kind]), "  </way>"]
        for id, members, pairs in [*self.relations, *self.rules]:
            body.append(f'  <relation id="{id}" visible="true" version="1">')
            body += [f'    <member type="{kind}" ref="{ref}" role="{role}" />' for kind, ref, role in members]
            body += [*tags(pairs), "  </relation>"]
        return document(body).replace("djinn-fixtures", "djinn-simulation")


def documents(lanelets, net):
    """The map's text by file suffix: `osm` with meters disguised as degrees, `osm_xy` with the meters."""
    made = LaneletMap()
    ids = {id(lanelet): 30001 + i for i, lanelet in enumerate(lanelets)}
    sides = [(made.way(lanelet.left, lanelet.left_kind), made.way(lanelet.right, lanelet.right_kind)) for lanelet in lanelets]
    rules = junction_rules(made, lanelets, net, ids)
    limits = {}
    for lanelet, (left, right) in zip(lanelets, sides):
        members = [("way", left, "left"), ("way", right, "right")]
        on_foot = lanelet.subtype in ("crosswalk", "walkway")
        if not on_foot:
            sign = {"sign_type": f"de274-{lanelet.speed_kmh}", "subtype": "speed_limit"}
            if lanelet.speed_kmh not in limits:
                limits[lanelet.speed_kmh] = made.rule([], sign)
            members += [("relation", ref, "regulatory_element") for ref in (limits[lanelet.speed_kmh], *rules.get(id(lanelet), []))]
        pairs = {"location": "urban", "one_way": "no" if on_foot else "yes", "region": "de", "subtype": lanelet.subtype, "type": "lanelet"}
        if lanelet.turn:
            pairs["turn_direction"] = lanelet.turn
        made.relations.append((ids[id(lanelet)], members, pairs))
    return {
        "osm": made.document(lambda id, x, y: node_element(id, degrees(x, y))),
        "osm_xy": made.document(lambda id, x, y: f'  <node id="{id}" visible="true" version="1" x="{x:.4f}" y="{y:.4f}" />'),
    }


def junction_rules(made, lanelets, net, ids):
    """Regulatory elements of all junctions in view; returns those that hold on a lanelet, by the lanelet's id()."""
    approaches = {}
    for lanelet in lanelets:
        if lanelet.approach:
            approaches.setdefault(lanelet.approach, []).append(lanelet)
    result = {}
    for junction in net.junctions.values():
        edges = [edge for edge in approaches if net.edges[edge].get("to") == junction.get("id")]
        states = {edge: states_of(net, edge) for edge in edges}
        kind = junction.get("type")
        if not edges or not is_contested(net, junction):
            continue
        if kind.startswith("traffic_light"):
            for edge in edges:
                line, light = stop_line(made, approaches[edge]), signal(made, approaches[edge])
                rule = made.rule([("way", light, "refers"), ("way", line, "ref_line")], {"subtype": "traffic_light"})
                for lanelet in approaches[edge]:
                    result.setdefault(id(lanelet), []).append(rule)
            continue
        yielding = [edge for edge in edges if kind == "allway_stop" or states[edge] <= set("msw")]
        if not yielding:
            continue
        members = [("way", stop_line(made, approaches[edge]), "ref_line") for edge in yielding]
        for edge in edges:
            role = "yield" if edge in yielding else "right_of_way"
            members += [("relation", ids[id(lanelet)], role) for lanelet in approaches[edge]]
        rule = made.rule(members, {"subtype": "all_way_stop" if kind == "allway_stop" else "right_of_way"})
        for edge in edges:
            for lanelet in approaches[edge]:
                result.setdefault(id(lanelet), []).append(rule)
    return result


def states_of(net, edge):
    """SUMO's letters of right of way of the connections out of an edge: M is major, m minor, s stop, w all-way stop."""
    return {c.get("state") for c in net.connections if c.get("from") == edge and not c.get("to").startswith(":")}


def is_contested(net, junction):
    """Whether paths of vehicles from different edges lead into one lane there."""
    sources = {}
    for c in net.connections:
        if not c.get("from").startswith(":") and net.edges[c.get("from")].get("to") == junction.get("id"):
            sources.setdefault((c.get("to"), c.get("toLane")), set()).add(c.get("from"))
    return any(len(edges) > 1 for edges in sources.values())


def stop_line(made, lanelets):
    """The line across all lanes of an approach, from its right border to its left one."""
    points = [lanelet.right[-1] for lanelet in lanelets] + [lanelets[-1].left[-1]]
    return made.way(points, "stop_line")


def signal(made, lanelets):
    """A traffic light a meter to the right of the stop line's right end."""
    right, left = np.array(lanelets[0].right[-1]), np.array(lanelets[-1].left[-1])
    across = (right - left) / np.hypot(*(right - left))
    return made.way([right + 1.0 * across, right + 1.4 * across], "traffic_light")
