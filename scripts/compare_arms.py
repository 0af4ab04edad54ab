"""What does each means of steering bring, and what does it cost? One row for each sweep of a run that asks for a behavior.

    pip install polars numpy
    djinn run pipelines/behaviors/arms.toml --set 'ingest.inputs=["/data/INTERACTION-sim-multi-v1_2.zip"]'
    python scripts/compare_arms.py output/arms/main [output/arms/seed_2 ...] [--by place]

Sweeps are named BEHAVIOR/ARM in their pipeline's `name`. Prints a Markdown table over all runs: shares of samples with the middle
95 % of 10,000 draws of pairs with replacement (fixed seed), pairs with a sample that is verified and valid, spread of the last
positions (MFD), and the Wasserstein distances of the motion of all agents from the recordings of the same scenes. With `--by place` there is a
row for each place, without the figures that runs give for sweeps as a whole.
"""

import argparse
import json
import pathlib

import numpy as np
import polars as pl

N_DRAWS = 10_000
MOTION = {"speed": "speed (m/s)", "acceleration": "acceleration (m/s²)", "distance to the nearest": "distance to the nearest (m)"}
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
    return f"{100 * by_pair.mean():.0f} ({100 * low:.0f}–{100 * high:.0f})"


def realism(runs, sweep, strength, quantity):
    """Mean over runs of a distance from the recordings."""
    found = []
    for run in runs:
        rows = json.loads((run / "metrics.json").read_text())["realism"]
        own = [row for row in rows if row["sweep"] == sweep and row["strength"] == strength and row["quantity"] == quantity]
        found += [row["wasserstein"] for row in own if row["group"] != "constant_velocity"]
    return f"{np.mean(found):.2f}" if found else "–"


def spread(runs, sweep, strength):
    """Mean over scenes of the maximum distance between last positions, meters."""
    rows = pl.concat([pl.read_parquet(run / "metrics.parquet") for run in runs])
    own = (pl.col("sweep") == sweep) & (pl.col("strength") == strength) & (pl.col("metric") == "mfd_m") & (pl.col("series") != "constant_velocity")
    values = rows.filter(own & pl.col("scene_id").is_not_null())["value"].drop_nans()
    return f"{values.mean():.1f}" if len(values) else "–"


def novelty(runs, sweep, strength):
    """Mean distance of accepted scenarios from the nearest recorded event of their kind, in standard deviations of its parameters."""
    corpora = [pl.read_parquet(path) for run in runs for path in (run / "corpus" / "scenarios").glob("**/*.parquet")]
    if not corpora:
        return "–"
    rows = pl.concat([rows.select("sweep", "guidance_strength", "nearest_recorded_event") for rows in corpora])
    values = rows.filter(pl.col("sweep") == sweep, pl.col("guidance_strength") == strength)["nearest_recorded_event"].drop_nulls()
    return f"{values.mean():.2f}" if len(values) else "–"


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("runs", type=pathlib.Path, nargs="+", help="folders of evaluated runs that differ in their seed")
    parser.add_argument("--by", choices=["place"], help="a row for each place")
    arguments = parser.parse_args()
    rows = pl.concat([samples(run) for run in arguments.runs])
    by = [arguments.by] if arguments.by else []
    whole = [] if by else ["MFD (m)", "from recorded events", *MOTION.values()]
    header = ["behavior", *by, "arm", "samples", "verified (%)", "valid (%)", "both (%)", "accepted", "pairs within the samples", *whole]
    print("| " + " | ".join(header) + " |\n" + "|---" * len(header) + "|")
    rows = rows.with_columns(pl.col("sweep").str.split("/").list.first().alias("behavior"))
    groups = rows.sort("behavior", *by, maintain_order=True) if by else rows
    for (sweep, strength, *place), own in groups.group_by("sweep", "strength", *by, maintain_order=True):
        behavior, _, arm = sweep.partition("/")
        both = own.group_by("pair").agg(pl.col("both").any().alias("works"))
        cells = [behavior, *place, arm + (f", α = {strength:g}" if strength else ""), f"{own.height}", share(own, "verified"), share(own, "valid"), share(own, "both")]
        cells += [f"{own['accepted'].sum()}", f"{both['works'].sum()} of {both.height}"]
        if not by:
            cells += [spread(arguments.runs, sweep, strength), novelty(arguments.runs, sweep, strength)]
            cells += [realism(arguments.runs, sweep, strength, quantity) for quantity in MOTION]
        print("| " + " | ".join(cells) + " |")


if __name__ == "__main__":
    main()
