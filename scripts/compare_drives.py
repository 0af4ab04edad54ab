"""Does one driver do worse than another in the same scenarios, also where both survive? Two drives of one corpus, paired.

    pip install pyarrow
    djinn drive CORPUS --ego ./old --out old && djinn drive CORPUS --ego ./new --out new
    python scripts/compare_drives.py old new

Prints CSV: in how many scenarios the second fails and the first does not, and the reverse; the same for a shorter time to collision,
harder braking, a harder contact and, of drives with --bisect, a shorter delay of the others that is survived; and how likely a
difference at least so large is by chance (sign test, two-sided).
"""

import argparse
import csv
import json
import math
import pathlib
import sys

# What is worse, and from which difference on; None where it was not measured.
WORSE = {
    "fails": (lambda row: row["outcome"] not in ("survived", "not_sampled"), 0),
    "time to collision shorter by 0.1 s": (lambda row: -math.inf if row["ego_min_ttc_s"] is None else -row["ego_min_ttc_s"], 0.1),
    "brakes harder by 0.2 m/s2": (lambda row: row["max_braking_mps2"], 0.2),
    "contact harder by 0.2 m/s": (lambda row: row["contact_relative_mps"] or 0.0, 0.2),
    "survives a shorter delay": (lambda row: None if row["delay_s"] is None else -row["delay_s"], 0.05),
}


def rows(folder):
    """The row of each scenario, of the driver that was asked for: the first one."""
    import pyarrow.parquet as pq

    margins = json.loads((folder / "drive.json").read_text()).get("margins", {"scenarios": []})
    # Who fails without any delay survives none.
    delays_s = {margin["scenario_id"]: -1.0 if (s := margin["own"]["delay_s"]) is None else s for margin in margins["scenarios"]}
    found = {}
    for row in pq.read_table(folder / "drives.parquet").to_pylist():
        found.setdefault(row["scenario_id"], {**row, "delay_s": delays_s.get(row["scenario_id"])})
    return found


def by_chance(more, less):
    """The probability that coins fall so unequally."""
    n = more + less
    return min(1.0, 2.0 * sum(math.comb(n, k) for k in range(max(more, less), n + 1)) / 2.0**n)


def compare(first, second):
    """What is worse, in how many scenarios of how many only in the second and only in the first, and how likely that is by chance."""
    both = first.keys() & second.keys()
    for name, (value, least) in WORSE.items():
        pairs = [(value(first[key]), value(second[key])) for key in both]
        pairs = [pair for pair in pairs if None not in pair]
        if not pairs:
            continue
        more, less = (sum(1 for a, b in ordered if b > a + least) for ordered in (pairs, [pair[::-1] for pair in pairs]))
        yield name, len(pairs), more, less, by_chance(more, less)


def main():
    arguments = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    arguments.add_argument("first", type=pathlib.Path, help="folder of a drive")
    arguments.add_argument("second", type=pathlib.Path, help="folder of a drive of the same corpus")
    arguments = arguments.parse_args()
    table = csv.writer(sys.stdout, lineterminator="\n")
    table.writerow(["worse", "scenarios", "second only", "first only", "by chance"])
    for *counts, chance in compare(rows(arguments.first), rows(arguments.second)):
        table.writerow([*counts, f"{chance:.2g}"])


if __name__ == "__main__":
    main()
