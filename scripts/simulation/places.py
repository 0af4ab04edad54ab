"""The catalog of places: families of geometry, and variants of each that differ in angles, radii, widths and lanes."""

import zlib

import numpy as np

from simulation import crossings, highways, motorways, roundabouts, streets

HELD_OUT = "held-out"


def catalog():
    """Place names to (family, maker, arguments, options); makers also take the name and a generator of random numbers."""
    places = {}

    def add(family, prefix, maker, variants):
        for letter, (args, options) in zip("ABCDEFGH", variants):
            places[f"SIM_{prefix}{letter}"] = (family, maker, args, options)

    add("merge", "Merge", highways.merge, [((2,), {}), ((3,), {}), ((2,), {"straightness": 160.0}), ((1,), {})])
    add("weave", "Weave", highways.weave, [((2,), {}), ((3,), {}), ((2,), {})])
    add("lane drop", "LaneDrop", highways.lane_drop, [((3,), {}), ((4,), {}), ((2,), {})])
    add("motorway", "Motorway", motorways.motorway, [
        ((3, "european"), {"both": True, "half_view_m": 160.0}),
        ((3, "european"), {"ramp": "on"}),
        ((4, "european"), {"ramp": "off", "half_view_m": 220.0}),
        ((5, "american"), {"ramp": "weave", "jams": 0.6}),
        ((4, "american"), {"ramp": "on", "jams": 0.4, "half_view_m": 170.0}),
        ((5, "american"), {"half_view_m": 210.0}),
        ((3, "european"), {"ramp": "weave", "jams": 0.5, "half_view_m": 180.0}),
        ((3, "american"), {"both": True, "jams": 0.3, "half_view_m": 150.0}),
    ])  # fmt: skip
    add("roundabout, one lane", "RoundaboutOne", roundabouts.roundabout, [
        (([5, 95, 180, 275], 10.0), {}),
        (([0, 110, 230], 8.0), {}),
        (([0, 70, 165, 260], 13.0), {}),
        (([0, 85, 200, 290], 16.0), {"half_view_m": 65.0}),
    ])  # fmt: skip
    add("roundabout, two lanes", "RoundaboutTwo", roundabouts.roundabout, [
        (([0, 90, 180, 270], 17.0, 2), {"half_view_m": 55.0, "busy": 0.7}),
        (([0, 105, 190, 280], 20.0, 2), {"half_view_m": 58.0, "busy": 0.7}),
        (([0, 120, 240], 15.0, 2), {"half_view_m": 55.0, "busy": 0.75}),
    ])  # fmt: skip
    add("all-way stop", "AllWayStop", crossings.all_way_stop, [
        (([0, 90, 180, 270], [(2, 2), (1, 1), (2, 2), (1, 1)], 7.0), {}),
        (([0, 82, 175, 268], [(1, 1), (1, 1), (1, 1), (1, 1)], 6.0), {}),
        (([0, 100, 200], [(2, 2), (1, 1), (2, 2)], 8.0), {}),
        (([0, 75, 180, 255], [(2, 1), (2, 1), (2, 1), (2, 1)], 7.5), {"per_hour": 150.0}),
    ])  # fmt: skip
    add("priority road", "Priority", crossings.minor_road, [
        (([0, 180, 270], [(1, 1), (1, 1), (1, 1)], 8.0), {}),
        (([0, 172, 85, 262], [(1, 1), (1, 1), (1, 1), (1, 1)], 6.5), {}),
        (([0, 165, 245], [(2, 2), (2, 2), (1, 1)], 9.0), {"stop": False}),
        (([0, 180, 65, 245], [(2, 2), (2, 2), (1, 1), (1, 1)], 8.0), {}),
    ])  # fmt: skip
    add("signals", "Signals", crossings.signals, [
        (([0, 90, 180, 270], [(2, 2)] * 4, 9.0, 60), {}),
        (([0, 80, 180, 265], [(2, 2), (1, 1), (2, 2), (1, 1)], 8.0, 50), {"pockets": (0, 2)}),
        (([0, 180, 275], [(2, 2), (2, 2), (2, 2)], 9.0, 55), {"pockets": (1,)}),
        (([0, 105, 190, 285], [(3, 2), (2, 2), (3, 2), (2, 2)], 10.0, 70), {"half_view_m": 48.0, "per_hour": 220.0}),
    ])  # fmt: skip
    add("arterial", "Arterial", streets.arterial, [
        (((2, 2), 90.0, (0.9,)), {}),
        (((2, 2), 60.0, (0.6, -0.7)), {"side_angle": 95.0}),
        (((3, 2), 130.0, (-0.5, 0.6)), {"side_angle": 65.0}),
    ])  # fmt: skip
    add("parking exit", "Driveway", streets.driveway, [
        (((1, 1), [(-5.0, True, 90.0)]), {}),
        (((2, 1), [(-20.0, True, 80.0), (18.0, False, 95.0)]), {}),
        (((1, 1), [(0.0, False, 70.0)]), {"bend_m": 70.0, "turns": (0.7,)}),
    ])  # fmt: skip
    add(HELD_OUT, "HeldOutRoundabout", roundabouts.roundabout, [(([10, 80, 150, 222, 295], 18.0), {"half_view_m": 62.0, "busy": 0.8})])
    add(HELD_OUT, "HeldOutMerge", highways.merge, [((3,), {"straightness": 200.0})])
    add(HELD_OUT, "HeldOutMotorway", motorways.motorway, [((4, "american"), {"ramp": "weave", "jams": 0.3, "half_view_m": 190.0})])
    add(HELD_OUT, "HeldOutCrossing", crossings.signals, [
        (([0, 60, 185, 250], [(2, 1), (1, 2), (2, 1), (1, 2)], 8.5, 65), {"pockets": (2,), "per_hour": 260.0}),
    ])  # fmt: skip
    return places


def plan_of(name, seed):
    """The plan of a place; it depends on the name and the seed alone."""
    _, maker, args, options = catalog()[name]
    return maker(name, np.random.default_rng([seed, zlib.crc32(name.encode())]), *args, **options)
