"""Samples of the same scene over each other, by place and model.

    pip install matplotlib numpy pillow pyarrow
    python scripts/draw_samples.py before=output/before/main:raw after=output/after/main:raw --out samples.png

A column for each LABEL=RUN:SWEEP, a row for each place: of the scenes that all of them continue, the first by name. Pasts are
black, recorded futures dashed; samples have a color for each agent, and a dot where they end. All runs must have ingested the
same recordings.
"""

import argparse
import io
import pathlib

import matplotlib
import numpy as np
import pyarrow as pa
import pyarrow.ipc as ipc
import pyarrow.parquet as pq
from draw_behaviors import lanes_in_scene

matplotlib.use("Agg")
import matplotlib.pyplot as plt
from PIL import Image

MARGIN_M, LEAST_M, MOST_BYTES = 8.0, 14.0, 200_000
WIDTH_IN, TITLE_IN = 3.2, 0.25
COLUMNS = ["sweep", "place", "scene_id", "tracks", "n_history"]


def path(track, steps=slice(None)):
    """Positions (N, 2) of a track in some timesteps, NaN where there is none."""
    positions = np.stack([track["x_m"], track["y_m"]], -1).astype(float)
    positions[~np.array(track["valid"])] = np.nan
    return positions[steps]


def sampled(run, sweep):
    """The samples of a sweep by place and scene."""
    found = {}
    for shard in sorted((run / "samples").glob("samples-*.parquet")):
        for row in pq.read_table(shard, columns=COLUMNS).to_pylist():
            if row["sweep"] == sweep:
                found.setdefault((row["place"], row["scene_id"]), []).append(row)
    return found


def recorded(run, scenes):
    """The recorded scenes of these names, with their lanes."""
    lanes, found = {}, {}
    for shard in sorted(run.glob("scenes/maps-*.arrow")):
        for row in ipc.open_file(pa.memory_map(str(shard))).read_all().to_pylist():
            lanes[row["map_id"], row["lane_id"]] = row
    for shard in sorted(run.glob("scenes/scenes-*.arrow")):
        table = ipc.open_file(pa.memory_map(str(shard))).read_all()
        for i in np.flatnonzero([scene in scenes for scene in table["scene_id"].to_pylist()]):
            row = table.slice(i, 1).to_pylist()[0]
            own = [lanes[row["map_id"], lane] for lane in row["lane_ids"]] if row["map_id"] else []
            found[row["scene_id"]] = {**row, "lanes": lanes_in_scene(own, row["world_from_scene"])}
    return found


def window(scene):
    """Center and half extents of what is drawn: where agents are recorded."""
    seen = np.concatenate([path(track) for track in scene["tracks"]])
    seen = seen[~np.isnan(seen).any(1)]
    half = np.maximum((seen.max(0) - seen.min(0)) / 2 + MARGIN_M, LEAST_M)
    return (seen.min(0) + seen.max(0)) / 2, half


def draw(axes, scene, samples):
    n_history = scene["n_history"]
    for lane in scene["lanes"]:
        for side in ("left", "right"):
            axes.plot(*lane[side].T, color="0.75", lw=0.6, zorder=0)
    for track in scene["tracks"]:
        axes.plot(*path(track, slice(n_history)).T, color="black", lw=1.4, zorder=3)
        axes.plot(*path(track, slice(n_history - 1, None)).T, color="black", lw=0.7, ls=(0, (3, 2)), zorder=4)
    for sample in samples:
        for i, track in enumerate(sample["tracks"]):
            future = path(track, slice(n_history - 1, None))
            axes.plot(*future.T, color=f"C{i % 10}", lw=0.9, alpha=0.75, zorder=2)
            axes.plot(*future[-1], ".", color=f"C{i % 10}", ms=3, zorder=2)
    middle, half = window(scene)
    axes.set(xlim=(middle[0] - half[0], middle[0] + half[0]), ylim=(middle[1] - half[1], middle[1] + half[1]), aspect="equal", xticks=[], yticks=[])


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("columns", nargs="+", metavar="LABEL=RUN:SWEEP")
    parser.add_argument("--out", type=pathlib.Path, required=True, metavar="PNG")
    arguments = parser.parse_args()
    columns = {}
    for column in arguments.columns:
        label, _, rest = column.partition("=")
        run, _, sweep = rest.rpartition(":")
        columns[label] = (pathlib.Path(run), sampled(pathlib.Path(run), sweep))
    common = sorted(set.intersection(*(set(samples) for _, samples in columns.values())))
    if not common:
        parser.error("no scene is continued by all of them")
    by_place = {place: scene for place, scene in reversed(common)}
    scenes = recorded(next(iter(columns.values()))[0], set(by_place.values()))
    halves = [window(scenes[scene])[1] for _, scene in sorted(by_place.items())]
    heights = [WIDTH_IN * y / x + TITLE_IN for x, y in halves]
    figure, panels = plt.subplots(
        len(by_place), len(columns), figsize=(WIDTH_IN * len(columns), sum(heights)), height_ratios=heights, squeeze=False
    )
    for row, (place, scene) in zip(panels, sorted(by_place.items())):
        for axes, (label, (_, samples)) in zip(row, columns.items()):
            draw(axes, scenes[scene], samples[place, scene])
            axes.set_title(f"{place}: {label}", fontsize=8)
        print(place, scene)
    figure.tight_layout(pad=0.4)
    drawn = io.BytesIO()
    figure.savefig(drawn, dpi=110)
    image = Image.open(drawn).convert("RGB").quantize(128)
    image.save(arguments.out, optimize=True)
    if arguments.out.stat().st_size > MOST_BYTES:
        print(f"{arguments.out} has {arguments.out.stat().st_size:,} bytes")


if __name__ == "__main__":
    main()
