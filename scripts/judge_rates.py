#!/usr/bin/env python3
"""Judges intervals of rates on simulated traffic, whose rates are known from many hours of it.

    pip install eclipse-sumo==1.28.0 numpy scipy pyarrow
    python scripts/judge_rates.py gather --out hours --hours 100 --djinn target/release/djinn SIM_MergeA SIM_SignalsA
    python scripts/judge_rates.py judge hours --hours 5

`gather` simulates recordings of ten minutes, mines them, keeps for each its exposure and its events, every one once, and
removes the recordings; stop it at any time, and go on. It counts on its own, without djinn's counting. `judge` draws hours
out of all of them, estimates rates from these alone, and tells how often the interval holds the rate of all hours; `tails`
does so for extrapolated ones, and `known` for draws from known distributions; `least` tells how narrow these can be.
"""

import argparse
import json
import pathlib
import shutil
import subprocess
import sys
import tempfile

import numpy as np
from scipy import special, stats

RUNS_PER_BATCH, DT_S, N_TIMESTEPS = 6, 0.1, 120
# Views of one event begin within so many frames after another view of it ends.
SAME_WITHIN_FRAMES = 10
CONFIG = """
[run]
seed = 1
[ingest]
dataset = "interaction"
inputs = ["recordings"]
n_history = 10
n_future = 110
window_stride = 60
holdout_share = 0.0
max_agents = 200
[mine]
"""


def gather(options):
    """Simulates and mines the places in turn, a batch of recordings each."""
    from simulation import recordings

    options.out.mkdir(parents=True, exist_ok=True)
    with tempfile.TemporaryDirectory() as scratch:
        places = [recordings.Place(name, options.seed, scratch) for name in options.places]
        for first in range(round(options.first * 6), round(options.hours * 6), RUNS_PER_BATCH):
            for place in places:
                kept = options.out / f"{place.name}_{options.seed}_{first:05}.json"
                if not kept.exists():
                    kept.with_suffix(".part").write_text(json.dumps(batch(options, place, first, pathlib.Path(scratch) / "batch")))
                    kept.with_suffix(".part").rename(kept)


def batch(options, place, first, folder):
    """The exposure and the events of some recordings."""
    place.write_map(folder / "recordings")
    rows = []
    for number in range(first, first + RUNS_PER_BATCH):
        tracks = place.tracks(number)
        place.write(folder / "recordings", number, tracks)
        cars = [track.rows for track in tracks if track.kind == "car"]
        rows.append({
            "recording": f"{number:03}", "hours": 1 / 6,
            "vehicle_hours": sum(map(len, cars)) * DT_S / 3600,
            "vehicle_km": sum(float(np.hypot(car[:, 2], car[:, 3]).sum()) for car in cars) * DT_S / 1000,
            "events": [],
        })  # fmt: skip
    (folder / "run.toml").write_text(CONFIG)
    mined = subprocess.run([options.djinn, "run", "run.toml", "--output", "out"], cwd=folder, capture_output=True, text=True)
    if mined.returncode != 0:
        raise SystemExit(mined.stderr)
    by_recording = {row["recording"]: row for row in rows}
    for recording, event in events(next(folder.glob("out/**/events.parquet"))):
        by_recording[recording]["events"].append(event)
    shutil.rmtree(folder)
    return rows


def events(path):
    """The positive events of a table, each once: (recording, [behavior, start frame, end frame, parameters])."""
    import pyarrow.parquet as parquet

    fixed = {"event_id", "behavior", "label", "scene_id", "dataset", "split", "place", "start_timestep", "end_timestep", "roles"}
    views = {}
    for row in parquet.read_table(path, filters=[("label", "=", "positive")]).to_pylist():
        recording, frame = row["scene_id"].rsplit("/", 1)[1].split("@")
        tracks = tuple(sorted(row[name] for name in row if name.endswith("_track_id") and row[name] is not None))
        values = {name: value for name, value in row.items() if name not in fixed and not name.endswith("_track_id") and value is not None}
        start, end = int(frame) + row["start_timestep"], int(frame) + row["end_timestep"]
        views.setdefault((recording, row["behavior"], tracks), []).append((start, end, values))
    for (recording, behavior, _), seen in sorted(views.items()):
        seen.sort(key=lambda view: view[:2])
        until, best = None, None
        for start, end, values in seen:
            if until is not None and start <= until + SAME_WITHIN_FRAMES:
                until = max(until, end)
                # The view with the most of the event counts, of equals the first.
                if end - start > best[1] - best[0]:
                    best = (start, end, values)
                continue
            if best is not None:
                yield recording, [behavior, *best]
            until, best = end, (start, end, values)
        yield recording, [behavior, *best]


