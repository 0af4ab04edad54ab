"""Are the cut-ins that djinn finds cut-ins? The definition of `cut_in` a second time, from lanes and states alone, compared pair by pair; and
what an engineer would call a cut-in, in other words and without lanes (`nobody_cut_off`), which every cut-in of djinn must be.

    pip install numpy pyarrow
    python scripts/check_cut_ins.py output/quickstart/main            # scenes/ and events.parquet of a run, and its corpus/
    python scripts/check_cut_ins.py output/quickstart/main/corpus     # verified cut-ins of a corpus

Of the recorded scenes every ordered pair is looked at that events.parquet names as a cut-in or as near one; of a corpus every verified scenario
of which a cut-in was asked, for the pair that was asked. The exit code is 1 where the two disagree on more than 1 % of the cut-ins: states are
stored in single precision, so that a case on the edge may fall to either side. `--collisions` is for runs whose `[mine]` lets cut-ins end in a
collision; the bundled pipelines do not.
"""

import argparse
import math
import pathlib
import sys

import numpy as np
import pyarrow as pa
import pyarrow.dataset as ds
import pyarrow.ipc as ipc
import pyarrow.parquet as pq

MAX_DELAY_S, MAX_HEADING_RAD, MIN_SHIFT_M, MIN_SPEED_MPS, SETTLING_S = 3.0, math.pi / 6, 0.5, 1.0, 1.0
NOMINAL_HALF_WIDTH_M, LANE_HALF_WIDTH_M, HYSTERESIS_M, EXTENSION_M, AHEAD_M, BEHIND_M = 1.9, 1.75, 0.3, 100.0, 200.0, 100.0
NOMINAL = {"vehicle": (4.6, 1.9), "unknown": (4.6, 1.9), "bus": (12.0, 2.6), "motorcyclist": (2.0, 0.8)}  # where a dataset gives no size
MERGES_M, MERGED_M = 50.0, 1.0
HEADING, VX = 2, 3


def wrapped(angle):
    return (angle + np.pi) % (2 * np.pi) - np.pi


def unit(angle):
    return np.array([np.cos(angle), np.sin(angle)])


class Line:
    """A polyline without repeated points: stations, offsets (positive to the left) and directions of points beside it."""

    def __init__(self, points):
        points = np.asarray(points, float)
        keep = [0]
        for i in range(1, len(points)):
            if np.hypot(*(points[i] - points[keep[-1]])) > 1e-9:
                keep.append(i)
        points = points[keep]
        self.start, self.along = points[:-1], np.diff(points, axis=0)
        self.length = np.hypot(*self.along.T)
        self.station = np.concatenate([[0.0], np.cumsum(self.length)])

    def at(self, station):
        points = np.vstack([self.start, self.start[-1] + self.along[-1]])
        return np.array([np.interp(station, self.station, points[:, axis]) for axis in (0, 1)])

    def project(self, points):
        points = np.atleast_2d(points)
        from_start = points[:, None] - self.start
        share = np.clip((from_start * self.along).sum(-1) / self.length**2, 0, 1)
        away = from_start - share[..., None] * self.along
        nearest = np.nan_to_num((away**2).sum(-1), nan=np.inf).argmin(1)
        rows = np.arange(len(points))
        away, along = away[rows, nearest], self.along[nearest]
        side = np.where(along[:, 0] * from_start[rows, nearest, 1] < along[:, 1] * from_start[rows, nearest, 0], -1, 1)
        station = self.station[nearest] + share[rows, nearest] * self.length[nearest]
        return station, side * np.hypot(*away.T), np.arctan2(along[:, 1], along[:, 0])


def is_in_polygon(polygon, points):
    """Even-odd rule."""
    a, b = polygon[None], np.roll(polygon, -1, 0)[None]
    x, y = points[:, :1], points[:, 1:2]
    with np.errstate(all="ignore"):
        at_x = a[..., 0] + (b[..., 0] - a[..., 0]) * (y - a[..., 1]) / (b[..., 1] - a[..., 1])
        hit = ((a[..., 1] > y) != (b[..., 1] > y)) & (x < at_x)
    return hit.sum(1) % 2 == 1


