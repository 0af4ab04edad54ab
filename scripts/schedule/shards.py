"""How do the workers of a plan go about its shards?"""

import dataclasses
import heapq


def setting(default, text):
    return dataclasses.field(default=default, metadata={"help": text})


@dataclasses.dataclass
class Cluster:
    """What the jobs run on."""

    workers: int = setting(100, "workers at once")
    cores: int = setting(1, "cores of a worker")
    thread_efficiency: float = setting(1.0, "what each further core of a worker adds, as a share of the first one")
    queue_s: float = setting(0.0, "seconds from when a job may begin to when it does")
    requeue_s: float = setting(120.0, "seconds until a worker that died comes back")
    kills_an_hour: float = setting(0.0, "deaths of a worker in an hour")
    retries: int = setting(10, "how often a worker comes back")
    slow_share: float = setting(0.0, "share of workers on slow nodes")
    slow_factor: float = setting(2.0, "how much longer these take")
    lookups_a_second: float = setting(0.0, "files that the shared file system opens in a second, for all workers; 0: any number")
    price: float = setting(0.04, "price of a core for an hour")

    def cores_of_worker(self):
        return 1 + (self.cores - 1) * self.thread_efficiency


@dataclasses.dataclass
class Tally:
    """What became of a job."""

    # From its beginning to its end.
    seconds: float = 0.0
    # For which workers were held, between their beginning and their end.
    held_s: float = 0.0
    # Of these, for shards that somebody had to make; for those that were made twice; lost to deaths.
    useful_s: float = 0.0
    twice_s: float = 0.0
    lost_s: float = 0.0
    n_kills: int = 0
    # Shards that were never made, because all workers were lost for good.
    n_unfinished: int = 0
    # How often a worker looked whether a shard is there.
    n_lookups: int = 0
    # Of a request: shards of which the result was not known when one was decided, on average.
    undecided: float = 0.0
    # When workers computed: (begin, end) each.
    busy: list = dataclasses.field(default_factory=list)

    def made(self, begin, end, is_first):
        """A shard was made, for the first time or once more."""
        self.busy.append((begin, end))
        if is_first:
            self.useful_s += end - begin
        else:
            self.twice_s += end - begin

    def profile(self, n_workers, n_bins=200):
        """Edges of bins of time, and how many workers computed in each."""
        if not self.busy:
            return [0.0, self.seconds], [n_workers]
        width = self.seconds / n_bins
        counts = [0.0] * n_bins
        for begin, end in self.busy:
            for i in range(int(begin / width), min(int(end / width), n_bins - 1) + 1):
                counts[i] += max(0.0, min(end, (i + 1) * width) - max(begin, i * width)) / width
        return [i * width for i in range(n_bins + 1)], counts


class Unfinished:
    """The shards that are not there yet, of which the next one from the end backward is found quickly."""

    def __init__(self, n):
        self.before = list(range(n))
        self.left = n

    def __contains__(self, idx):
        return self.before[idx] == idx

    def remove(self, idx):
        if idx in self:
            self.before[idx] = idx - 1
            self.left -= 1

    def at_or_before(self, idx):
        """The last one not after `idx`, or -1."""
        found = idx
        while found >= 0 and self.before[found] != found:
            found = self.before[found]
        while idx >= 0 and self.before[idx] != idx:
            self.before[idx], idx = found, self.before[idx]
        return found


