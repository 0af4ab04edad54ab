"""DJINN's denoiser in PyTorch: reads our checkpoints, and is the independent implementation that our tests compare with.

    pip install -r scripts/requirements-torch.txt
    python scripts/torch_reference.py          # writes tests/golden/{scene_network,carried_denoiser}.safetensors

The geometric network is in torch_geometric_network.py.

To use a checkpoint from Python:

    from torch_reference import Denoiser
    denoiser = Denoiser.load("output/my/main/denoiser/model.safetensors")
    x0_hat = denoiser(x, sigma, batch)

with x (B, A, T, D) noisy states in units of the checkpoint's normalizer, zero where not latent, sigma (B,), and in batch:
context (B, A, T, D), features (B, A, T, 7), valid and latent (B, A, T), lanes (B, L, 35), lane_valid (B, L), and for
motion parametrization observed_motion (B, A, T, D) and path (B, A, T, T). src/tensor/scene_batch.rs says what these hold.

The network is written from the paper (appendix A) with PyTorch's own functions where they exist.
"""

import json
import math
import pathlib
import struct

import numpy as np
import torch
from safetensors.torch import load_file, save_file

AGENT_FEATURES, LANE_FEATURES = 7, 35
STATE_PERIODS, TIMESTEP_PERIODS, NOISE_PERIODS = (0.01, 10.0), (1.0, 100.0), (0.1, 10_000.0)
ROOT = pathlib.Path(__file__).parent.parent


def sinusoidal(x, dim, periods):
    shortest, longest = periods
    n = dim // 2
    periods = torch.tensor([shortest * (longest / shortest) ** (i / (n - 1)) for i in range(n)], dtype=x.dtype)
    angle = 2 * math.pi * x.unsqueeze(-1) / periods
    return torch.cat([angle.sin(), angle.cos()], -1)


def linear(w, name, x):
    return torch.nn.functional.linear(x, w[f"{name}.weight"], w[f"{name}.bias"])


def norm(w, name, x):
    return torch.nn.functional.layer_norm(x, (x.shape[-1],), w[f"{name}.weight"], w[f"{name}.bias"])


def mlp(w, name, x, n_layers):
    for i in range(n_layers):
        x = linear(w, f"{name}.{2 * i}", x)
        x = x if i == n_layers - 1 else x.relu()
    return x


def attend(n_heads, q, k, v, key_mask):
    """q (N, Q, D), k and v (N, K, D), key_mask (N, K): rows without any key give zero."""
    heads = lambda t: t.unflatten(-1, (n_heads, -1)).transpose(1, 2)
    some = key_mask.any(-1)
    mask = key_mask | ~some[:, None]  # keeps the softmax defined; such rows are zeroed below
    out = torch.nn.functional.scaled_dot_product_attention(heads(q), heads(k), heads(v), attn_mask=mask[:, None, None])
    return out.transpose(1, 2).flatten(-2) * some[:, None, None]


def lane_keys(w, config, lane):
    """Keys and values of encoded lanes (M, L, width), one (M, L, 2 width) for each map layer."""
    letters = enumerate(config["layers"].replace(" ", ""))
    return [linear(w, f"trunk.{i}.map.key_value", lane) for i, letter in letters if letter == "M"]


def trunk(w, config, h, valid, keys, lane_valid):
    """The layers over h (B, A, T, width) with valid (B, A, T). Each of the M maps belongs to B A T / M states that follow each other:
    one map for each scene or for each agent."""
    n_heads, mask, keys = config["n_heads"], valid[..., None], iter(keys)
    for i, letter in enumerate(config["layers"].replace(" ", "")):
        p = f"trunk.{i}"
        n = norm(w, f"{p}.norm_mix", h)
        if letter == "M":
            q = linear(w, f"{p}.map.query", n).reshape(lane_valid.shape[0], -1, h.shape[-1])
            k, v = next(keys).chunk(2, -1)
            read = linear(w, f"{p}.map.out", attend(n_heads, q, k, v, lane_valid > 0))
            # Without any lane there is nothing to read, not even the bias.
            mixed = (read * (lane_valid > 0).any(-1)[:, None, None]).reshape(h.shape)
        else:
            name, axis = ("time", 2) if letter == "T" else ("agent", 1)
            qkv = linear(w, f"{p}.{name}.qkv", n)
            key_mask = valid > 0
            if axis == 1:
                qkv, key_mask = qkv.transpose(1, 2), key_mask.transpose(1, 2)
            shape = qkv.shape[:2]
            q, k, v = qkv.flatten(0, 1).chunk(3, -1)
            mixed = attend(n_heads, q, k, v, key_mask.flatten(0, 1)).unflatten(0, shape)
            mixed = mixed.transpose(1, 2) if axis == 1 else mixed
            mixed = linear(w, f"{p}.{name}.out", mixed)
        h = h + mixed * mask
        h = h + mlp(w, f"{p}.feed_forward", norm(w, f"{p}.norm_feed", h), 2) * mask
    return h