class Lane:
    def __init__(self, row, to_scene):
        points = lambda name: to_scene(np.stack([row[f"{name}_x_m"], row[f"{name}_y_m"]], -1).astype(float))
        self.id, self.successors, self.predecessors = row["lane_id"], row["successors"], row["predecessors"]
        self.center, self.left, self.right = points("centerline"), points("left"), points("right")
        self.has_sides = len(self.left) >= 2 and len(self.right) >= 2
        self.line = Line(self.center) if len(self.center) >= 2 else None
        ends = [np.arctan2(*np.diff(self.center, axis=0)[i][::-1]) for i in (0, -1)] if self.line else [0, 0]
        self.bend = abs(wrapped(ends[1] - ends[0]))

    def holds(self, points):
        if self.has_sides:
            return is_in_polygon(np.vstack([self.left, self.right[::-1]]), points)
        station, offset, _ = self.line.project(points)
        return (abs(offset) <= NOMINAL_HALF_WIDTH_M) & (station > 0) & (station < self.line.station[-1])


def extended(points):
    kept = []
    for point in points:
        if not kept or np.hypot(*(point - kept[-1])) > 0.05:
            kept.append(point)
    onward = lambda a, b: b + (b - a) / np.hypot(*(b - a)) * EXTENSION_M
    return Line([onward(kept[1], kept[0]), *kept, onward(kept[-2], kept[-1])])


class Scene:
    """States as an array (agent, timestep, 5), NaN where an agent is not tracked; lanes in the scene frame."""

    def __init__(self, header, names, states, sizes, lane_rows):
        frame = header["world_from_scene"]
        if isinstance(frame, dict):
            frame = [frame["x_m"], frame["y_m"], frame["rotation_rad"]]
        cos, sin = np.cos(frame[2]), np.sin(frame[2])
        turn = np.array([[cos, -sin], [sin, cos]])
        to_scene = lambda points: (points - np.array(frame[:2])) @ turn if len(points) else points.reshape(0, 2)
        self.dt_s, self.present, self.end = header["dt_s"], header["n_history"] - 1, header["n_timesteps"]
        self.idx = {name: i for i, name in enumerate(names)}
        self.states, self.sizes, self.kept_lanes = states, sizes, {}
        lanes = [Lane(row, to_scene) for row in lane_rows]
        self.lanes = {lane.id: lane for lane in lanes if lane.line}

    def kept(self, agent):
        if agent not in self.kept_lanes:
            self.kept_lanes[agent] = KeptLane(self, agent)
        return self.kept_lanes[agent]


class KeptLane:
    """The lane that an agent keeps; without lanes where it is in none."""

    def __init__(self, scene, agent):
        states = scene.states[agent]
        here = states[scene.present]
        future, history = states[scene.present :], states[: scene.present + 1]
        future, history = (part[np.isfinite(part).all(1), :2] for part in (future, history))
        best = None
        for lane in scene.lanes.values():
            if abs(wrapped(lane.line.project(here[:2])[2][0] - here[HEADING])) >= np.pi / 4 or not lane.holds(here[None, :2])[0]:
                continue
            route = self.follow(scene, [lane], history, BEHIND_M, lambda lane: lane.predecessors)[::-1]
            self.use(self.follow(scene, route, future, AHEAD_M, lambda lane: lane.successors))
            score = ((~self.holds(future)).sum(), abs(self.center.project(future)[1]).sum())
            if best is None or score < best[0]:
                best = (score, self.lanes)
        self.lanes = []
        if best:
            self.use(best[1])

    @staticmethod
    def follow(scene, route, driven, length_m, connections):
        added_m = 0.0
        while added_m < length_m:
            ids = [lane.id for lane in route]
            onward = [scene.lanes[i] for i in connections(route[-1]) if i in scene.lanes and i not in ids]
            if not onward:
                break
            route = [*route, min(onward, key=lambda lane: (-lane.holds(driven).sum(), lane.bend))]
            added_m += route[-1].line.station[-1]
        return route

    def use(self, lanes):
        joined = lambda name: extended(np.concatenate([getattr(lane, name) for lane in lanes]))
        self.lanes, self.center = lanes, joined("center")
        self.sides = (joined("left"), joined("right")) if all(lane.has_sides for lane in lanes) else None

    def beyond(self, points, side):
        """How far points are beyond the left (+1) or right (-1) side, meters."""
        if self.sides:
            return side * self.sides[0 if side > 0 else 1].project(points)[1]
        return side * self.center.project(points)[1] - NOMINAL_HALF_WIDTH_M

    def holds(self, points):
        return np.maximum(self.beyond(points, 1), self.beyond(points, -1)) <= HYSTERESIS_M


