"""Makes anew the tables beside the pipelines that change when samples are drawn or judged in another way.

    cargo build --release
    python scripts/simulate_recordings.py --out held_out.zip --places held-out --cases 20 --val-cases 70
    python scripts/make_tables.py --recordings INTERACTION-sim-multi-v1_2.zip --held-out held_out.zip [measure arms ...]

Runs the pipelines of the tables that are named, or of all, and writes each table in place. Runs that are finished are not repeated.
Needs what the scripts behind the tables need (polars and numpy).
"""

import argparse
import pathlib
import subprocess
import sys

# By name: the pipeline, its seeds, whether it runs on places that no model has seen, and the script that makes the table.
TABLES = {
    "models/measure": ("models/measure", [3], False, "measure_models"),
    "models/measure_held_out": ("models/measure", [3], True, "measure_models"),
    "behaviors/arms": ("behaviors/arms", [1, 2], False, "compare_arms"),
}
PIPELINES = pathlib.Path(__file__).parent.parent / "pipelines"


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("tables", nargs="*", metavar="TABLE", help=f"any of {', '.join(name.split('/')[1] for name in TABLES)}")
    parser.add_argument("--recordings", type=pathlib.Path, required=True, help="the archive of the three places of the training")
    parser.add_argument("--held-out", type=pathlib.Path, help="recordings of places that no model has seen")
    parser.add_argument("--djinn", default="target/release/djinn", help="the program")
    parser.add_argument("--output", type=pathlib.Path, default=pathlib.Path("output/tables"))
    arguments = parser.parse_args()
    wanted = {name: row for name, row in TABLES.items() if not arguments.tables or name.split("/")[1] in arguments.tables}
    unknown = set(arguments.tables) - {name.split("/")[1] for name in wanted}
    if unknown or (arguments.held_out is None and any(is_held_out for _, _, is_held_out, _ in wanted.values())):
        parser.error(f"no such table: {', '.join(unknown)}" if unknown else "--held-out is needed for the tables of held-out places")
    for name, (pipeline, seeds, is_held_out, script) in wanted.items():
        recordings = (arguments.held_out if is_held_out else arguments.recordings).resolve()
        output = arguments.output / name
        for seed in seeds:
            command = [arguments.djinn, "run", f"{PIPELINES / pipeline}.toml", "--output", output, "--run", f"seed_{seed}"]
            subprocess.run([*command, "--set", f"run.seed={seed}", "--set", f'ingest.inputs=["{recordings}"]'], check=True)
        runs = [output / pathlib.Path(pipeline).name / f"seed_{seed}" for seed in seeds]
        made = subprocess.run([sys.executable, pathlib.Path(__file__).parent / f"{script}.py", *runs], check=True, capture_output=True)
        (PIPELINES / f"{name}.csv").write_bytes(made.stdout)
        print(f"pipelines/{name}.csv", file=sys.stderr)


if __name__ == "__main__":
    main()