def judge(options):
    """Prints a table: how often intervals from draws hold the rate of all hours."""
    rng = np.random.default_rng(options.seed)
    n_runs = round(options.hours * 6)
    print(f"| place | of | in {options.hours:g} h | dispersion | holds | as if independent |\n|---|---|---:|---:|---:|---:|")
    all_held = []
    for place in sorted({path.name.rsplit("_", 2)[0] for path in options.folder.glob("*.json")}):
        runs = [run for path in sorted(options.folder.glob(f"{place}_*.json")) for run in json.loads(path.read_text())]
        km = np.array([run["vehicle_km"] for run in runs]) / 1000
        for name, is_of in series(runs):
            n = np.array([sum(map(is_of, run["events"])) for run in runs])
            if n.sum() < 10:
                continue
            truth = n.sum() / km.sum()
            # Runs are drawn with replacement: the rate of all of them is then exactly that of the draws.
            drawn = [rng.integers(0, len(runs), n_runs) for _ in range(options.draws)]
            held = [[low <= truth <= high for low, high in (interval(n[i], km[i], True), interval(n[i], km[i], False))] for i in drawn]
            share, plain = np.mean(held, axis=0)
            all_held.append((share, plain))
            print(f"| {place} | {name} | {n.mean() * n_runs:.1f} | {dispersion(n, km):.1f} | {100 * share:.0f} % | {100 * plain:.0f} % |")
        print(f"{place}: {len(runs) / 6:.0f} h", file=sys.stderr)
    share, plain = np.mean(all_held, axis=0)
    inside = np.mean([0.92 <= share <= 0.98 for share, _ in all_held])
    print(f"| all | {len(all_held)} rows | | | {100 * share:.1f} % | {100 * plain:.1f} % |")
    print(f"{100 * inside:.0f} % of rows hold in 92 to 98 %", file=sys.stderr)


# Buckets of parameters beside whole behaviors.
BUCKETS = [
    ("cut_in", "gap_m", -99, 5), ("cut_in", "relative_speed_mps", 2, 99), ("cut_in", "ttc_s", 0, 3), ("lane_change", "speed_mps", 0, 6),
    ("hard_brake", "max_deceleration_mps2", 5, 99), ("near_miss", "pet_s", -99, 0.3), ("left_turn", "duration_s", 5, 99),
]  # fmt: skip


def series(runs):
    """Names, and whether an event is of it: behaviors, then buckets."""
    for behavior in sorted({event[0] for run in runs for event in run["events"]}):
        yield behavior, lambda event, behavior=behavior: event[0] == behavior
    for behavior, parameter, low, high in BUCKETS:
        yield f"{behavior}, {parameter} {low}..{high}", (
            lambda event, of=(behavior, parameter, low, high): event[0] == of[0] and of[2] <= event[3].get(of[1], 1e9) < of[3]
        )


def dispersion(n, exposure):
    expected = n.sum() / exposure.sum() * exposure
    return max(1.0, float(((n - expected) ** 2).sum() / n.sum() * len(n) / (len(n) - 1))) if n.sum() else 1.0


def interval(n, exposure, is_clustered):
    """As src/statistics/clustered.rs defines it."""
    scale = dispersion(n, exposure) if is_clustered else 1.0
    alike = n.sum() / scale
    low = stats.gamma.ppf(0.025, alike) if alike else 0.0
    return low * scale / exposure.sum(), stats.gamma.ppf(0.975, alike + 1) * scale / exposure.sum()


