#!/usr/bin/env python3
"""Can situations that nobody recorded be told from recorded ones?

    python scripts/check_situations.py output/NAME/main [--seed N]

Trains gradient boosting (scikit-learn) on road users at the present: position, speed, offset and heading to the nearest
lane, gaps and relative speeds ahead and behind, distance to the nearest road user, changes of speed, and the number of
others around. Folds never divide a recorded scene from the loops that go on from it. Prints the area under the ROC
curve for road users, and for scenes by the mean score of their road users, of continued and of populated situations.
Needs numpy, pyarrow and scikit-learn.
"""

import argparse
import collections
import pathlib

import numpy as np
import pyarrow.ipc as ipc
from sklearn.ensemble import HistGradientBoostingClassifier
from sklearn.metrics import roc_auc_score
from sklearn.model_selection import GroupKFold


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
        if lanes is not None:
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


def main():
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("run", type=pathlib.Path)
    parser.add_argument("--seed", type=int, default=0)
    arguments = parser.parse_args()
    lanes = lanes_of(arguments.run / "scenes")
    by_kind = collections.defaultdict(list)
    for folder in ("scenes", "situations"):
        for scene in rows(arguments.run / folder, "scenes"):
            found = features(scene, lanes.get(scene["map_id"]))
            by_kind[scene["situation"]].append((scene["continues"] or scene["scene_id"], found))
    recorded = by_kind.pop("recorded")
    for kind, scenes in sorted(by_kind.items()):
        both = recorded + scenes
        label = np.repeat([0] * len(recorded) + [1] * len(scenes), [len(found) for _, found in both])
        number = np.repeat(np.arange(len(both)), [len(found) for _, found in both])
        groups = np.array([name for name, _ in both])[number]
        x, score = np.vstack([found for _, found in both]), np.zeros(len(label))
        for train, test in GroupKFold(5, shuffle=True, random_state=arguments.seed).split(x, label, groups):
            model = HistGradientBoostingClassifier(random_state=arguments.seed, class_weight="balanced")
            score[test] = model.fit(x[train], label[train]).decision_function(x[test])
        of_scene = np.bincount(number, score) / np.bincount(number)
        truth = [0] * len(recorded) + [1] * len(scenes)
        print(
            f"{kind}: {len(scenes)} scenes of {len({name for name, _ in scenes})} recorded ones; road users "
            f"{roc_auc_score(label, score):.3f}, scenes {roc_auc_score(truth, of_scene):.3f}"
        )


if __name__ == "__main__":
    main()
