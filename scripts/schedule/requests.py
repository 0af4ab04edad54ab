"""How do workers go about the shards of a request, round by round?

A round is decided from the results of earlier ones: with a lag of 0, as in the program, from all of them, so that workers wait for
each other at its end. With a lag of L, rounds are decided without the last L before them: fewer wait, and more is decided
without what was known a little later.
"""

import collections
import heapq

from .shards import Tally, Workers

# How many times the time of a shard a worker leaves one to another worker before it makes it, too.
PATIENCE = 3.0
# What happens to a worker besides that it has made a shard.
BEGINS, DIES, LOOKS = -1, -2, -3


class Rounds:
    """Which shards may be begun?"""

    def __init__(self, n_shards, size, lag):
        self.n_shards, self.size, self.lag = n_shards, size, lag
        self.left = [min(size, n_shards - begin) for begin in range(0, n_shards, size)]
        self.complete = 0
        self.is_done = [False] * n_shards
        self.free = collections.deque()
        self.decided = 0
        self.decide()

    def decide(self):
        """Opens the rounds that can be decided now."""
        while self.decided < len(self.left) and self.decided <= self.complete + self.lag:
            begin = self.decided * self.size
            self.free.extend(range(begin, begin + self.left[self.decided]))
            self.decided += 1

    def finish(self, shard):
        """Whether it was the first time."""
        if self.is_done[shard]:
            return False
        self.is_done[shard] = True
        self.left[shard // self.size] -= 1
        while self.complete < len(self.left) and self.left[self.complete] == 0:
            self.complete += 1
        self.decide()
        return True

    def are_complete(self):
        return self.complete == len(self.left)

    def undecided(self):
        """Of how many shards is the result not known when one is decided, on average?"""
        sizes = [min(self.size, self.n_shards - begin) for begin in range(0, self.n_shards, self.size)]
        unknown = (sum(sizes[max(0, i - self.lag) : i]) + (size - 1) / 2 for i, size in enumerate(sizes))
        return sum(size * n for size, n in zip(sizes, unknown)) / self.n_shards


class Request:
    """The workers of a request."""

    def __init__(self, n_shards, shard_s, spread, start_s, cluster, rng, rounds):
        self.rounds, self.tally = Rounds(n_shards, *rounds), Tally()
        self.workers = Workers(cluster, rng, start_s, self.tally)
        self.shard_s, self.spread, self.start_s = shard_s, spread, start_s
        self.idle = set()
        # Shards that somebody is at, or died at, with the time when others lose their patience.
        self.begun = {}
        # (when, worker, the shard that it has made or what else happens, when it began with that)
        self.events = [(start_s, number, BEGINS, 0.0) for number in range(cluster.workers)]
        # When each worker that waits looks next: only the last word counts.
        self.looks = [-1.0] * cluster.workers

    def play(self):
        while self.events and not self.rounds.are_complete():
            now, number, made, since = heapq.heappop(self.events)
            if made == DIES:
                # It may have died already, and come back.
                if self.workers.dies_at[number] > now:
                    continue
                self.idle.discard(number)
                if (again := self.workers.die(number, since)) is not None:
                    heapq.heappush(self.events, (again + self.start_s, number, BEGINS, 0.0))
                continue
            if made == LOOKS:
                if number not in self.idle or self.looks[number] != now:
                    continue
                self.looks[number] = -1.0
            elif made != BEGINS:
                self.finish(made, since, now)
            self.idle.discard(number)
            if not self.rounds.are_complete():
                self.take(number, now)
        busy = max((end for _, end in self.tally.busy), default=0.0)
        self.tally.seconds = max(self.start_s, busy)
        self.tally.held_s += sum(max(0.0, self.tally.seconds - begin) for begin in self.workers.began)
        self.tally.n_unfinished = sum(self.rounds.left)
        self.tally.undecided = self.rounds.undecided()
        return self.tally

    def finish(self, shard, since, now):
        n_complete = self.rounds.complete
        is_first = self.rounds.finish(shard)
        self.tally.made(since, now, is_first)
        self.begun.pop(shard, None)
        # Whoever waits sees that a round is whole.
        if self.rounds.complete > n_complete:
            for waiting in sorted(self.idle):
                self.look(waiting, now)

    def look(self, number, at):
        if self.looks[number] != at:
            self.looks[number] = at
            heapq.heappush(self.events, (at, number, LOOKS, at))

    def take(self, number, now):
        """The worker takes a shard that nobody is at, or that somebody has been at for long; else it waits."""
        self.tally.n_lookups += 1
        free, dies_at = self.rounds.free, self.workers.dies_at[number]
        shard = free.popleft() if free else next((one for one, until in self.begun.items() if until <= now), None)
        if shard is None:
            self.idle.add(number)
            next_look = min(self.begun.values())
            if dies_at < next_look:
                heapq.heappush(self.events, (max(now, dies_at), number, DIES, dies_at))
            else:
                self.look(number, next_look)
            return
        self.begun[shard] = now + PATIENCE * self.shard_s
        end = now + self.workers.seconds(number, self.shard_s, self.spread)
        if dies_at < end:
            heapq.heappush(self.events, (max(now, dies_at), number, DIES, now))
        else:
            heapq.heappush(self.events, (end, number, shard, now))


def play_rounds(n_shards, shard_s, spread, start_s, cluster, rng, rounds):
    """Plays the workers of a request of `rounds`: (shards a round, lag)."""
    return Request(n_shards, shard_s, spread, start_s, cluster, rng, rounds).play()
