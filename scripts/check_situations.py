#!/usr/bin/env python3
"""Can situations that nobody recorded be told from recorded ones?

    python scripts/check_situations.py output/NAME/main [--seed N]

Trains gradient boosting (scikit-learn) on road users at the present: position, speed, offset and heading to the nearest
lane, gaps and relative speeds ahead and behind, distance to the nearest road user, changes of speed, and the number of
others around. The recorded scenes are those of the splits and places in which loops began, and weigh as much at each
place as the others do. Folds never divide a recorded scene from the loops that go on from it. Prints the area under the
ROC curve for road users, and for scenes by the mean score of their road users, of continued and of populated situations;
then of each place, and of each feature alone, the most telling ones first. Needs numpy, pyarrow and scikit-learn.
"""

import argparse
import collections
import pathlib

import numpy as np
import pyarrow.ipc as ipc
from sklearn.ensemble import HistGradientBoostingClassifier
from sklearn.metrics import roc_auc_score
from sklearn.model_selection import GroupKFold

# The columns of each feature.
FEATURES = {
    "position": [0, 1],
    "speed": [2],
    "offset to the lane": [3],
    "heading to the lane": [4],
    "speed across the lane": [5],
    "gap ahead": [6],
    "speed of the one ahead": [7],
    "gap behind": [8],
    "speed of the one behind": [9],
    "nearest road user": [10],
    "others within 40 m": [11],
    "speed gained in .5 s": [12],
}
Seen = collections.namedtuple("Seen", "name place split found")


def rows(folder, prefix):
    for path in sorted(folder.glob(f"{prefix}-*.arrow")):
        yield from ipc.open_file(path).read_all().to_pylist()


def lanes_of(folder):
    lanes = collections.defaultdict(list)
    for row in rows(folder, "maps"):
        line = np.column_stack([row["centerline_x_m"], row["centerline_y_m"]])
        points = np.concatenate([a + (b - a) * np.linspace(0, 1, 5)[:-1, None] for a, b in zip(line, line[1:])])
        steps = np.diff(np.vstack([points, line[-1:]]), axis=0)
        lanes[row["map_id"]].append(np.column_stack([points, np.arctan2(steps[:, 1], steps[:, 0])]))
    return {name: np.concatenate(of_map) for name, of_map in lanes.items()}


def wrapped(angle):
    return (angle + np.pi) % (2 * np.pi) - np.pi


def features(scene, lanes):
    now = scene["n_history"] - 1
    before = max(0, now - 5)
    frame = scene["world_from_scene"]
    turn = frame["rotation_rad"]
    rotation = np.array([[np.cos(turn), -np.sin(turn)], [np.sin(turn), np.cos(turn)]])
    tracks = [track for track in scene["tracks"] if track["valid"][now] and track["role"] != "parked"]
    at = np.array([[track["x_m"][now], track["y_m"][now]] for track in tracks]) @ rotation.T
    at = at + [frame["x_m"], frame["y_m"]]
    heading = np.array([track["heading_rad"][now] for track in tracks]) + turn
    velocity = np.array([[track["vx_mps"][now], track["vy_mps"][now]] for track in tracks]) @ rotation.T
    speed = np.linalg.norm(velocity, axis=1)
    half = np.array([(track["length_m"] or 0.75) / 2 for track in tracks])
    found = []
    for i, track in enumerate(tracks):
        row = [at[i, 0], at[i, 1], speed[i]]
        if lanes is None:
            row += [0.0] * 3
        else:
            away = np.linalg.norm(lanes[:, :2] - at[i], axis=1)
            near = lanes[np.argmin(away + 3 * np.abs(wrapped(lanes[:, 2] - heading[i])))]
            across = np.array([-np.sin(near[2]), np.cos(near[2])])
            row += [across @ (at[i] - near[:2]), wrapped(heading[i] - near[2]), across @ velocity[i]]
        along = np.array([np.cos(heading[i]), np.sin(heading[i])])
        others = np.delete(np.arange(len(tracks)), i)
        ahead = (at[others] - at[i]) @ along
        aside = np.abs((at[others] - at[i]) @ [-along[1], along[0]])
        for is_there in ((ahead > 0) & (aside < 2), (ahead < 0) & (aside < 2)):
            there = others[is_there]
            gaps = np.abs(ahead[is_there]) - half[i] - half[there]
            nearest = np.argmin(gaps) if len(gaps) else None
            row += [np.nan, np.nan] if nearest is None else [gaps[nearest], speed[there[nearest]] - speed[i]]
        distances = np.linalg.norm(at[others] - at[i], axis=1)
        row += [distances.min(initial=200), (distances < 40).sum()]
        was = np.hypot(track["vx_mps"][before], track["vy_mps"][before]) if track["valid"][before] else np.nan
        found.append(row + [speed[i] - was])
    return np.array(found)


