#!/usr/bin/env python3
"""Judges splitting: how many evaluations of the network does a rare event take, beside closed loops that are not split?

    pip install numpy
    python scripts/judge_splitting.py --djinn target/release/djinn --out judged --plain 4000 --split 1000

Loops begin with the scenes of the fixtures. Plain ones give the shares of loops that reach severities, from which levels
follow: each is reached by one in `--copies` of the loops that reach the one before. Events are those of EVENTS, and near
misses at times to collision (or required decelerations) that the first half of split loops gives for `--shares`; the second half estimates them. Plain
estimates of a share p vary by p (1 - p) a loop, split ones as their loops do.
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
horizon_s = {horizon_s}
severity = "{severity}"
levels = {levels}
copies = {copies}
"""
# Severities that plain loops are asked for, the least severe first.
GRIDS = {
    "required_deceleration_mps2": np.geomspace(0.25, 16, 37).round(3).tolist(),
    "time_to_collision_s": np.geomspace(8, 0.2, 33).round(3).tolist(),
    "gap_m": np.geomspace(20, 0.1, 33).round(3).tolist(),
}
EVENTS = {"hard_brake": None, "near_miss": None, "collision": None}
FEWEST = 8


def loops(options, name, **settings):
    """Runs loops; returns their events, each loop a list of (behavior, parameters, weight), and the figures."""
    folder = options.out / name
    if not (done := folder / "out" / "run" / "main" / "modeled.json").exists():
        folder.mkdir(parents=True, exist_ok=True)
        settings = {"root": ROOT, "horizon_s": options.horizon, "severity": options.severity, **settings}
        (folder / "run.toml").write_text(CONFIG.format(**settings))
        stages = [word for stage in ("ingest", "mine", "train_denoiser", "train_distill", "rates") for word in ("--stage", stage)]
        subprocess.run([options.djinn, "run", "run.toml", "--output", "out", *stages], cwd=folder, check=True)
    return read(done.with_name("modeled.bin")), json.loads(done.read_text())


def read(path):
    """The loops of a file `modeled`: a line of text, then postcard (varints, and floats of eight bytes)."""
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


def levels_of(figures, grid, copies):
    """Severities that are each reached by one in `copies` of the loops that reach the one before, as far as enough do."""
    levels, share = [], 1.0
    for level, reached in zip(grid, figures["reached"]):
        if reached <= share / copies and reached * figures["n_loops"] >= FEWEST:
            levels, share = [*levels, float(level)], reached
    return levels


def sums(found, is_of):
    return np.array([sum(weight for behavior, values, weight in events if is_of(behavior, values)) for events in found])


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--djinn", default="djinn", type=lambda path: str(pathlib.Path(path).resolve()) if "/" in path else path)
    parser.add_argument("--out", type=pathlib.Path, required=True, help="where runs are kept; those that are there are not made again")
    parser.add_argument("--plain", type=int, default=4000, help="plain loops (default: 4000)")
    parser.add_argument("--split", type=int, default=1000, help="loops that are split (default: 1000)")
    parser.add_argument("--copies", type=int, default=3)
    parser.add_argument("--levels", type=float, nargs="*", help="instead of those that plain loops give")
    parser.add_argument("--severity", choices=GRIDS, default="required_deceleration_mps2")
    parser.add_argument("--horizon", type=float, default=6.0, help="seconds (default: 6)")
    options = parser.parse_args()
    grid = GRIDS[options.severity]
    plain, of_plain = loops(options, f"plain_{options.severity}_{options.plain}", seed=1, loops=options.plain, levels=grid, copies=1)
    levels = options.levels or levels_of(of_plain, grid, options.copies)
    name = f"split_{options.severity}_{options.split}_{options.copies}_{'_'.join(map(str, levels))}"
    split, of_split = loops(options, name, seed=2, loops=options.split, levels=levels, copies=options.copies)
    cost = [figures["n_futures"] / figures["n_loops"] for figures in (of_plain, of_split)]
    print(f"levels {levels}, reached by {[f'{reached:.2e}' for reached in of_split['reached']]}")
    print(f"plain: {len(plain)} loops of {cost[0]:.1f} futures; split: {len(split)} of {cost[1]:.1f}\n")
    print("| event | a loop | plain | times fewer evaluations |\n|---|---:|---:|---:|")
    for name, is_of in events(split[::2]):
        found, hits = sums(split[1::2], is_of), sums(plain, is_of)
        mean, error, p = found.mean(), found.std(ddof=1) / len(found) ** 0.5, hits.mean()
        gain = mean * (1 - min(mean, 1)) * cost[0] / (found.var(ddof=1) * cost[1]) if found.any() else np.nan
        print(f"| {name} | {mean:.2e} ± {error:.1e} | {p:.2e} ± {(p / len(hits)) ** 0.5:.1e} ({hits.sum():.0f}) | {gain:.2f} |")


def events(split):
    """Names, and whether an event is of it: behaviors, and near misses and hard brakes of decreasing shares."""
    for behavior in EVENTS:
        yield behavior, lambda of, _, behavior=behavior: of == behavior
    for behavior, parameter, sign in (("hard_brake", "max_deceleration_mps2", -1), ("near_miss", "min_ttc_s", 1)):
        found = sorted((sign * values[parameter], weight) for loop in split for of, values, weight in loop if of == behavior and parameter in values)
        severity, share = np.array([at for at, _ in found]), np.cumsum([weight for _, weight in found]) / len(split)
        for wanted in (1e-2, 3e-3, 1e-3, 3e-4, 1e-4):
            if len(share) and share[0] < wanted < share[-1]:
                limit = float(severity[np.searchsorted(share, wanted)])
                yield f"{behavior}, {parameter} {'at most' if sign > 0 else 'at least'} {abs(limit):.2f}", (
                    lambda of, values, behavior=behavior, parameter=parameter, sign=sign, limit=limit:
                    of == behavior and sign * values.get(parameter, sign * 1e9) <= limit
                )  # fmt: skip


if __name__ == "__main__":
    main()
