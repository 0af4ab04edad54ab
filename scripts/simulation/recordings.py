"""Whole recordings of a place: ten minutes of traffic each, in INTERACTION's v1.1 form with its Lanelet2 map."""

import pathlib
import zlib

import numpy as np

from fixtures import interaction
from fixtures.traffic import DT_S
from simulation import lanelet_map, lanelets, network, places, runs

N_FRAMES = round(runs.DURATION_S / DT_S)


class Place:
    """A place with its network and map, from which recordings are made one by one."""

    def __init__(self, name, seed, scratch):
        self.name, self.seed, self.scratch = name, seed, pathlib.Path(scratch)
        self.plan = places.plan_of(name, seed)
        self.net_file = network.build(self.plan, self.scratch)
        self.net = network.Network(self.net_file)

    def write_map(self, folder):
        """Writes the maps below `folder`."""
        (folder / "maps").mkdir(parents=True, exist_ok=True)
        for kind, text in lanelet_map.documents(lanelets.lanelets_of(self.net, self.plan), self.net).items():
            (folder / "maps" / f"{self.name}.{kind}").write_text(text)

    def tracks(self, number):
        """The tracks of recording `number`, which depend on the place, the seed and the number alone."""
        rng = np.random.default_rng([self.seed, zlib.crc32(self.name.encode()), 2, number])
        tracks = runs.simulate(self.plan, self.net, self.net_file, rng, int(rng.integers(1 << 30)), self.scratch)
        return [track.window(0, N_FRAMES) for track in tracks]

    def write(self, folder, number, tracks):
        """Writes the tables of a recording below `folder`."""
        tables = folder / "recorded_trackfiles" / self.name
        tables.mkdir(parents=True, exist_ok=True)
        vehicles, pedestrians = interaction.v1_1(tracks)
        (tables / f"vehicle_tracks_{number:03}.csv").write_text(vehicles)
        if "\n" in pedestrians:
            (tables / f"pedestrian_tracks_{number:03}.csv").write_text(pedestrians, newline="")
