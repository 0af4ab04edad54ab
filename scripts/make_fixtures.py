#!/usr/bin/env python3
"""Makes the fixture recordings in tests/fixtures/recordings: small, simulated, in the datasets' own formats.

    pip install eclipse-sumo==1.28.0 numpy pyarrow
    python scripts/make_fixtures.py [--out FOLDER]

SUMO simulates a merging highway and a four-way intersection without signals; nothing is taken from any recorded dataset.
The same versions and the same seed give the same bytes.
"""

import argparse
import pathlib
import shutil
import tempfile

from fixtures import argoverse1, argoverse2, interaction, lanelet2, lanes, traffic, womd

SEED = 20
N_CASES = {"train": 120, "val": 30, "test": 5}
RECORDING_S = 60.0


def merging(out, scratch):
    """INTERACTION v1.2: one archive with train, val and test cases of the merging highway, and its map."""
    net = traffic.highway_net(scratch)
    road = lanes.lanes_of(net)
    cases = {}
    for i, (split, n_cases) in enumerate(N_CASES.items()):
        tracks = traffic.simulate_highway(net, scratch, duration_s=4.0 * n_cases, seed=SEED + i)
        cases[split] = interaction.cases(tracks, n_cases)
    files = {f"maps/FIX_Merging.{kind}": text for kind, text in lanelet2.documents(road, speed_kmh=50).items()}
    files["train/FIX_Merging_train.csv"] = interaction.v1_2(cases["train"])
    files["val/FIX_Merging_val.csv"] = interaction.v1_2(cases["val"])
    files["test_multi-agent/FIX_Merging_obs.csv"] = interaction.v1_2_test(cases["test"], seed=SEED)
    interaction.write_zip(out / "interaction" / "FIX-multi-v1_2.zip", "FIX-multi-v1_2", files)


def intersection(out, scratch):
    """INTERACTION v1.1, Argoverse 1 and 2, Waymo Open Motion: parts of one simulation of the intersection."""
    net = traffic.intersection_net(scratch)
    road = lanes.lanes_of(net)
    crossings = lanes.crossings_of(net)
    tracks = traffic.simulate_intersection(net, scratch, duration_s=RECORDING_S + 60.0, seed=SEED)

    folder = out / "interaction_v1_1"
    for kind, text in lanelet2.documents(road, speed_kmh=50, crossings=crossings).items():
        write(folder / "maps" / f"FIX_Intersection.{kind}", text)
    recording = folder / "recorded_trackfiles" / "FIX_Intersection"
    vehicles, pedestrians = interaction.v1_1([track.window(0, int(RECORDING_S * 10)) for track in tracks])
    write(recording / "vehicle_tracks_000.csv", vehicles)
    write(recording / "pedestrian_tracks_000.csv", pedestrians)

    folder = out / "argoverse1"
    write(folder / "map_files" / "pruned_argoverse_MIA_10316_vector_map.xml", argoverse1.vector_map(road))
    for split, first_frames in {"train": range(0, 600, 100), "val": range(700, 900, 100)}.items():
        for i, first in enumerate(first_frames):
            text = argoverse1.forecasting_csv([track.window(first, first + 50) for track in tracks], seed=first)
            write(folder / split / "data" / f"{i + 1}.csv", text)

    argoverse2.write(out / "argoverse2", [track.window(620, 730) for track in tracks], road, crossings)

    sets = {"training": (range(0, 300, 150), 91, ".gz"), "validation": ([700], 91, ""), "testing": ([850], 11, "")}
    for name, (first_frames, n_steps, suffix) in sets.items():
        windows = [(first, [track.window(first, first + 91) for track in tracks]) for first in first_frames]
        records = [womd.of_window(f"f1d{first:013x}", window, road, crossings, n_steps) for first, window in windows]
        womd.write_records(out / "womd" / name / f"{name}.tfrecord-00000-of-00001{suffix}", records)


def write(path, text):
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_bytes(text.encode())


def main():
    here = pathlib.Path(__file__).resolve().parent
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    default = here.parent / "tests" / "fixtures" / "recordings"
    parser.add_argument("--out", type=pathlib.Path, default=default, help="where to write (default: %(default)s)")
    out = parser.parse_args().out
    for folder in ("interaction", "interaction_v1_1", "argoverse1", "argoverse2", "womd"):
        shutil.rmtree(out / folder, ignore_errors=True)
    with tempfile.TemporaryDirectory() as scratch:
        merging(out, pathlib.Path(scratch))
        intersection(out, pathlib.Path(scratch))
    files = sorted(path for path in out.rglob("*") if path.is_file())
    for path in files:
        print(f"{path.stat().st_size:>9} {path.relative_to(out)}")
    print(f"{sum(path.stat().st_size for path in files):>9} bytes in all")


if __name__ == "__main__":
    main()
