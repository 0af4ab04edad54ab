"""The geometric denoiser in PyTorch: F of src/model/geometric_network.rs and D of src/model/scene_denoiser.rs.

To use a checkpoint: BoundDenoiser(*read_checkpoint(path), batch)(x, sigma). A batch holds features, valid, latent, observed_motion and path
as in torch_reference.py, and observed (B, A, T), base (B, A, T, 3), rotation (B, A, 2), unit (B, A, 3), origin (B, A, 2), attributes (B, A, 9), agent_lanes (B, A, S, 51) with
agent_lane_valid (B, A, S), modes (B, A, D, T, T), variances (B, A, D, T), and the geometry that torch_relations.py reads.
src/tensor/{scene_batch,surroundings}.rs say what these hold.
"""

import torch
from torch_reference import dense, lane_keys, linear, mlp, norm, sinusoidal, trunk, trunk_shapes
from torch_relations import Surroundings, relations, turned

ENCODING, NOISE_PERIODS, TOKEN_PERIODS = 32, (0.2, 20.0), (2.0, 200.0)
POSITION_M, EGO_POSITION_M = 10.0, 50.0
KNOWN, AGENT, PIECE, OWN, NEIGHBOR, LANE = 9, 16, 51, 10, 17, 13


def tokens(x, patch):
    """(B, A, T, F) to (B, A, N, patch F); what the last token lacks is zero."""
    n = -(-x.shape[2] // patch)
    x = torch.nn.functional.pad(x, (0, 0, 0, n * patch - x.shape[2]))
    return x.reshape(*x.shape[:2], n, patch * x.shape[3])


def known_features(batch):
    """What is known of each state, in the agent's own frame: (B, A, T, 9)."""
    cos, sin = batch["rotation"][:, :, None].unbind(-1)
    x, y = ((batch["base"][..., :2] - batch["origin"][:, :, None]) / POSITION_M).unbind(-1)
    heading, (vx, vy) = batch["base"][..., 2], batch["features"][..., :2].unbind(-1)
    pairs = turned(x, y, cos, sin) + turned(heading.cos(), heading.sin(), cos, sin) + turned(vx, vy, cos, sin)
    masks = torch.stack([batch["valid"], batch["observed"], batch["latent"]], -1)
    return torch.cat([torch.stack(pairs, -1) * batch["valid"][..., None], masks], -1)


class Known:
    """What F computes from what does not change between calls."""

    def __init__(self, w, config, batch):
        patch = config["geometry"]["patch"]
        any_of = lambda mask: tokens(mask[..., None], patch).amax(-1)
        self.valid, self.read = any_of(batch["valid"]), any_of(batch["latent"])
        constants = batch["features"][..., 4:].amax(2)
        agent = torch.cat([batch["attributes"], batch["origin"] / EGO_POSITION_M, batch["rotation"], constants], -1)
        time = sinusoidal(torch.arange(self.valid.shape[2], dtype=agent.dtype), ENCODING, TOKEN_PERIODS)
        states = linear(w, "input.known", tokens(known_features(batch), patch))
        self.input = states + linear(w, "input.agent", agent)[:, :, None] + linear(w, "input.time", time)
        lanes = mlp(w, "lane_encoder", batch["agent_lanes"], 2)
        self.keys = lane_keys(w, config, lanes)
        self.lane_valid = batch["agent_lane_valid"]
        self.around = Surroundings(batch, patch)

    def map(self, change):
        """The same with every tensor changed."""
        other = object.__new__(Known)
        for name, value in self.__dict__.items():
            if name == "keys":
                other.keys = [change(keys) for keys in value]
            else:
                other.__dict__[name] = value.map(change) if name == "around" else change(value)
        return other


def network(w, config, seen, poses, known, c_noise):
    """F for what is seen of noisy states (B, A, T, 4 D), of which the estimate has `poses` (B, A, T, 3)."""
    patch, geometry, n_steps = config["geometry"]["patch"], config["geometry"], seen.shape[2]
    own, (neighbors, has_neighbor), (lanes, has_lane) = relations(
        known.around, poses, geometry["n_neighbors"], geometry["n_nearest_lanes"]
    )
    # The largest of what is made of each that is there, and 0 without any.
    pool = lambda name, entries, there, dim: (mlp(w, name, entries, 2).relu() * there[..., None]).amax(dim)
    pooled = [pool("input.neighbors", neighbors, has_neighbor, 2), pool("input.lanes", lanes, has_lane, 3)]
    noise = linear(w, "input.noise", sinusoidal(c_noise, ENCODING, NOISE_PERIODS))[:, None, None]
    h = linear(w, "input.latent", tokens(seen, patch)) + known.input + linear(w, "input.own", own) + noise
    h = linear(w, "input.out", (h + linear(w, "input.pooled", torch.cat(pooled, -1))).relu()) * known.valid[..., None]
    flat = lambda t: t.flatten(0, 1)
    h = trunk(w, config, h, known.valid, [flat(keys) for keys in known.keys], flat(known.lane_valid))
    f = mlp(w, "output", norm(w, "norm_out", h), 2) * known.read[..., None]
    return f.reshape(*f.shape[:2], f.shape[2] * patch, -1)[:, :, :n_steps]


def decode(batch, x):
    """Meters and radians in each row's ego frame, (B, A, T, 3): base + rotation (unit path x)."""
    residual = torch.nn.functional.pad(batch["path"] @ (x * batch["latent"][..., None]), (0, 3 - x.shape[-1]))
    along, across, turn = (residual * batch["unit"][:, :, None]).unbind(-1)
    cos, sin = batch["rotation"][:, :, None].unbind(-1)
    return torch.stack([along * cos - across * sin, along * sin + across * cos, turn], -1) + batch["base"]


class BoundDenoiser:
    """D(x; sigma) = W x + U' c_out U F for `n_samples` of each row of a batch, with W = U' w U by modes U of variance V: the smaller of V
    and sigma_data^2 is s, w = s / (s + sigma^2), c_out^2 = (1 - w)^2 V + w^2 sigma^2."""

    def __init__(self, spec, w, batch, n_samples=1):
        self.config, self.w, self.sigma_data = spec["network"], w, spec["edm"]["sigma_data"]
        again = (lambda t: t.repeat_interleave(n_samples, 0)) if n_samples > 1 else (lambda t: t)
        self.known = Known(w, self.config, batch).map(again)
        names = ("base", "rotation", "unit", "path", "latent", "observed_motion", "modes", "variances")
        self.batch = {name: again(batch[name]) for name in names}
        path = self.batch["path"]
        self.unit_path = path / path.square().sum(-1, keepdim=True).sqrt().clamp(min=1e-6)

    def skip_factors(self, sigma):
        """w of each mode, (B, A, D, T)."""
        trusted = self.batch["variances"].clamp(max=self.sigma_data**2)
        return trusted / (trusted + sigma[:, None, None, None] ** 2)

    def estimate(self, x, sigma):
        """W x: what is known of clean states before the network is asked."""
        return self.scaled_modes(x, self.skip_factors(sigma))

    def scaled_modes(self, x, factors):
        modes = self.batch["modes"]
        along = modes @ x.transpose(2, 3)[..., None]
        return (modes.mT @ (factors[..., None] * along)).squeeze(-1).transpose(2, 3)

    def __call__(self, x, sigma):
        latent, variances, s = self.batch["latent"][..., None], self.batch["variances"], sigma[:, None, None, None]
        w = self.skip_factors(sigma)
        c_out = ((1 - w) ** 2 * variances + w**2 * s**2).sqrt()
        x = x * latent
        scaled = x / (s**2 + self.sigma_data**2).sqrt()
        skipped = self.scaled_modes(x, w)
        parts = [scaled + self.batch["observed_motion"], self.unit_path @ scaled, skipped, 0.5 * (self.unit_path @ skipped)]
        poses = decode(self.batch, skipped.detach())
        f = network(self.w, self.config, torch.cat(parts, -1), poses, self.known, sigma.log() / 4)
        return (skipped + self.scaled_modes(f, c_out)) * latent


def shapes(config, state_dim):
    """Names and shapes of all weights."""
    width, patch, relation = config["width"], config["geometry"]["patch"], config["geometry"]["relation_width"]
    s = {}
    for name, n_in in [("latent", patch * 4 * state_dim), ("known", patch * KNOWN), ("agent", AGENT), ("time", ENCODING)]:
        s |= dense(f"input.{name}", n_in, width)
    for name, n_in in [("noise", ENCODING), ("own", OWN), ("pooled", 2 * relation), ("out", width)]:
        s |= dense(f"input.{name}", n_in, width)
    for name, n_in in [("input.neighbors", NEIGHBOR), ("input.lanes", LANE)]:
        s |= dense(f"{name}.0", n_in, relation) | dense(f"{name}.2", relation, relation)
    s |= dense("lane_encoder.0", PIECE, width) | dense("lane_encoder.2", width, width) | trunk_shapes(config)
    s |= {"norm_out.weight": (width,), "norm_out.bias": (width,)}
    return s | dense("output.0", width, width) | dense("output.2", width, patch * state_dim)
