"""How do ingest, mine and evaluate grow with scenes, agents, samples and threads?

    cargo build --release
    python scripts/bench_scaling.py --djinn target/release/djinn --work SCRATCH --interaction ARCHIVE.zip \\
        --denoiser pipelines/models/simulated_places.safetensors

Needs no packages. Works on the largest table of cases of an INTERACTION v1.2 archive, which is unpacked first so that reading does
not stop halfway in other tables. Seconds are those of the stage in the run folder's timings.json, processor seconds those of
the whole process, start included; each the median of `--rounds`. Samples are made by a given denoiser with four evaluations:
they need not be good to be measured. Threads are compared by whole runs over all of the archive. SCRATCH is emptied.
"""

import argparse
import os
import shutil
import zipfile

import bench_common as bench

SCENES = (500, 1000, 2000, 4000)
AGENTS = (2, 4, 8, 16, 32)
EVALUATED_SCENES = (8, 16, 32)
SAMPLES = (2, 4, 8, 16)
STAGES = ("ingest", "mine", "generate", "evaluate")


class Bench:
    def __init__(self, arguments):
        self.arguments = arguments
        self.recordings = arguments.work / "recordings"

    def unpack(self):
        """The largest table of cases with the maps, and the same again as held-out cases of another place."""
        with zipfile.ZipFile(self.arguments.interaction) as archive:
            cases = [info for info in archive.infolist() if info.filename.endswith("_train.csv")]
            largest = max(cases, key=lambda info: info.file_size)
            maps = [info for info in archive.infolist() if "/maps/" in info.filename and not info.is_dir()]
            for info in (largest, *maps):
                archive.extract(info, self.recordings)
        table = self.recordings / largest.filename
        place = table.name.removesuffix("_train.csv")
        again = table.parent.parent / "val" / f"{place}B_val.csv"
        again.parent.mkdir()
        again.hardlink_to(table)
        for file in table.parent.parent.glob(f"maps/{place}.*"):
            file.with_name(f"{place}B{file.suffix}").hardlink_to(file)

    def stage(self, name, folder, *settings, threads=2, inputs=()):
        """Runs a stage `--rounds` times; its wall seconds, processor seconds and peak memory, as medians."""
        usages = []
        for _ in range(self.arguments.rounds):
            more = [part for setting in settings for part in ("--set", setting)]
            command = [self.arguments.djinn, "--threads", threads, name, *inputs, "--output", folder, "--quiet", *more]
            for done in folder.glob(f"{name}.done.json"):
                done.unlink()
            usage = bench.measure(command)
            usage.wall_s = bench.stage(folder, name)["seconds"]
            usages.append(usage)
        return [bench.median(usages, key) for key in ("wall_s", "cpu_s", "peak_bytes")]

    def ingest(self, folder, *settings, threads=2):
        bench.fresh(folder)
        inputs = [self.recordings, "--dataset", "interaction"]
        return self.stage("ingest", folder, *settings, threads=threads, inputs=inputs)

    def mine(self, folder, threads=2):
        return self.stage("mine", folder, 'mine.behaviors=[{ kind = "cut_in" }]', threads=threads)

    def generate(self, source, n_scenes, n_samples):
        """A folder with scenes and samples of them."""
        folder = bench.fresh(self.arguments.work / "samples")
        config = folder / "generate.toml"
        config.write_text(
            '[run]\nseed = 1\n[train.denoiser]\ncheckpoint = "%s"\n[generate]\nsampler = { kind = "dpmpp_2m", n_steps = 4 }\n'
            '[[generate.sweeps]]\nname = "plain"\nn_scenes = %d\nn_samples = %d\n'
            % (self.arguments.denoiser, n_scenes, n_samples)
        )
        shared = ["--config", config, "--scenes", source / "scenes", "--output", folder, "--quiet"]
        bench.measure([self.arguments.djinn, "train", "denoiser", *shared])
        bench.measure([self.arguments.djinn, "generate", *shared])
        (folder / "scenes").symlink_to(source / "scenes")
        return folder

    def whole_run(self, threads):
        """Seconds of the stages of a run over the whole archive, with 480 samples by ten evaluations: medians."""
        config = self.arguments.work / "whole.toml"
        config.write_text(
            '[run]\nseed = 1\n[ingest]\ndataset = "interaction"\ninputs = ["%s"]\n[mine]\nbehaviors = [{ kind = "cut_in" }]\n'
            '[train.denoiser]\ncheckpoint = "%s"\n[generate]\nsampler = { kind = "dpmpp_2m", n_steps = 10 }\n'
            '[[generate.sweeps]]\nname = "plain"\nn_scenes = 40\nn_samples = 12\n[evaluate]\nkeep = "all"\n'
            % (self.arguments.interaction, self.arguments.denoiser)
        )
        rounds = []
        for _ in range(self.arguments.rounds):
            output = bench.fresh(self.arguments.work / "whole")
            bench.measure([self.arguments.djinn, "--threads", threads, "run", config, "--output", output, "--quiet"])
            folder = output / "whole" / "main"
            rounds.append([bench.stage(folder, stage)["seconds"] for stage in STAGES])
        return [bench.middle(seconds) for seconds in zip(*rounds)]

    def evaluate(self, folder, threads=2):
        return self.stage("evaluate", folder, 'evaluate.keep="all"', threads=threads)


