"""By how much do the sweeps of a run differ from one of them, and how sure is that?

    pip install polars numpy
    python scripts/compare_sweeps.py output/few_evaluations_small/main --with heun_50

Prints a Markdown table: for each unguided sweep of the same scenes its means over them, and the relative difference to the
reference with the middle 95 % of 10,000 draws of scenes with replacement (paired bootstrap, fixed seed). The last column is how
far agents end from where they end in the reference's sample of the same number, meters: near 0 where noise becomes the same sample.
"""

import argparse
import pathlib

import numpy as np
import polars as pl

DIFFERENCES = ("min_scene_ade_m", "mfd_m")
RATES = ("collision_rate", "offroad_rate", "jerk_violation_rate", "validity_rate")
N_DRAWS = 10_000


def by_scene(rows, metric):
    """A metric of each scene: of all its samples together where it is one of theirs, else the mean of what each sample has."""
    rows = rows.filter(pl.col("metric") == metric, pl.col("scene_id").is_not_null())
    together = rows.filter(pl.col("scenario_id").is_null())
    return (together if together.height else rows).group_by("scene_id").agg(pl.col("value").mean())


def difference(ours, theirs, metric):
    ours, theirs = by_scene(ours, metric), by_scene(theirs, metric)
    both = ours.join(theirs, on="scene_id", suffix="_reference").drop_nans().sort("scene_id")
    a, b = both["value"].to_numpy(), both["value_reference"].to_numpy()
    drawn = np.random.default_rng(0).integers(0, len(a), (N_DRAWS, len(a)))
    low, high = np.quantile(a[drawn].mean(1) / b[drawn].mean(1) - 1, (0.025, 0.975))
    return f"{a.mean():.3f} ({a.mean() / b.mean() - 1:+.1%}, {low:+.1%} to {high:+.1%}; {len(a)} scenes)"


def endings(run, sweeps):
    """Last positions (N, 2) of the agents of each sample, by sweep, scene and number."""
    columns = ["sweep", "scene_id", "sample_idx", "tracks"]
    found = {}
    for path in sorted((run / "samples").glob("samples-*.parquet")):
        samples = pl.read_parquet(path, columns=columns).filter(pl.col("sweep").is_in(sweeps))
        for row in samples.iter_rows(named=True):
            last = [(track["x_m"][-1], track["y_m"][-1]) for track in row["tracks"] if track["valid"][-1]]
            found[row["sweep"], row["scene_id"], row["sample_idx"]] = np.reshape(last, (-1, 2))
    return found


def distance_m(endings, sweep, reference):
    pairs = ((ours, endings.get((reference, *rest))) for (name, *rest), ours in endings.items() if name == sweep)
    distances = [np.linalg.norm(a - b, axis=1).mean() for a, b in pairs if b is not None and a.shape == b.shape and len(a)]
    return np.mean(distances)


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("run", type=pathlib.Path, help="folder of a run that was evaluated")
    parser.add_argument("--with", dest="reference", required=True, metavar="SWEEP")
    arguments = parser.parse_args()
    metrics = pl.read_parquet(arguments.run / "metrics.parquet").filter(pl.col("series") == "unguided")
    sweeps = {sweep: rows for (sweep,), rows in metrics.group_by("sweep", maintain_order=True)}
    if arguments.reference not in sweeps:
        parser.error(f"no sweep {arguments.reference!r} without guidance in {arguments.run}; there are {', '.join(sweeps)}")
    scenes = {sweep: set(by_scene(rows, DIFFERENCES[0])["scene_id"]) for sweep, rows in sweeps.items()}
    # Sweeps that ask for a behavior choose scenes of their own.
    sweeps = {sweep: rows for sweep, rows in sweeps.items() if scenes[sweep] == scenes[arguments.reference]}
    last = endings(arguments.run, list(sweeps))
    header = ["sweep", *DIFFERENCES, *RATES, "from the reference (m)"]
    print("| " + " | ".join(header) + " |\n" + "|---" * len(header) + "|")
    for sweep, rows in sweeps.items():
        cells = [difference(rows, sweeps[arguments.reference], metric) for metric in DIFFERENCES]
        cells += [f"{by_scene(rows, metric)['value'].mean():.1%}" for metric in RATES]
        cells.append(f"{distance_m(last, sweep, arguments.reference):.2f}")
        print("| " + " | ".join([sweep, *cells]) + " |")


if __name__ == "__main__":
    main()
