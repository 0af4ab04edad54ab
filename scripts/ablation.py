"""What is each part of a model or its training worth? Trainings that differ in one thing, given the same processor time.

    pip install polars numpy
    python scripts/ablation.py pipelines/models/ablation.toml --djinn target/release/djinn \
        --set 'ingest.inputs=["/data/INTERACTION-sim-multi-v1_2.zip"]' --scenes output/simulated/scenes

The other pipelines of that form are ablation_rules.toml and ablation_two_steps.toml, beside it.

Each row trains with one thread. The cost of one of its steps (user and system time of the process) is measured on trainings of
two lengths first, and decides how many steps fit into --seconds, so that a loaded machine changes nothing but how long it
takes. Finished rows are kept in the output folder; the same command again goes on. Prints a Markdown table: means over held-out
scenes of all seeds, with the middle 95 % of 10,000 draws of scenes with replacement (fixed seed).
"""

import argparse
import json
import os
import pathlib
import shutil
import subprocess
import typing

import numpy as np
import polars as pl
from compare_sweeps import N_DRAWS, by_scene

METRICS = {
    "collision_rate": ("samples with a collision", 100, "%"),
    "offroad_rate": ("vehicles off the road", 100, "%"),
    "validity_rate": ("valid", 100, "%"),
    "min_scene_ade_m": ("minSceneADE (m)", 1, ""),
    "mfd_m": ("MFD (m)", 1, ""),
}
LOSS, TURNED = "held_out_loss_at_sigma_0.8", "held_out_loss_at_sigma_0.8_map_turned"
CALIBRATION_STEPS = (10, 50)

PAPER = ["train.denoiser.preset='paper_small'"]
THREE_PLACES = ["train.denoiser.data=[]", "train.denoiser.own_weight=1"]
GEOMETRY = {"patch": 3, "n_lanes": 24, "n_neighbors": 6, "n_nearest_lanes": 3, "relation_width": 48}


def geometry(**changed):
    """The network of the preset `small` with another geometry."""
    settings = GEOMETRY | changed
    inner = ", ".join(f"{key} = {str(value).lower()}" for key, value in settings.items())
    network = f'{{ layers = "TMATMAT", width = 96, n_heads = 4, feed_forward = 384, geometry = {{ {inner} }} }}'
    return [f"train.denoiser.network={network}"]


BLIND = {"own_pose": False, "n_neighbors": 0, "n_nearest_lanes": 0}
NETWORKS = {
    "paper_three_places": ("the paper's network, three places", [*PAPER, *THREE_PLACES]),
    "paper": ("+ 35 simulated places", PAPER),
    "paper_balanced": (
        "+ balance of places, 20 agents",
        [*PAPER, "train.denoiser.balance='places'", "train.denoiser.max_agents=20"],
    ),
    "blind": ("geometric: lanes in each agent's frame, patches of 3", geometry(**BLIND)),
    "own_pose": ("+ pose of the estimate", geometry(**BLIND | {"own_pose": True})),
    "neighbors": ("+ neighbors at the estimate", geometry(n_nearest_lanes=0)),
    "small": ("+ lanes at the estimate: the preset `small`", []),
    "patch_1": ("`small`, patches of 1", geometry(patch=1)),
    "patch_2": ("`small`, patches of 2", geometry(patch=2)),
    "patch_5": ("`small`, patches of 5", geometry(patch=5)),
}


def objectives(section, weight, *more):
    """The rules of traffic as objectives of a training."""
    kinds = ["'no_collision', margin_m = 0.3", "'stay_on_road'", "'slip_limit'", *more]
    entries = ", ".join(f"{{ kind = {kind}, weight = {weight} }}" for kind in kinds)
    return f"{section}.objectives=[{entries}]"


RULES = {
    "further": ("trained further", []),
    "further_rules": ("trained further with the rules of traffic", [objectives("train.denoiser", 0.1)]),
}
TWO_STEPS = {
    "two_steps": ("two steps", []),
    "two_steps_rules": (
        "two steps with the rules of traffic",
        [objectives("train.distill", 0.25, "'acceleration_limit', limit_mps2 = 5.0")],
    ),
}


class Table(typing.NamedTuple):
    """Rows that differ in one thing, and what they train."""

    rows: dict
    section: str  # of the pipeline file
    stages: list  # those needed for the training
    folder: str  # of the trained model, in that of the run


DENOISER = ("train.denoiser", ["ingest", "train_denoiser"], "denoiser")
DISTILLED = ("train.distill", ["ingest", "train_denoiser", "train_distill"], "distilled")
TABLES = {
    "ablation": Table(NETWORKS, *DENOISER),
    "ablation_rules": Table(RULES, *DENOISER),
    "ablation_two_steps": Table(TWO_STEPS, *DISTILLED),
}


def run(arguments, name, settings, stages, log):
    """Runs stages with settings on one thread. Returns the processor time in seconds."""
    command = [arguments.djinn, "run", arguments.pipeline, "--run", name, "--output", arguments.output, "--no-progress"]
    command += [word for stage in stages for word in ("--stage", stage)]
    command += [word for setting in settings for word in ("--set", setting)]
    before = os.times()
    done = subprocess.run([*map(str, command), "--threads", "1"], stdout=log, stderr=log, check=False)
    if done.returncode:
        raise SystemExit(f"{name}: exit code {done.returncode}; see {log.name}")
    after = os.times()
    return after.children_user + after.children_system - before.children_user - before.children_system