# Severities whose tails are judged: behavior, parameter, and 1 where larger values are more severe.
SEVERITIES = [("cut_in", "ttc_s", -1), ("cut_in_paper", "ttc_s", -1), ("near_miss", "pet_s", -1), ("hard_brake", "max_deceleration_mps2", 1),
              ("tailgating", "time_headway_s", -1), ("pedestrian_steps_out", "time_to_arrival_s", -1)]  # fmt: skip


def tails(options):
    """Prints a table: how often extrapolated intervals hold the rate of a level that is expected in a third of the draws."""
    rng = np.random.default_rng(options.seed)
    # Pieces of recordings are drawn, all of one length, so that rates are per piece.
    n_drawn = round(options.hours * 60 / options.minutes)
    print(HEAD.format("place and severity", "level"))
    for place in sorted({path.name.rsplit("_", 2)[0] for path in options.folder.glob("*.json")}):
        runs = [run for path in sorted(options.folder.glob(f"{place}_*.json")) for run in json.loads(path.read_text())]
        pieces = [piece for run in runs for piece in cut(run["events"], options.minutes)]
        print(f"{place}: {len(runs) / 6:.0f} h", file=sys.stderr)
        for behavior, parameter, sign in SEVERITIES:
            # As src/rates/tail.rs has it: of times, the logarithm.
            severity = (lambda value: -np.log(value) if value > 0 else np.inf) if sign < 0 else float
            found = [np.array([severity(event[3][parameter]) for event in piece if event[0] == behavior and parameter in event[3]]) for piece in pieces]
            severities = np.sort(np.concatenate(found))[::-1]
            n_beyond = round(len(pieces) / n_drawn / 3)
            if len(severities) < 100 or n_beyond < 1:
                continue
            level = (severities[n_beyond - 1] + severities[n_beyond]) / 2
            if level == np.inf:
                continue
            # Without replacement: a piece that is drawn twice would have the same severities twice.
            draws = (rng.choice(len(pieces), n_drawn, replace=False) for _ in range(options.draws))
            draws = (([found[i] for i in drawn], np.ones(n_drawn)) for drawn in draws)
            n = len(severities) * n_drawn / len(pieces)
            value, beyond = np.exp(-level) if sign < 0 else level, (severities > level).sum()
            print(row(f"{place}, {behavior} {parameter}", f"{value:.2f}", n, draws, level, beyond / len(pieces)), flush=True)


def cut(events, minutes):
    """The events that begin in each piece of a recording of ten minutes."""
    first = [int(event[1] * DT_S / 60 / minutes) for event in events]
    return [[event for event, of in zip(events, first) if of == i] for i in range(round(10 / minutes))]


# Distributions of severities: the value that is exceeded with a probability.
KNOWN = [("exponential", lambda p: -np.log(p)), ("generalized Pareto, shape -0.3", lambda p: (1 - p**0.3) / 0.3),
         ("generalized Pareto, shape 0.2", lambda p: (p**-0.2 - 1) / 0.2), ("half normal", lambda p: special.ndtri(1 - p / 2)),
         ("lognormal", lambda p: np.exp(-0.6 * special.ndtri(p))),
         ("logarithm of gamma times, shape 2", lambda p: -np.log(special.gammaincinv(2, p))),
         ("exponential, held at 4 to 4.1", lambda p: np.where(p < LIMITED, 4.1 - 0.1 * p / LIMITED, -np.log(p)))]  # fmt: skip
# The share of events that reach a limit.
LIMITED = np.exp(-4)