def moved_across_headings(states):
    """To the left, across the mean of the headings at both ends."""
    known = states[np.isfinite(states).all(1)]
    first, last = known[0], known[-1]
    across = unit(first[HEADING] + wrapped(last[HEADING] - first[HEADING]) / 2 + np.pi / 2)
    return float((last[:2] - first[:2]) @ across)


def merges_ahead(others, lane, at):
    """Whether one lane leads into another soon after this place."""
    ahead = others.center.at(others.center.project(at)[0][0] + MERGES_M)
    return abs(lane.center.project(ahead)[1][0]) < MERGED_M


def cut_in(scene, ego, other):
    """(t_other, t_ego) where `other` cuts in ahead of `ego`, or else why not, in a word."""
    now, end, dt = scene.present, scene.end, scene.dt_s
    own, theirs = scene.states[ego], scene.states[other]
    tracked = np.isfinite(theirs).all(1)
    if not (tracked[now] and np.isfinite(own[now]).all()):
        return "absent"
    lane = scene.kept(ego)
    if not lane.lanes:
        return "ego_in_no_lane"
    side = 1 if lane.center.project(theirs[now, :2])[1][0] >= 0 else -1
    if lane.beyond(theirs[now, :2], side)[0] <= 0:
        return "in_the_lane_before"
    later = np.arange(now + 1, end)
    with np.errstate(invalid="ignore"):
        near_side, far_side = lane.beyond(theirs[:, :2], side), lane.beyond(theirs[:, :2], -side)
        inside = later[tracked[later] & (near_side[later] <= 0) & (far_side[later] <= 0)]
    if not len(inside):
        return "never_in"
    crossing, settling = inside[0], round(SETTLING_S / dt)
    stay = np.arange(crossing, min(end, crossing + settling))
    if (tracked[stay] & (near_side[stay] > 0)).any():
        return "goes_back"
    (s_own, o_own, h_own), (s_theirs, o_theirs, h_theirs) = (lane.center.project(agent[:, :2]) for agent in (own, theirs))
    own_known = np.isfinite(own).all(1)
    slant = wrapped(theirs[:, HEADING] - h_theirs)
    until = np.arange(now, crossing + 1)
    if (tracked[until] & (abs(slant[until]) >= MAX_HEADING_RAD)).any():
        return "another_way"
    (length, width), (their_length, their_width) = scene.sizes[ego], scene.sizes[other]
    cos, sin = abs(np.cos(slant)), abs(np.sin(slant))
    along, across = (cos * their_length + sin * their_width) / 2, (sin * their_length + cos * their_width) / 2
    in_strip = tracked & (abs(o_theirs - o_own[now]) <= width / 2 + across)
    if in_strip[now]:
        return "in_front_before"
    delay = math.floor(MAX_DELAY_S / dt - 1e-6)
    found = None
    for t in later[in_strip[later]]:
        soon = np.arange(t + 1, min(end, t + delay + 1))
        there = soon[own_known[soon] & (abs(s_own[soon] - s_theirs[t]) <= length / 2 + along[t])]
        if len(there):
            found = int(t), int(there[0])
            break
    if not found:
        return "not_reached"
    come_in = max(crossing, found[0])
    if not all(own_known[t] and tracked[t] and s_theirs[t] > s_own[t] for t in (crossing, found[0])):
        return "behind"
    if not s_theirs[come_in] - along[come_in] - s_own[come_in] - length / 2 >= 0:
        return "alongside"
    for third in set(range(len(scene.states))) - {ego, other}:
        at = scene.states[third][come_in, :2]
        if np.isfinite(at).all() and max(lane.beyond(at, 1)[0], lane.beyond(at, -1)[0]) <= 0:
            if s_own[come_in] < lane.center.project(at)[0][0] < s_theirs[come_in]:
                return "behind_a_third"
    until = np.arange(now, come_in + 1)
    if not lane.holds(own[until[own_known[until]], :2]).all():
        return "ego_leaves"
    last = min(come_in + settling, end - 1)
    until = np.arange(now, last + 1)
    shift = max(-side * (o_theirs[until] - o_theirs[now])[tracked[until]])
    ego_shift = max(side * (o_own[until] - o_own[now])[own_known[until]])
    if shift < MIN_SHIFT_M or shift <= ego_shift:
        return "moves_less"
    others = scene.kept(other)
    keeps = lambda end: bool(others.lanes) and others.holds(theirs[now : end + 1][tracked[now : end + 1], :2]).all()
    joins = {lane.id for lane in others.lanes} & {lane.id for lane in lane.lanes}
    is_mutual = joins and merges_ahead(others, lane, theirs[crossing, :2]) and keeps(crossing)
    if not is_mutual and keeps(last):
        return "keeps_a_lane_of_its_own"
    if is_mutual and side * moved_across_headings(own[until]) >= -side * moved_across_headings(theirs[until]):
        return "ego_comes_in"
    if min(np.hypot(*agent[found[0], VX:]) for agent in (own, theirs)) < MIN_SPEED_MPS:
        return "stands"
    # Where the ego drives at the place of the other, or else where it is last.
    last = np.flatnonzero(own_known)[-1]
    passes = lambda t: next((k for k in range(t, last + 1) if own_known[k] and s_own[k] >= s_theirs[t]), last)
    is_met = lambda t: own_known[t] and s_theirs[t] > s_own[t] and abs(o_theirs[t] - o_own[passes(t)]) <= (width + their_width) / 2
    if is_met(now) or not any(is_met(t) for t in later[tracked[later]]):
        return "ego_drives_elsewhere"
    return found


