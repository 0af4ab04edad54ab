#!/usr/bin/env python3
"""Writes tests/golden/careful_driver.json: encounters on a straight road, and what the careful driver makes of them.

Usage: python scripts/golden_careful_driver.py [OUTPUT]

The definitions are those of src/metrics/careful_driver/mod.rs, for boxes along x. Looks are 0.1 s apart; motion is
integrated in steps of a millisecond, so that the code is compared with braking that grows continuously. Each encounter
has the ego's speed, the states of the others every 0.1 s from -0.9 s to 5 s, when hard braking begins, and by how much
later the driver could react.
"""

import json
import sys
from pathlib import Path

import numpy as np

LOOK_S, STEP_S, PAST_S, END_S, AFTER_S = 0.1, 0.001, 0.9, 5.0, 5.0
EGO = (4.5, 1.9)
SIZES = {"vehicle": (4.5, 1.9), "pedestrian": (0.5, 0.5)}
NEEDS_M, LANE_M = 1.9 / 2 + 0.2, 1.75 - 0.3


def stopping_m(v):
    """From this speed: 12.65 m/s^3 for 0.6 s, then 7.593 m/s^2."""
    jerk, most = 7.593 / 0.6, 7.593
    if v <= most * 0.3:
        t = np.sqrt(2 * v / jerk)
        return v * t - jerk * t**3 / 6
    return v * 0.6 - jerk * 0.6**3 / 6 + (v - most * 0.3) ** 2 / (2 * most)


class Other:
    """Somebody by class and a function of time to x, y of the center, and velocity; straight on after the end."""

    def __init__(self, kind, at):
        self.kind, self.motion, (self.length, self.width) = kind, at, SIZES[kind]
        self.offsets, self.speeds, self.coming, self.braking, self.revealed = [], [], None, None, None
        self.danger, self.hidden, self.in_way = None, False, False

    def at(self, t):
        if t <= END_S:
            return self.motion(t)
        x, y, vx, vy = self.motion(END_S)
        return x + vx * (t - END_S), y + vy * (t - END_S), vx, vy


def look(others, t, ego_x, ego_v):
    seen = []
    for other in others:
        x, y, vx, _ = other.at(t)
        seen.append((abs(y), abs(y) - other.width / 2, x - other.length / 2 - ego_x - EGO[0] / 2, ego_v - vx, vx))
    covers = [
        gap for other, (offset, flank, gap, _, _) in zip(others, seen)
        if other.kind == "vehicle" and flank <= 0 and gap >= 0 and offset - min(other.offsets + [offset]) <= 0.375
    ]
    covered_from = min(covers, default=np.inf)
    for other, (offset, flank, gap, closing, vx) in zip(others, seen):
        toward = (other.offsets[-1] - offset) / LOOK_S if other.offsets else 0.0
        other.offsets.append(offset)
        other.speeds.append(vx)
        lengths = EGO[0] + other.length
        on_foot = other.kind == "pedestrian"
        was_hidden, other.hidden = other.hidden, flank <= 0 and gap > covered_from
        if other.hidden:
            other.danger = None
            continue
        if was_hidden:
            other.revealed = t + 0.4
        comes = toward >= 0.5 if on_foot else max(other.offsets) - offset > 0.375
        if (comes or flank <= LANE_M) and other.coming is None:
            other.coming = t + 0.4
        leads = flank < NEEDS_M and gap > -lengths / 2
        brakes = (other.speeds[-4] - vx) / 0.3 if len(other.speeds) > 3 else 0.0
        if leads and brakes > 5.0:
            other.braking = t + 0.4 if other.braking is None else other.braking
        elif other.danger is None and brakes < 1.0:
            other.braking = None
        expected = max(toward, 5 / 3.6) if on_foot and toward >= 0.5 else max(toward, 0.0)
        other.in_way = flank - 2.0 * expected < NEEDS_M

        def past(time):
            return time is not None and t >= time - 1e-9

        if closing <= 0 or gap < -lengths:
            dangerous = False
        elif on_foot:
            met = flank < NEEDS_M or (flank - NEEDS_M) / max(expected, 1e-9) < (gap + lengths) / closing
            far = max(closing * 0.75 + stopping_m(closing) + 1.0, 2.0 * closing)
            dangerous = past(other.coming) and met and gap <= far
        else:
            follows = leads and gap <= 2.0 * ego_v
            dangerous = past(other.coming) and gap <= 2.0 * closing
            dangerous = dangerous or follows and (past(other.braking) or past(other.revealed))
        if on_foot:
            over = ego_v < 0.3 or (flank > LANE_M and toward <= -0.5) or gap < -lengths
        else:
            over = not other.in_way or closing <= 0
        if other.in_way and dangerous:
            other.danger = t if other.danger is None else other.danger
        elif over:
            other.danger = other.braking = other.revealed = None
    return seen


def ordinary(others, seen, t, v, wanted, own, later):
    free = max(1 - (v / max(wanted, 1.0)) ** 4, -2.0 / 1.5)
    held = 0.0
    for other, (_, _, gap, closing, _) in zip(others, seen):
        known = other.coming is not None and t - max(later, 0.0) >= other.coming - 1e-9
        if gap > -(EGO[0] + other.length) / 2 and other.in_way and not other.hidden and known:
            gap_wanted = 2.0 + max(1.5 * v + v * closing / (2 * np.sqrt(1.5 * 2.0)), 0.0)
            held = max(held, (gap_wanted / max(gap, 0.1)) ** 2)
    a = max(1.5 * (free - held), -2.0)
    return float(np.clip(a, own - 12.65 * LOOK_S, own + 12.65 * LOOK_S))


