#!/usr/bin/env python3
"""How long do the jobs of a pipeline take on a cluster, how busy are its workers, and what does a scenario cost?

    python3 scripts/simulate_schedule.py scripts/schedule/measured.json --scenarios 1e6 --workers 100
    python3 scripts/simulate_schedule.py MEASURED.json --scenarios 1e6 --workers 100 --status STATUS.json --picture schedule.png

Plays the graph of `djinn submit` shard by shard, as `djinn run --part work` goes about them: each worker makes its own ones
first, then what is missing from the end backward, so that shards of late workers are made twice; workers die, lose the
shard at hand, and come back after a while. MEASURED.json says what was measured (its keys are explained in `Measured`);
`--status` takes the time of a shard from what `djinn status RUN --json` prints while workers are at work. Same seed, same result.
Needs no packages but for the picture (matplotlib).
"""

import argparse
import dataclasses
import json
import random
import sys
from pathlib import Path

sys.path.insert(0, str(Path(__file__).parent))
from schedule.requests import play_rounds
from schedule.shards import Cluster, Tally, play_shards

# The graph of `djinn submit` for a pipeline with all stages. Each job waits for the one before it.
GRAPH = [
    {"name": name, "workers": name.endswith("work")}
    for name in ("prepare", "plan", "work", "seal", "evaluate-plan", "evaluate-work", "evaluate-seal", "finish")
]


@dataclasses.dataclass
class Measured:
    """What was measured."""

    # By the name of the job: `fixed_s`, what it takes anyhow; `s_a_scenario`, more for each scenario (of one core); `s_a_shard`,
    # more for each shard; `spread`, the standard deviation of the logarithm of a shard's time.
    jobs: dict
    # Scenarios of a shard.
    scenarios_a_shard: int
    # What a scenario takes of the disk, by table.
    bytes_a_scenario: dict
    # Files of a shard until it is sealed, all stages.
    files_a_shard: int
    # The share of scenarios that is accepted.
    accepted_share: float

    def shard_s(self, job):
        times = self.jobs[job]
        return times.get("s_a_shard", 0.0) + times.get("s_a_scenario", 0.0) * self.scenarios_a_shard

    def alone_s(self, job, n_scenarios, n_shards):
        """The time of a job of one process."""
        times = self.jobs[job]
        return (
            times.get("fixed_s", 0.0)
            + times.get("s_a_scenario", 0.0) * n_scenarios
            + times.get("s_a_shard", 0.0) * n_shards
        )


