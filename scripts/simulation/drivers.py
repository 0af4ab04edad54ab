"""Who moves: 50 kinds of drivers with vehicles for a run, from timid to pushy, and people on foot."""

import dataclasses

import numpy as np

N_CARS, N_TRUCKS, N_CYCLISTS = 40, 6, 4


@dataclasses.dataclass
class Kind:
    """A kind of road user of a run: the XML that SUMO reads, and its size in meters."""

    id: str
    xml: str
    length: float
    width: float


def kinds(rng, plan):
    """The kinds of a run at a place by class: `car`, `truck`, `cyclist`."""
    return {
        "car": [car(rng, f"car{i}", plan) for i in range(N_CARS)],
        "truck": [truck(rng, f"truck{i}", plan) for i in range(N_TRUCKS)],
        "cyclist": [cyclist(rng, f"cyclist{i}") for i in range(N_CYCLISTS)],
    }


def car(rng, id, plan):
    long = rng.random() < 0.15  # vans and pickups
    length = rng.uniform(5.0, 6.0) if long else rng.normal(4.5, 0.3)
    width = rng.uniform(1.9, 2.05) if long else rng.normal(1.82, 0.07)
    size = max(length, 3.6), max(width, 1.6)
    return motorized(rng, id, "passenger", *size, rng.uniform(1.7, 2.9), rng.normal(1.0, 0.13), plan.keep_right)


def truck(rng, id, plan):
    size = rng.uniform(*plan.truck_m), rng.uniform(2.2, 2.5)
    limits = {} if plan.truck_kmh is None else {"maxSpeed": rng.uniform(*plan.truck_kmh) / 3.6}
    return motorized(rng, id, "truck", *size, rng.uniform(0.9, 1.5), rng.normal(0.88, 0.08), plan.keep_right, **limits)


def motorized(rng, id, vehicle_class, length, width, accel, speed_factor, keep_right, **limits):
    """A driver: three in four follow by the extended intelligent driver model, the others by Krauss's."""
    pushy = rng.random()
    if rng.random() < 0.75:
        model = {"carFollowModel": "EIDM", "tau": rng.uniform(0.8, 1.7) - 0.3 * pushy}
    else:
        model = {"carFollowModel": "Krauss", "tau": rng.uniform(0.8, 1.6) - 0.2 * pushy, "sigma": rng.uniform(0.05, 0.4)}
    return kind(
        id, length, width, vClass=vehicle_class, accel=accel, decel=rng.uniform(2.8, 4.5), emergencyDecel=7.5,
        minGap=rng.uniform(1.2, 2.6), speedFactor=float(np.clip(speed_factor, 0.65, 1.35)), impatience=rng.uniform(0.0, 0.5),
        latAlignment="center", minGapLat=rng.uniform(0.5, 0.8) - 0.15 * pushy, maxSpeedLat=rng.uniform(0.8, 1.5),
        lcMaxSpeedLatStanding=0.0, lcMaxSpeedLatFactor=0.3, lcAccelLat=rng.uniform(0.7, 1.4), lcAssertive=1.0 + 1.6 * pushy, lcStrategic=rng.uniform(1.0, 2.0),
        lcPushy=0.5 * pushy, lcImpatience=0.8 * pushy, lcCooperative=rng.uniform(0.4, 1.0),
        lcSpeedGain=rng.uniform(0.5, 1.5) + 2.5 * pushy, lcKeepRight=keep_right * rng.uniform(0.0, 1.0), lcSigma=rng.uniform(0.0, 0.15),
        **model, **limits,
    )  # fmt: skip


def cyclist(rng, id):
    return kind(
        id, 1.8, 0.6, vClass="bicycle", accel=rng.uniform(0.8, 1.3), decel=2.5, emergencyDecel=5.0, tau=1.0, minGap=0.8,
        maxSpeed=rng.uniform(3.5, 6.5), speedFactor=1.0, latAlignment="right", maxSpeedLat=0.6, minGapLat=0.4,
        lcMaxSpeedLatStanding=0.0, lcMaxSpeedLatFactor=0.3,
    )  # fmt: skip


def kind(id, length, width, **attributes):
    length, width = round(length, 2), round(width, 2)
    written = " ".join(f'{key}="{value:.3f}"' if isinstance(value, float) else f'{key}="{value}"' for key, value in attributes.items())
    return Kind(id, f'<vType id="{id}" length="{length}" width="{width}" {written}/>', length, width)