def network(w, config, x, context, features, valid, lanes, lane_valid, c_noise):
    """F of the scaled noisy states x; `config` is the `network` section of a checkpoint."""
    batch, agents, steps, _ = context.shape
    dim = config["encoding"]
    t = sinusoidal(torch.arange(steps, dtype=x.dtype), dim, TIMESTEP_PERIODS).expand(batch, agents, steps, -1)
    known = torch.cat([sinusoidal(context, dim, STATE_PERIODS).flatten(-2), t, features], -1)
    noise = sinusoidal(c_noise, dim, NOISE_PERIODS)[:, None, None]
    latent = sinusoidal(x, dim, config["latent_periods"]).flatten(-2)
    h = linear(w, "input.latent", latent) + linear(w, "input.known", known) + linear(w, "input.noise", noise)
    h = linear(w, "input.out", h.relu())
    keys = lane_keys(w, config, mlp(w, "lane_encoder", lanes, 4))
    h = trunk(w, config, h, valid, keys, lane_valid)
    return mlp(w, "output", norm(w, "norm_out", h), 2) * valid[..., None]


def read_checkpoint(path, dtype=torch.float32):
    """What a checkpoint says of itself, and its weights by name."""
    with open(path, "rb") as file:
        header = json.loads(file.read(struct.unpack("<Q", file.read(8))[0]))
    weights = {name: tensor.to(dtype) for name, tensor in load_file(path).items()}
    return json.loads(header["__metadata__"]["djinn"]), weights


class Denoiser:
    """D(x; sigma) = c_skip x + c_out F(c_in x, c_noise), of a checkpoint."""

    def __init__(self, spec, weights):
        self.spec, self.weights = spec, weights

    @classmethod
    def load(cls, path, dtype=torch.float32):
        return cls(*read_checkpoint(path, dtype))

    def __call__(self, x, sigma, batch):
        sigma_data = self.spec["edm"]["sigma_data"]
        s = sigma[:, None, None, None]
        total = s**2 + sigma_data**2
        latent = batch["latent"][..., None]
        x = x * latent
        scaled = x / total.sqrt()
        is_motion = self.spec["normalizer"]["parametrization"] == "motion"
        seen = scaled + batch["observed_motion"] if is_motion else scaled
        if self.spec["network"]["path_input"]:
            path = batch["path"]
            unit = path / path.square().sum(-1, keepdim=True).sqrt().clamp(min=1e-6)
            seen = torch.cat([seen, unit @ scaled], -1)
        inputs = {name: batch[name] for name in ("context", "features", "valid", "lanes", "lane_valid")}
        f = network(self.weights, self.spec["network"], seen, **inputs, c_noise=sigma.log() / 4)
        return (sigma_data**2 / total * x + s * sigma_data / total.sqrt() * f) * latent


def dense(name, n_in, n_out):
    return {f"{name}.weight": (n_out, n_in), f"{name}.bias": (n_out,)}


def trunk_shapes(config):
    width, feed_forward, s = config["width"], config["feed_forward"], {}
    for i, letter in enumerate(config["layers"].replace(" ", "")):
        p = f"trunk.{i}"
        for name in ("norm_mix", "norm_feed"):
            s |= {f"{p}.{name}.weight": (width,), f"{p}.{name}.bias": (width,)}
        s |= dense(f"{p}.feed_forward.0", width, feed_forward) | dense(f"{p}.feed_forward.2", feed_forward, width)
        if letter == "M":
            s |= dense(f"{p}.map.query", width, width) | dense(f"{p}.map.key_value", width, 2 * width)
            s |= dense(f"{p}.map.out", width, width)
        else:
            name = "time" if letter == "T" else "agent"
            s |= dense(f"{p}.{name}.qkv", width, 3 * width) | dense(f"{p}.{name}.out", width, width)
    return s


def shapes(config, state_dim):
    """Names and shapes of all weights."""
    width, encoding = config["width"], config["encoding"]
    n_latent = encoding * state_dim * (2 if config["path_input"] else 1)
    s = dense("input.latent", n_latent, width) | dense("input.noise", encoding, width)
    s |= dense("input.known", encoding * (state_dim + 1) + AGENT_FEATURES, width) | dense("input.out", width, width)
    for i, n_in in enumerate([LANE_FEATURES, width, width, width]):
        s |= dense(f"lane_encoder.{2 * i}", n_in, width)
    s |= trunk_shapes(config) | {"norm_out.weight": (width,), "norm_out.bias": (width,)}
    return s | dense("output.0", width, width) | dense("output.2", width, state_dim)


