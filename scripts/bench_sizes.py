"""How many bytes does a state of an agent take in our files, in CSV and in Argoverse 2's Parquet?

    pip install numpy pyarrow
    cargo build --release
    python scripts/bench_sizes.py --djinn target/release/djinn --work SCRATCH --interaction ARCHIVE.zip \\
        --argoverse2 FOLDER --denoiser pipelines/models/simulated_places.safetensors

An agent-step is a state that was tracked, which is a row in all of the formats compared. Recordings are measured as they came and
as scenes; a corpus of generated scenarios as we write it, and exported by `djinn export` to both formats, with the same states.
SCRATCH is emptied.
"""

import argparse
import pathlib
import shutil
import zipfile

import bench_common as bench
import pyarrow.parquet as pq
from bench_scenes import read_scenes


def parquet_rows(folder):
    return sum(pq.read_metadata(file).num_rows for file in pathlib.Path(folder).rglob("*.parquet"))


def csv_rows(files):
    return sum(content.count(b"\n") - 1 for content in files)


def steps_of(scenes_folder):
    """Tracked states, and places for states, which Arrow shards have for every timestep of every agent."""
    tracked = places = 0
    for scene in read_scenes(scenes_folder):
        tracked += int(scene.valid.sum())
        places += scene.valid.size
    return tracked, places


def column_bytes(folder):
    """Compressed bytes by column."""
    found = {}
    for file in pathlib.Path(folder).rglob("*.parquet"):
        metadata = pq.read_metadata(file)
        for group in range(metadata.num_row_groups):
            for i in range(metadata.num_columns):
                column = metadata.row_group(group).column(i)
                name = column.path_in_schema
                found[name] = found.get(name, 0) + column.total_compressed_size
    return found


def ingest(djinn, source, dataset, folder, *more):
    bench.measure([djinn, "ingest", source, "--dataset", dataset, "--output", folder, "--quiet", *more])
    return folder / "scenes"


def recordings(arguments):
    rows = []

    def add(name, n_bytes, steps, note):
        rows.append([name, f"{n_bytes / bench.MB:.2f}", steps, f"{n_bytes / steps:.1f}", note])

    with zipfile.ZipFile(arguments.interaction) as archive:
        tables = [info for info in archive.infolist() if info.filename.endswith(".csv")]
        n_rows = csv_rows(archive.read(info) for info in tables)
        add("INTERACTION v1.2, CSV", sum(info.file_size for info in tables), n_rows, "three decimals")
        add("the same in its zip", sum(info.compress_size for info in tables), n_rows, "")
    scenes = ingest(arguments.djinn, arguments.interaction, "interaction", arguments.work / "interaction")
    tracked, places = steps_of(scenes)
    shards = sum(file.stat().st_size for file in scenes.glob("scenes-*.arrow"))
    add("its scenes, Arrow shards", shards, tracked, f"mapped, not compressed; {tracked / places:.0%} of the places hold a state")
    if arguments.argoverse2:
        files = list(arguments.argoverse2.rglob("scenario_*.parquet"))
        n_rows = sum(pq.read_metadata(file).num_rows for file in files)
        add("Argoverse 2, Parquet", sum(file.stat().st_size for file in files), n_rows, f"{len(files)} scenario(s), no sizes")
        scenes = ingest(arguments.djinn, arguments.argoverse2, "argoverse2", arguments.work / "av2")
        tracked, places = steps_of(scenes)
        shards = sum(file.stat().st_size for file in scenes.glob("scenes-*.arrow"))
        note = f"agents at present, no static ones; {tracked / places:.0%} of the places hold a state"
        add("its scenes, Arrow shards", shards, tracked, note)
    print("Recordings:\n")
    bench.table(["", "MB", "agent-steps", "bytes an agent-step", ""], rows)


def corpus(arguments):
    pipeline = arguments.work / "corpus.toml"
    pipeline.write_text(
        '[run]\nseed = 1\n[ingest]\ndataset = "interaction"\ninputs = ["%s"]\nsplits = ["val"]\n'
        '[mine]\nbehaviors = [{ kind = "cut_in" }]\n[train.denoiser]\ncheckpoint = "%s"\n'
        '[generate]\nsampler = { kind = "dpmpp_2m", n_steps = 4 }\n'
        '[[generate.sweeps]]\nname = "plain"\nn_scenes = %d\nn_samples = 4\n[evaluate]\nkeep = "all"\n'
        % (arguments.interaction, arguments.denoiser, arguments.n_scenes)
    )
    bench.measure([arguments.djinn, "run", pipeline, "--output", arguments.work / "runs", "--quiet"])
    run = next((arguments.work / "runs").rglob("timings.json")).parent
    tracks = run / "corpus" / "tracks"
    n_rows = parquet_rows(tracks)
    rows = []

    def add(name, n_bytes, note):
        rows.append([name, f"{n_bytes / bench.MB:.2f}", f"{n_bytes / n_rows:.1f}", note])

    by_column = column_bytes(tracks)
    world = sum(n for name, n in by_column.items() if name.startswith("world_"))
    note = f"scene and world frame; of it the world frame in double precision {world / n_rows:.1f}"
    add("corpus, tracks", bench.size_of(tracks), note)
    add("corpus, all tables", bench.size_of(run / "corpus"), "with scenarios, metrics, the recordings they came from, lanes")
    add("sample shards", bench.size_of(run / "samples"), "scene frame alone")
    for name, pattern in (("interaction", "*.csv"), ("argoverse2", "*.parquet")):
        folder = arguments.work / name / "export"
        folder.parent.mkdir(exist_ok=True)
        bench.measure([arguments.djinn, "export", name, run / "corpus", "--out", folder, "--quiet"])
        files = list(folder.rglob(pattern))
        if name == "interaction":
            exported = csv_rows(file.read_bytes() for file in files)
        else:
            exported = sum(pq.read_metadata(file).num_rows for file in files)
        n_bytes = sum(file.stat().st_size for file in files) * n_rows / exported
        note = f"{len(files)} files, {exported} rows" + ("" if exported == n_rows else ", scaled to all")
        add(f"exported to {name}", n_bytes, note)
    print(f"A corpus of {arguments.n_scenes * 4} generated scenarios, {n_rows} agent-steps:\n")
    bench.table(["", "MB", "bytes an agent-step", ""], rows)
    largest = sorted(by_column.items(), key=lambda item: -item[1])[:10]
    print("Largest columns of its tracks, bytes an agent-step: ", end="")
    print(", ".join(f"`{name}` {n / n_rows:.2f}" for name, n in largest) + ".\n")


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    for name in ("djinn", "work", "interaction", "denoiser"):
        parser.add_argument(f"--{name}", type=bench.path, required=True)
    parser.add_argument("--argoverse2", type=bench.path)
    parser.add_argument("--n-scenes", type=int, default=50)
    arguments = parser.parse_args()
    bench.introduce(arguments.djinn, ["pyarrow"])
    bench.fresh(arguments.work)
    recordings(arguments)
    corpus(arguments)
    shutil.rmtree(arguments.work)
    bench.conclude()


if __name__ == "__main__":
    main()
