"""Connects a planner in Python with `djinn drive`, with nothing but the standard library.

    from djinn.drive import serve
    serve(lambda observation, hello: {"acceleration_mps2": 0.0, "curvature_1pm": 0.0})

`serve` calls the function for every observation; what it returns is the action. Both are as in
schemas/drive_protocol.v1.json. With gymnasium, `environment()` gives an environment whose episodes are the scenarios of
a corpus, one after the other.
"""

import json
import math
import shlex
import socket
import subprocess
import sys


def serve(act, lines=sys.stdin, out=sys.stdout):
    """Answers djinn until it ends. `act(observation, hello)` returns an action as a dict; hello is of the scenario."""
    hello = None
    for line in lines:
        message = json.loads(line)
        if message["type"] == "hello":
            hello = message
        elif message["type"] == "observation":
            out.write(json.dumps({"type": "action", **act(message, hello)}) + "\n")
            out.flush()


def peek(n, lines=sys.stdin, out=sys.stdout):
    """Within `act`: n sampled futures of everybody from now on, each a list of agents with `id` and `states`."""
    out.write(json.dumps({"type": "peek", "n": n}) + "\n")
    out.flush()
    return json.loads(lines.readline())["futures"]


def find(observation, agent_id):
    """The agent of this name."""
    return next(agent for agent in observation["agents"] if agent["id"] == agent_id)


def along(route, x, y):
    """How far along the route, an array of points, a place is, and how far to the left of it, meters."""
    best, station = (math.inf, 0.0, 0.0), 0.0
    for (ax, ay), (bx, by) in zip(route, route[1:]):
        dx, dy = bx - ax, by - ay
        length = math.hypot(dx, dy) or 1e-9
        share = min(max(((x - ax) * dx + (y - ay) * dy) / length**2, 0.0), 1.0)
        aside = (dx * (y - ay) - dy * (x - ax)) / length
        distance = math.hypot(x - ax - share * dx, y - ay - share * dy)
        best = min(best, (distance, station + share * length, aside))
        station += length
    return best[1], best[2]


def relay(port):
    """Passes lines between djinn and the environment that started it."""
    connection = socket.create_connection(("127.0.0.1", port)).makefile("rw", encoding="utf-8")
    for line in sys.stdin:
        connection.write(line)
        connection.flush()
        if json.loads(line)["type"] in ("observation", "futures"):
            sys.stdout.write(connection.readline())
            sys.stdout.flush()


def environment(corpus, out, djinn="djinn", options="", n_agents=8):
    """A gymnasium environment. Observations are the ego's speed, its place on the route, and of the nearest agents x, y
    (in the frame of the ego), cos and sin of the heading, and velocity; actions are acceleration and curvature. The
    reward is the way driven in meters, and -100 for a failure. `reset(seed=...)` begins with the first scenario again;
    djinn writes its results to `out`-0, `out`-1, …"""
    import gymnasium
    import numpy

    class Drive(gymnasium.Env):
        metadata = {"render_modes": []}
        observation_space = gymnasium.spaces.Box(-numpy.inf, numpy.inf, (3 + 6 * n_agents,), numpy.float32)
        action_space = gymnasium.spaces.Box(numpy.float32([-9.0, -0.3]), numpy.float32([5.0, 0.3]), dtype=numpy.float32)
        process, n_runs, lines, last = None, 0, None, None

        def start(self, seed):
            self.close()
            with socket.create_server(("127.0.0.1", 0)) as server:
                ego = shlex.join([sys.executable, __file__, str(server.getsockname()[1])])
                command = [*shlex.split(djinn), "drive", corpus, "--ego", ego, "--out", f"{out}-{self.n_runs}"]
                command += ["--quiet", "--threads", "1", "--seed", str(seed), *shlex.split(options)]
                self.process = subprocess.Popen(command, stdout=subprocess.DEVNULL)
                server.settimeout(60.0)
                self.lines = server.accept()[0].makefile("rw", encoding="utf-8")
            self.n_runs += 1

        def read(self):
            message = json.loads(self.lines.readline() or '{"type": "end"}')
            if message["type"] == "observation":
                self.last = message
            return message

        def features(self):
            ego = find(self.last, self.hello["ego_id"])
            x, y, heading, vx, vy = ego["states"][-1]
            cos, sin = math.cos(heading), math.sin(heading)
            turned = lambda dx, dy: (dx * cos + dy * sin, dy * cos - dx * sin)
            others = [a["states"][-1] for a in self.last["agents"] if a is not ego]
            others.sort(key=lambda s: math.hypot(s[0] - x, s[1] - y))
            seen = [math.hypot(vx, vy), *along(self.hello["route"], x, y)]
            for s in others[:n_agents]:
                turn = s[2] - heading
                seen += [*turned(s[0] - x, s[1] - y), math.cos(turn), math.sin(turn), *turned(s[3], s[4])]
            return numpy.array(seen + [0.0] * (3 + 6 * n_agents - len(seen)), numpy.float32)

        def reset(self, *, seed=None, options=None):
            super().reset(seed=seed)
            if self.process is None or seed is not None:
                self.start(seed or 0)
            elif self.last is not None:
                while self.act([0.0, 0.0])["type"] == "observation":  # An episode that was left is driven to its end.
                    pass
            self.hello = self.read()
            if self.hello["type"] == "end":
                self.process.wait()
                self.start(0)
                self.hello = self.read()
            self.read()
            return self.features(), {"scenario_id": self.hello["scenario_id"]}

        def act(self, action):
            action = {"type": "action", "acceleration_mps2": float(action[0]), "curvature_1pm": float(action[1])}
            self.lines.write(json.dumps(action) + "\n")
            self.lines.flush()
            message = self.read()
            self.last = None if message["type"] != "observation" else self.last
            return message

        def peek(self, n):
            """n sampled futures of everybody from now on, each a list of agents with `id` and `states`."""
            return peek(n, self.lines, self.lines)

        def step(self, action):
            before, station = self.features(), along(self.hello["route"], *self.ego_place())[0]
            message = self.act(action)
            if message["type"] == "observation":
                return self.features(), along(self.hello["route"], *self.ego_place())[0] - station, False, False, {}
            survived = message.get("outcome") == "survived"
            return before, 0.0 if survived else -100.0, not survived, survived, message

        def ego_place(self):
            return find(self.last, self.hello["ego_id"])["states"][-1][:2]

        def close(self):
            if self.process is not None:
                self.lines.close()
                self.process.terminate()
                self.process.wait()
                self.process = self.last = None

    return Drive()


if __name__ == "__main__":
    relay(int(sys.argv[1]))
