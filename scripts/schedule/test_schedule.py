"""Does the simulator agree with schedules that can be worked out by hand?

    python3 scripts/schedule/test_schedule.py
"""

import math
import random
import sys
import unittest
from pathlib import Path

sys.path.insert(0, str(Path(__file__).parents[1]))
from schedule.requests import play_rounds
from schedule.shards import Cluster, Unfinished, Worker, play_shards
from simulate_schedule import GRAPH, Measured, simulate, summary, take_status


class Deaths(random.Random):
    """Workers that die after so many seconds each, in the order in which they begin."""

    def __init__(self, *lifetimes):
        super().__init__(0)
        self.lifetimes = list(lifetimes)

    def expovariate(self, _rate):
        return self.lifetimes.pop(0) if self.lifetimes else math.inf


def play(n_shards, n_workers, shard_s=1.0, spread=0.0, start_s=0.0, rng=None, **more):
    return play_shards(n_shards, shard_s, spread, start_s, Cluster(workers=n_workers, **more), rng or random.Random(1))


class Shards(unittest.TestCase):
    def test_equal_shards_without_failures_take_the_longest_share(self):
        for n_shards, n_workers in ((12, 4), (13, 4), (3, 8), (1, 1), (1000, 7)):
            tally = play(n_shards, n_workers, 2.5, start_s=1.0)
            self.assertAlmostEqual(tally.seconds, 1.0 + 2.5 * math.ceil(n_shards / n_workers))
            self.assertAlmostEqual(tally.useful_s, 2.5 * n_shards)
        tally = play(12, 4)
        self.assertEqual((tally.twice_s, tally.held_s, tally.n_lookups), (0.0, 12.0, 4 * 12))

    def test_one_worker_takes_the_sum(self):
        rng = random.Random(3)
        tally = play(50, 1, 4.0, spread=0.5, rng=rng)
        self.assertAlmostEqual(tally.seconds, sum(end - begin for begin, end in tally.busy))
        self.assertEqual((len(tally.busy), tally.twice_s), (50, 0.0))
        many = play(40_000, 1, 4.0, spread=0.5)
        self.assertAlmostEqual(many.seconds / 160_000, 1.0, delta=0.01)

    def test_a_slow_worker_is_helped(self):
        class OneSlow(random.Random):
            def random(self):
                self.drawn = getattr(self, "drawn", 0) + 1
                return 0.0 if self.drawn == 2 else 1.0

        # Six shards by a worker that makes one a second and one that makes half: 6 / 1.5 seconds.
        tally = play(6, 2, rng=OneSlow(), slow_share=0.5, slow_factor=2.0)
        self.assertEqual((tally.seconds, tally.twice_s), (4.0, 0.0))

    def test_the_shards_of_a_lost_worker_are_made_by_the_others(self):
        # The second of two dies in its third shard. The first goes on from the end: 7, 5.
        tally = play(8, 2, rng=Deaths(math.inf, 2.5), kills_an_hour=1.0, retries=0)
        self.assertEqual((tally.seconds, tally.lost_s, tally.n_kills, tally.n_unfinished), (6.0, 0.5, 1, 0))
        # It comes back after a second, makes 5, and 7 at the same time as the first.
        tally = play(8, 2, rng=Deaths(math.inf, 2.5), kills_an_hour=1.0, retries=1, requeue_s=1.0)
        self.assertEqual((tally.seconds, tally.twice_s, tally.held_s), (5.5, 1.0, 5.0 + 2.5 + 2.0))
        # Nobody is left.
        tally = play(8, 1, rng=Deaths(2.5), kills_an_hour=1.0, retries=0)
        self.assertEqual((tally.seconds, tally.n_unfinished), (2.5, 6))

    def test_deaths_cost_what_renewal_theory_says(self):
        # A shard of t seconds takes (1 / rate + pause) (exp(rate t) - 1) where deaths come at this rate.
        rate, pause, shard_s, n = 1 / 600, 120.0, 300.0, 4000
        tally = play(n, 1, shard_s, kills_an_hour=3600 * rate, requeue_s=pause, retries=10**9)
        expected = n * (1 / rate + pause) * (math.exp(rate * shard_s) - 1)
        self.assertAlmostEqual(tally.seconds / expected, 1.0, delta=0.04)

    def test_a_slow_file_system_bounds_the_looking(self):
        # 4 workers look at 12 shards each: 48 lookups at 8 a second take 6 seconds of the 3 + 6.
        self.assertAlmostEqual(play(12, 4, lookups_a_second=8.0).seconds, 3.0 + 6.0)

    def test_workers_go_about_shards_as_those_of_the_program_do(self):
        def order(number, of, n_shards):
            worker, unfinished, found = Worker(number - 1, of, n_shards), Unfinished(n_shards), []
            while (idx := worker.next(unfinished)) is not None:
                found.append(idx)
                unfinished.remove(idx)
            return found

        # The values of the test of `Worker::order`.
        self.assertEqual([order(1, 2, 5), order(2, 2, 5), order(1, 1, 3)], [[0, 2, 4, 3, 1], [1, 3, 2, 0, 4], [0, 1, 2]])
        for of in range(1, 9):
            for number in range(1, of + 1):
                own = list(range(number - 1, 7, of))
                others = [idx for idx in reversed(range(7)) if idx not in own]
                self.assertEqual(order(number, of, 7), own + others[number - 1 :] + others[: number - 1])


