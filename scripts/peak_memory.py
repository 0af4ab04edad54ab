"""How does the peak memory of each stage grow with scenes and scenarios?

    cargo build --release
    python scripts/peak_memory.py --djinn target/release/djinn --work SCRATCH --sizes 1000 10000

Needs no packages and no data: recordings in INTERACTION's recorded form are made here, 3 MB of cars on three lanes of which some
change lanes, and linked under as many numbers as give the scenes that are asked for. A size N stands for N scenes that are ingested
and mined, and for N scenarios that a small untrained denoiser samples in N / 4 of them. SCRATCH is emptied. Prints a Markdown table: memory of the process
itself, which is looked at every few milliseconds, and in brackets with the files that it has mapped, whose pages the system takes back
when it needs them.
"""

import argparse
import math
import pathlib
import shutil
import subprocess
import sys
import time

import bench_common as bench

N_FRAMES = 3000
N_CARS = 16
WINDOW = 40
LIFETIME = 200
STAGES = ("ingest", "mine", "train denoiser", "generate", "evaluate", "report")

PIPELINE = """[run]
seed = 1
[ingest]
dataset = "interaction"
inputs = ["%s"]
maps = "none"
limit = %d
[mine]
behaviors = [{ kind = "cut_in_paper" }, { kind = "hard_brake" }, { kind = "near_miss" }]
[train.denoiser]
preset = "tiny"
network = { layers = "T", width = 16, n_heads = 2, feed_forward = 16, geometry = { relation_width = 8 } }
steps = 1
warmup_steps = 1
n_eval_scenes = 1
[generate]
sampler = { kind = "euler", n_steps = 1 }
validity_strength = 0.0
batch_size = 64
scenes_per_shard = 64
splits = ["train", "val"]
[[generate.sweeps]]
name = "plain"
n_scenes = %d
n_samples = 4
[evaluate]
keep = "all"
[report]
"""


def recording(path):
    """One recording: cars come one after the other, drive for twenty seconds, and every fourth changes its lane."""
    lines = ["track_id,frame_id,timestamp_ms,agent_type,x,y,vx,vy,psi_rad,length,width"]
    for car in range(N_FRAMES * N_CARS // LIFETIME):
        first = 1 + car * LIFETIME // N_CARS
        lane, speed = car % 3, 9.0 + car % 5
        for step in range(min(LIFETIME, N_FRAMES - first + 1)):
            frame = first + step
            changed = 1 / (1 + math.exp(-(step - 100) / 6)) if car % 4 == 0 else 0.0
            y = 3.5 * (lane + (changed if lane < 2 else -changed))
            x = speed * 0.1 * step
            lines.append(f"{car + 1},{frame},{frame * 100},car,{x:.3f},{y:.3f},{speed:.3f},0.000,0.000,4.50,1.80")
    path.write_text("\n".join(lines) + "\n")


def peaks_of(command):
    """The most kilobytes that a command held, without and with mapped files."""
    child = subprocess.Popen([str(part) for part in command], stdout=subprocess.DEVNULL, stderr=subprocess.PIPE, text=True)
    most = {"RssAnon": 0, "VmHWM": 0}
    while child.poll() is None:
        try:
            status = pathlib.Path(f"/proc/{child.pid}/status").read_text()
        except OSError:
            continue
        for line in status.splitlines():
            name, _, rest = line.partition(":")
            if name in most:
                most[name] = max(most[name], int(rest.split()[0]))
        time.sleep(0.003)
    if child.returncode != 0:
        sys.exit(f"{' '.join(map(str, command))} ended with {child.returncode}:\n{child.stderr.read()}")
    return most["RssAnon"], most["VmHWM"]


def measured(arguments, size):
    """Peaks of each stage."""
    place = bench.fresh(arguments.work / "recordings" / "SIM_Lanes")
    first = place / "vehicle_tracks_00000.csv"
    recording(first)
    for number in range(1, -(-size // (N_FRAMES // WINDOW - 1))):
        (place / f"vehicle_tracks_{number:05d}.csv").hardlink_to(first)
    config = arguments.work / "peak.toml"
    config.write_text(PIPELINE % (place.parent, size, size // 4))
    folder = bench.fresh(arguments.work / "run")
    peaks = []
    for stage in STAGES:
        more = ["--from", folder] if stage == "report" else []
        command = [arguments.djinn, *stage.split(), "--config", config, "--output", folder, "--quiet", *more]
        peaks.append(peaks_of(command))
    return peaks


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    for name in ("djinn", "work"):
        parser.add_argument(f"--{name}", type=bench.path, required=True)
    parser.add_argument("--sizes", type=int, nargs="+", default=[1000, 10000])
    arguments = parser.parse_args()
    bench.introduce(arguments.djinn, [])
    columns = [measured(arguments, size) for size in arguments.sizes]
    print("Peak memory, MB:\n")
    megabytes = lambda peaks: f"{peaks[0] / 1000:.0f} ({peaks[1] / 1000:.0f})"
    rows = [[stage, *(megabytes(peaks[i]) for peaks in columns)] for i, stage in enumerate(STAGES)]
    bench.table(["stage", *(f"{size:,}" for size in arguments.sizes)], rows)
    shutil.rmtree(arguments.work)
    bench.conclude()


if __name__ == "__main__":
    main()
