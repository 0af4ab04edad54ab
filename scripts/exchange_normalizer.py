"""Puts the normalizer of one checkpoint into another of the same network, to train that one further on motion of another scale.

    python scripts/exchange_normalizer.py WEIGHTS.safetensors NORMALIZER.safetensors start.safetensors

The result has the weights of the first and the normalizer of the second; before a training (start_from) it samples nothing of use.
"""

import json
import struct
import sys


def read(path):
    """The header of a safetensors file, and the tensors after it."""
    with open(path, "rb") as file:
        (n,) = struct.unpack("<Q", file.read(8))
        return json.loads(file.read(n)), file.read()


def main():
    weights, normalizer, out = sys.argv[1:]
    (header, tensors), (other, _) = read(weights), read(normalizer)
    spec, of_other = (json.loads(h["__metadata__"]["djinn"]) for h in (header, other))
    if spec["network"] != of_other["network"]:
        sys.exit("the two have different networks")
    spec["normalizer"] = of_other["normalizer"]
    header["__metadata__"]["djinn"] = json.dumps(spec)
    text = json.dumps(header).encode()
    text += b" " * (-len(text) % 8)
    with open(out, "wb") as file:
        file.write(struct.pack("<Q", len(text)) + text + tensors)


if __name__ == "__main__":
    main()
