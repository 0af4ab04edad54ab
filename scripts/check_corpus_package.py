"""Compares what the Python package of the installed wheel makes of a corpus with what pyarrow reads in it.

python scripts/check_corpus_package.py tests/fixtures/corpus/cut_ins FOLDER     # an empty folder, for exports
"""

import pathlib
import pickle
import struct
import sys
import xml.etree.ElementTree as ET

import numpy as np
import pyarrow.dataset as ds
import pyarrow.parquet as pq
from djinn import corpus as reader
from djinn import convert, export, womd


def check(condition, what):
    if not condition:
        sys.exit(f"wrong: {what}")


def same_numbers(corpus, folder):
    """Every number of the tables is in the arrays, and nothing else."""
    table = lambda name: ds.dataset(f"{folder}/{name}", partitioning="hive").to_table().to_pylist()
    scenarios = {row["scenario_id"]: row for row in table("scenarios")}
    check(sorted(corpus.ids) == sorted(scenarios) and len(corpus) > 0, "the ids")
    seen, rows = 0, table("tracks")
    lanes = {(row["map_id"], row["lane_id"]): row for row in pq.read_table(f"{folder}/lanes.parquet").to_pylist()}
    for scenario in corpus:
        row = scenarios[scenario.id]
        check(
            {name: value for name, value in scenario.columns.items() if value is not None}
            == {name: value for name, value in row.items() if value is not None},
            f"columns of {scenario.id}",
        )
        states = [state for state in rows if state["scenario_id"] == scenario.id]
        check(scenario.valid.sum() == len(states) == row["n_states"], f"states of {scenario.id}")
        for state in states:
            agent, at = scenario.track_ids.index(state["track_id"]), state["timestep"]
            found = [*scenario.states[agent, at].tolist(), *scenario.to_world(scenario.states[agent, at, :2])]
            wanted = [state[name] for name in [*reader.STATES, "world_x_m", "world_y_m"]]
            check(scenario.valid[agent, at] and found[:5] == wanted[:5], f"{state}")
            check(np.allclose(found[5:], wanted[5:], rtol=0, atol=1e-5), f"{state}")
            check(
                scenario.observed[agent, at] == state["observed"] and scenario.classes[agent] == state["class"],
                f"{state}",
            )
            sizes = [np.nan if state[name] is None else state[name] for name in ["length_m", "width_m"]]
            check(np.array_equal(scenario.sizes[agent], np.float32(sizes), equal_nan=True), f"{state}")
            check(state["event_role"] is None or scenario.roles[state["event_role"]] == agent, f"{state}")
        check([lane.id for lane in scenario.lanes] == row["lane_ids"], f"lanes of {scenario.id}")
        for lane in scenario.lanes:
            wanted = lanes[row["map_id"], lane.id]
            for name in ["centerline", "left", "right"]:
                points = np.stack([wanted[f"{name}_x_m"], wanted[f"{name}_y_m"]], -1)
                check(np.allclose(scenario.to_world(getattr(lane, name)), points, rtol=0, atol=1e-6), f"lane {lane.id}")
            check(
                (lane.successors, lane.left_neighbor) == (wanted["successors"], wanted["left_neighbor"]),
                f"lane {lane.id}",
            )
        check(corpus[scenario.id[:8]].id == scenario.id and scenario.present == row["n_history"] - 1, scenario.id)
        seen += len(states)
    check(seen == len(rows), f"{seen} of {len(rows)} states")
    verified = corpus.where(reader.field("verified"))
    check(sorted(verified.ids) == sorted(name for name, row in scenarios.items() if row["verified"]), "the condition")
    check([scenario.id for scenario in verified] == verified.ids, "the states of a part")
    for id_or_place, error in [("", KeyError), ("no such id", KeyError), (len(corpus), IndexError)]:
        try:
            check(corpus[id_or_place] is None, f"{id_or_place!r} is in the corpus")
        except error:
            pass
    return seen


def scenarionet(corpus, folder):
    """Pickles hold the same states."""
    export.scenarionet(corpus, folder)
    summary, mapping = (pickle.loads((folder / f"dataset_{name}.pkl").read_bytes()) for name in ["summary", "mapping"])
    check(len(summary) == len(corpus) and summary.keys() == mapping.keys(), "the summary")
    for name, metadata in summary.items():
        found = pickle.loads((folder / mapping[name] / name).read_bytes())
        scenario = corpus[metadata["scenario_id"]]
        check(found["metadata"]["sdc_id"] == scenario.track_ids[scenario.ego], name)
        for agent, track in enumerate(found["tracks"].values()):
            state = track["state"]
            values = np.column_stack([state["position"][:, :2], state["heading"], state["velocity"]])
            check(
                np.array_equal(values, scenario.states[agent])
                and np.array_equal(state["valid"], scenario.valid[agent]),
                name,
            )


