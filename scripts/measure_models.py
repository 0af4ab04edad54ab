"""The tables of pipelines/models/README.md on how good models are, from runs of pipelines/models/measure.toml.

    python scripts/measure_models.py output/measure/main > pipelines/models/measure.csv

Prints CSV: a row for the recordings and for each sweep, over all places and at each. Needs nothing but Python.
"""

import argparse
import csv
import json
import pathlib
import sys

PERCENT = ("collision_rate", "offroad_rate", "validity_rate")
METERS = ("min_scene_ade_m", "min_scene_fde_m", "mfd_m")
AUC = ("all", "smoothed", "half_seconds", "seam", "lanes_and_gaps")


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("run", type=pathlib.Path, help="folder of a run that was evaluated")
    summary = json.loads((parser.parse_args().run / "metrics.json").read_text())
    values, sweeps, places = {}, [], [""]
    for row in summary["aggregates"]:
        if row["scene_id"] is None and row["scenario_id"] is None and row["group"] != "constant_velocity":
            name = "recorded" if row["group"] == "recorded" else row["sweep"]
            values.setdefault((row["place"], name), {})[row["metric"]] = row["value"]
            sweeps += [] if row["sweep"] in sweeps else [row["sweep"]]
            places += [] if row["place"] in places else [row["place"]]
    n_cases = {(row["place"], row["sweep"]): row["n"] for row in summary["validity"] if row["group"] == "recorded"}
    told = {(row["place"], row["sweep"], row["features"]): row["auc"] for row in summary.get("distinguishability", [])}
    writer = csv.writer(sys.stdout, lineterminator="\n")
    columns = ["samples_with_collision_percent", "vehicles_offroad_percent", "valid_percent", *METERS]
    writer.writerow(["place", "n_cases", "samples", *columns, *(f"auc_{name}" for name in AUC)])
    for place in places:
        for name in ["recorded", *sweeps]:
            found = values.get((place, name), {})
            percent = [f"{100 * found[metric]:.1f}" if metric in found else "" for metric in PERCENT]
            meters = [f"{found[metric]:.2f}" if metric in found and name != "recorded" else "" for metric in METERS]
            auc = [f"{told[place, name, features]:.2f}" if (place, name, features) in told else "" for features in AUC]
            writer.writerow([place or "all", n_cases.get((place, sweeps[0]), ""), name, *percent, *meters, *auc])


if __name__ == "__main__":
    main()
