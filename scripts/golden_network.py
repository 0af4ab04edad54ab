"""An independent PyTorch implementation of DJINN's network, and the vectors that our tests compare with.

    pip install torch safetensors numpy
    python scripts/golden_network.py            # writes tests/golden/scene_network.safetensors

The network is written from the paper (appendix A) with PyTorch's own layers where they exist. Weights and inputs are
random; the file holds them, the output F, the gradient of sum(F * probe) with respect to the noisy states, and with
respect to every weight. Padding is in the inputs: an agent that is not there, a gap in a track, a lane that is not there.
"""

import math
import pathlib

import numpy as np
import torch
from safetensors.torch import save_file

LAYERS, WIDTH, HEADS, FEED_FORWARD, ENCODING, STATE_DIM = "TAMT", 16, 2, 32, 8, 3
AGENT_FEATURES, LANE_FEATURES = 7, 35


def sinusoidal(x, dim, min_period, max_period):
    n = dim // 2
    periods = torch.tensor([min_period * (max_period / min_period) ** (i / (n - 1)) for i in range(n)], dtype=x.dtype)
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


def attend(q, k, v, key_mask):
    """q (N, Q, D), k and v (N, K, D), key_mask (N, K): rows without any key give zero."""
    heads = lambda t: t.unflatten(-1, (HEADS, -1)).transpose(1, 2)
    some = key_mask.any(-1)
    mask = key_mask | ~some[:, None]  # keeps the softmax defined; such rows are zeroed below
    out = torch.nn.functional.scaled_dot_product_attention(heads(q), heads(k), heads(v), attn_mask=mask[:, None, None])
    return out.transpose(1, 2).flatten(-2) * some[:, None, None]


def network(w, x, context, features, valid, lanes, lane_valid, c_noise):
    batch, agents, steps, _ = x.shape
    encode = lambda s: sinusoidal(s, ENCODING, 0.01, 10.0).flatten(-2)
    t = sinusoidal(torch.arange(steps, dtype=x.dtype), ENCODING, 1.0, 100.0).expand(batch, agents, steps, -1)
    known = torch.cat([encode(context), t, features], -1)
    noise = sinusoidal(c_noise, ENCODING, 0.1, 10_000.0)[:, None, None]
    h = linear(w, "input.latent", encode(x)) + linear(w, "input.known", known) + linear(w, "input.noise", noise)
    h = linear(w, "input.out", h.relu())
    lane = mlp(w, "lane_encoder", lanes, 4)
    mask = valid[..., None]
    for i, letter in enumerate(LAYERS):
        p = f"trunk.{i}"
        n = norm(w, f"{p}.norm_mix", h)
        if letter == "M":
            q = linear(w, f"{p}.map.query", n).flatten(1, 2)
            k, v = linear(w, f"{p}.map.key_value", lane).chunk(2, -1)
            mixed = linear(w, f"{p}.map.out", attend(q, k, v, lane_valid > 0).unflatten(1, (agents, steps)))
        else:
            name, axis = ("time", 2) if letter == "T" else ("agent", 1)
            qkv = linear(w, f"{p}.{name}.qkv", n)
            key_mask = valid > 0
            if axis == 1:
                qkv, key_mask = qkv.transpose(1, 2), key_mask.transpose(1, 2)
            shape = qkv.shape[:2]
            q, k, v = qkv.flatten(0, 1).chunk(3, -1)
            mixed = attend(q, k, v, key_mask.flatten(0, 1)).unflatten(0, shape)
            mixed = mixed.transpose(1, 2) if axis == 1 else mixed
            mixed = linear(w, f"{p}.{name}.out", mixed)
        h = h + mixed * mask
        h = h + mlp(w, f"{p}.feed_forward", norm(w, f"{p}.norm_feed", h), 2) * mask
    return mlp(w, "output", norm(w, "norm_out", h), 2) * mask