def single(tensors):
    """What is committed is f32: round first, so that both sides start from the same numbers."""
    return {name: tensor.detach().float().double() for name, tensor in tensors.items()}


def write(name, tensors):
    path = ROOT / "tests/golden" / name
    save_file({name: tensor.detach().float().contiguous() for name, tensor in tensors.items()}, path)
    print(f"wrote {path}, {path.stat().st_size} bytes")


def scene_batch(rng, valid, lane_valid, state_dim):
    """Random inputs with padding: an agent that is not there, a gap in a track, a lane that is not there."""
    draw = lambda *shape: torch.tensor(rng.normal(size=shape) * 0.4)
    return {
        "context": draw(*valid.shape, state_dim) * valid[..., None],
        "features": draw(*valid.shape, AGENT_FEATURES) * valid[..., None],
        "valid": valid,
        "lanes": draw(*lane_valid.shape, LANE_FEATURES) * lane_valid[..., None],
        "lane_valid": lane_valid,
    }


def random_network():
    """A network with random weights: its output, and the gradients of sum(F * probe) by its states and every weight."""
    rng = np.random.default_rng(20)
    config = {"layers": "TAMT", "width": 16, "n_heads": 2, "feed_forward": 32, "encoding": 8}
    config |= {"latent_periods": STATE_PERIODS, "path_input": False}
    draw = lambda *shape: torch.tensor(rng.normal(size=shape) * 0.4)
    weights = single({name: draw(*shape) for name, shape in shapes(config, 3).items()})
    valid = torch.ones(2, 4, 5, dtype=torch.float64)
    valid[0, 3] = 0
    valid[1, 1, 2] = 0
    lane_valid = torch.tensor([[1.0, 1, 0], [1, 1, 1]], dtype=torch.float64)
    inputs = {"x": draw(2, 4, 5, 3) * valid[..., None], "c_noise": torch.tensor([-0.4, 0.3], dtype=torch.float64)}
    inputs = single(inputs | scene_batch(rng, valid, lane_valid, 3))
    probe = single({"probe": draw(2, 4, 5, 3)})["probe"]
    for tensor in [inputs["x"], *weights.values()]:
        tensor.requires_grad_()
    output = network(weights, config, **inputs)
    (output * probe).sum().backward()
    golden = {f"weight.{name}": tensor for name, tensor in weights.items()}
    golden |= {f"input.{name}": tensor for name, tensor in inputs.items()}
    golden |= {f"gradient.{name}": tensor.grad for name, tensor in weights.items()}
    golden |= {"gradient_x": inputs["x"].grad * valid[..., None], "probe": probe, "output": output}
    write("scene_network.safetensors", golden)


def carried_denoiser():
    """The bundled checkpoint: clean estimates at four noise levels, and the gradients of sum(D * probe) by x."""
    denoiser = Denoiser.load(ROOT / "pipelines/models/simulated_places.safetensors", torch.float64)
    rng = np.random.default_rng(21)
    n_history, n_timesteps = denoiser.spec["n_history"], denoiser.spec["n_timesteps"]
    valid = torch.ones(4, 3, n_timesteps, dtype=torch.float64)
    valid[0, 2] = 0
    valid[1, 1, n_history + 4] = 0
    latent = valid.clone()
    latent[:, :, :n_history] = 0
    lane_valid = torch.ones(4, 5, dtype=torch.float64)
    lane_valid[2, 3:] = 0
    batch = scene_batch(rng, valid, lane_valid, 3) | {"latent": latent}
    batch["observed_motion"] = torch.tensor(rng.normal(size=(4, 3, n_timesteps, 3))) * (valid - latent)[..., None]
    # Residuals that are running sums of what is latent.
    batch["path"] = torch.tril(torch.ones(n_timesteps, n_timesteps)) * latent[..., None] * latent[..., None, :]
    sigma = torch.tensor([0.02, 0.3, 2.0, 40.0], dtype=torch.float64)
    x = torch.tensor(rng.normal(size=(4, 3, n_timesteps, 3))) * (sigma**2 + 0.25).sqrt()[:, None, None, None]
    inputs = single(batch | {"x": x * latent[..., None], "sigma": sigma})
    probe = single({"probe": torch.tensor(rng.normal(size=x.shape))})["probe"]
    inputs["x"].requires_grad_()
    output = denoiser(inputs["x"], inputs["sigma"], inputs)
    (output * probe).sum().backward()
    golden = {f"input.{name}": tensor for name, tensor in inputs.items()}
    write("carried_denoiser.safetensors", golden | {"gradient_x": inputs["x"].grad, "probe": probe, "output": output})


if __name__ == "__main__":
    random_network()
    carried_denoiser()
