"""Makes what tests/it/pytorch.rs compares the geometric denoiser with, in PyTorch and double precision.

    pip install -r scripts/requirements-torch.txt
    DJINN_UPDATE_GOLDEN=1 cargo test --test it pytorch      # only where batches changed: writes tests/golden/geometric_scene.safetensors
    python scripts/golden_geometric.py                      # writes tests/golden/{geometric_network,carried_geometric}.safetensors

The first file is a network with random weights on a batch that is made here. The second is the bundled checkpoint on scenes that the
crate collated, of which the changes of variables along time, their covariances and modes are worked out anew, from the masks.
"""

import numpy as np
import torch
from safetensors.torch import load_file
from torch_geometric_network import BoundDenoiser, Surroundings, decode, relations, shapes
from torch_reference import ROOT, read_checkpoint, single, write

N_POINTS = 10


def orthonormal(rng, latent):
    """Random modes over the latent timesteps, (A, D, T, T) for `latent` (A, T), and variances (A, D, T)."""
    n_agents, n_steps = latent.shape
    modes, variances = np.zeros((n_agents, 3, n_steps, n_steps)), np.zeros((n_agents, 3, n_steps))
    for agent, dim in np.ndindex(n_agents, 3):
        at = np.flatnonzero(latent[agent])
        modes[agent, dim][np.ix_(at, at)] = np.linalg.qr(rng.normal(size=(len(at), len(at))))[0]
        variances[agent, dim, at] = rng.uniform(0.01, 1.0, len(at))
    return modes, variances


def arc(x, y, heading, bend):
    """Ten points two meters apart, (10, 3), each with the heading of the way on."""
    headings = heading + bend * np.arange(N_POINTS)
    steps = 2.0 * np.stack([np.cos(headings), np.sin(headings)], -1)
    return np.concatenate([[x, y] + np.cumsum(steps, 0) - steps, headings[:, None]], -1)


def made_row(rng, n_agents, has_lanes=True, has_edges=True, has_sizes=True, crowd_m=12, lanes_m=10):
    """A row of four agents (some of them missing), eleven timesteps and five pieces of four lanes, four of them shown, with agents and
    lanes up to so many meters away along each axis."""
    t, slots, n_pieces, n_seen = 11, 4, 5, 4
    there = np.arange(slots) < n_agents
    valid = np.repeat(there[:, None], t, 1).astype(float)
    valid[1, [0, 5]] = 0  # a gap in a track, which comes after the first timestep
    observed = valid * (np.arange(t) < 4)
    if n_agents == slots:
        observed[3] = 0  # never observed
    if n_agents == 3:
        observed[2, 1:] = valid[2, 1:] = 0  # gone after the first timestep
    latent = valid - observed
    has_frame = observed.any(-1)

    start, heading, speed = rng.uniform(-crowd_m, crowd_m, (slots, 2)), rng.uniform(-3, 3, slots), rng.uniform(3, 9, slots)
    axis = np.stack([np.cos(heading), np.sin(heading)], -1)
    position = start[:, None] + axis[:, None] * (0.1 * speed[:, None] * (np.arange(t) - 3))[..., None]
    base = np.concatenate([position, np.broadcast_to(heading[:, None, None], (slots, t, 1))], -1)
    base *= (valid * has_frame[:, None])[..., None]
    sizes = rng.uniform(1, 5, (slots, 2)) * has_sizes
    features = np.zeros((slots, t, 7))
    features[..., :2] = rng.normal(size=(slots, t, 2)) * observed[..., None]
    features[..., 2:4] = np.stack([observed, valid], -1)
    features[..., 4:6] = sizes[:, None] / 5 * valid[..., None]
    features[..., 6] = valid * ~has_frame[:, None]
    modes, variances = orthonormal(rng, latent)

    # The first two pieces are one lane and share a point, which is nearest to where the first agent is.
    near = arc(*start[0], heading[0] + 0.3, 0.05)
    near[:, :2] += start[0] + 1.0 - near[-1, :2]
    pieces = [near, arc(*near[-1], 0.2)] + [arc(*rng.uniform(-lanes_m, lanes_m, 2), rng.uniform(-3, 3), -0.1) for _ in range(3)]
    edge_known = np.full((n_pieces, N_POINTS), float(has_edges))
    edge_known[3, 5:] = 0
    seen = np.stack([rng.permutation(n_pieces)[:n_seen] for _ in range(slots)])
    shown = (np.arange(n_seen) < rng.integers(2, n_seen + 1, slots)[:, None]) & there[:, None] & has_lanes
    if has_lanes:
        seen[0], shown[0] = [1, 0, 2, 3], True
    is_reached = (rng.uniform(size=seen.shape) < 0.6) * shown
    attributes = np.zeros((slots, 9))
    attributes[:, 0] = has_sizes * there
    attributes[np.arange(slots), 1 + rng.integers(0, 8, slots)] = there
    return {
        "valid": valid,
        "observed": observed,
        "latent": latent,
        "base": base,
        "features": features,
        "observed_motion": rng.normal(size=(slots, t, 3)) * observed[..., None],
        "rotation": np.where(has_frame[:, None], axis, [1.0, 0.0]),
        "origin": start * has_frame[:, None],
        "unit": rng.uniform(0.1, 0.4, (slots, 3)),
        "path": np.tril(np.ones((t, t))) * latent[..., None] * latent[:, None],
        "modes": modes,
        "variances": variances,
        "attributes": attributes,
        "agent_lanes": rng.normal(size=(slots, n_seen, 51)) * shown[..., None],
        "agent_lane_valid": shown.astype(float),
        "piece_points": np.stack(pieces),
        "piece_edges": rng.uniform(1, 5, (n_pieces, N_POINTS, 2)) * edge_known[..., None],
        "piece_has_edges": edge_known,
        "piece_lane": np.array([0.0, 0, 1, 2, 3]),
        "piece_length": np.full(n_pieces, 18.0),
        "seen_piece": seen.astype(float),
        "seen_reach": rng.uniform(-5, 30, seen.shape) * is_reached,
        "seen_is_reached": is_reached.astype(float),
        "half_size": (sizes if has_sizes else rng.uniform(2, 5, (slots, 2))) / 2,
        "is_vulnerable": (attributes[:, 1:3].sum(-1) > 0).astype(float),
        "dt_s": np.array(0.1 if has_edges else 0.5),
    }