def shapes():
    def dense(name, n_in, n_out):
        return {f"{name}.weight": (n_out, n_in), f"{name}.bias": (n_out,)}

    s = {}
    s |= dense("input.latent", ENCODING * STATE_DIM, WIDTH) | dense("input.noise", ENCODING, WIDTH)
    s |= dense("input.known", ENCODING * (STATE_DIM + 1) + AGENT_FEATURES, WIDTH) | dense("input.out", WIDTH, WIDTH)
    for i, n_in in enumerate([LANE_FEATURES, WIDTH, WIDTH, WIDTH]):
        s |= dense(f"lane_encoder.{2 * i}", n_in, WIDTH)
    for i, letter in enumerate(LAYERS):
        p = f"trunk.{i}"
        for name in ("norm_mix", "norm_feed"):
            s |= {f"{p}.{name}.weight": (WIDTH,), f"{p}.{name}.bias": (WIDTH,)}
        s |= dense(f"{p}.feed_forward.0", WIDTH, FEED_FORWARD) | dense(f"{p}.feed_forward.2", FEED_FORWARD, WIDTH)
        if letter == "M":
            s |= dense(f"{p}.map.query", WIDTH, WIDTH) | dense(f"{p}.map.key_value", WIDTH, 2 * WIDTH)
            s |= dense(f"{p}.map.out", WIDTH, WIDTH)
        else:
            name = "time" if letter == "T" else "agent"
            s |= dense(f"{p}.{name}.qkv", WIDTH, 3 * WIDTH) | dense(f"{p}.{name}.out", WIDTH, WIDTH)
    s |= {"norm_out.weight": (WIDTH,), "norm_out.bias": (WIDTH,)}
    return s | dense("output.0", WIDTH, WIDTH) | dense("output.2", WIDTH, STATE_DIM)


def main():
    rng = np.random.default_rng(20)
    draw = lambda *shape: torch.tensor(rng.normal(size=shape) * 0.4)
    weights = {name: draw(*shape).requires_grad_() for name, shape in shapes().items()}
    batch, agents, steps, n_lanes = 2, 4, 5, 3
    valid = torch.ones(batch, agents, steps, dtype=torch.float64)
    valid[0, 3] = 0
    valid[1, 1, 2] = 0
    lane_valid = torch.tensor([[1.0, 1, 0], [1, 1, 1]], dtype=torch.float64)
    masked = lambda t: t * valid[..., None]
    inputs = {
        "x": masked(draw(batch, agents, steps, STATE_DIM)).requires_grad_(),
        "context": masked(draw(batch, agents, steps, STATE_DIM)),
        "features": masked(draw(batch, agents, steps, AGENT_FEATURES)),
        "valid": valid,
        "lanes": draw(batch, n_lanes, LANE_FEATURES) * lane_valid[..., None],
        "lane_valid": lane_valid,
        "c_noise": torch.tensor([-0.4, 0.3], dtype=torch.float64),
    }
    # What is committed is f32: round first, so that both sides start from the same numbers.
    for tensors in (weights, inputs):
        for tensor in tensors.values():
            tensor.data = tensor.data.float().double()
    output = network(weights, **inputs)
    probe = draw(*output.shape)
    probe.data = probe.data.float().double()
    (output * probe).sum().backward()
    golden = {f"weight.{name}": tensor for name, tensor in weights.items()}
    golden |= {f"input.{name}": tensor for name, tensor in inputs.items()}
    golden |= {f"gradient.{name}": tensor.grad for name, tensor in weights.items()}
    golden |= {"gradient_x": inputs["x"].grad * valid[..., None], "probe": probe, "output": output}
    path = pathlib.Path(__file__).parent.parent / "tests/golden/scene_network.safetensors"
    save_file({name: tensor.detach().float().contiguous() for name, tensor in golden.items()}, path)
    print(f"wrote {path}, {path.stat().st_size} bytes")


if __name__ == "__main__":
    main()
