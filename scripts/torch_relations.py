"""Where noisy agents are and what is around them there, in PyTorch: what the geometric network is told of an estimate.

What src/model/relations.rs looks up row by row, over whole batches at once. Nothing here takes a gradient. What it reads of a
batch beside states is geometry: pieces of lanes (B, P) with piece_points (B, P, 10, 3) (x, y, heading), piece_edges (B, P, 10, 2) and
piece_has_edges (B, P, 10), piece_lane and piece_length (B, P); which of them each agent is shown, seen_piece, seen_reach,
seen_is_reached and agent_lane_valid (B, A, S); half_size (B, A, 2), is_vulnerable (B, A), and dt_s (B).
"""

import torch

POSITION_M, EGO_POSITION_M, SPEED_MPS = 10.0, 50.0, 10.0
AWAY_M, PREVIEW_POINTS = 2.0, 3


def pick(x, index, dim):
    """Entries `index` of x along `dim`, with the dimensions behind it: index has the shape of x up to `dim`."""
    tail = x.shape[dim + 1 :]
    index = index.reshape(*index.shape, *[1] * len(tail)).expand(*index.shape, *tail)
    return x.gather(dim, index)


def turned(x, y, cos, sin):
    """A vector in the frame whose axis is (cos, sin)."""
    return x * cos + y * sin, y * cos - x * sin


def smallest(x, n, dim):
    """The `n` smallest entries along `dim` and where they are; of equal ones the first."""
    values, index = x.sort(dim=dim, stable=True)
    return values.narrow(dim, 0, min(n, x.shape[dim])), index.narrow(dim, 0, min(n, x.shape[dim]))


