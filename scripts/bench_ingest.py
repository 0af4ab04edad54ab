"""How fast is `djinn ingest`, against pandas on the same archives, and does its memory stay the same when the data grows?

    pip install numpy pandas pyarrow     # for Argoverse's own reader also: av2 (without its dependencies), universal-pathlib
    cargo build --release
    python scripts/bench_ingest.py --djinn target/release/djinn --work SCRATCH --interaction ARCHIVE.zip \\
        --argoverse1 ARCHIVE.tar.gz --argoverse2 FOLDER

Datasets that are not given are left out. First it checks that both sides hold the same: scenes, agents, classes, sizes,
validity, states (`scripts/bench_ingest_pandas.py` says what pandas does), and fails when they do not. Then both take turns,
round after round. The processor time of a peer is that after loading its libraries, that of djinn everything. Unpacking alone
is timed, too: nothing that reads the archive can be faster. `--copies N` repeats what Argoverse 2's folder holds under new
names, since one scenario takes no time; `--grow N` measures peak memory on N times the recordings (hard links under other
names), 0 leaves that out; `--loop` also times a loader of nested groupbys once, which takes minutes. Needs room for the scenes
of N times the recordings in SCRATCH, which is emptied.
"""

import argparse
import csv
import itertools
import os
import pathlib
import re
import shutil
import sys
import tarfile
import uuid
import zipfile

import bench_common as bench

POSITION_TOLERANCE = 1e-3  # single precision on both sides: 0.03 mm at 300 m, and rotations in another order


def check(scenes_folder, npz):
    """Compares what djinn wrote with what a peer wrote, in this process. Ends it with an error where they differ."""
    import numpy as np
    from bench_scenes import read_scenes

    with np.load(npz) as arrays:
        theirs = {key: arrays[key] for key in arrays.files}
    starts = np.r_[0, np.cumsum(theirs["n_agents"])]
    spans = {id: slice(a, b) for id, a, b in zip(theirs["scene_id"], starts, starts[1:])}
    worst, n_states = np.zeros(5), 0
    for scene in read_scenes(scenes_folder):
        span = spans.pop(scene.id, None)
        assert span is not None, f"pandas has no scene {scene.id}"
        t = scene.states.shape[1]
        assert list(theirs["track_id"][span]) == scene.tracks, f"{scene.id}: other agents"
        assert list(theirs["class_name"][span]) == scene.classes, f"{scene.id}: other classes"
        assert np.allclose(theirs["size"][span], scene.size, equal_nan=True), f"{scene.id}: other sizes"
        valid = theirs["valid"][span]
        assert (valid[:, :t] == scene.valid).all() and not valid[:, t:].any(), f"{scene.id}: other validity"
        difference = np.abs(theirs["states"][span][:, :t] - scene.states)
        difference[..., 2] = np.abs((difference[..., 2] + np.pi) % (2 * np.pi) - np.pi)
        difference = difference[scene.valid]
        n_states += len(difference)
        # Only Argoverse 1 has no headings, and there only pandas.
        assert np.isfinite(difference[:, [0, 1, 3, 4]]).all(), f"{scene.id}: states that are not finite"
        worst = np.fmax(worst, np.nanmax(difference, 0, initial=0))
    assert not spans, f"djinn has no scene {next(iter(spans))}"
    assert worst.max() < POSITION_TOLERANCE, f"states differ by up to {worst}"
    print(f"{n_states} states agree; largest differences (m, m, rad, m/s, m/s): {' '.join(f'{w:.1e}' for w in worst)}")


def egos_of(scenes_folder, path):
    from bench_scenes import read_scenes

    with open(path, "w", newline="") as file:
        csv.writer(file).writerows((scene.id, scene.ego) for scene in read_scenes(scenes_folder))


def unpack(archive):
    """Reads every file of an archive and drops it."""
    work = bench.Work()
    if archive.suffix == ".zip":
        with zipfile.ZipFile(archive) as zipped:
            for name in zipped.namelist():
                if name.endswith(".csv"):
                    with zipped.open(name) as file:
                        while file.read(1 << 20):
                            pass
    else:
        with tarfile.open(archive, "r|gz") as tarred:
            for member in tarred:
                if member.isfile():
                    tarred.extractfile(member).read()
    work.done()


def repeat_scenarios(source, target, n):
    """N copies of each scenario of an Argoverse 2 folder under new ids, written as the original is: same codec, one file each."""
    import pyarrow as pa
    import pyarrow.parquet as pq

    for file in sorted(source.rglob("scenario_*.parquet")):
        table = pq.read_table(file)
        codec = pq.ParquetFile(file).metadata.row_group(0).column(0).compression
        at = table.schema.get_field_index("scenario_id")
        for i in range(n):
            name = str(uuid.uuid5(uuid.NAMESPACE_URL, f"{file.stem}/{i}"))
            folder = target / "train" / name
            folder.mkdir(parents=True)
            ids = pa.array([name] * len(table)).cast(table.schema.field(at).type)
            pq.write_table(table.set_column(at, table.schema.field(at), ids), folder / f"scenario_{name}.parquet", compression=codec)
            os.link(next(file.parent.glob("log_map_archive_*.json")), folder / f"log_map_archive_{name}.json")


