#!/usr/bin/env python3
"""Judges splitting: how many evaluations of the network does a rare event take, beside closed loops that are not split?

    pip install numpy
    python scripts/judge_splitting.py --djinn target/release/djinn --out judged

Loops begin with the scenes of the fixtures. Plain ones say how many reach each value of a severity, from which levels
follow: one in `--copies` of the loops that reach a level reaches the next. Of the loops that are split at these, every
second one gives the limits of EVENTS at which they have the shares of SHARES; the others estimate them. Plain estimates
of a share p vary by p (1 - p) a loop, split ones as their loops do. Where a share u of the events is in loops that never
reach the first level, those alone vary by u p: no levels and copies beyond it take less than u times the evaluations.
"""

import argparse
import json
import pathlib
import struct
import subprocess

import numpy as np

ROOT = pathlib.Path(__file__).resolve().parent.parent
CONFIG = """
[run]
seed = {seed}
[ingest]
dataset = "interaction"
inputs = ["{root}/tests/fixtures/recordings/interaction/FIX-multi-v1_2.zip"]
splits = ["train", "val"]
max_agents = 6
[mine]
behaviors = [{{ kind = "near_miss" }}, {{ kind = "collision" }}, {{ kind = "hard_brake" }}]
[train.denoiser]
checkpoint = "{root}/pipelines/models/geometric.safetensors"
[train.distill]
checkpoint = "{root}/pipelines/models/geometric_two_steps.safetensors"
[generate]
splits = ["train", "val"]
sweeps = [{{ name = "none", n_scenes = 1 }}]
[rates]
loops = {loops}
horizon_s = 6.0
severity = "{severity}"
levels = {levels}
copies = {copies}
"""
STAGES = [word for stage in ("ingest", "mine", "train_denoiser", "train_distill", "rates") for word in ("--stage", stage)]
# Values of severities, the least severe first.
GRIDS = {
    "required_deceleration_mps2": np.geomspace(0.25, 16, 37).round(3).tolist(),
    "time_to_collision_s": np.geomspace(8, 0.1, 37).round(3).tolist(),
    "gap_m": np.geomspace(16, 0.1, 37).round(3).tolist(),
}
# Behaviors with a parameter, and whether larger ones are rarer.
EVENTS = [("near_miss", "min_ttc_s", False), ("hard_brake", "max_deceleration_mps2", True)]
SHARES = (1e-2, 3e-3, 1e-3, 3e-4, 1e-4)
# A level is reached by at least so many plain loops.
FEWEST = 8


def loops(options, name, **settings):
    """Drives loops, or finds those of an earlier run; returns the events of each, and the figures."""
    folder = options.out / f"{name}_{options.severity}"
    summary = folder / "out" / "run" / "main" / "modeled.json"
    if not summary.exists():
        folder.mkdir(parents=True, exist_ok=True)
        (folder / "run.toml").write_text(CONFIG.format(root=ROOT, seed=1, severity=options.severity, **settings))
        subprocess.run([options.djinn, "run", "run.toml", "--output", "out", *STAGES], cwd=folder, check=True)
    return read(summary.with_name("modeled.bin")), json.loads(summary.read_text())


def read(path):
    """The loops of a file, each a list of (behavior, parameters, weight): a line of text, then postcard."""
    data = path.read_bytes()
    at = data.index(b"\n") + 1

    def number():
        nonlocal at
        value = shift = 0
        while True:
            byte, at = data[at], at + 1
            value, shift = value | (byte & 127) << shift, shift + 7
            if byte < 128:
                return value

    def text():
        nonlocal at
        n = number()
        at += n
        return data[at - n : at].decode()

    def real():
        nonlocal at
        at += 8
        return struct.unpack("<d", data[at - 8 : at])[0]

    found = []
    for _ in range(number()):
        text(), text(), real(), real()
        found.append([(text(), {text(): real() for _ in range(number())}, real()) for _ in range(number())])
    return found


def levels_of(grid, figures, copies):
    levels, share = [], 1.0
    for level, reached in zip(grid, figures["reached"]):
        if reached <= share / copies and reached * figures["n_loops"] >= FEWEST:
            levels, share = [*levels, level], reached
    return levels


def events(split):
    """Names of events of decreasing shares, and whether an event is of them."""
    for behavior, parameter, is_larger in EVENTS:
        sign = -1 if is_larger else 1
        known = sorted((sign * values[parameter], weight) for loop in split for of, values, weight in loop if of == behavior and parameter in values)
        shares = np.cumsum([weight for _, weight in known]) / len(split)
        for wanted in SHARES:
            if len(known) and shares[0] < wanted < shares[-1]:
                limit = known[np.searchsorted(shares, wanted)][0]
                yield f"{behavior}, {parameter} {'≥' if is_larger else '≤'} {abs(limit):.2f}", (
                    lambda of, values, case=(behavior, parameter, sign, limit): of == case[0] and case[2] * values.get(case[1], case[2] * 1e9) <= case[3]
                )


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--djinn", default="djinn", type=lambda path: str(pathlib.Path(path).resolve()) if "/" in path else path)
    parser.add_argument("--out", type=pathlib.Path, required=True, help="where runs are kept")
    parser.add_argument("--plain", type=int, default=3000, help="plain loops (default: 3000)")
    parser.add_argument("--split", type=int, default=500, help="loops that are split (default: 500)")
    parser.add_argument("--copies", type=int, default=3)
    parser.add_argument("--severity", choices=GRIDS, default="required_deceleration_mps2")
    options = parser.parse_args()
    grid = GRIDS[options.severity]
    plain, of_plain = loops(options, f"plain_{options.plain}", loops=options.plain, levels=grid, copies=1)
    levels = levels_of(grid, of_plain, options.copies)
    split, of_split = loops(options, f"split_{options.split}_{options.copies}", loops=options.split, levels=levels, copies=options.copies)
    cost = [figures["n_futures"] / figures["n_loops"] for figures in (of_plain, of_split)]
    print(f"levels {levels}, reached by {[f'{reached:.2g}' for reached in of_split['reached']]}")
    print(f"{len(plain)} plain loops of {cost[0]:.1f} futures, {len(split)} of {cost[1]:.1f} that are split\n")
    print("| event | a loop, split | plain (found) | times fewer evaluations | below the first level |\n|---|---:|---:|---:|---:|")
    for name, is_of in events(split[::2]):
        sums, hits = (np.array([sum(e[2] for e in loop if is_of(*e[:2])) for loop in found]) for found in (split[1::2], plain))
        mean, error, p = sums.mean(), sums.std(ddof=1) / len(sums) ** 0.5, hits.mean()
        found = [weight for loop in split for of, values, weight in loop if is_of(of, values)]
        below = sum(weight for weight in found if weight == 1) / sum(found)
        gain = mean * (1 - mean) * cost[0] / (sums.var(ddof=1) * cost[1]) if sums.any() else np.nan
        print(f"| {name} | {mean:.2g} ± {error:.1g} | {p:.2g} ({hits.sum():.0f}) | {gain:.1f} | {below:.0%} |")


if __name__ == "__main__":
    main()
