"""What the benchmarks of the front half share: children measured one by one, alternation, tables. Standard library only.

A child's processor time and peak memory come from `wait4`, so they are its own. The kernel counts the memory of the process
that starts a child as a lower bound of the child's, which is why nothing large is imported here: work happens in children.
"""

import dataclasses
import json
import os
import pathlib
import platform
import resource
import shutil
import statistics
import subprocess
import sys
import time

HERE = pathlib.Path(__file__).parent
MB = 1e6


@dataclasses.dataclass
class Usage:
    """What one run of a child took. `said` is its last line of output as JSON, if it is that. NaN: too little to be told."""

    wall_s: float
    cpu_s: float
    peak_bytes: float
    said: dict


def measure(command, env=None, silent=True):
    """Runs a command to its end; fails with its error output if it fails. `silent` drops what it prints."""
    start = time.perf_counter()
    child = subprocess.Popen(
        [str(part) for part in command],
        stdout=subprocess.DEVNULL if silent else subprocess.PIPE,
        stderr=subprocess.PIPE,
        env=dict(os.environ, **(env or {})),
        text=True,
    )
    # One pipe at a time is safe here: what is read is short, and the other end is quiet or dropped.
    out = "" if silent else child.stdout.read()
    error = child.stderr.read()
    _, status, used = os.wait4(child.pid, 0)
    wall_s = time.perf_counter() - start
    child.returncode = os.waitstatus_to_exitcode(status)
    if child.returncode != 0:
        sys.exit(f"{' '.join(str(part) for part in command)} ended with {child.returncode}:\n{error}{out}")
    # What is not above this process's own peak may be this process.
    own = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    peak_bytes = used.ru_maxrss * 1024 if used.ru_maxrss > own else float("nan")
    return Usage(wall_s, used.ru_utime + used.ru_stime, peak_bytes, last_json(out))


def in_child(work, *arguments):
    """What `work` returns, in a forked child, so that what it reads does not stay with this process."""
    receiving, sending = os.pipe()
    child = os.fork()
    if child == 0:
        try:
            os.write(sending, json.dumps(work(*arguments)).encode())
            os._exit(0)
        except BaseException:
            sys.excepthook(*sys.exc_info())
            os._exit(1)
    os.close(sending)
    with os.fdopen(receiving) as pipe:
        said = pipe.read()
    if os.waitpid(child, 0)[1] != 0:
        sys.exit(f"{work.__name__} failed")
    return json.loads(said)


def megabytes(n_bytes):
    return "below 30" if n_bytes != n_bytes else f"{n_bytes / MB:.0f}"


def last_json(text):
    lines = text.strip().splitlines()
    try:
        said = json.loads(lines[-1])
    except (IndexError, ValueError):
        return {}
    return said if isinstance(said, dict) else {}


def peer(script, *arguments):
    """Runs one of our Python peers, which ends by saying what it took once its libraries were loaded."""
    usage = measure([sys.executable, HERE / script, *arguments], silent=False)
    for key in ("wall_s", "cpu_s"):
        setattr(usage, key, usage.said[key])
    return usage


class Work:
    """In a peer: time since the libraries were loaded. `done` prints it as the last line."""

    def __init__(self):
        self.cpu_s, self.wall_s = time.process_time(), time.perf_counter()

    def used(self):
        return {"cpu_s": time.process_time() - self.cpu_s, "wall_s": time.perf_counter() - self.wall_s}

    def done(self, **more):
        print(json.dumps(self.used() | more))


def alternate(subjects, rounds):
    """Runs every subject once without counting it, then all of them in turn, round after round."""
    usages = {name: [] for name in subjects}
    for round_idx in range(rounds + 1):
        for name, run in subjects.items():
            usage = run()
            if round_idx > 0:
                usages[name].append(usage)
            print(f"  round {round_idx}: {name}: {usage.wall_s:.2f} s, cpu {usage.cpu_s:.2f} s", file=sys.stderr)
    return usages


def middle(values):
    return statistics.median(values)


def median(usages, key):
    return middle([getattr(usage, key) for usage in usages])


def spread(usages, key, digits=2):
    """Median, and in brackets the least and the greatest."""
    return spread_of([getattr(usage, key) for usage in usages], digits)


def spread_of(values, digits=2):
    middle = f"{statistics.median(values):.{digits}f}"
    return middle if len(values) == 1 else f"{middle} ({min(values):.{digits}f} to {max(values):.{digits}f})"


def table(header, rows):
    """Prints a Markdown table."""
    print("| " + " | ".join(header) + " |")
    print("|" + "---|" * len(header))
    for row in rows:
        print("| " + " | ".join(str(cell) for cell in row) + " |")
    print(flush=True)


def cpu_model():
    try:
        lines = pathlib.Path("/proc/cpuinfo").read_text().splitlines()
        fields = dict(line.split(":", 1) for line in lines if ":" in line)
        fields = {key.strip(): value.strip() for key, value in fields.items()}
        return f"{fields['model name']} (family {fields['cpu family']}, model {fields['model']})"
    except (OSError, KeyError):
        return platform.processor() or platform.machine()


def memory_gib():
    return os.sysconf("SC_PAGE_SIZE") * os.sysconf("SC_PHYS_PAGES") / 2**30


def versions(*packages):
    """The installed versions, without importing anything."""
    from importlib import metadata

    def version(package):
        try:
            return metadata.version(package)
        except metadata.PackageNotFoundError:
            return "not installed"

    return ", ".join(f"{package} {version(package)}" for package in packages)


def introduce(djinn, packages):
    """Prints what the figures belong to. Paths are shown by their last part."""
    shown = [pathlib.Path(word).name if "/" in word else word for word in sys.argv[1:]]
    version = subprocess.run([djinn, "--version"], capture_output=True, text=True, check=True).stdout.strip()
    print(f"- Command: `python scripts/{pathlib.Path(sys.argv[0]).name} {' '.join(shown)}`")
    print(f"- Machine: {cpu_model()}, {os.cpu_count()} cores, {memory_gib():.0f} GiB, Linux {platform.release()}")
    print(f"- Versions: {version}, Python {platform.python_version()}, {versions(*packages)}")
    print(f"- Load average of the machine before: {os.getloadavg()[0]:.1f} ({os.cpu_count()} would be all cores busy)")
    print(flush=True)


def conclude():
    used = resource.getrusage(resource.RUSAGE_CHILDREN)
    print(f"Load average after: {os.getloadavg()[0]:.1f}. Processor time of all of this: {used.ru_utime + used.ru_stime:.0f} s.")


def path(text):
    """An argument that is a path, found from everywhere."""
    return pathlib.Path(text).resolve()


def fresh(folder):
    """The folder, empty."""
    shutil.rmtree(folder, ignore_errors=True)
    folder.mkdir(parents=True)
    return folder


def size_of(path):
    """Bytes of a file, or of all files below a folder."""
    path = pathlib.Path(path)
    return path.stat().st_size if path.is_file() else sum(p.stat().st_size for p in path.rglob("*") if p.is_file())


def stage(folder, name):
    """The last entry of a stage in a run folder's timings.json."""
    return read_json(pathlib.Path(folder) / "timings.json")["stages"][name][-1]


def read_json(path):
    return json.loads(pathlib.Path(path).read_text())