def overlap(pair, sizes):
    """Whether two boxes overlap, given as states and sizes: no axis of either separates them."""
    if not np.isfinite(pair).all():
        return False
    halves = [np.array(size) / 2 for size in sizes]
    axes = [unit(state[HEADING] + turn) for state in pair for turn in (0, np.pi / 2)]
    reach = lambda axis: sum(abs(axis @ unit(s[HEADING])) * h[0] + abs(axis @ unit(s[HEADING] + np.pi / 2)) * h[1] for s, h in zip(pair, halves))
    return all(abs((pair[1][:2] - pair[0][:2]) @ axis) <= reach(axis) for axis in axes)


def boxes_touch(scene, ego, other):
    """Whether the boxes overlap at the same time, from the present on."""
    sizes = [scene.sizes[ego], scene.sizes[other]]
    return any(overlap([scene.states[ego, t], scene.states[other, t]], sizes) for t in range(scene.present, scene.end))


def nobody_cut_off(scene, ego, other):
    """Why an engineer who sees the two drive, and no lanes, would not say that the ego is cut off; None if one would.

    One drives along. Another, beside it, comes over onto the strip of ground that the first goes on to cover, ahead of its front, the same
    way, and so close that the first would be there within 3 s at its speed. They do not crash. Beyond where it is last, nobody knows where
    the first goes on: as over its last second or as over all of its way, and within a lane.
    """
    way = scene.states[ego, scene.present :]
    way = way[np.isfinite(way).all(1), :2]
    if len(way) < 2 or np.hypot(*(way[-1] - way[0])) < 1:
        return "the ego stands"
    second = min(len(way) - 1, round(1 / scene.dt_s))
    reasons = [why_not(scene, ego, other, extended([*way, way[-1] + onward])) for onward in (way[-1] - way[-1 - second], way[-1] - way[0])]
    return None if None in reasons else reasons[0]


