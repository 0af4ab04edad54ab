"""How fast is `djinn mine` at finding cut-ins, against shapely and numpy on the same scenes, with the same result?

    pip install numpy pyarrow shapely
    cargo build --release
    python scripts/bench_mining.py --djinn target/release/djinn --work SCRATCH --interaction ARCHIVE.zip

Ingests the archive once, then djinn (all scenes) and its peers (random scenes of them, `scripts/bench_mining_shapely.py` says how
they search) take turns. Every peer compares its events with djinn's and fails unless scene, agents, t_other and t_ego of all of
them are the same. Asked are the cut-ins alone, and cut-ins with their hard negatives, which is djinn's default.

Figures are processor time a scene. A peer's is its search alone, without reading scenes, loading libraries and writing a table.
djinn's is first that of the whole process: start, reading, search, parameters of events, the event table. A run of
`hard_brake`, which looks at no pairs, stands beside it, to show what of that is not search. With `--perf` and Linux perf
installed, the share of the search in the whole is sampled, and a second ratio given for it. SCRATCH is emptied.
"""

import argparse
import shutil
import subprocess

import bench_common as bench

CUT_INS = '[{ kind = "cut_in_paper", negative_distance_m = 0.0, same_time = true }]'
WITH_NEGATIVES = '[{ kind = "cut_in_paper" }]'
NO_PAIRS = '[{ kind = "hard_brake" }]'
DETECT = "<djinn::behavior::cut_in_paper::CutInPaper as djinn::behavior::Behavior>::detect"


class Runs:
    def __init__(self, arguments):
        self.arguments = arguments
        self.folders = {}

    def mine(self, behaviors, threads=1):
        """Mines into a folder of its own, which keeps the events for the peers."""
        scenes = self.arguments.work / "scenes"
        folder = self.folders.setdefault(behaviors, self.arguments.work / f"mine-{len(self.folders)}")
        bench.fresh(folder)
        (folder / "scenes").symlink_to(scenes / "scenes")
        return bench.measure(self.command(behaviors, threads, folder))

    def command(self, behaviors, threads, folder):
        mine = ["mine", "--output", folder, "--quiet", "--set", f"mine.behaviors={behaviors}"]
        return [self.arguments.djinn, "--threads", str(threads), *mine]

    def peer(self, style, n_scenes, negatives):
        run = self.folders[WITH_NEGATIVES if negatives else CUT_INS]
        more = ["--negatives"] if negatives else []
        scenes = ["--n-scenes", n_scenes, "--seed", self.arguments.seed]
        return bench.peer("bench_mining_shapely.py", run, "--style", style, *scenes, *more)

    def search_share(self, behaviors):
        """The share of samples inside the detector, by `perf` with call graphs. None where it cannot be had."""
        if not self.arguments.perf:
            return None
        data, folder = self.arguments.work / "perf.data", bench.fresh(self.arguments.work / "perf")
        (folder / "scenes").symlink_to(self.arguments.work / "scenes" / "scenes")
        record = ["perf", "record", "-q", "-F", "997", "--call-graph", "dwarf,16384", "-o", data]
        subprocess.run([*record, *self.command(behaviors, 1, folder)], check=True, capture_output=True)
        report = ["perf", "report", "-i", data, "--children", "--stdio", "-g", "none", "--no-inline"]
        text = subprocess.run(report, check=True, capture_output=True, text=True).stdout
        shares = [float(line.split("%")[0]) / 100 for line in text.splitlines() if line.rstrip().endswith(DETECT)]
        return max(shares, default=None)


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--djinn", type=bench.path, required=True)
    parser.add_argument("--work", type=bench.path, required=True)
    parser.add_argument("--interaction", type=bench.path, required=True)
    parser.add_argument("--rounds", type=int, default=5)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--n-scenes", type=int, default=200, help="of the quick peers; the slow ones get the first quarter of them")
    parser.add_argument("--perf", action="store_true")
    arguments = parser.parse_args()
    bench.introduce(arguments.djinn, ["numpy", "shapely", "pyarrow"])
    bench.fresh(arguments.work)
    ingest = [arguments.djinn, "ingest", arguments.interaction, "--dataset", "interaction", "--quiet"]
    bench.measure([*ingest, "--output", arguments.work / "scenes"])

    runs, few = Runs(arguments), max(arguments.n_scenes // 4, 1)
    usages = bench.alternate(
        {
            "djinn, no pairs (hard braking)": lambda: runs.mine(NO_PAIRS),
            "djinn, cut-ins": lambda: runs.mine(CUT_INS),
            "shapely, all pairs, cut-ins": lambda: runs.peer("pairs", arguments.n_scenes, False),
            "shapely, tree, cut-ins": lambda: runs.peer("tree", arguments.n_scenes, False),
            "numpy, all pairs, cut-ins": lambda: runs.peer("numpy", arguments.n_scenes, False),
            "djinn, with negatives": lambda: runs.mine(WITH_NEGATIVES),
            "shapely, all pairs, with negatives": lambda: runs.peer("pairs", arguments.n_scenes, True),
            "shapely, tree, with negatives": lambda: runs.peer("tree", few, True),
            "numpy, all pairs, with negatives": lambda: runs.peer("numpy", few, True),
        },
        arguments.rounds,
    )
    share = {"cut-ins": runs.search_share(CUT_INS), "with negatives": runs.search_share(WITH_NEGATIVES)}
    report(arguments, usages, share, runs)
    shutil.rmtree(arguments.work)
    bench.conclude()


def report(arguments, usages, share, runs):
    manifest = bench.read_json(arguments.work / "scenes" / "scenes" / "manifest.json")
    n_all, agents = manifest["n_scenes"], manifest["n_agents"] / manifest["n_scenes"]
    per_scene = {}
    for name, of_subject in usages.items():
        n = of_subject[0].said.get("n_scenes", n_all)
        per_scene[name] = (n, [usage.cpu_s / n * 1e3 for usage in of_subject])
    rows = []
    for name, (n, values) in per_scene.items():
        kind = name.split(", ")[-1]
        middle = bench.middle(values)
        whole = bench.middle(per_scene[f"djinn, {kind}"][1]) if kind in share else None
        said = usages[name][0].said
        events = f"{said['n_cut_ins']} and {said['n_negatives']}" if said else ""
        is_peer = not name.startswith("djinn")
        in_search = f"{middle / (whole * share[kind]):.0f}" if is_peer and share[kind] else ""
        rows.append([
            name,
            n,
            f"{said.get('n_agents', agents):.1f}",
            bench.spread_of(values, 3),
            f"{middle / whole:.1f}" if is_peer else "",
            in_search,
            events,
            bench.megabytes(bench.median(usages[name], "peak_bytes")),
        ])
    print(f"Same events in every run of every peer: cut-ins with both times, negatives by pair. {arguments.rounds} rounds.\n")
    header = ["", "scenes", "agents a scene", "CPU ms a scene", "ratio to djinn's whole process", "ratio to djinn's search"]
    bench.table([*header, "cut-ins and negatives compared", "peak memory MB"], rows)
    for kind, behaviors in (("cut-ins", CUT_INS), ("with negatives", WITH_NEGATIVES)):
        seconds = bench.stage(runs.folders[behaviors], "mine")["seconds"]
        sampled = "not sampled" if share[kind] is None else f"{share[kind]:.0%} of it in the search"
        print(f"- djinn, {kind}: last run's stage took {seconds:.2f} s of wall time on one thread; {sampled}.")
    print()


if __name__ == "__main__":
    main()
