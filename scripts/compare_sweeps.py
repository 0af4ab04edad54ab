"""By how much do the sweeps of a run differ from one of them, and how sure is that?

    pip install polars numpy
    python scripts/compare_sweeps.py output/few_evaluations_small/main --with heun_50

Prints a Markdown table: for each unguided sweep of the same scenes its means over them, and the relative difference to the
reference with the middle 95 % of 10,000 draws of scenes with replacement (paired bootstrap, fixed seed).
"""

import argparse
import pathlib

import numpy as np
import polars as pl

DIFFERENCES = ("min_scene_ade_m", "mfd_m")
RATES = ("collision_rate", "offroad_rate", "jerk_violation_rate", "validity_rate")
N_DRAWS = 10_000


def by_scene(metrics, sweep, metric):
    """A metric of each scene: of all its samples together where it is one of theirs, else the mean of what each sample has."""
    rows = metrics.filter(pl.col("sweep") == sweep, pl.col("metric") == metric, pl.col("scene_id").is_not_null())
    together = rows.filter(pl.col("scenario_id").is_null())
    return (together if together.height else rows).group_by("scene_id").agg(pl.col("value").mean())


def difference(metrics, sweep, reference, metric):
    ours, theirs = (by_scene(metrics, name, metric) for name in (sweep, reference))
    both = ours.join(theirs, on="scene_id", suffix="_reference").drop_nans().sort("scene_id")
    a, b = both["value"].to_numpy(), both["value_reference"].to_numpy()
    drawn = np.random.default_rng(0).integers(0, len(a), (N_DRAWS, len(a)))
    low, high = np.quantile(a[drawn].mean(1) / b[drawn].mean(1) - 1, (0.025, 0.975))
    return f"{a.mean():.3f} ({a.mean() / b.mean() - 1:+.1%}, {low:+.1%} to {high:+.1%}; {len(a)} scenes)"


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("run", type=pathlib.Path, help="folder of a run that was evaluated")
    parser.add_argument("--with", dest="reference", required=True, metavar="SWEEP")
    arguments = parser.parse_args()
    metrics = pl.read_parquet(arguments.run / "metrics.parquet").filter(pl.col("series") == "unguided")
    sweeps = metrics["sweep"].unique(maintain_order=True).to_list()
    if arguments.reference not in sweeps:
        parser.error(f"no sweep {arguments.reference!r} without guidance in {arguments.run}; there are {', '.join(sweeps)}")
    scenes = {sweep: set(by_scene(metrics, sweep, DIFFERENCES[0])["scene_id"]) for sweep in sweeps}
    # Sweeps that ask for a behavior choose scenes of their own.
    sweeps = [sweep for sweep in sweeps if scenes[sweep] == scenes[arguments.reference]]
    header = ["sweep", *DIFFERENCES, *RATES]
    print("| " + " | ".join(header) + " |\n" + "|---" * len(header) + "|")
    for sweep in sweeps:
        cells = [difference(metrics, sweep, arguments.reference, metric) for metric in DIFFERENCES]
        cells += [f"{by_scene(metrics, sweep, metric)['value'].mean():.1%}" for metric in RATES]
        print("| " + " | ".join([sweep, *cells]) + " |")


if __name__ == "__main__":
    main()
