"""Many runs in parallel processes, and one archive in INTERACTION's layout whose bytes follow from the seed alone."""

import collections
import concurrent.futures
import dataclasses
import json
import multiprocessing
import pathlib
import shutil
import sys
import zipfile
import zlib

import numpy as np

from fixtures.traffic import DT_S
from simulation import cases, lanelet_map, lanelets, network, places, runs, trackers

SPLITS = ("train", "val")
# What a run is expected to give before the first run of a place has told.
GUESSED_CASES = 150
# Case ids of a run begin at its number times this.
ID_STEP = 1000
# Runs of a place in which there is no case to keep, after which it is given up.
MAX_EMPTY_RUNS = 4


@dataclasses.dataclass
class Outcome:
    """What came of a run: where its rows are, the bytes of each case, and how many cases were left out for which flaw."""

    path: pathlib.Path
    sizes: list
    flaws: collections.Counter

    def note(self):
        """Marks the run as done, for whoever goes on later."""
        text = json.dumps({"sizes": self.sizes, "flaws": self.flaws})
        unfinished = self.path.with_suffix(".json.part")
        unfinished.write_text(text)
        unfinished.rename(self.path.with_suffix(".json"))

    @classmethod
    def noted(cls, path):
        """The outcome of a run that is done; `None` if it is not."""
        note = path.with_suffix(".json")
        if not note.exists():
            return None
        values = json.loads(note.read_text())
        return cls(path, values["sizes"], collections.Counter(values["flaws"]))


class Shelf:
    """The cases of a place and split as they come in, run by run."""

    def __init__(self, name, split, n_wanted):
        self.name, self.split, self.n_wanted = name, split, n_wanted
        self.next_run, self.outcomes = 0, {}

    def in_order(self):
        """The outcomes of the first runs, up to the first that is still missing or not needed."""
        n_cases, run = 0, 0
        while run in self.outcomes and n_cases < self.n_wanted:
            yield self.outcomes[run]
            n_cases += len(self.outcomes[run].sizes)
            run += 1

    def n_cases(self):
        return min(self.n_wanted, sum(len(outcome.sizes) for outcome in self.in_order()))

    def is_full(self):
        return self.n_cases() >= self.n_wanted

    def needs_more(self):
        """Whether the runs that are done or under way will presumably not do."""
        done = [len(outcome.sizes) for outcome in self.outcomes.values()]
        if len(done) >= MAX_EMPTY_RUNS and not any(done):
            flaws = dict(sum((outcome.flaws for outcome in self.outcomes.values()), collections.Counter()))
            raise SystemExit(f"{self.name}: no run gives a case to keep; they were left out as {flaws}")
        each = np.mean(done) if done else GUESSED_CASES
        return not self.is_full() and sum(done) + each * (self.next_run - len(done)) < self.n_wanted


def make(out, names, seed, n_cases, errors, jobs, scratch, kept, tell):
    """Writes the archive and returns the shelves, without their rows.

    `n_cases` has the number of cases by split, `errors` the share of cases with errors of a tracker. The rows of runs go
    to the folder `kept`; runs that are done there are not simulated again. `tell` is called with the cases done, those
    wanted, and a place.
    """
    files = {}
    for name in names:
        plan = places.plan_of(name, seed)
        net = network.Network(network.build(plan, scratch))
        for kind, text in lanelet_map.documents(lanelets.lanelets_of(net, plan), net).items():
            files[f"maps/{name}.{kind}"] = text
    shelves = [Shelf(name, split, n_cases[split]) for name in names for split in SPLITS if n_cases[split]]
    unfinished = out.with_name(out.name + ".part")
    with zipfile.ZipFile(unfinished, "w") as archive:
        for path in sorted(files):
            with archive.open(entry(f"{out.stem}/{path}"), "w") as target:
                target.write(files[path].encode())
        n_written = 0
        for shelf in filled(shelves, seed, errors, jobs, scratch, kept):
            while n_written < len(shelves) and shelves[n_written].is_full():
                write_table(archive, out.stem, shelves[n_written])
                if kept == scratch:
                    for outcome in shelves[n_written].outcomes.values():
                        outcome.path.unlink()
                n_written += 1
            tell(sum(shelf.n_cases() for shelf in shelves), sum(shelf.n_wanted for shelf in shelves), shelf.name)
    unfinished.rename(out)
    return shelves