def simulate(measured, cluster, n_scenarios, graph=GRAPH, rounds=None, seed=0):
    """Plays the graph. Returns for each job, in order, its name, when it begins, its workers (None for one process), and what
    became of it. `rounds` is (shards a round, lag) where a request is played."""
    n_shards = -(-n_scenarios // measured.scenarios_a_shard)
    rows, now = [], 0.0
    for job in graph:
        name, rng = job["name"], random.Random(f"{seed}/{job['name']}")
        begin = now + cluster.queue_s
        if job["workers"]:
            times = measured.jobs[name]
            shard_s = measured.shard_s(name) / cluster.cores_of_worker()
            play = play_rounds if rounds and name == "work" else play_shards
            more = {"rounds": rounds} if play is play_rounds else {}
            tally = play(n_shards, shard_s, times.get("spread", 0.0), times.get("fixed_s", 0.0), cluster, rng, **more)
        else:
            seconds = measured.alone_s(name, n_scenarios, n_shards)
            tally = Tally(seconds=seconds, held_s=seconds, useful_s=seconds)
        rows.append((name, begin, cluster.workers if job["workers"] else None, tally))
        now = begin + tally.seconds
    return rows


def summary(rows, measured, cluster, n_scenarios):
    """The figures of a schedule."""
    total = rows[-1][1] + rows[-1][3].seconds
    at_work = [tally for _, _, n_workers, tally in rows if n_workers]
    held = sum(tally.held_s for tally in at_work)
    n_shards = -(-n_scenarios // measured.scenarios_a_shard)
    # One process holds the cores of a worker.
    core_s = sum(tally.held_s for _, _, _, tally in rows) * cluster.cores
    n_accepted = n_scenarios * measured.accepted_share
    return {
        "hours": total / 3600,
        "idle_share": 1 - sum(tally.useful_s for tally in at_work) / held if held else 0.0,
        "idle_share_of_all_nodes": 1 - sum(tally.useful_s for *_, tally in rows) / (cluster.workers * total),
        "made_twice_s": sum(tally.twice_s for tally in at_work),
        "lost_s": sum(tally.lost_s for tally in at_work),
        "n_kills": sum(tally.n_kills for tally in at_work),
        "n_shards": n_shards,
        "n_unfinished": sum(tally.n_unfinished for tally in at_work),
        "n_lookups": sum(tally.n_lookups for tally in at_work),
        "gigabytes": sum(measured.bytes_a_scenario.values()) * n_scenarios / 1e9,
        "objects": n_shards * measured.files_a_shard,
        "undecided_shards": max((tally.undecided for tally in at_work), default=0.0),
        "core_s_an_accepted_scenario": core_s / n_accepted if n_accepted else float("inf"),
        "price_an_accepted_scenario": core_s / 3600 * cluster.price / n_accepted if n_accepted else float("inf"),
    }


def describe(rows, figures):
    lines = [f"{'job':<16}{'begins':>9}{'seconds':>9}{'idle':>7}{'kills':>7}"]
    for name, begin, _, tally in rows:
        idle = 1 - tally.useful_s / tally.held_s if tally.held_s else 0.0
        lines.append(f"{name:<16}{begin:>9.0f}{tally.seconds:>9.0f}{idle:>7.0%}{tally.n_kills:>7}")
    lines += [f"{key:<32}{value:,.4g}" for key, value in figures.items()]
    return "\n".join(lines)


def draw(rows, path):
    import matplotlib

    matplotlib.use("svg")
    matplotlib.rcParams["svg.hashsalt"] = "djinn"
    from matplotlib import pyplot

    figure, axes = pyplot.subplots(figsize=(9, 3.2), layout="constrained")
    top = max(n_workers or 1 for _, _, n_workers, _ in rows)
    for color, (name, begin, n_workers, tally) in zip(pyplot.cm.tab10.colors, rows):
        edges, counts = tally.profile(n_workers or 1)
        minutes = [(begin + edge) / 60 for edge in edges]
        axes.stairs(counts, minutes, fill=True, color=color, alpha=0.85, label=name)
    axes.set(xlabel="minutes", ylabel="processes that compute", yscale="log", ylim=(0.8, 1.5 * top), xlim=(0, None))
    axes.legend(ncols=4, fontsize="small", loc="upper center", bbox_to_anchor=(0.5, -0.2), frameon=False)
    axes.spines[["top", "right"]].set_visible(False)
    figure.savefig(path, metadata={"Date": None})


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("measured", type=Path)
    parser.add_argument("--scenarios", type=float, default=1e6)
    parser.add_argument("--graph", type=Path, help="the graph that `djinn submit --engine json` printed, with its workers")
    parser.add_argument("--status", type=Path, help="what `djinn status RUN --json` printed")
    parser.add_argument("--scenarios-a-shard", type=int, help="in place of the measured number")
    parser.add_argument("--rounds", type=int, metavar="SHARDS", help="play a request with so many shards a round")
    parser.add_argument("--lag", type=int, default=0, help="rounds that are decided before the one before them is known")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--json", action="store_true", help="print JSON instead of text")
    parser.add_argument("--picture", type=Path, help="draw the busy workers over time into this SVG file")
    for field in dataclasses.fields(Cluster):
        name = "--" + field.name.replace("_", "-")
        parser.add_argument(name, type=field.type, default=field.default, help=f"{field.metadata['help']} [%(default)s]")
    args = parser.parse_args()

    measured = Measured(**json.loads(args.measured.read_text()))
    if args.scenarios_a_shard:
        measured.scenarios_a_shard = args.scenarios_a_shard
    if args.status:
        take_status(measured, json.loads(args.status.read_text()))
    cluster = Cluster(**{field.name: getattr(args, field.name) for field in dataclasses.fields(Cluster)})
    graph = GRAPH
    if args.graph:
        graph = json.loads(args.graph.read_text())["jobs"]
        cluster.workers = max((job["workers"] or 1 for job in graph), default=1)
    if unknown := [job["name"] for job in graph if job["name"] not in measured.jobs]:
        sys.exit(f"{args.measured} has no times of {', '.join(unknown)}: add them to its jobs")
    rounds = (args.rounds, args.lag) if args.rounds else None
    rows = simulate(measured, cluster, int(args.scenarios), graph, rounds, args.seed)
    figures = summary(rows, measured, cluster, int(args.scenarios))
    print(json.dumps(figures, indent=2) if args.json else describe(rows, figures))
    if args.picture:
        draw(rows, args.picture)


def take_status(measured, status):
    """The time of a shard as the workers of a run take it."""
    shards = status.get("shards") or {}
    if not shards.get("seconds_a_shard"):
        sys.exit("the status has no shards that are done: take it while workers are at work")
    job = {"generate": "work", "evaluate": "evaluate-work"}[shards["stage"]]
    measured.jobs[job] |= {"s_a_shard": shards["seconds_a_shard"], "s_a_scenario": 0.0}


if __name__ == "__main__":
    main()
