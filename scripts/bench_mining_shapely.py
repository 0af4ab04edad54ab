"""Cut-ins in scenes with shapely or numpy: what a user would write instead of `djinn mine`, and what the benchmark compares with.

    pip install numpy pyarrow shapely
    python scripts/bench_mining_shapely.py RUN_FOLDER --style pairs --n-scenes 50 --seed 1

Takes a random subset of the scenes of a run folder, finds the cut-ins of the DJINN paper (the box of `other` at a future t_other
overlaps the box of `ego` at a future t_ego less than 3 s later, unless other's present box overlaps any of the ego's), and
compares them with the folder's events.parquet: it fails unless scenes, agents and both times are the same. With `--negatives`
also the hard negatives: all other ordered pairs that come closer than 5 m, at any two timesteps. Styles:

- pairs: every ordered pair of agents, every pair of timesteps, boxes as shapely polygons, all in one vectorized call a scene;
- numpy: the same pairs by a separating-axis test on arrays;
- tree: the polygons of a scene in one STRtree, which is asked once for all that overlap.

Ends by printing what the search took, without reading scenes and loading libraries, as JSON.
"""

import argparse
import json
import pathlib

import numpy as np
import pyarrow.parquet as pq
import shapely
from bench_common import Work
from bench_scenes import MOTORIZED, NOMINAL_EXTENT_M, read_scenes

MAX_DELAY = 29  # timesteps of 0.1 s: strictly less than 3 s
NEAR_M = 5.0


class Boxes:
    """The boxes of a scene's motorized agents that are there at present: arrays (N, T), corners (N, T, 4, 2)."""

    def __init__(self, scene):
        self.present = scene.n_history - 1
        kept = [i for i, name in enumerate(scene.classes) if name in MOTORIZED and scene.valid[i, self.present]]
        self.tracks = [scene.tracks[i] for i in kept]
        nominal = np.array([NOMINAL_EXTENT_M[scene.classes[i]] for i in kept]).reshape(-1, 2)
        size = np.where(np.isnan(scene.size[kept]).any(1, keepdims=True), nominal, scene.size[kept])
        self.half = size[:, None] / 2
        self.center, self.valid = scene.states[kept][..., :2], scene.valid[kept]
        heading = scene.states[kept][..., 2]
        self.forward = np.stack([np.cos(heading), np.sin(heading)], -1)

    def corners(self):
        along = self.forward * self.half[..., :1]
        across = np.stack([-self.forward[..., 1], self.forward[..., 0]], -1) * self.half[..., 1:]
        center = self.center
        return np.stack([center + along + across, center - along + across, center - along - across, center + along - across], -2)

    def polygons(self):
        polygons = shapely.polygons(self.corners())
        polygons[~self.valid] = None
        return polygons


class Search:
    """Pairs of agents and of timesteps, all of them, and what follows from whether their boxes meet."""

    def __init__(self, boxes):
        n, n_timesteps = boxes.valid.shape
        self.boxes = boxes
        self.ego, self.other = (index.ravel() for index in np.nonzero(~np.eye(n, dtype=bool)))
        future = np.arange(boxes.present + 1, n_timesteps)
        t_other, t_ego = (index.ravel() for index in np.meshgrid(future, future, indexing="ij"))
        delay = t_ego - t_other
        later = (delay > 0) & (delay <= MAX_DELAY)
        self.t_other, self.t_ego = t_other[later], t_ego[later]  # by t_other, then by t_ego

    def meet(self, a, t, b, u):
        raise NotImplementedError

    def near(self, a, b):
        """Whether the boxes of agents a and b come within NEAR_M, at any two timesteps."""
        raise NotImplementedError

    def cut_ins(self):
        if len(self.t_other) == 0 or len(self.ego) == 0:
            return {}
        ego, other = self.ego[:, None], self.other[:, None]
        hits = self.meet(ego, self.t_ego, other, self.t_other)
        found = np.flatnonzero(hits.any(1))
        all_timesteps = np.arange(self.boxes.valid.shape[1])
        follows = self.meet(ego[found], all_timesteps, other[found], self.boxes.present).any(1)
        found = found[~follows]
        first = hits[found].argmax(1)
        pairs = zip(self.ego[found], self.other[found])
        return dict(zip(pairs, zip(self.t_other[first], self.t_ego[first])))

    def negatives(self, cut_ins):
        if len(self.t_other) == 0 or len(self.ego) == 0:
            return []
        once = self.ego < self.other
        a, b = self.ego[once], self.other[once]
        near = self.near(a, b)
        pairs = [pair for a, b in zip(a[near], b[near]) for pair in ((a, b), (b, a))]
        return [pair for pair in pairs if pair not in cut_ins]


class ShapelyPairs(Search):
    def __init__(self, boxes):
        super().__init__(boxes)
        self.polygons = boxes.polygons()

    def meet(self, a, t, b, u):
        return shapely.intersects(self.polygons[a, t], self.polygons[b, u])

    def near(self, a, b):
        return np.array([shapely.dwithin(self.polygons[i][:, None], self.polygons[j], NEAR_M).any() for i, j in zip(a, b)], bool)