def step_cost_s(arguments, name, settings, log):
    """Processor time of one training step."""
    table = TABLES[arguments.pipeline.stem]
    spent = []
    for steps in CALIBRATION_STEPS:
        quick = [*settings, f"{table.section}.steps={steps}", "train.denoiser.n_eval_scenes=1"]
        spent.append(run(arguments, f"{name}-steps-{steps}", quick, table.stages, log))
        shutil.rmtree(arguments.output / arguments.pipeline.stem / f"{name}-steps-{steps}")
    return (spent[1] - spent[0]) / (CALIBRATION_STEPS[1] - CALIBRATION_STEPS[0])


def measure(arguments, row, settings, seed):
    """Trains one row with one seed, samples and evaluates it, once. Returns where, and its steps."""
    name = f"{row}-{seed}"
    section = TABLES[arguments.pipeline.stem].section
    folder = arguments.output / arguments.pipeline.stem / name
    cost_file = arguments.output / f"{row}.cost_s"
    with open(arguments.output / f"{name}.log", "a") as log:
        if not cost_file.exists():
            cost_file.write_text(str(step_cost_s(arguments, row, settings, log)))
        steps = round(arguments.seconds / float(cost_file.read_text()))
        if not (folder / "evaluate.done.json").exists():
            settings = [*settings, f"run.seed={seed}", f"{section}.steps={steps}", f"{section}.evaluate_every={steps}"]
            run(arguments, name, settings, [], log)
    return folder, steps


def cell(folders, metric):
    """Mean over scenes and seeds with its interval; the seeds' own means in brackets."""
    _, scale, unit = METRICS[metric]
    rows = [pl.read_parquet(folder / "metrics.parquet").filter(pl.col("series") == "unguided") for folder in folders]
    seeds = [by_scene(of_seed, metric).drop_nans().sort("scene_id") for of_seed in rows]
    means = pl.concat(seeds).group_by("scene_id").agg(pl.col("value").mean()).sort("scene_id")["value"].to_numpy() * scale
    drawn = np.random.default_rng(0).integers(0, len(means), (N_DRAWS, len(means)))
    low, high = np.quantile(means[drawn].mean(1), (0.025, 0.975))
    digits = 1 if scale == 100 or metric == "mfd_m" else 2
    own = " / ".join(f"{seed['value'].mean() * scale:.{digits}f}" for seed in seeds)
    return f"{means.mean():.{digits}f}{unit and ' ' + unit} ({low:.{digits}f}–{high:.{digits}f}; {own})"


def map_effect(folder):
    """Held-out loss with the map turned, over that with the map as it is; a dash where that is not measured."""
    lines = [json.loads(line)["evaluation"] for line in open(folder / "statistics.jsonl")]
    measured = [line for line in lines if LOSS in line and TURNED in line]
    return f"{measured[-1][TURNED] / measured[-1][LOSS]:.1f}" if measured else "–"


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("pipeline", type=pathlib.Path)
    parser.add_argument("--djinn", type=pathlib.Path, required=True, help="the program, optimized")
    parser.add_argument("--scenes", type=pathlib.Path, required=True, help="scenes of all places, as `djinn ingest` wrote them")
    parser.add_argument("--set", action="append", default=[], help="a setting of the pipeline, such as its inputs")
    parser.add_argument("--seconds", type=float, default=300.0, help="processor time of each training")
    parser.add_argument("--seeds", type=int, nargs="+", default=[1, 2])
    names = "; ".join(f"{table}: {', '.join(TABLES[table].rows)}" for table in TABLES)
    parser.add_argument("--rows", nargs="*", metavar="ROW", help=f"only these of the pipeline's rows ({names})")
    parser.add_argument("--output", type=pathlib.Path, default=pathlib.Path("output/ablation"))
    arguments = parser.parse_args()
    table = TABLES.get(arguments.pipeline.stem) or parser.error(f"{arguments.pipeline}: expected one of {', '.join(TABLES)}")
    if unknown := set(arguments.rows or []) - set(table.rows):
        parser.error(f"{', '.join(unknown)}: expected rows among {', '.join(table.rows)}")
    rows = {row: table.rows[row] for row in arguments.rows or table.rows}
    arguments.output.mkdir(parents=True, exist_ok=True)
    shared = [*arguments.set, f"{table.section}.data=[{{ scenes = '{arguments.scenes}' }}]", f"{table.section}.own_weight=0"]
    done = {row: [] for row in rows}
    for seed in arguments.seeds:
        for row, (_, settings) in rows.items():
            done[row].append(measure(arguments, row, [*shared, *settings], seed))
    header = ["training", "steps", *(name for name, _, _ in METRICS.values()), "map turned"]
    print("| " + " | ".join(header) + " |\n" + "|---" * len(header) + "|")
    for row, measured in done.items():
        folders = [folder for folder, _ in measured]
        turned = " / ".join(map_effect(folder / table.folder) for folder in folders)
        cells = [rows[row][0], str(measured[0][1]), *(cell(folders, metric) for metric in METRICS), turned]
        print("| " + " | ".join(cells) + " |")


if __name__ == "__main__":
    main()
