"""How do workers go about the shards of a request, round by round?

A round is decided from the results of earlier ones: with a lag of 0, as in the program, from all of them, so that workers wait for
each other at its end. With a lag of L, rounds are decided without the last L before them: fewer wait, and more is decided
without what was known a little later.
"""

import collections
import heapq

from .shards import Tally, lifetime, log_normal

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

    def undecided(self):
        """Of how many shards is the result not known when one is decided, on average?"""
        sizes = [min(self.size, self.n_shards - begin) for begin in range(0, self.n_shards, self.size)]
        unknown = (sum(sizes[max(0, i - self.lag) : i]) + (size - 1) / 2 for i, size in enumerate(sizes))
        return sum(size * n for size, n in zip(sizes, unknown)) / self.n_shards


def play_rounds(n_shards, shard_s, spread, start_s, cluster, rng, rounds):
    """Plays the workers of a request of `rounds`: (shards a round, lag)."""
    state, tally = Rounds(n_shards, *rounds), Tally()
    slow = [rng.random() < cluster.slow_share for _ in range(cluster.workers)]
    dies_at = [start_s + lifetime(cluster, rng) for _ in slow]
    restarts, began, idle = [0] * cluster.workers, [0.0] * cluster.workers, set()
    # Shards that somebody is at, or died at, with the time when others lose their patience.
    begun = {}
    events = [(start_s, number, BEGINS, 0.0) for number in range(cluster.workers)]
    # When each worker that waits looks next: only the last word counts.
    looks = [0.0] * cluster.workers

    def look(number, at):
        if looks[number] != at:
            looks[number] = at
            heapq.heappush(events, (at, number, LOOKS, at))

    while events and state.complete < len(state.left):
        now, number, made, since = heapq.heappop(events)
        if made == DIES:
            tally.held_s += now - began[number]
            idle.discard(number)
            if restarts[number] < cluster.retries:
                restarts[number] += 1
                began[number] = now + cluster.requeue_s
                dies_at[number] = began[number] + start_s + lifetime(cluster, rng)
                heapq.heappush(events, (began[number] + start_s, number, BEGINS, 0.0))
            else:
                began[number] = float("inf")
            continue
        if made == LOOKS:
            if number not in idle or looks[number] != now:
                continue
            looks[number] = -1.0
        elif made != BEGINS:
            tally.busy.append((since, now))
            n_complete = state.complete
            if state.finish(made):
                tally.useful_s += now - since
                begun.pop(made, None)
            else:
                tally.twice_s += now - since
            # Whoever waits sees it.
            if state.complete > n_complete:
                for waiting in sorted(idle):
                    look(waiting, now)
        idle.discard(number)
        shard = state.free.popleft() if state.free else next((s for s, until in begun.items() if until <= now), None)
        tally.n_lookups += 1
        if shard is None:
            idle.add(number)
            if dies_at[number] < min(begun.values(), default=float("inf")):
                tally.n_kills += 1
                heapq.heappush(events, (dies_at[number], number, DIES, 0.0))
                dies_at[number] = float("inf")
            elif begun:
                look(number, min(begun.values()))
            continue
        begun[shard] = now + PATIENCE * shard_s
        end = now + shard_s * (cluster.slow_factor if slow[number] else 1.0) * log_normal(spread, rng)
        if dies_at[number] < end:
            tally.n_kills += 1
            tally.lost_s += max(0.0, dies_at[number] - now)
            heapq.heappush(events, (max(now, dies_at[number]), number, DIES, 0.0))
        else:
            heapq.heappush(events, (end, number, shard, now))
        tally.seconds = max(tally.seconds, now)
    # All end when they see the last round whole.
    tally.seconds = max((end for _, end in tally.busy), default=start_s) if state.complete == len(state.left) else tally.seconds
    tally.held_s += sum(max(0.0, tally.seconds - begin) for begin in began)
    tally.n_unfinished = sum(state.left)
    tally.undecided = state.undecided()
    return tally