def check_margins(spec, batch, poses):
    """Fails where rounding decides which neighbor or lane is nearest: then no other implementation could be expected to agree."""
    geometry = spec["network"]["geometry"]
    found = []
    for dtype in (torch.float32, torch.float64):
        around = Surroundings({name: tensor.to(dtype) for name, tensor in batch.items()}, geometry["patch"])
        own, *sets = relations(around, poses.to(dtype), geometry["n_neighbors"], geometry["n_nearest_lanes"])
        found.append([own, *(features for features, _ in sets)])
    worst = max((a - b).abs().max().item() for a, b in zip(*found))
    if worst > 2e-3:
        raise SystemExit(f"features differ by {worst:.1e} between single and double precision: choose another seed")


def golden(spec, weights, batch, x, sigma, probe, of_weights):
    """D(x; sigma), and the gradients of sum(D * probe)."""
    x.requires_grad_()
    bound = BoundDenoiser(spec, weights, batch, len(x) // len(batch["valid"]))
    output = bound(x, sigma)
    (output * probe).sum().backward()
    result = {"x": x, "sigma": sigma, "probe": probe, "output": output, "gradient_x": x.grad}
    if of_weights:
        result |= {f"weight.{name}": tensor for name, tensor in weights.items()}
        result |= {f"gradient.{name}": tensor.grad for name, tensor in weights.items()}
    again = {name: t.repeat_interleave(len(x) // len(t), 0) for name, t in batch.items()}
    check_margins(spec, again, decode(again, bound.estimate(x.detach(), sigma)))
    return result


def random_network():
    """A row with a gap and one who is never observed; one without lanes; one alone without edges; one of unknown sizes in a crowd, of
    whom one leaves, with lanes far away."""
    rng = np.random.default_rng(30)
    config = {"layers": "TMAT", "width": 8, "n_heads": 2, "feed_forward": 12}
    config["geometry"] = {"patch": 3, "n_neighbors": 2, "n_nearest_lanes": 2, "relation_width": 4}
    spec = {"network": config, "edm": {"sigma_data": 0.5}}
    rows = [made_row(rng, 4), made_row(rng, 2, has_lanes=False), made_row(rng, 1, has_edges=False)]
    rows.append(made_row(rng, 3, has_sizes=False, crowd_m=0.8, lanes_m=80))
    batch = single({name: torch.tensor(np.stack([row[name] for row in rows])) for name in rows[0]})
    weights = single({name: torch.tensor(rng.normal(size=shape) * 0.4) for name, shape in shapes(config, 3).items()})
    for weight in weights.values():
        weight.requires_grad_()
    sigma = single({"sigma": torch.tensor([0.05, 0.4, 2.0, 20.0], dtype=torch.float64)})["sigma"]
    latent = batch["latent"][..., None]
    draw = lambda: torch.tensor(rng.normal(size=(*batch["latent"].shape, 3)))
    x = draw() * (sigma**2 + 0.25).sqrt()[:, None, None, None] * latent
    inputs = single({"x": x, "probe": draw()})
    result = golden(spec, weights, batch, inputs["x"], sigma, inputs["probe"], True)
    write("geometric_network.safetensors", result | {f"input.{name}": tensor for name, tensor in batch.items()})


def stretches(observed, latent):
    """Latent timesteps between observed ones, in the order in which they are counted from an observed state, with how far away each is
    and how far away the state is that ends the stretch."""
    edges = [-1, *observed, None]
    for before, after in zip(edges, edges[1:]):
        inside = [t for t in latent if t > before and (after is None or t < after)]
        if not inside:
            continue
        if before >= 0:
            yield inside, np.array([t - before for t in inside]), after and after - before
        else:
            inside = inside[::-1]
            yield inside, np.array([after - t for t in inside]), None


def of_noise(k, n, dim):
    """What unit errors of k + 1 observed positions do to k steps and to the motion at n timesteps after them, (k + n, k + n), both
    beyond the velocity at the last position: the slope of the parabola through the last three, or of the line through two."""
    steps = np.eye(k + n, k + 1, 1) - np.eye(k + n, k + 1)
    velocity = np.zeros(k + 1)
    if dim < 2:
        velocity[-3:] = [0.5, -2, 1.5] if k > 1 else [-1, 1]
    return (steps - velocity) @ (steps - velocity).T


def left_to_chance(known, dim, n_past):
    """The covariance of motion after the last observed state that is not predicted from the n_past steps before it, (N, N)."""
    k, n = known["n_past"], known["n_timesteps"]
    covariance = np.array(known["values"][dim]).reshape(k + n, k + n)
    past, future = slice(k - n_past, k), slice(k, k + n)
    if n_past == 0:
        return covariance[future, future]
    noisy = covariance + known["noise"][dim] ** 2 * of_noise(k, n, dim)
    w = noisy[future, past] @ np.linalg.inv(noisy[past, past])
    explained = w @ covariance[past, future]
    return covariance[future, future] - explained - explained.T + w @ covariance[past, past] @ w.T


def change_of_variables(known, observed, latent, present):
    """The path G by which residuals follow from x, (T, T), the modes of x, (D, T, T), and their variances, (D, T), of one agent.

    x is white where residuals are a Brownian path, or a bridge between observed states: G is the Cholesky factor of its covariance. In
    traffic residuals have another covariance S, and x that of inv(G) S inv(G)'.
    """
    t, n_dims = len(observed), len(known["values"])
    path, modes, variances = np.zeros((t, t)), np.zeros((n_dims, t, t)), np.zeros((n_dims, t))
    seen, hidden = np.flatnonzero(observed), np.flatnonzero(latent)
    if len(seen) == 0:
        path[hidden, hidden], modes[:, hidden, hidden], variances[:, hidden] = 1, 1, 0.25
        return path, modes, variances
    # Steps without a gap up to the last observed state, from which motion is predicted if nothing later than the present is observed.
    n_past = 0
    while seen[-1] <= present and n_past < min(known["n_past"], len(seen) - 1) and seen[-1 - n_past] - 1 == seen[-2 - n_past]:
        n_past += 1
    for at, away, gap in stretches(seen, hidden):
        brownian = np.minimum.outer(away, away) - (np.outer(away, away) / gap if gap else 0)
        factor = np.linalg.cholesky(brownian)
        path[np.ix_(at, at)] = factor
        for dim in range(n_dims):
            covariance = left_to_chance(known, dim, n_past if at[0] > seen[-1] else 0)
            n = max(gap or 0, away.max())
            index = np.minimum(np.arange(n), len(covariance) - 1)
            sums = covariance[np.ix_(index, index)].cumsum(0).cumsum(1)
            if gap:
                sums = sums - np.outer(sums[:, gap - 1], sums[gap - 1]) / max(sums[gap - 1, gap - 1], 1e-4)
            residuals = sums[np.ix_(away - 1, away - 1)]
            values, vectors = np.linalg.eigh(np.linalg.solve(factor, np.linalg.solve(factor, residuals).T))
            modes[dim][np.ix_(at, at)] = vectors.T
            variances[dim, at] = values.clip((0.2 * known["noise"][dim]) ** 2 if known["noise"] else 1e-4)
    return path, modes, variances


def carried_geometric():
    spec, weights = read_checkpoint(ROOT / "pipelines/models/geometric.safetensors", torch.float64)
    batch = {name: t.double() for name, t in load_file(ROOT / "tests/golden/geometric_scene.safetensors").items()}
    known = spec["normalizer"]["motion_covariance"]
    parts = []
    for b, a in np.ndindex(*batch["valid"].shape[:2]):
        parts.append(change_of_variables(known, batch["observed"][b, a], batch["latent"][b, a], spec["n_history"] - 1))
        if batch["attributes"][b, a, 6] > 0:  # INTERACTION records no heading of this class: none is generated
            parts[-1][1][2], parts[-1][2][2] = 0, 0
    for name, part in zip(("path", "modes", "variances"), zip(*parts)):
        batch[name] = torch.tensor(np.stack(part)).unflatten(0, batch["valid"].shape[:2])
    rng = np.random.default_rng(31)
    n_samples = 2
    sigma = torch.tensor([0.02, 0.3, 2.0, 40.0], dtype=torch.float64)
    shape = (4, *batch["valid"].shape[1:], 3)
    assert len(batch["valid"]) * n_samples == len(sigma)
    x = torch.tensor(rng.normal(size=shape)) * (sigma**2 + 0.25).sqrt()[:, None, None, None]
    latent = batch["latent"].repeat_interleave(n_samples, 0)[..., None]
    inputs = single({"x": x * latent, "probe": torch.tensor(rng.normal(size=shape)), "sigma": sigma})
    write("carried_geometric.safetensors", golden(spec, weights, batch, *(inputs[n] for n in ("x", "sigma", "probe")), False))


if __name__ == "__main__":
    random_network()
    carried_geometric()