def known(options):
    """Prints the table of `tails` for draws of 30 recordings from known distributions, with clusters of two kinds."""
    rng = np.random.default_rng(options.seed)
    print(HEAD.format("distribution", "dispersion, scales differ by"))
    for n, phi, spread in ((300, 1, 0), (300, 3, 0.15), (1500, 5, 0), (1500, 5, 0.15)):
        for name, quantile in KNOWN:
            def recordings(n_recordings):
                counts = rng.poisson(n / 30 if phi == 1 else rng.gamma(n / 30 / (phi - 1), phi - 1, n_recordings), n_recordings)
                return [np.exp(spread * rng.normal()) * quantile(1 - rng.random(count)) for count in counts]

            severities = np.sort(np.concatenate(recordings(30 * 1000)))[::-1]
            draws = ((recordings(30), np.ones(30)) for _ in range(options.draws))
            print(row(name, f"{phi}, {spread:.0%}", n, draws, severities[333], 1 / 90), flush=True)


WHYS = ("few", "no fit", "limit", "rare", "wide")
HEAD = f"| {{}} | {{}} | in a draw | given | holds | median width, times | refused: {', '.join(WHYS)} |\n|---|---|---:|---:|---:|---:|---|"


def row(name, detail, n, draws, level, truth):
    """A row of a table: of the draws with fewer than three events beyond the level."""
    found = [tail_interval(*draw, level) for draw in draws if sum((each > level).sum() for each in draw[0]) < 3]
    given = np.array([each for each in found if not isinstance(each, str)]).reshape(-1, 2)
    holds = f"{100 * np.mean((given[:, 0] <= truth) & (truth <= given[:, 1])):.0f} %" if len(given) else ""
    width = f"{np.median(given[:, 1] / given[:, 0]):.0f}" if len(given) else ""
    refused = ", ".join(f"{sum(each == why for each in found if isinstance(each, str))}" for why in WHYS)
    return f"| {name} | {detail} | {n:.0f} | {len(given)} of {len(found)} | {holds} | {width} | {refused} |"


def tail_interval(found, exposure, level):
    """As src/rates/tail.rs defines it; why no rate is given where none is."""
    import golden_rates

    together, recording = np.concatenate(found), np.repeat(np.arange(len(found)), [len(each) for each in found])
    severities, is_tried = np.sort(together)[::-1], False
    if len(severities) and severities[0] == np.inf:
        return "limit"
    for share in (1.0, 0.7, 0.5, 0.4, 0.3, 0.25, 0.2, 0.15, 0.1):
        threshold = severities[min(int(share * len(severities)), len(severities) - 1)]
        is_beyond = together > threshold
        y = together[is_beyond] - threshold
        if threshold >= level or len(y) < 30:
            continue
        is_tried = True
        shape, scale = golden_rates.quick_fit(y)
        critical = np.interp(shape, np.arange(-0.5, 1.01, 0.25), CRITICAL)
        if not -0.499 < shape < 0.999 or golden_rates.anderson_darling(y, shape, scale) >= critical:
            continue
        by_size = [np.interp(shape, np.arange(-0.5, 0.51, 0.25), values) for values in CROWDING.values()]
        if golden_rates.crowding(y, shape, scale) < np.interp(np.log(len(y)), np.log(list(CROWDING)), by_size):
            return "limit"
        at = level - threshold
        counts = np.bincount(recording[is_beyond], minlength=len(found))
        survival = stats.genpareto.sf(at, shape, scale=scale)
        # No dispersion can be told of a level that the fitted tail does not reach.
        phi = golden_rates.tail_dispersion(y, at, shape, scale, recording[is_beyond], 2_000) if survival else 1.0
        low, high = profile_interval(y, at, phi)
        rate = counts.sum() / exposure.sum()
        ends = interval(counts, exposure, True)
        if survival == 0:
            low, high = 0, high * np.hypot(ends[1] - rate, rate)
        else:
            with np.errstate(divide="ignore"):
                down, up = (np.hypot(np.log(end / rate), np.log(of / survival)) for end, of in zip(ends, (low, high)))
            low, high = rate * survival * np.exp(-down), rate * survival * np.exp(up)
        if high * exposure.sum() * 10 < 1:
            return "rare"
        return "wide" if high > 100 * low else (low, high)
    return "no fit" if is_tried else "few"