class Subject:
    """An archive and all who read it."""

    def __init__(self, arguments, dataset, source):
        self.djinn, self.work = arguments.djinn, arguments.work / dataset
        self.dataset, self.source = dataset, source
        bench.fresh(self.work)

    def ingest(self, source, name, *more, maps=False):
        folder = bench.fresh(self.work / name)
        # Argoverse 1 keeps its maps elsewhere, and what pandas does has none.
        settings = [] if maps else ["--set", 'ingest.maps="none"']
        # Nor does pandas smooth.
        settings += ["--set", "ingest.smooth_tracks=false"]
        command = [self.djinn, "ingest", source, "--dataset", self.dataset, "--output", folder, "--quiet"]
        return bench.measure([*command, *settings, *more])

    def pandas(self, style, *more):
        path = self.work / f"{style}.npz"
        return bench.peer("bench_ingest_pandas.py", self.dataset, self.source, path, "--style", style, *more)

    def subjects(self, styles):
        both = {
            "djinn, 2 threads": lambda: self.ingest(self.source, "two", "--threads", "2"),
            "djinn, 1 thread": lambda: self.ingest(self.source, "one", "--threads", "1"),
        }
        if self.dataset != "argoverse1":
            both["djinn, 2 threads, with maps"] = lambda: self.ingest(self.source, "maps", "--threads", "2", maps=True)
        names = {"vectorized": "pandas, vectorized", "av2": "av2, the dataset's package"}
        for style in styles:
            both[names[style]] = lambda style=style: self.pandas(style)
        if self.source.is_file():
            both["unpacking alone, Python"] = lambda: bench.peer("bench_ingest.py", "--unpack", self.source)
            tool = ["unzip", "-p", self.source, "*.csv"] if self.source.suffix == ".zip" else ["gzip", "-dc", self.source]
            if shutil.which(tool[0]):
                both[f"unpacking alone, {tool[0]}"] = lambda: bench.measure(tool)
        return both

    def verify(self, styles):
        self.ingest(self.source, "check")
        scenes, egos = self.work / "check" / "scenes", self.work / "egos.csv"
        bench.measure([sys.executable, __file__, "--write-egos", scenes, egos])
        for style in styles:
            self.pandas(style, "--egos", egos)
            arguments = [sys.executable, __file__, "--check", scenes, self.work / f"{style}.npz"]
            said = os.popen(" ".join(f"'{a}'" for a in arguments) + " 2>&1").read().strip()
            print(f"- {self.dataset}, {style}: {said}", flush=True)
            if "states agree" not in said:
                sys.exit("djinn and its peer do not hold the same; their times cannot be compared")

    def unpacked_bytes(self):
        if self.source.suffix == ".zip":
            with zipfile.ZipFile(self.source) as archive:
                return sum(info.file_size for info in archive.infolist() if info.filename.endswith(".csv"))
        if self.source.is_dir():
            return sum(file.stat().st_size for file in self.source.rglob("scenario_*.parquet"))
        with tarfile.open(self.source, "r|gz") as archive:
            return sum(member.size for member in archive if member.isfile())

    def compare(self, rounds, styles, loop):
        packed, unpacked = bench.size_of(self.source), self.unpacked_bytes()
        if self.source.is_dir():
            packed = unpacked
        usages = bench.alternate(self.subjects(styles), rounds)
        if loop and self.dataset == "interaction":
            usages["pandas, nested groupbys (once)"] = [self.pandas("loop")]
        n_scenes = usages["pandas, vectorized"][0].said["n_scenes"]
        base = usages["djinn, 2 threads"]
        shape = f"{packed / bench.MB:.1f} MB, {unpacked / bench.MB:.1f} MB unpacked, {n_scenes} scenes, {rounds} rounds"
        print(f"{self.dataset}: {shape}\n")
        rows = []
        for name, runs in usages.items():
            wall, cpu = bench.median(runs, "wall_s"), bench.median(runs, "cpu_s")
            rows.append([
                name,
                bench.spread(runs, "wall_s"),
                bench.spread(runs, "cpu_s"),
                f"{cpu / bench.median(base, 'cpu_s'):.2f}",
                f"{packed / bench.MB / wall:.1f}",
                f"{unpacked / bench.MB / wall:.0f}",
                f"{unpacked / bench.MB / cpu:.0f}",
                "" if name.startswith("unpack") else f"{n_scenes / wall:.0f}",
                bench.megabytes(bench.median(runs, "peak_bytes")),
            ])
        header = ["", "wall s", "CPU s", "CPU, ratio to the first row", "archive MB/s", "unpacked MB/s", "unpacked MB per CPU s"]
        bench.table([*header, "scenes/s", "peak memory MB"], rows)

    def grow(self, n):
        """Peak memory on the recordings once, and n times under other names."""
        rows = []
        for copies in (1, n):
            folder = bench.fresh(self.work / "grown")
            n_bytes = bench.in_child(self.unfold, folder, copies)
            usages = []
            for threads in ("1", "2"):
                usages.append(self.ingest(folder, "out", "--threads", threads, maps=self.dataset != "argoverse1"))
                shutil.rmtree(self.work / "out")
            peaks = [bench.megabytes(usage.peak_bytes) for usage in usages]
            rows.append([self.dataset, f"{n_bytes / bench.MB:.0f}", *peaks, f"{usages[-1].cpu_s:.1f}"])
            shutil.rmtree(folder)
        return rows

    def unfold(self, folder, copies):
        """The unpacked recordings and, as hard links under other places or numbers, copies of them. Returns the bytes of all."""
        n_bytes = 0
        if self.dataset == "argoverse2":
            for file in self.source.rglob("*"):
                if file.is_file():
                    new = folder / file.relative_to(self.source)
                    new.parent.mkdir(parents=True, exist_ok=True)
                    os.link(file, new)
                    n_bytes += file.stat().st_size if file.suffix == ".parquet" else 0
            return n_bytes
        for name, content in members(self.source):
            first = folder / name
            first.parent.mkdir(parents=True, exist_ok=True)
            first.write_bytes(content)
            n_bytes += copies * len(content) * name.endswith(".csv")
            for copy in range(1, copies):
                os.link(first, first.with_name(renamed(self.dataset, first.name, copy)))
        return n_bytes