def converted(corpus, source, folder):
    """CommonRoad's files of these pickles hold the same states, links and center lines."""
    check(convert.scenarionet(source, folder) == {"scenarios": len(corpus), "road_users_left_out": 0}, "what is converted")
    number = lambda element, name: float(element.find(f"{name}/exact").text)
    position = lambda element: [float(element.find(f".//{axis}").text) for axis in "xy"]
    for path in sorted(folder.glob("*.xml")):
        root = ET.parse(path).getroot()
        scenario = corpus[root.get("source").split(", ")[1]]
        obstacles = root.findall("dynamicObstacle")
        check(len(obstacles) == len(scenario.track_ids), path)
        for agent, obstacle in enumerate(obstacles):
            steps = [obstacle.find("initialState"), *obstacle.iter("state")]
            found = [[*position(state.find("position")), number(state, "orientation")] for state in steps]
            at = [int(number(state, "time")) for state in steps]
            check(at == list(np.flatnonzero(scenario.valid[agent])), path)
            check(np.allclose(found, scenario.states[agent, at, :3], atol=1e-4), path)
        for lanelet, lane in zip(root.findall("lanelet"), scenario.lanes):
            bounds = [[position(point) for point in lanelet.findall(f"{side}Bound/point")] for side in ("left", "right")]
            check(np.allclose(np.mean(bounds, 0), lane.centerline, atol=1e-3), f"{path}, lane {lane.id}")
            known = [of for of in lane.successors if of in {of.id for of in scenario.lanes}]
            check(len(lanelet.findall("successor")) == len(known), f"{path}, lane {lane.id}")
    (folder.parent / "unsafe.pkl").write_bytes(pickle.dumps(print))
    left_out = convert.scenarionet(folder.parent / "unsafe.pkl", folder.parent / "unsafe")
    check(left_out == {"scenarios_left_out": 1}, "a pickle of a function")


def fields(data):
    """The fields of a message of a protocol buffer whose fields are all of wire type 2."""

    def varint(at):
        number, shift = 0, 0
        while True:
            number, at, shift = number | (data[at] & 127) << shift, at + 1, shift + 7
            if not data[at - 1] & 128:
                return number, at

    at = 0
    while at < len(data):
        tag, at = varint(at)
        length, at = varint(at)
        yield tag >> 3, data[at : at + length]
        at += length


def integers(data):
    """Packed numbers of 64 bits."""
    found, number, shift = [], 0, 0
    for byte in data:
        number, shift = number | (byte & 127) << shift, shift + 7
        if not byte & 128:
            found.append(number - 2**64 if number >= 2**63 else number)
            number, shift = 0, 0
    return np.array(found)


def decoded(data):
    [(_, features)] = fields(data)
    found = {}
    for _, entry in fields(features):
        name, feature = (value for _, value in fields(entry))
        [(kind, values)] = fields(feature)
        [(_, values)] = fields(values)
        found[name.decode()] = [bytes, lambda v: np.frombuffer(v, "<f4"), integers][kind - 1](values)
    return found


def examples(corpus, path):
    """Examples, decoded again, hold the same states; sums are those of the CRC's definition."""
    womd.womd(corpus, path)
    data, at = path.read_bytes(), 0
    for scenario in corpus:
        (length,) = struct.unpack("<Q", data[at : at + 8])
        record, sums = (
            data[at + 12 : at + 12 + length],
            (data[at + 8 : at + 12], data[at + 12 + length : at + 16 + length]),
        )
        check(sums == (struct.pack("<I", crc(data[at : at + 8])), struct.pack("<I", crc(record))), "a sum")
        at += 16 + length
        found = decoded(record)
        check(found["scenario/id"].decode() == scenario.id, scenario.id)
        of = lambda name, n: np.concatenate([found[f"state/{s}/{name}"].reshape(128, -1) for s in womd.SPANS], 1)[:n]
        order = found["state/id"][: len(scenario.track_ids)].astype(int)
        check(
            sorted(order) == list(range(len(order))) and order[found["state/is_sdc"].argmax()] == scenario.ego,
            scenario.id,
        )
        before = 10 - scenario.present  # The dataset has a timestep more before the present.
        span = slice(before, before + scenario.valid.shape[1])
        valid = of("valid", len(order))
        check(
            np.array_equal(valid[:, span], scenario.valid[order]) and valid.sum() == scenario.valid.sum(), scenario.id
        )
        for k, name in enumerate(["x", "y", "bbox_yaw", "velocity_x", "velocity_y"]):
            values = np.where(scenario.valid[order], scenario.states[order, :, k], -1)
            check(np.array_equal(of(name, len(order))[:, span], values), f"{scenario.id} {name}")
        n_points = found["roadgraph_samples/valid"].sum()
        ids = set(found["roadgraph_samples/id"][:n_points].tolist())
        check(
            ids == {lane.id for lane in scenario.lanes} and len(found["roadgraph_samples/xyz"]) == 90_000, "the lanes"
        )
    check(at == len(data), "the end of the file")


def crc(data):
    found = 0xFFFFFFFF
    for byte in data:
        found = found >> 8 ^ int(womd.CRC[(found ^ byte) & 0xFF])
    found ^= 0xFFFFFFFF
    return ((found >> 15 | found << 17) + 0xA282EAD8) % 2**32


def main(folder, out):
    check(womd.masked_crc(b"") == 0xA282EAD8, "the CRC of nothing")
    check(womd.masked_crc(b"123456789") == ((0xE3069283 >> 15 | 0xE3069283 << 17) + 0xA282EAD8) % 2**32, "the CRC")
    corpus, out = reader.Corpus(folder), pathlib.Path(out)
    n_states = same_numbers(corpus, folder)
    scenarionet(corpus, out / "scenarionet")
    converted(corpus, out / "scenarionet", out / "converted")
    examples(corpus, out / "womd.tfrecord")
    print(f"{len(corpus)} scenarios with {n_states} states are the same")
    try:
        import torch
    except ImportError:
        return print("not run: batches of tensors, torch is not installed")
    loader = torch.utils.data.DataLoader(corpus, batch_size=4, collate_fn=reader.collate, num_workers=2)
    batches = list(loader)
    check(sum(len(batch["scenarios"]) for batch in batches) == len(corpus), "the batches")
    check(sum(int(batch["valid"].sum()) for batch in batches) == n_states, "their states")


if __name__ == "__main__":
    main(*sys.argv[1:])
