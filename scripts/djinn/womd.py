"""tf.Example as the Waymo Open Motion Dataset has it, without TensorFlow: see `djinn.export`."""

import collections
import struct

from djinn.corpus import resampled  # First: it says what to install.

import numpy as np
from djinn.export import FREEWAYS, HEIGHT_M, KINDS, sizes_of

N_AGENTS, N_POINTS, N_LIGHTS, SPANS = 128, 30_000, 16, {"past": 10, "current": 1, "future": 80}
OF_STATES = "x y bbox_yaw velocity_x velocity_y z vel_yaw speed length width height timestamp_micros valid".split()


def womd(scenarios, path):
    """A TFRecord file of examples, padded with -1 to the dataset's sizes: 128 agents (those nearest to the ego), ten
    timesteps before the present and 80 after it, 30,000 points of lanes, no lights."""
    counts = collections.Counter()
    with open(path, "xb") as file:
        for scenario in scenarios:
            if abs(scenario.dt_s - 0.1) > 1e-6:
                raise ValueError(f"scenario {scenario.id} has timesteps of {scenario.dt_s} s, expected 0.1 s")
            data = encoded(example(scenario, counts))
            length = struct.pack("<Q", len(data))
            file.write(length + struct.pack("<I", masked_crc(length)) + data + struct.pack("<I", masked_crc(data)))
            counts["scenarios"] += 1
    return dict(counts)


def example(scenario, counts):
    """The features of an example: text, or arrays of float32 or int64."""
    at_present = np.where(scenario.valid[:, [scenario.present]], scenario.states[:, scenario.present, :2], np.inf)
    away = np.linalg.norm(at_present - scenario.states[scenario.ego, scenario.present, :2], axis=-1)
    agents = np.argsort(away, kind="stable")[:N_AGENTS]
    steps = np.arange(-SPANS["past"], SPANS["future"] + 1) + scenario.present
    within = (steps >= 0) & (steps < scenario.valid.shape[1])
    counts["agents_left_out"] += len(away) - len(agents)
    counts["timesteps_left_out"] += scenario.valid.shape[1] - int(within.sum())
    valid = np.zeros((N_AGENTS, len(steps)), bool)
    valid[: len(agents), within] = scenario.valid[np.ix_(agents, steps[within])]
    values = np.zeros((len(OF_STATES), *valid.shape))
    values[:5, : len(agents), within] = np.moveaxis(scenario.states[np.ix_(agents, steps[within])], -1, 0)
    values[6:8] = np.arctan2(values[4], values[3]), np.hypot(values[3], values[4])
    values[8:10, : len(agents)] = sizes_of(scenario, counts)[agents].T[:, :, None]
    values[10], values[11] = HEIGHT_M, np.round(1e5 * (steps - steps[0]))
    values = np.where(valid, values, -1)
    values[12] = valid
    found, begin = {"scenario/id": scenario.id}, 0
    for span, n in SPANS.items():
        for name, column in zip(OF_STATES, values):
            kind = np.int64 if name in ("timestamp_micros", "valid") else np.float32
            found[f"state/{span}/{name}"] = column[:, begin : begin + n].astype(kind)
        for name in ["state", "valid", "id", "x", "y", "z"]:
            kind = np.float32 if name in "xyz" else np.int64
            found[f"traffic_light_state/{span}/{name}"] = np.full((n, N_LIGHTS), 0 if name == "valid" else -1, kind)
        found[f"traffic_light_state/{span}/timestamp_micros"] = 100_000 * np.arange(begin, begin := begin + n)
    of_agents = {
        "id": agents.astype(np.float32),
        "type": np.float32([KINDS[scenario.classes[agent]][1] for agent in agents]),
        "is_sdc": (agents == scenario.ego).astype(np.int64),
        "tracks_to_predict": np.isin(agents, list(scenario.roles.values())).astype(np.int64),
        "objects_of_interest": np.isin(agents, list(scenario.roles.values())).astype(np.int64),
    }
    for name, column in of_agents.items():
        found[f"state/{name}"] = np.pad(column, (0, N_AGENTS - len(agents)), constant_values=-1)
    return found | roadgraph(scenario, counts)