def renamed(dataset, name, copy):
    if dataset == "argoverse1":
        return f"{copy}{int(pathlib.PurePath(name).stem):07d}.csv"
    return re.sub(r"(_(?:train|val|obs))?(\.\w+)$", lambda match: f"{copy}{match[0]}", name)


def members(archive):
    if archive.suffix == ".zip":
        with zipfile.ZipFile(archive) as zipped:
            for name in zipped.namelist():
                if not name.endswith("/"):
                    yield name, zipped.read(name)
    else:
        with tarfile.open(archive, "r|gz") as tarred:
            for member in tarred:
                if member.isfile():
                    yield member.name, tarred.extractfile(member).read()


def main():
    if len(sys.argv) > 2 and sys.argv[1] == "--unpack":
        return unpack(pathlib.Path(sys.argv[2]))
    if len(sys.argv) > 3 and sys.argv[1] == "--check":
        return check(*map(pathlib.Path, sys.argv[2:4]))
    if len(sys.argv) > 3 and sys.argv[1] == "--write-egos":
        return egos_of(*map(pathlib.Path, sys.argv[2:4]))
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--djinn", type=bench.path, required=True)
    parser.add_argument("--work", type=bench.path, required=True)
    for dataset in ("interaction", "argoverse1", "argoverse2"):
        parser.add_argument(f"--{dataset}", type=bench.path)
    parser.add_argument("--rounds", type=int, default=5, help="0: measure memory alone")
    parser.add_argument("--copies", type=int, default=200)
    parser.add_argument("--grow", type=int, default=10)
    parser.add_argument("--loop", action="store_true")
    arguments = parser.parse_args()
    bench.introduce(arguments.djinn, ["numpy", "pandas", "pyarrow", "av2"])
    subjects = []
    for dataset in ("interaction", "argoverse1", "argoverse2"):
        source = getattr(arguments, dataset)
        if source is None:
            continue
        styles = ["vectorized"]
        if dataset == "argoverse2":
            styles += [] if bench.versions("av2").endswith("not installed") else ["av2"]
            copies = bench.fresh(arguments.work / "copies")
            bench.in_child(repeat_scenarios, source, copies, arguments.copies)
            source = copies
        subjects.append((Subject(arguments, dataset, source), styles))
    if arguments.rounds:
        print("Same content on both sides:\n")
        for subject, styles in subjects:
            subject.verify(styles)
        print()
        for subject, styles in subjects:
            subject.compare(arguments.rounds, styles, arguments.loop)
    if arguments.grow:
        print(f"Peak memory of `djinn ingest` as the recordings grow {arguments.grow}-fold (unpacked, as a folder):\n")
        grown = [s.grow(arguments.grow) for s, _ in subjects if s.dataset != "argoverse2"]
        header = ["dataset", "recordings MB", "peak MB, 1 thread", "peak MB, 2 threads", "CPU s, 2 threads"]
        bench.table(header, itertools.chain.from_iterable(grown))
    shutil.rmtree(arguments.work)
    bench.conclude()


if __name__ == "__main__":
    main()