def drive(make, speed, later):
    """Whether the ego touches somebody with its front or flanks, and when it begins to brake hard."""
    others = make()
    v, x, begins, last_v = speed, 0.0, None, speed
    n_past, n_end, n_all = round(PAST_S / LOOK_S), round(END_S / LOOK_S), round((END_S + AFTER_S) / LOOK_S)
    for i in range(-n_past, n_all):
        t = i * LOOK_S
        if i < 0:
            look(others, t, speed * t, speed)
            continue
        seen = look(others, t, x, v)
        if i >= n_end and all(other.danger is None for other in others):
            break
        a = ordinary(others, seen, t, v, speed, (v - last_v) / LOOK_S, later)
        last_v = v
        for step in range(round(LOOK_S / STEP_S)):
            now = t + (step + 0.5) * STEP_S
            ramps = [np.clip((now - o.danger - 0.75 - later) / 0.6, 0, 1) for o in others if o.danger is not None]
            hard = 7.593 * max(ramps, default=0.0)
            if hard > 0 and begins is None:
                begins = t
            then = max(v + (min(a, -hard) if hard > 0 else a) * STEP_S, 0.0)
            x, v = x + (v + then) / 2 * STEP_S, then
        for other in others:
            ox, oy, _, _ = other.at(t + LOOK_S)
            near = abs(ox - x) < (EGO[0] + other.length) / 2 and abs(oy) < (EGO[1] + other.width) / 2
            if near and not (ox - x) / EGO[0] < -abs(oy) / EGO[1]:
                return True, begins
    return False, begins


def margin(make, speed):
    """The boundary nearest to the regulation's driver, by trying every hundredth of a second."""
    hits = lambda later: drive(make, speed, later)[0]
    if hits(0.0):
        return next((-i / 100 for i in range(1, 76) if not hits(-i / 100)), -0.75)
    return next((i / 100 for i in range(1, 201) if hits(i / 100)), 2.0)


def lateral(t, y0, y1, begins, across):
    """From y0 to y1 at this speed across."""
    lasts = abs(y1 - y0) / across
    share = np.clip((t - begins) / lasts, 0, 1)
    return y0 + (y1 - y0) * share, (np.sign(y1 - y0) * across if 0 < t - begins < lasts else 0.0)


def cut_in(gap, closing, across, speed=20.0):
    def at(t):
        y, vy = lateral(t, 3.5, 0.0, 0.0, across)
        return gap + 4.5 + (speed - closing) * t, y, speed - closing, vy

    return speed, lambda: [Other("vehicle", at)]


def deceleration(headway, brakes, speed=20.0):
    def at(t):
        b = np.clip(t - 0.5, 0, speed / brakes)
        return headway * speed + 4.5 + speed * (min(t, 0.5) + b) - brakes * b * b / 2, 0.0, speed - brakes * b, 0.0

    return speed, lambda: [Other("vehicle", at)]


def cut_out(headway, stands, speed=15.0):
    def at(t):
        y, vy = lateral(t, 0.0, 3.5, 0.2, 1.5)
        return headway * speed + 4.5 + speed * t, y, speed, vy

    return speed, lambda: [Other("vehicle", at), Other("vehicle", lambda t: (stands, 0.0, 0.0, 0.0))]


def pedestrian(speed, walks, aside, meets_s):
    """Who would be at the middle of the path when an ego that does not brake comes."""

    def at(t):
        y = -aside + walks * max(t - (meets_s - aside / walks), 0)
        return speed * meets_s + 2.25 + 0.25, y, 0.0, walks if t > meets_s - aside / walks else 0.0

    return speed, lambda: [Other("pedestrian", at)]


def main() -> None:
    default = Path(__file__).parent.parent / "tests" / "golden" / "careful_driver.json"
    output = Path(sys.argv[1]) if len(sys.argv) > 1 else default
    cases = {f"cut-in {gap} {closing} {across}": cut_in(gap, closing, across)
             for closing in (4.0, 8.0, 12.0) for gap, across in ((8.0, 1.0), (14.0, 1.8), (22.0, 1.0), (30.0, 1.8))}
    cases |= {f"deceleration {headway} {brakes}": deceleration(headway, brakes)
              for headway, brakes in ((0.5, 6.0), (0.8, 4.0), (0.8, 6.0), (1.2, 4.0), (1.2, 8.0), (2.0, 8.0))}
    cases |= {f"cut-out {headway} {stands}": cut_out(headway, stands)
              for headway, stands in ((0.6, 38.0), (0.6, 45.0), (1.0, 30.0), (1.0, 60.0))}
    cases |= {f"pedestrian {speed} {walks} {aside} {meets}": pedestrian(speed, walks, aside, meets)
              for speed in (8.0, 16.67) for walks, aside, meets in ((1.0, 3.0, 2.0), (1.39, 3.0, 3.0), (1.39, 5.0, 4.5))}
    times = np.arange(-round(PAST_S / LOOK_S), round(END_S / LOOK_S) + 1) * LOOK_S
    rows = []
    for name, (speed, make) in cases.items():
        hit, begins = drive(make, speed, 0.0)
        others = [{"class": o.kind, "states": [[round(float(v), 4) for v in o.at(t)] for t in times]} for o in make()]
        rows.append({"name": name, "speed_mps": speed, "others": others, "braking_from_s": begins and round(begins, 3),
                     "preventable": not hit, "margin_s": margin(make, speed)})
        print(name, begins, not hit, rows[-1]["margin_s"], file=sys.stderr)
    output.write_text("[\n" + ",\n".join(json.dumps(row) for row in rows) + "\n]\n", encoding="utf-8")


if __name__ == "__main__":
    main()
