"""What does each means of steering bring, and what does it cost? One row for each sweep of a run that asks for a behavior.

    pip install polars numpy
    djinn run pipelines/behaviors/arms.toml --set 'ingest.inputs=["/data/INTERACTION-sim-multi-v1_2.zip"]'
    python scripts/compare_arms.py output/arms/main [output/arms/seed_2 ...]

Sweeps are named BEHAVIOR/ARM in their pipeline's `name`. Prints CSV over all runs: shares of samples with the middle 95 % of 10,000
draws of pairs with replacement (fixed seed), pairs with a sample that is verified and valid, spread of the last positions (MFD), and
the mean distance of accepted ones from recorded events.
"""

import argparse
import csv
import pathlib
import sys

import numpy as np
import polars as pl

N_DRAWS = 10_000
# Reasons against a scenario that say nothing of its validity.
NOT_VALIDITY = ["not_verified", "nothing_asked", "near_duplicate", "surplus", "repeated", "outside", "beyond_limits", "not_found"]


def samples(run):
    """A row for each judged sample: sweep, strength, place, scene, whether it is verified, valid and accepted."""
    columns = ["scenario_id", "scene_id", "place", "verified", "guidance_roles"]
    drawn = pl.concat([pl.read_parquet(path, columns=columns) for path in sorted((run / "samples").glob("samples-*.parquet"))])
    pair = pl.concat_str("scene_id", pl.col("guidance_roles").list.eval(pl.element().struct.json_encode()).list.join(" ")).alias("pair")
    verdicts = pl.read_parquet(run / "verdicts.parquet", columns=["scenario_id", "sweep", "strength", "accepted", "reasons"])
    flaws = pl.col("reasons").list.set_difference(pl.lit(NOT_VALIDITY, dtype=pl.List(pl.String)))
    rows = verdicts.join(drawn.with_columns(pair), on="scenario_id").with_columns(valid=flaws.list.len() == 0)
    return rows.with_columns(both=pl.col("verified") & pl.col("valid"))


def share(rows, column):
    """Percentage of samples, with an interval over pairs."""
    by_pair = rows.group_by("pair", maintain_order=True).agg(pl.col(column).mean())[column].to_numpy()
    draws = np.random.default_rng(0).integers(0, len(by_pair), (N_DRAWS, len(by_pair)))
    low, high = np.quantile(by_pair[draws].mean(1), (0.025, 0.975))
    return [f"{100 * figure:.0f}" for figure in (by_pair.mean(), low, high)]


def spread(runs, sweep, strength):
    """Mean over scenes of the maximum distance between last positions, meters."""
    rows = pl.concat([pl.read_parquet(run / "metrics.parquet") for run in runs])
    own = (pl.col("sweep") == sweep) & (pl.col("strength") == strength) & (pl.col("metric") == "mfd_m") & (pl.col("series") != "constant_velocity")
    values = rows.filter(own & pl.col("scene_id").is_not_null())["value"].drop_nans()
    return f"{values.mean():.1f}" if len(values) else ""


def novelty(runs, sweep, strength):
    """Mean distance of accepted scenarios from the nearest recorded event of their kind, in standard deviations of its parameters."""
    corpora = [pl.read_parquet(path) for run in runs for path in (run / "corpus" / "scenarios").glob("**/*.parquet")]
    if not corpora:
        return ""
    rows = pl.concat([rows.select("sweep", "guidance_strength", "nearest_recorded_event") for rows in corpora])
    values = rows.filter(pl.col("sweep") == sweep, pl.col("guidance_strength") == strength)["nearest_recorded_event"].drop_nulls()
    return f"{values.mean():.2f}" if len(values) else ""


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("runs", type=pathlib.Path, nargs="+", help="folders of evaluated runs that differ in their seed")
    runs = parser.parse_args().runs
    rows = pl.concat([samples(run) for run in runs])
    rows = rows.with_columns(pl.col("sweep").str.split("/").list.first().alias("behavior"))
    writer = csv.writer(sys.stdout, lineterminator="\n")
    shares = [f"{name}_percent{bound}" for name in ("verified", "valid", "both") for bound in ("", "_low", "_high")]
    writer.writerow(["behavior", "arm", "samples", *shares, "accepted", "pairs", "pairs_of", "mfd_m", "from_recorded_events"])
    for (sweep, strength), own in rows.group_by("sweep", "strength", maintain_order=True):
        behavior, _, arm = sweep.partition("/")
        works = own.group_by("pair").agg(pl.col("both").any())["both"]
        measured = [spread(runs, sweep, strength), novelty(runs, sweep, strength)]
        percent = [figure for column in ("verified", "valid", "both") for figure in share(own, column)]
        name = arm.replace("_", " ") + (f", α = {strength:g}" if strength else "")
        writer.writerow([behavior, name, own.height, *percent, own["accepted"].sum(), works.sum(), len(works), *measured])


if __name__ == "__main__":
    main()
