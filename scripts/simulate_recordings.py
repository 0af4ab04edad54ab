#!/usr/bin/env python3
"""Makes recordings of simulated traffic at many places: an archive in INTERACTION's v1.2 form with Lanelet2 maps.

    pip install eclipse-sumo==1.28.0 numpy
    python scripts/simulate_recordings.py --out sim.zip                        # 1,000 train and 60 val cases a place
    python scripts/simulate_recordings.py --out sim.zip --places 'SIM_Round*'  # roundabouts only
    python scripts/simulate_recordings.py --out sim.zip --tracker-errors 0.3   # three of ten cases as trackers err
    python scripts/simulate_recordings.py --out held.zip --places held-out --cases 0 --val-cases 100
    python scripts/simulate_recordings.py --out big.zip --cases 50000 --jobs 8 --keep runs  # stop it at any time, and go on
    python scripts/simulate_recordings.py --list                               # the places
    python scripts/simulate_recordings.py --check sim.zip                      # what is in it, measured anew

A case has 40 frames at 10 Hz, 10 of them observed. The same versions, seed and places give the same bytes, whatever the
number of jobs. Nothing is taken from any recorded dataset. Places that are held out are made only when asked for by name.
"""

import argparse
import collections
import fnmatch
import pathlib
import sys
import tempfile
import time

from simulation import archive, check, places


def arguments():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    task = parser.add_mutually_exclusive_group(required=True)
    task.add_argument("--out", type=pathlib.Path, metavar="ZIP", help="the archive to write")
    task.add_argument("--list", action="store_true", help="print the places with their families, and stop")
    task.add_argument("--check", type=pathlib.Path, metavar="ZIP", help="measure an archive and print a table by place")
    parser.add_argument("--places", default="trained", metavar="NAMES",
                        help="names or patterns, comma-separated; `trained` are all but the held-out ones, `held-out` those (default: trained)")  # fmt: skip
    parser.add_argument("--cases", type=int, default=1000, metavar="N", help="train cases a place (default: 1000)")
    parser.add_argument("--val-cases", type=int, default=60, metavar="N", help="val cases a place, of other runs (default: 60)")
    parser.add_argument("--tracker-errors", type=float, default=0.0, metavar="SHARE",
                        help="share of cases whose past has errors as trackers make them (default: 0)")  # fmt: skip
    parser.add_argument("--seed", type=int, default=1, help="what geometry and traffic are drawn from (default: 1)")
    parser.add_argument("--jobs", type=int, default=1, metavar="N", help="parallel processes (default: 1)")
    parser.add_argument("--keep", type=pathlib.Path, metavar="FOLDER",
                        help="keep the rows of finished runs there, and go on from those that are there; empty it when this program changes")
    parser.add_argument("--check-cases", type=int, default=100, metavar="N", help="with --check: cases to measure of each table (default: 100)")
    return parser.parse_args()


def chosen(patterns):
    """The names of the places that are asked for, in the order of the catalog."""
    catalog = places.catalog()
    names = set()
    for pattern in patterns.split(","):
        if pattern in ("trained", places.HELD_OUT):
            found = [name for name, (family, *_) in catalog.items() if (family == places.HELD_OUT) == (pattern == places.HELD_OUT)]
        else:
            found = fnmatch.filter(catalog, pattern.strip())
        if not found:
            raise SystemExit(f"no place is named {pattern}; --list names them")
        names.update(found)
    return [name for name in catalog if name in names]


class Progress:
    """A line on standard error: in place on a terminal, else a new one every 20 seconds."""

    def __init__(self):
        self.start, self.told = time.monotonic(), 0.0

    def tell(self, n_done, n_wanted, place):
        now = time.monotonic() - self.start
        terminal = sys.stderr.isatty()
        if now - self.told < (0.2 if terminal else 20.0) and n_done < n_wanted:
            return
        self.told = now
        left = f", about {now / n_done * (n_wanted - n_done) / 60:.0f} min left" if n_done else ""
        line = f"{n_done:,} of {n_wanted:,} cases, {now:.0f} s{left} ({place})"
        print(f"\r{line:<80}" if terminal else line, end="" if terminal else "\n", file=sys.stderr, flush=True)


def print_counts(shelves):
    """Cases kept and left out, by place and reason."""
    flaws = ("few", "many", "standstill", "appears", "motion", "overlap", "failed run")
    print(f"\n{'place':<24}{'split':<7}{'cases':>7}{'runs':>6}   left out: " + "".join(f"{flaw:>11}" for flaw in flaws))
    for shelf in shelves:
        outcomes = list(shelf.in_order())
        counts = sum((outcome.flaws for outcome in outcomes), collections.Counter())
        left_out = "".join(f"{counts[flaw]:>11}" for flaw in flaws)
        print(f"{shelf.name:<24}{shelf.split:<7}{shelf.n_cases():>7}{len(outcomes):>6}{'':13}{left_out}")


def main():
    options = arguments()
    if options.list:
        for name, (family, *_) in places.catalog().items():
            print(f"{name:<24}{family}")
        return
    if options.check:
        check.print_table(options.check, options.check_cases)
        return
    n_cases = {"train": options.cases, "val": options.val_cases}
    names = chosen(options.places)
    for folder in {options.out.parent, options.keep or options.out.parent}:
        folder.mkdir(parents=True, exist_ok=True)
    with tempfile.TemporaryDirectory(dir=options.out.parent) as scratch:
        scratch = pathlib.Path(scratch)
        shelves = archive.make(options.out, names, options.seed, n_cases, options.tracker_errors, options.jobs, scratch,
                               options.keep or scratch, Progress().tell)  # fmt: skip
    print_counts(shelves)


if __name__ == "__main__":
    main()