class Surroundings:
    """What does not change between calls: when tokens are, and the lanes that each agent is shown."""

    def __init__(self, batch, patch):
        valid = batch["valid"]
        n_rows, n_agents, n_steps = valid.shape
        n_tokens = -(-n_steps // patch)
        there = torch.nn.functional.pad(valid, (0, n_tokens * patch - n_steps)).unflatten(-1, (n_tokens, patch)) > 0
        times = torch.arange(n_tokens * patch).view(n_tokens, patch)
        last = torch.where(there, times, -1).amax(-1)
        first = torch.where(there, times, n_steps).amin(-1)
        before = torch.nn.functional.pad(last.cummax(-1).values[..., :-1], (1, 0), value=-1)
        since = torch.where(before >= 0, before, first)
        self.there, self.last, self.since = last >= 0, last.clamp(min=0), since.clamp(max=n_steps - 1)
        self.moves = self.there & (since < last)
        dt_s = batch["dt_s"][:, None, None]
        self.elapsed_s = torch.where(self.moves, (last - since) * dt_s, torch.ones_like(dt_s))

        self.origin, self.rotation = batch["origin"], batch["rotation"]
        self.half_size, self.is_vulnerable = batch["half_size"], batch["is_vulnerable"]
        piece, rows = batch["seen_piece"].long(), torch.arange(n_rows)[:, None, None]
        self.points, self.edges = batch["piece_points"][rows, piece], batch["piece_edges"][rows, piece]
        self.has_edges = batch["piece_has_edges"][rows, piece]
        self.step_m = batch["piece_length"][rows, piece] / (self.points.shape[-2] - 1)
        self.reach, self.is_reached = batch["seen_reach"], batch["seen_is_reached"]
        self.seen = batch["agent_lane_valid"] > 0
        lane = batch["piece_lane"][rows, piece]
        self.same_lane = lane[..., :, None] == lane[..., None, :]
        self.by_lane = lane.argsort(dim=-1, stable=True)
        self.direction = torch.stack([self.points[..., 2].cos(), self.points[..., 2].sin()], -1)

    def map(self, change):
        """The same with every tensor changed."""
        other = object.__new__(Surroundings)
        other.__dict__.update({name: change(tensor) for name, tensor in self.__dict__.items()})
        return other


@torch.no_grad()
def relations(around, poses, n_neighbors, n_lanes):
    """Features of each token at decoded `poses` (B, A, T, 3) of `around`: own (B, A, N, 10), neighbors (B, A, K, N, 17) with whether
    there is one, lanes (B, A, N, L, 13) with whether there is one."""
    now, then = pick(poses, around.last, 2), pick(poses, around.since, 2)
    velocity = (now - then)[..., :2] / around.elapsed_s[..., None] * around.moves[..., None]
    x, y, heading = now.unbind(-1)
    pose = torch.stack([x, y, heading.cos(), heading.sin(), *velocity.unbind(-1)], -1)
    return own(around, pose), neighbors(around, pose, n_neighbors), lanes(around, pose, n_lanes)


def own(around, pose):
    x, y, cos, sin, vx, vy = pose.unbind(-1)
    (x0, y0), (cos0, sin0) = around.origin[:, :, None].unbind(-1), around.rotation[:, :, None].unbind(-1)
    along, across = turned(x - x0, y - y0, cos0, sin0)
    ahead, aside = turned(cos, sin, cos0, sin0)
    forward, sideways = turned(vx, vy, cos, sin)
    features = [along / POSITION_M, across / POSITION_M, ahead, aside, x / EGO_POSITION_M, y / EGO_POSITION_M, cos, sin]
    return torch.stack([*features, forward / SPEED_MPS, sideways / SPEED_MPS], -1) * around.there[..., None]


def gaps(around, pose):
    """How far boxes are apart on the axis on which they are farthest apart (separating axes), (B, A, A, N)."""
    x, y, cos, sin = pose[..., :4].unbind(-1)
    me, them = lambda t: t[:, :, None], lambda t: t[:, None]
    dx, dy = them(x) - me(x), them(y) - me(y)
    c = (me(cos) * them(cos) + me(sin) * them(sin)).abs()
    s = (me(cos) * them(sin) - me(sin) * them(cos)).abs()
    length, width = around.half_size[..., None].unbind(-2)

    def beyond(cos, sin, length, width, other_length, other_width):
        along, across = turned(dx, dy, cos, sin)
        along = along.abs() - length - (other_length * c + other_width * s)
        return torch.maximum(along, across.abs() - width - (other_length * s + other_width * c))

    mine = beyond(me(cos), me(sin), me(length), me(width), them(length), them(width))
    return torch.maximum(mine, beyond(them(cos), them(sin), them(length), them(width), me(length), me(width)))


def neighbors(around, pose, n):
    n_agents = pose.shape[1]
    others = around.there[:, :, None] & around.there[:, None] & ~torch.eye(n_agents, dtype=torch.bool)[None, :, :, None]
    gap, index = smallest(gaps(around, pose).masked_fill(~others, torch.inf), n, 2)
    there = gap.isfinite()
    gap = gap.masked_fill(~there, 0.0)
    sizes = torch.cat([around.half_size, around.is_vulnerable[..., None]], -1)
    known = torch.cat([pose, sizes[:, :, None].expand(*pose.shape[:3], 3)], -1)
    known = pick(known[:, None].expand(-1, n_agents, -1, -1, -1).transpose(2, 3), index.transpose(2, 3), 3).transpose(2, 3)
    x, y, cos, sin, vx, vy, length, width, is_vulnerable = known.unbind(-1)
    x0, y0, cos0, sin0, vx0, vy0 = pose[:, :, None].unbind(-1)
    dx, dy = turned(x - x0, y - y0, cos0, sin0)
    dvx, dvy = turned(vx - vx0, vy - vy0, cos0, sin0)
    ahead, aside = turned(cos, sin, cos0, sin0)
    distance = torch.hypot(dx, dy)
    closing = -(dx * dvx + dy * dvy) / distance.clamp(min=0.1)
    near = POSITION_M + distance
    features = [dx / near, dy / near, (dx / 4).tanh(), (dy / 4).tanh(), ahead, aside, dvx / SPEED_MPS, dvy / SPEED_MPS]
    features += [(gap / 2).tanh(), (gap / 10).tanh(), (-gap.clamp(min=-1)).exp(), closing / SPEED_MPS]
    features += [(closing / gap.clamp(min=0.5)).tanh(), length / 3, width / 1.5, is_vulnerable]
    features += [torch.hypot(vx0, vy0).expand_as(gap) / SPEED_MPS]
    return torch.stack(features, -1) * there[..., None], there


def lanes(around, pose, n):
    """The nearest point of the nearest piece of each of the `n` nearest lanes."""
    x, y, cos, sin, vx, vy = pose[:, :, :, None].unbind(-1)
    n_tokens, n_pieces = pose.shape[2], around.points.shape[2]
    points = around.points[:, :, None]
    squared = (x[..., None] - points[..., 0]).square() + (y[..., None] - points[..., 1]).square()
    squared, k = squared.min(-1)
    wide = lambda t: t[:, :, None].expand(-1, -1, n_tokens, *[-1] * (t.dim() - 2))
    along = pick(wide(around.direction), k[..., None], 4).squeeze(-2)
    cost = squared.sqrt() + AWAY_M * (1 - (along[..., 0] * cos + along[..., 1] * sin))
    cost = cost.masked_fill(~wide(around.seen), torch.inf)
    # Of the pieces of a lane the nearest counts; of those that are as near, sharing a point, the first that is shown.
    mine, theirs = cost[..., :, None], cost[..., None, :]
    earlier = torch.ones(n_pieces, n_pieces, dtype=torch.bool).tril(-1)
    beaten = wide(around.same_lane) & ((theirs < mine) | ((theirs == mine) & earlier))
    # Lanes that begin where others end are as near as those: the one with the lower number comes first.
    by_lane = wide(around.by_lane)
    cost, index = smallest(cost.masked_fill(beaten.any(-1), torch.inf).gather(-1, by_lane), n, -1)
    index = by_lane.gather(-1, index)
    there = cost.isfinite() & around.there[..., None]

    k = k.gather(-1, index)
    at = lambda t: pick(wide(t), index, 3)
    of_points = torch.cat([around.points, around.edges, around.has_edges[..., None]], -1)
    of_points = at(of_points)
    px, py, heading, left, right, has_edges = pick(of_points, k[..., None], 4).squeeze(-2).unbind(-1)
    ahead = (k + PREVIEW_POINTS).clamp(max=around.points.shape[-2] - 1)
    turn = pick(of_points[..., 2], ahead[..., None], 4).squeeze(-1) - heading
    c, s = heading.cos(), heading.sin()
    along, offset = turned(x - px, y - py, c, s)
    half_width = around.half_size[:, :, None, None, 1]
    is_reached = at(around.is_reached)
    reach = (at(around.reach) + at(around.step_m) * k) * is_reached
    facing, aside = turned(cos, sin, c, s)
    forward, sideways = turned(vx, vy, c, s)
    features = [offset.tanh(), (offset / 5).clamp(-4, 4), (along / 5).clamp(-4, 4), facing, aside]
    features += [((left - offset - half_width) / 2).tanh() * has_edges, ((right + offset - half_width) / 2).tanh() * has_edges]
    features += [has_edges, torch.atan2(turn.sin(), turn.cos()), is_reached, reach / 20, forward / SPEED_MPS, sideways / SPEED_MPS]
    return torch.stack(features, -1) * there[..., None], there