def figures(measured):
    wall, cpu, peak = measured
    return [f"{wall:.2f}", f"{cpu:.2f}", bench.megabytes(peak)]


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    for name in ("djinn", "work", "interaction", "denoiser"):
        parser.add_argument(f"--{name}", type=bench.path, required=True)
    parser.add_argument("--rounds", type=int, default=3)
    arguments = parser.parse_args()
    bench.introduce(arguments.djinn, [])
    bench.fresh(arguments.work)
    job = Bench(arguments)
    job.unpack()
    by_scenes(job)
    by_agents(job)
    by_samples(job)
    by_threads(job)
    shutil.rmtree(arguments.work)
    bench.conclude()


UNITS = ("s", "CPU s", "peak MB")


def by_scenes(job):
    rows, folder = [], job.arguments.work / "scenes"
    for threads in (2, 1):
        for n in SCENES:
            if threads == 1 and n != SCENES[-1]:
                continue
            ingested = job.ingest(folder, f"ingest.limit={n}", threads=threads)
            mined = job.mine(folder, threads)
            n_agents = bench.read_json(folder / "scenes" / "manifest.json")["n_agents"]
            n_events = sum(c["n_positive"] + c["n_negative"] for c in bench.read_json(folder / "mine.json")["counts"])
            rows.append([n, threads, f"{n_agents / n:.1f}", *figures(ingested), n_events, *figures(mined)])
    print("Scenes (of one place; cut-ins with their hard negatives are mined):\n")
    header = ["scenes", "threads", "agents a scene", *(f"ingest {u}" for u in UNITS), "events", *(f"mine {u}" for u in UNITS)]
    bench.table(header, rows)


def by_agents(job):
    rows, folder = [], job.arguments.work / "agents"
    for cap in AGENTS:
        ingested = job.ingest(folder, "ingest.limit=2000", f"ingest.max_agents={cap}")
        mined = job.mine(folder)
        n_agents = bench.read_json(folder / "scenes" / "manifest.json")["n_agents"]
        n_events = sum(c["n_positive"] + c["n_negative"] for c in bench.read_json(folder / "mine.json")["counts"])
        rows.append([cap, f"{n_agents / 2000:.1f}", *figures(ingested), n_events, *figures(mined)])
    print("Agents (2,000 scenes, 2 threads, `ingest.max_agents`):\n")
    header = ["at most", "agents a scene", *(f"ingest {u}" for u in UNITS), "events", *(f"mine {u}" for u in UNITS)]
    bench.table(header, rows)


def by_samples(job):
    source = job.arguments.work / "scenes"
    cases = [(n, 4) for n in EVALUATED_SCENES] + [(16, n) for n in SAMPLES if n != 4]
    rows = []
    for n_scenes, n_samples in cases:
        folder = job.generate(source, n_scenes, n_samples)
        generate_s = bench.stage(folder, "generate")["seconds"]
        for threads in (2, 1) if (n_scenes, n_samples) in (cases[0], cases[-1]) else (2,):
            evaluated = job.evaluate(folder, threads)
            rate = f"{n_scenes * n_samples / evaluated[1]:.0f}"
            rows.append([n_scenes, n_samples, threads, *figures(evaluated), rate, f"{generate_s:.1f}"])
    print("Evaluation, with verdicts, metrics and the corpus:\n")
    header = ["scenes", "samples a scene", "threads", *(f"evaluate {u}" for u in UNITS), "samples per CPU s"]
    bench.table([*header, "generate s (4 evaluations)"], rows)


def by_threads(job):
    n_cores = os.cpu_count() or 1
    counts = sorted({2**i for i in range(n_cores.bit_length())} | {n_cores})
    measured = [job.whole_run(threads) for threads in counts]
    rows = [[threads, *(f"{s:.2f}" for s in seconds)] for threads, seconds in zip(counts, measured)]
    rows.append(["ratio", *(f"{first / last:.2f}" for first, last in zip(measured[0], measured[-1]))])
    print("Threads, seconds of the stages (all scenes with maps; cut-ins with negatives; 480 samples by ten evaluations):\n")
    bench.table(["threads", *STAGES], rows)


if __name__ == "__main__":
    main()