def scores(x, label, groups, weight, seed, n_trees=100):
    found = np.zeros(len(label))
    for train, test in GroupKFold(5, shuffle=True, random_state=seed).split(x, label, groups):
        model = HistGradientBoostingClassifier(max_iter=n_trees, random_state=seed)
        found[test] = model.fit(x[train], label[train], weight[train]).decision_function(x[test])
    return found


def report(kind, recorded, made, seed):
    """Prints how well scenes that were made are told from recorded ones."""
    both = recorded + made
    of_scene = np.array([0] * len(recorded) + [1] * len(made))
    number = np.repeat(np.arange(len(both)), [len(scene.found) for scene in both])
    label, x = of_scene[number], np.vstack([scene.found for scene in both])
    groups = np.array([scene.name for scene in both])[number]
    places = np.array([scene.place for scene in both])
    # Both kinds weigh as much, at each place.
    share = collections.Counter(zip(places[number], label))
    at_place = collections.Counter(places[number][label == 1])
    weight = np.array([at_place[place] / share[place, one] for place, one in zip(places[number], label)])
    score = scores(x, label, groups, weight, seed)
    mean = np.bincount(number, score) / np.bincount(number)
    users, scenes = roc_auc_score(label, score, sample_weight=weight), roc_auc_score(of_scene, mean)
    print(f"{kind}: {len(made)} scenes of {len({scene.name for scene in made})} recorded ones;", end=" ")
    print(f"road users {users:.3f}, scenes {scenes:.3f}")
    for place in sorted(set(places)):
        own, at = places[number] == place, places == place
        users, scenes = roc_auc_score(label[own], score[own]), roc_auc_score(of_scene[at], mean[at])
        print(f"    {place}: {(of_scene[at] == 1).sum()} scenes; road users {users:.3f}, scenes {scenes:.3f}")
    alone = {}
    for name, columns in FEATURES.items():
        one = scores(x[:, columns], label, groups, weight, seed, n_trees=30)
        alone[name] = roc_auc_score(label, one, sample_weight=weight)
    for name, users in sorted(alone.items(), key=lambda item: -item[1]):
        print(f"    {name} alone: road users {users:.3f}")


def main():
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("run", type=pathlib.Path)
    parser.add_argument("--seed", type=int, default=0)
    arguments = parser.parse_args()
    lanes = lanes_of(arguments.run / "scenes")
    by_kind = collections.defaultdict(list)
    for folder in ("scenes", "situations"):
        for row in rows(arguments.run / folder, "scenes"):
            found = features(row, lanes.get(row["map_id"]))
            scene = Seen(row["continues"] or row["scene_id"], row["place"], row["split"], found)
            by_kind[row["situation"]].append(scene)
    recorded = by_kind.pop("recorded")
    for kind, made in sorted(by_kind.items()):
        where = {(scene.place, scene.split) for scene in made}
        report(kind, [scene for scene in recorded if (scene.place, scene.split) in where], made, arguments.seed)


if __name__ == "__main__":
    main()