def why_not(scene, ego, other, path):
    """The same, of an ego that drives this path."""
    own, theirs = (states[scene.present :] for states in (scene.states[ego], scene.states[other]))
    (length, width), sizes = scene.sizes[ego], [scene.sizes[ego], scene.sizes[other]]
    if not (np.isfinite(own[0]).all() and np.isfinite(theirs[0]).all()):
        return "one of them is not there at present"
    station, _, direction = path.project(own[:, :2])

    def gap(t, half_beyond=LANE_HALF_WIDTH_M):
        """How far ahead of the ego's front the other is in the way, in meters; None if it is not."""
        corners = theirs[t, :2] + np.array([[a, b] for a in (-0.5, 0, 0.5) for b in (-0.5, 0, 0.5)]) * sizes[1] @ np.array([unit(theirs[t, HEADING]), unit(theirs[t, HEADING] + np.pi / 2)])
        s, beside, _ = path.project(corners)
        half = np.where(s > np.nanmax(station), half_beyond, width / 2)
        is_over = (beside < half).any() and (beside > -half).any()
        return s.min() - station[t] - length / 2 if is_over and s.mean() > station[t] else None

    if gap(0, width / 2) is not None:
        return "the other is in its way from the start"
    known = [t for t in range(1, len(own)) if np.isfinite(own[t]).all() and np.isfinite(theirs[t]).all()]
    in_way = [t for t in known if gap(t) is not None]
    if not in_way:
        return "the other never gets where the ego drives, ahead of it"
    first = in_way[0]
    if gap(first) > MAX_DELAY_S * np.hypot(*own[first, VX:]):
        return "the other is far ahead"
    if abs(wrapped(theirs[first, HEADING] - direction[first])) > np.pi / 4:
        return "they do not go the same way"
    beside = abs(path.project(theirs[[0, *in_way], :2])[1])
    if beside[0] - min(beside[1:]) < MIN_SHIFT_M:
        return "the other does not come over"
    return "they crash" if boxes_touch(scene, ego, other) else None


def recorded_scenes(folder, wanted):
    """The scenes of a run with these ids."""
    rows = lambda name: [row for path in sorted(folder.glob(name)) for batch in [ipc.open_file(pa.memory_map(str(path))).read_all()] for row in batched(batch)]
    lanes = {(row["map_id"], row["lane_id"]): row for row in rows("maps-*.arrow")}
    for row in rows("scenes-*.arrow"):
        if row["scene_id"] not in wanted:
            continue
        states = np.array([[track[name] for name in ("x_m", "y_m", "heading_rad", "vx_mps", "vy_mps")] for track in row["tracks"]])
        states = states.transpose(0, 2, 1).astype(float)
        states[~np.array([track["valid"] for track in row["tracks"]])] = np.nan
        own = [lanes[row["map_id"], lane] for lane in row["lane_ids"]] if row["map_id"] else []
        names = [track["track_id"] for track in row["tracks"]]
        sizes = [size(track) for track in row["tracks"]]
        yield row["scene_id"], Scene(row, names, states, sizes, own)


def size(track):
    return (track["length_m"], track["width_m"]) if track["length_m"] else NOMINAL.get(track["class"], (4.6, 1.9))


def batched(table):
    for batch in table.to_batches(max_chunksize=64):
        yield from batch.to_pylist()


def check_run(folder, collision_free):
    events = pq.read_table(folder / "events.parquet").to_pylist()
    events = [event for event in events if event["behavior"] == "cut_in"]
    of_scene = {}
    for event in events:
        of_scene.setdefault(event["scene_id"], []).append(event)
    both = only_djinn = only_here = n_wrong = 0
    for scene_id, scene in recorded_scenes(folder / "scenes", of_scene):
        for event in of_scene[scene_id]:
            ego, other = (scene.idx[event[f"{role}_track_id"]] for role in ("ego", "other"))
            found = cut_in(scene, ego, other)
            if collision_free and not isinstance(found, str) and boxes_touch(scene, ego, other):
                found = "collision"
            theirs = (event["start_timestep"], event["end_timestep"]) if event["label"] == "positive" else None
            n_wrong += bool(theirs) and tell_wrong(scene_id, scene, ego, other, collision_free)
            if theirs and found == theirs:
                both += 1
            elif theirs or not isinstance(found, str):
                only_djinn, only_here = only_djinn + bool(theirs), only_here + (not isinstance(found, str))
                print(f"{scene_id}: {event['other_track_id']} before {event['ego_track_id']}: djinn {theirs or 'none'}, here {found}")
    print(f"recorded: {both} cut-ins agree in {len(events)} pairs; {only_djinn} are found otherwise or only by djinn, {only_here} otherwise or only here")
    print(f"recorded: in {n_wrong} of {both + only_djinn} cut-ins of djinn an engineer sees nobody cut off")
    return both, max(only_djinn, only_here, n_wrong)