def filled(shelves, seed, errors, jobs, scratch, kept):
    """Runs until all shelves are full; yields the shelf of each run that is done."""
    context = multiprocessing.get_context("spawn")
    with concurrent.futures.ProcessPoolExecutor(jobs, mp_context=context) as pool:
        under_way = {}
        while True:
            for shelf in shelves:
                while len(under_way) < jobs + 1 and shelf.needs_more():
                    task = pool.submit(run, shelf.name, shelf.split, shelf.next_run, seed, errors, scratch, kept)
                    under_way[task] = (shelf, shelf.next_run)
                    shelf.next_run += 1
            if not under_way:
                return
            done, _ = concurrent.futures.wait(under_way, return_when=concurrent.futures.FIRST_COMPLETED)
            for task in done:
                shelf, number = under_way.pop(task)
                shelf.outcomes[number] = task.result()
                yield shelf


def run(name, split, number, seed, errors, scratch, kept):
    """Simulates one run in a process of its own and writes the rows of its cases."""
    seen_by = f"_{errors}" if errors > 0.0 else ""
    path = kept / f"{name}_{split}_{seed}_{number}{seen_by}.csv"
    outcome = Outcome.noted(path)
    if outcome is not None:
        return outcome
    outcome = Outcome(path, [], collections.Counter())
    rng = np.random.default_rng([seed, zlib.crc32(name.encode()), SPLITS.index(split), number])
    plan = places.plan_of(name, seed)
    net_file = scratch / f"{name}.net.xml"
    folder = scratch / f"{name}_{split}_{number}"
    folder.mkdir()
    try:
        tracks = runs.simulate(plan, network.Network(net_file), net_file, rng, int(rng.integers(1 << 30)), folder)
    except SystemExit as failure:
        # One run among thousands in which SUMO gives up must not end them all.
        print(f"\n{name}, {split} run {number}, is left out: {failure}", file=sys.stderr)
        tracks, outcome.flaws["failed run"] = [], 1
    with open(outcome.path, "wb") as file:
        found = cases.windows(tracks, round(runs.DURATION_S / DT_S), rng) if tracks else []
        for i, case in enumerate(found):
            flaw = cases.flaw(case, plan)
            if flaw:
                outcome.flaws[flaw] += 1
            else:
                drawn = np.random.default_rng([seed, zlib.crc32(name.encode()), SPLITS.index(split), number, i])
                if seen_by and drawn.random() < errors:
                    case = trackers.with_errors(case, drawn)
                outcome.sizes.append(file.write(cases.rows(number * ID_STEP + i + 1, case).encode()))
    shutil.rmtree(folder)
    outcome.note()
    return outcome


def write_table(archive, top, shelf):
    """Adds the table of a shelf to the archive."""
    n_left, header = shelf.n_wanted, f"case_id,{cases.interaction.COLUMNS}\n".encode()
    with archive.open(entry(f"{top}/{shelf.split}/{shelf.name}_{shelf.split}.csv"), "w", force_zip64=True) as target:
        target.write(header)
        for outcome in shelf.in_order():
            with open(outcome.path, "rb") as source:
                for size in outcome.sizes[:n_left]:
                    target.write(source.read(size))
            n_left -= min(n_left, len(outcome.sizes))


def entry(name):
    """An entry whose bytes do not depend on the clock."""
    info = zipfile.ZipInfo(name, date_time=(2020, 1, 1, 0, 0, 0))
    info.compress_type, info.external_attr = zipfile.ZIP_DEFLATED, 0o644 << 16
    return info