class Worker:
    """One worker's way through the shards, as `Worker::order` of the program has it."""

    def __init__(self, number, of, n_shards):
        self.number, self.of, self.n_shards = number, of, n_shards
        self.begin()

    def begin(self):
        self.own = self.number
        # It skips as many of the others' shards, from the end, as its number says; its own do not count.
        last_own = self.number + (self.n_shards - 1 - self.number) // self.of * self.of if self.number < self.n_shards else -1
        first = self.n_shards - 1 - self.number
        self.first = max(-1, first - 1 if last_own >= first else first)
        self.cursor, self.wrapped, self.looked = self.first, False, 0

    def others(self, low, high):
        """How many shards after `low`, up to `high`, are not its own."""
        own = (high - self.number) // self.of - (low - self.number) // self.of
        return max(0, high - low - own)

    def next(self, unfinished):
        """The shard that it makes next, or None; `looked` is at how many it had to look for it."""
        self.looked = 0
        while self.own < self.n_shards:
            idx, self.own = self.own, self.own + self.of
            self.looked += 1
            if idx in unfinished:
                return idx
        while True:
            idx = unfinished.at_or_before(self.cursor) if self.cursor >= 0 else -1
            low = self.first if self.wrapped else -1
            if idx > low:
                self.looked += self.others(idx - 1, self.cursor)
                self.cursor = idx - 1
                return idx
            self.looked += self.others(low, self.cursor)
            if self.wrapped or self.first >= self.n_shards - 1:
                self.cursor = low
                return None
            self.cursor, self.wrapped = self.n_shards - 1, True


class Workers:
    """Who is slow, who dies when, and who comes back: the same for all kinds of work."""

    def __init__(self, cluster, rng, start_s, tally):
        self.cluster, self.rng, self.tally = cluster, rng, tally
        self.slow = [rng.random() < cluster.slow_share for _ in range(cluster.workers)]
        self.dies_at = [lifetime(cluster, rng) for _ in self.slow]
        self.restarts, self.began = [0] * cluster.workers, [0.0] * cluster.workers
        self.start_s = start_s

    def seconds(self, number, shard_s, spread):
        """What a shard takes this worker."""
        return shard_s * (self.cluster.slow_factor if self.slow[number] else 1.0) * log_normal(spread, self.rng)

    def die(self, number, since):
        """The worker dies, at work since then. Returns when it begins again, or None."""
        died = self.dies_at[number]
        self.tally.n_kills += 1
        self.tally.lost_s += max(0.0, died - since)
        self.tally.held_s += died - self.began[number]
        if self.restarts[number] == self.cluster.retries:
            self.began[number] = self.dies_at[number] = float("inf")
            return None
        self.restarts[number] += 1
        self.began[number] = died + self.cluster.requeue_s
        self.dies_at[number] = self.began[number] + lifetime(self.cluster, self.rng)
        return self.began[number]


def play_shards(n_shards, shard_s, spread, start_s, cluster, rng):
    """Plays the workers of one job until each has seen every shard finished."""
    tally, unfinished = Tally(), Unfinished(n_shards)
    workers = Workers(cluster, rng, start_s, tally)
    look_s = cluster.workers / cluster.lookups_a_second if cluster.lookups_a_second else 0.0
    ways = [Worker(number, cluster.workers, n_shards) for number in range(cluster.workers)]
    # (when, worker, shard that it has made, when it began with it); no shard: the worker begins.
    events = [(0.0, number, None, 0.0) for number in range(cluster.workers)]
    # Whoever decides at a moment knows of all that is finished then.
    free = []
    while events or free:
        if not free or (events and events[0][0] == free[0][0]):
            now, number, made, since = heapq.heappop(events)
            if made is not None:
                tally.made(since, now, made in unfinished)
                unfinished.remove(made)
            free.append((now, number, made))
            continue
        now, number, made = free.pop(0)
        shard = ways[number].next(unfinished)
        tally.n_lookups += ways[number].looked
        begin = now + (start_s if made is None else 0.0) + ways[number].looked * look_s
        end = begin if shard is None else begin + workers.seconds(number, shard_s, spread)
        tally.seconds = max(tally.seconds, min(end, workers.dies_at[number]))
        if workers.dies_at[number] < end:
            if (again := workers.die(number, begin)) is not None:
                ways[number].begin()
                heapq.heappush(events, (again, number, None, again))
        elif shard is None:
            tally.held_s += end - workers.began[number]
        else:
            heapq.heappush(events, (end, number, shard, begin))
    tally.n_unfinished = unfinished.left
    return tally


def lifetime(cluster, rng):
    return rng.expovariate(cluster.kills_an_hour / 3600) if cluster.kills_an_hour else float("inf")


def log_normal(spread, rng):
    """A factor whose mean is 1."""
    return rng.lognormvariate(-spread * spread / 2, spread) if spread else 1.0