def tell_wrong(name, scene, ego, other, collision_free=True):
    """Says why nobody is cut off, if so."""
    why = nobody_cut_off(scene, ego, other)
    if why is None or (why == "they crash" and not collision_free):
        return False
    print(f"{name}: nobody is cut off: {why}")
    return True


def check_corpus(folder):
    part = lambda name: ds.dataset(folder / name if (folder / name).exists() else folder / f"{name}.parquet", format="parquet", partitioning="hive")
    scenarios = [row for row in part("scenarios").to_table().to_pylist() if row["verified"] and row["requested_behavior"] == "cut_in"]
    lanes = {(row["map_id"], row["lane_id"]): row for row in part("lanes").to_table().to_pylist()}
    ids = pa.array([row["scenario_id"] for row in scenarios])
    tracks = {}
    for row in part("tracks").to_table(filter=ds.field("scenario_id").isin(ids)).to_pylist() if scenarios else []:
        tracks.setdefault(row["scenario_id"], {}).setdefault(row["track_id"], []).append(row)
    n_agree = n_wrong = 0
    for row in scenarios:
        own = tracks[row["scenario_id"]]
        states = np.full((len(own), row["n_timesteps"], 5), np.nan)
        for i, rows in enumerate(own.values()):
            for state in rows:
                states[i, state["timestep"]] = [state[name] for name in ("x_m", "y_m", "heading_rad", "vx_mps", "vy_mps")]
        sizes = [size(rows[0]) for rows in own.values()]
        near = [lanes[row["map_id"], lane] for lane in row["lane_ids"]] if row["map_id"] else []
        scene = Scene(row, list(own), states, sizes, near)
        roles = {name: rows[0]["event_role"] for name, rows in own.items()}
        pair = [next((scene.idx[name] for name, role in roles.items() if role == wanted), None) for wanted in ("ego", "other")]
        found = "no such roles" if None in pair else cut_in(scene, *pair)
        theirs = row["event_start_timestep"], row["event_end_timestep"]
        n_agree += found == theirs
        n_wrong += None not in pair and tell_wrong(row["scenario_id"], scene, *pair)
        if found != theirs:
            print(f"{row['scenario_id']}: djinn {theirs}, here {found}")
    print(f"generated: {n_agree} of {len(scenarios)} verified cut-ins agree")
    print(f"generated: in {n_wrong} of {len(scenarios)} an engineer sees nobody cut off")
    return n_agree, max(len(scenarios) - n_agree, n_wrong)


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("folder", type=pathlib.Path, help="a run folder, or a corpus")
    parser.add_argument("--collisions", action="store_true", help="cut-ins may end in a collision: [mine] does not say collision_free")
    arguments = parser.parse_args()
    results = []
    if (arguments.folder / "events.parquet").exists():
        results.append(check_run(arguments.folder, not arguments.collisions))
    corpus = arguments.folder / "corpus" if (arguments.folder / "corpus").exists() else arguments.folder
    if (corpus / "manifest.json").exists():
        results.append(check_corpus(corpus))
    if not results:
        sys.exit(f"{arguments.folder}: neither a run with events.parquet nor a corpus with manifest.json")
    if any(n_differ > 0.01 * (n_agree + n_differ) for n_agree, n_differ in results):
        sys.exit("the two definitions disagree on more than 1 % of the cut-ins")


if __name__ == "__main__":
    main()