class Requests(unittest.TestCase):
    def play(self, n_shards, n_workers, rounds, rng=None, **more):
        return play_rounds(n_shards, 1.0, 0.0, 0.0, Cluster(workers=n_workers, **more), rng or random.Random(1), rounds)

    def test_rounds_follow_each_other_and_a_lag_overlaps_them(self):
        for n_shards, n_workers, rounds, seconds in (
            (8, 4, (2, 0), 4.0),  # half of the workers wait
            (8, 4, (2, 1), 2.0),  # two rounds at once
            (12, 4, (4, 0), 3.0),
            (12, 4, (6, 0), 4.0),
            (12, 4, (6, 1), 3.0),
        ):
            tally = self.play(n_shards, n_workers, rounds)
            self.assertAlmostEqual(tally.seconds, seconds)
            self.assertAlmostEqual(tally.useful_s, n_shards)
            self.assertAlmostEqual(tally.held_s, n_workers * seconds)

    def test_what_is_not_known_when_a_shard_is_decided(self):
        self.assertEqual(self.play(12, 4, (4, 0)).undecided, 1.5)
        # The first round knows of no round before it.
        self.assertAlmostEqual(self.play(12, 4, (4, 1)).undecided, 1.5 + (0 + 4 + 4) / 3)

    def test_a_shard_of_a_lost_worker_is_made_after_a_while(self):
        # It dies at 0.5 in the only round; the other waits until 3, and is done at 4.
        tally = self.play(2, 2, (2, 0), Deaths(math.inf, 0.5), kills_an_hour=1.0, retries=0)
        self.assertEqual((tally.seconds, tally.lost_s, tally.n_kills, tally.held_s), (4.0, 0.5, 1, 4.5))

    def test_nothing_is_lost_among_many_deaths(self):
        tally = self.play(200, 5, (10, 1), kills_an_hour=600.0, retries=10**9, requeue_s=2.0, slow_share=0.4)
        made = len(tally.busy)
        self.assertTrue(tally.n_kills > 10 and made >= 200 and tally.n_unfinished == 0)
        self.assertLess(tally.useful_s + tally.twice_s + tally.lost_s, tally.held_s + 1e-9)
        # The slow take two seconds, the others one.
        self.assertTrue(200 <= tally.useful_s <= 400)


class Graph(unittest.TestCase):
    measured = {
        "jobs": {job["name"]: {"fixed_s": 10.0} for job in GRAPH if not job["workers"]}
        | {"work": {"s_a_scenario": 0.5}, "evaluate-work": {"s_a_scenario": 0.25, "fixed_s": 1.0}},
        "scenarios_a_shard": 10,
        "bytes_a_scenario": {"samples": 900, "corpus": 100},
        "files_a_shard": 4,
        "accepted_share": 0.5,
    }

    def test_jobs_follow_each_other(self):
        cluster, measured = Cluster(workers=4, queue_s=3.0, cores=2, price=3.6), Measured(**self.measured)
        rows = simulate(measured, cluster, 200)
        figures = summary(rows, measured, cluster, 200)
        # Six jobs of one process, and twenty shards of 5 and 2.5 seconds, made by four workers of two cores each.
        seconds = 8 * 3.0 + 6 * 10.0 + 5 * 2.5 + 1.0 + 5 * 1.25
        self.assertAlmostEqual(figures["hours"] * 3600, seconds)
        core_s = 2 * (6 * 10.0 + 4 * (5 * 2.5 + 1.0 + 5 * 1.25))
        self.assertAlmostEqual(figures["core_s_an_accepted_scenario"], core_s / 100)
        self.assertAlmostEqual(figures["price_an_accepted_scenario"], core_s / 1000 / 100)
        self.assertEqual((figures["objects"], figures["n_shards"], figures["gigabytes"]), (80, 20, 200 * 1000 / 1e9))
        idle = 1 - (5 * 2.5 + 5 * 1.25) / (5 * 2.5 + 1.0 + 5 * 1.25)
        self.assertAlmostEqual(figures["idle_share"], idle)
        self.assertEqual(rows, simulate(measured, cluster, 200))
        alone = summary(simulate(measured, Cluster(workers=1), 200), measured, Cluster(workers=1), 200)
        self.assertAlmostEqual(alone["hours"] * 3600, 6 * 10.0 + 20 * 5 + 1.0 + 20 * 2.5)
        self.assertAlmostEqual(alone["idle_share"], 1 / (20 * 5 + 1.0 + 20 * 2.5))

    def test_a_status_takes_the_place_of_what_was_measured(self):
        measured = Measured(**self.measured)
        measured.jobs = {name: dict(times) for name, times in measured.jobs.items()}
        take_status(measured, {"shards": {"stage": "evaluate", "seconds_a_shard": 7.0}})
        self.assertEqual((measured.shard_s("evaluate-work"), measured.shard_s("work")), (7.0, 5.0))
        with self.assertRaises(SystemExit):
            take_status(measured, {"shards": None})


if __name__ == "__main__":
    unittest.main()