def profile_interval(y, at, phi):
    """As scripts/golden_rates.py defines it, but on a grid, and by sums that depend on the ratio of shape and scale alone."""
    ratios = np.unique(np.concatenate([np.geomspace(1e-9, 1, 250) - 1, -np.geomspace(1e-4, 0.1, 40), [0], np.geomspace(1e-4, 3e3, 250)])) / y.max()
    sums = np.log1p(np.maximum(ratios[:, None] * y, 1e-12 - 1)).sum(1)
    per_ratio = np.divide(sums, ratios, out=np.full_like(sums, y.sum()), where=ratios != 0)
    shapes, ln_p = np.linspace(-0.5, 1, 76)[:, None] + 1e-9, -np.geomspace(40, 1e-3, 400)
    scales = shapes * at / np.expm1(-shapes * ln_p)
    each = -len(y) * np.log(scales) - np.interp(shapes / scales, ratios, sums) - np.interp(shapes / scales, ratios, per_ratio) / scales
    profile = np.where(shapes / scales * y.max() > -1, each, -np.inf).max(0)
    inside = np.flatnonzero(profile.max() - profile < phi * stats.chi2.ppf(0.95, 1) / 2)
    return np.exp(ln_p[inside[0]]) if inside[0] else 0.0, np.exp(ln_p[inside[-1]])


def least(_):
    """Prints the least factor between the ends of an interval of 95 % that a fit of both parameters allows, by Fisher's information."""
    sizes = (300, 1500, 3000, 10_000)
    print("| shape |" + "".join(f" {n:,} events |" for n in sizes) + "\n|---:|" + "---:|" * len(sizes))
    for shape in (-0.3, -0.2, -0.1, 1e-4, 0.1, 0.2):
        widths = []
        for n in sizes:
            # The level is expected in one draw of three.
            at = ((3 * n) ** shape - 1) / shape
            slopes = np.array([np.log1p(shape * at) / shape**2 - at / (shape * (1 + shape * at)), at / (1 + shape * at)])
            covariance = np.array([[(1 + shape) ** 2, -1 - shape], [-1 - shape, 2 + 2 * shape]]) / n
            widths.append(np.exp(2 * stats.norm.ppf(0.975) * np.sqrt(slopes @ covariance @ slopes + 1 / n)))
        print(f"| {shape:.1f} |" + "".join(f" {width:.0f} |" for width in widths))


# From tests/golden/rates.json.
CRITICAL = [0.937, 0.858, 0.78, 0.741, 0.691, 0.65, 0.641]
CROWDING = {30: [0.12, 0.12, 0.088, 0.072, 0.058], 95: [0.053, 0.044, 0.032, 0.021, 0.021],
            300: [0.029, 0.021, 0.017, 0.012, 0.01], 949: [0.017, 0.013, 0.01, 0.0074, 0.0074]}  # fmt: skip


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    tasks = parser.add_subparsers(required=True)
    task = tasks.add_parser("gather")
    task.set_defaults(run=gather)
    task.add_argument("places", nargs="+")
    task.add_argument("--out", type=pathlib.Path, required=True)
    task.add_argument("--hours", type=float, default=100.0, help="of each place (default: 100)")
    task.add_argument("--first", type=float, default=0.0, help="where to begin, for a second process beside the first")
    task.add_argument("--seed", type=int, default=1)
    task.add_argument("--djinn", default="djinn")
    tasks.add_parser("least").set_defaults(run=least)
    for name, run in (("judge", judge), ("tails", tails), ("known", known)):
        task = tasks.add_parser(name)
        task.set_defaults(run=run)
        if run is not known:
            task.add_argument("folder", type=pathlib.Path)
        task.add_argument("--draws", type=int, default=400)
        task.add_argument("--hours", type=float, default=5.0, help="of a draw (default: 5)")
        task.add_argument("--seed", type=int, default=1)
        if run is tails:
            task.add_argument("--minutes", type=float, default=10.0, help="of the pieces of recordings that are drawn (default: 10)")
    options = parser.parse_args()
    options.run(options)


if __name__ == "__main__":
    main()