def roadgraph(scenario, counts):
    """Points of center lines every half meter, those nearest to the ego."""
    rows = [np.empty((0, 8))]  # x, y, z, their direction, lane, type
    for lane in scenario.lanes:
        length = np.linalg.norm(np.diff(lane.centerline, axis=0), axis=1).sum()
        points = resampled(lane.centerline, max(2, round(length / 0.5) + 1))
        ahead = np.diff(points, axis=0, append=2 * points[-1:] - points[-2:-1])
        ahead /= np.maximum(np.linalg.norm(ahead, axis=1, keepdims=True), 1e-9)
        height, kind = np.zeros((len(points), 1)), 1 if lane.kind in FREEWAYS else 2
        rows.append(np.hstack([points, height, ahead, height, height + lane.id, height + kind]))
    rows = np.concatenate(rows)
    away = np.linalg.norm(rows[:, :2] - scenario.states[scenario.ego, scenario.present, :2], axis=1)
    kept = rows[np.sort(np.argsort(away, kind="stable")[:N_POINTS])]
    counts["points_left_out"] += len(rows) - len(kept)
    full = np.pad(kept, [(0, N_POINTS - len(kept)), (0, 0)], constant_values=-1)
    found = {"xyz": full[:, :3].astype(np.float32), "dir": full[:, 3:6].astype(np.float32)}
    found |= {"id": full[:, 6].astype(np.int64), "type": full[:, 7].astype(np.int64)}
    found["valid"] = (np.arange(N_POINTS) < len(kept)).astype(np.int64)
    return {f"roadgraph_samples/{name}": values for name, values in found.items()}


def varint(number):
    number, found = int(number) % 2**64, bytearray()
    while number > 127:
        number, low = number >> 7, number & 127
        found.append(low | 128)
    return bytes([*found, number])


def message(tag, data):
    """A field of a protocol buffer: of wire type 2, bytes with their length."""
    return bytes([tag << 3 | 2]) + varint(len(data)) + data


def encoded(features):
    """A tf.Example: features.feature, a map of names to lists of bytes (1), floats or integers (2, 3, both packed)."""
    found = []
    for name, values in sorted(features.items()):
        if isinstance(values, str):
            feature = message(1, message(1, values.encode()))
        elif values.dtype == np.float32:
            feature = message(2, message(1, values.astype("<f4").tobytes()))
        else:
            different, index = np.unique(values, return_inverse=True)
            texts = [varint(number) for number in different]
            feature = message(3, message(1, b"".join([texts[i] for i in index.ravel()])))
        found.append(message(1, message(1, name.encode()) + message(2, feature)))
    return message(1, b"".join(found))


CRC = np.arange(256, dtype=np.uint32)  # Of each byte, bit by bit.
for _ in range(8):
    CRC = np.where(CRC & 1, CRC >> 1 ^ 0x82F63B78, CRC >> 1).astype(np.uint32)


def masked_crc(data, n_lanes=1024):
    """CRC-32C as TFRecord masks it. Lanes of bytes are summed side by side; a CRC is linear, so the sum of a lane,
    moved on by the length of one, adds up with the next."""
    length = -(-len(data) // n_lanes)
    padded = np.zeros(n_lanes * length, np.uint8)  # Zeros in front change nothing, as the register begins with zero,
    padded[len(padded) - len(data) :] = np.frombuffer(data, np.uint8)
    padded[len(padded) - len(data) :][:4] ^= 0xFF  # with its initial ones in the first four bytes instead.
    lanes, moved = np.zeros(n_lanes, np.uint32), np.uint32(1) << np.arange(32, dtype=np.uint32)
    for column in padded.reshape(n_lanes, length).T:
        lanes = lanes >> np.uint32(8) ^ CRC[(lanes ^ column) & 0xFF]
        moved = moved >> np.uint32(8) ^ CRC[moved & 0xFF]
    total = np.uint32(0)
    for lane in lanes:
        total = np.bitwise_xor.reduce(moved[(total >> np.arange(32, dtype=np.uint32) & 1).astype(bool)]) ^ lane
    crc = int(total) ^ 0xFFFFFFFF ^ 0xFFFFFFFF >> 8 * len(data)  # Of fewer bytes, the rest of the initial ones.
    return ((crc >> 15 | crc << 17) + 0xA282EAD8) % 2**32