class NumpyPairs(Search):
    def meet(self, a, t, b, u):
        x = self.boxes
        fa, fb = x.forward[a, t], x.forward[b, u]
        cos, sin = np.abs((fa * fb).sum(-1)), np.abs(fa[..., 0] * fb[..., 1] - fa[..., 1] * fb[..., 0])
        between = x.center[b, u] - x.center[a, t]
        (la, wa), (lb, wb) = (x.half[a, 0].T if np.ndim(a) == 0 else np.moveaxis(x.half[i, 0], -1, 0) for i in (a, b))
        hit = x.valid[a, t] & x.valid[b, u]
        for f, length, width, l, w in ((fa, la, wa, lb, wb), (fb, lb, wb, la, wa)):
            hit &= np.abs((between * f).sum(-1)) <= length + l * cos + w * sin
            hit &= np.abs(f[..., 0] * between[..., 1] - f[..., 1] * between[..., 0]) <= width + l * sin + w * cos
        return hit

    def near(self, a, b):
        x, corners = self.boxes, self.boxes.corners()
        t = np.arange(x.valid.shape[1])
        found = np.zeros(len(a), bool)
        for k, (i, j) in enumerate(zip(a, b)):
            both = x.valid[i][:, None] & x.valid[j]
            if self.meet(i, t[:, None], j, t).any():
                found[k] = True
                continue
            # Two disjoint rectangles are closest at a corner of one of them.
            for p, q in ((i, j), (j, i)):
                offset = corners[q][None] - x.center[p][:, None, None]
                f = x.forward[p][:, None, None]
                along = np.abs((offset * f).sum(-1)) - x.half[p, 0, 0]
                across = np.abs(f[..., 0] * offset[..., 1] - f[..., 1] * offset[..., 0]) - x.half[p, 0, 1]
                square = (np.maximum(along, 0) ** 2 + np.maximum(across, 0) ** 2).min(-1)
                found[k] |= ((square < NEAR_M**2) & (both if p == i else both.T)).any()
        return found


class ShapelyTree(Search):
    """Overlaps come from one query of a tree, and are looked up."""

    def __init__(self, boxes):
        super().__init__(boxes)
        polygons = boxes.polygons()
        self.shape = polygons.shape
        self.flat = polygons.ravel()
        self.tree = shapely.STRtree(self.flat)

    def pairs(self, **how):
        first, second = self.tree.query(self.flat, **how)
        (a, t), (b, u) = (np.divmod(index, self.shape[1]) for index in (first, second))
        apart = a != b
        return a[apart], t[apart], b[apart], u[apart]

    def cut_ins(self):
        ego, t_ego, other, t_other = self.pairs(predicate="intersects")
        present = self.boxes.present
        follows = np.zeros((self.shape[0], self.shape[0]), bool)
        at_present = t_other == present
        follows[ego[at_present], other[at_present]] = True
        delay = t_ego - t_other
        hit = (t_other > present) & (delay > 0) & (delay <= MAX_DELAY) & ~follows[ego, other]
        order = np.lexsort((t_ego[hit], t_other[hit]))
        found = {}
        for i, j, t, u in zip(ego[hit][order], other[hit][order], t_other[hit][order], t_ego[hit][order]):
            found.setdefault((i, j), (t, u))
        return found

    def negatives(self, cut_ins):
        if len(self.t_other) == 0:
            return []
        a, _, b, _ = self.pairs(predicate="dwithin", distance=NEAR_M)
        near = np.unique(np.stack([a, b], -1), axis=0) if len(a) else np.zeros((0, 2), int)
        return [pair for pair in map(tuple, near) if pair not in cut_ins]


STYLES = {"pairs": ShapelyPairs, "numpy": NumpyPairs, "tree": ShapelyTree}


def search(scenes, style, with_negatives):
    """Cut-ins as (scene, ego, other, t_other, t_ego), and negatives as (scene, ego, other)."""
    positives, negatives = set(), set()
    for scene in scenes:
        boxes = Boxes(scene)
        found = STYLES[style](boxes)
        cut_ins = found.cut_ins()
        name = boxes.tracks
        positives.update((scene.id, name[i], name[j], int(t), int(u)) for (i, j), (t, u) in cut_ins.items())
        if with_negatives:
            negatives.update((scene.id, name[i], name[j]) for i, j in found.negatives(cut_ins))
    return positives, negatives


def found_by_djinn(path, ids):
    columns = ["scene_id", "label", "ego_track_id", "other_track_id", "start_timestep", "end_timestep"]
    rows = [row for row in zip(*pq.read_table(path, columns=columns).to_pydict().values()) if row[0] in ids]
    positives = {(scene, ego, other, t, u) for scene, label, ego, other, t, u in rows if label == "positive"}
    return positives, {(scene, ego, other) for scene, label, ego, other, _, _ in rows if label == "negative"}


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("run", type=pathlib.Path)
    parser.add_argument("--style", choices=STYLES, default="pairs")
    parser.add_argument("--n-scenes", type=int, default=50)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--negatives", action="store_true")
    arguments = parser.parse_args()
    n_all = json.loads((arguments.run / "scenes" / "manifest.json").read_text())["n_scenes"]
    n = min(arguments.n_scenes, n_all)
    chosen = set(np.random.default_rng(arguments.seed).permutation(n_all)[:n].tolist())
    scenes = [scene for i, scene in enumerate(read_scenes(arguments.run / "scenes")) if i in chosen]

    work = Work()
    positives, negatives = search(scenes, arguments.style, arguments.negatives)
    used = work.used()

    ids = {scene.id for scene in scenes}
    theirs, their_negatives = found_by_djinn(arguments.run / "events.parquet", ids)
    assert positives == theirs, f"cut-ins differ, such as {sorted(positives ^ theirs)[:3]}"
    if arguments.negatives:
        different = negatives ^ their_negatives
        assert not different, f"negatives differ, such as {sorted(different)[:3]}"
    n_agents = sum(len(scene.tracks) for scene in scenes) / len(scenes)
    found = {"n_scenes": len(scenes), "n_agents": n_agents, "n_cut_ins": len(positives), "n_negatives": len(negatives)}
    print(json.dumps(used | found))


if __name__ == "__main__":
    main()
