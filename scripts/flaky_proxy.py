#!/usr/bin/env python3
"""Passes requests on to an object store and lets some of them go wrong, as networks and servers do.

    scripts/flaky_proxy.py --upstream http://127.0.0.1:5000 --port 5001 --share 0.1 --seed 1 --count faults.json

Of the requests, a share drawn from the seed fails in one of these ways:

    busy       503, and nothing was done
    reset      a write is done, and the connection closed without an answer
    conflict   409 for a write, and nothing was done
    truncated  half of what was asked for, and the connection is closed
    short      half of what was asked for, with a length that fits

It serves until it is ended, and keeps in the file of --count how often each happened. Standard library only.
"""

import argparse
import http.client
import http.server
import json
import random
import threading
import urllib.parse

# What concerns one connection and not what goes through it.
HOP_BY_HOP = {"connection", "keep-alive", "transfer-encoding", "te", "upgrade", "expect"}
WRITES = {"PUT", "POST", "DELETE"}


class Faults:
    """Draws what happens to each request, and counts."""

    def __init__(self, share, seed, count_path):
        self.share, self.random, self.count_path = share, random.Random(seed), count_path
        self.counts = {"requests": 0}
        self.lock = threading.Lock()

    def draw(self, method):
        """What goes wrong with a request; None for nothing."""
        with self.lock:
            fault = None
            if self.random.random() < self.share:
                if method in WRITES:
                    fault = self.random.choice(["busy", "reset", "conflict"])
                elif method == "GET":
                    fault = self.random.choice(["busy", "truncated", "short"])
                else:
                    fault = "busy"
                self.counts[fault] = self.counts.get(fault, 0) + 1
            self.counts["requests"] += 1
            if self.count_path:
                with open(self.count_path, "w", encoding="utf-8") as file:
                    json.dump(self.counts, file)
            return fault


class Handler(http.server.BaseHTTPRequestHandler):
    """Passes one request on."""

    protocol_version = "HTTP/1.1"
    upstream = None
    faults = None

    def handle_request(self):
        body = self.rfile.read(int(self.headers.get("Content-Length") or 0))
        fault = self.faults.draw(self.command)
        if fault in ("busy", "conflict"):
            status, code = (503, "SlowDown") if fault == "busy" else (409, "OperationAborted")
            self.answer(status, {"Content-Type": "application/xml"}, f"<Error><Code>{code}</Code></Error>".encode())
            return
        status, headers, content = self.ask(body)
        if fault == "reset":
            self.close_connection = True
        elif fault in ("truncated", "short") and status == 200 and len(content) > 1:
            half = content[: len(content) // 2]
            length = len(half) if fault == "short" else len(content)
            self.answer(status, headers, half, length)
            self.close_connection = True
        else:
            self.answer(status, headers, content)

    do_GET = do_HEAD = do_PUT = do_POST = do_DELETE = handle_request

    def ask(self, body):
        """The answer of the store: status, headers, content."""
        connection = http.client.HTTPConnection(self.upstream.hostname, self.upstream.port, timeout=60)
        try:
            headers = {name: value for name, value in self.headers.items() if name.lower() not in HOP_BY_HOP}
            connection.request(self.command, self.path, body=body, headers=headers)
            response = connection.getresponse()
            content = response.read()
            headers = {name: value for name, value in response.getheaders() if name.lower() not in HOP_BY_HOP}
            return response.status, headers, content
        finally:
            connection.close()

    def answer(self, status, headers, content, length=None):
        """Sends an answer; `length` is what it claims to hold."""
        self.send_response_only(status)
        for name, value in headers.items():
            if name.lower() != "content-length":
                self.send_header(name, value)
        # A HEAD tells the length of what it does not send.
        told = {name.lower(): value for name, value in headers.items()}.get("content-length")
        is_head = self.command == "HEAD"
        self.send_header("Content-Length", told if is_head and told else str(len(content) if length is None else length))
        self.end_headers()
        if not is_head:
            self.wfile.write(content)

    def log_message(self, *_):
        """Requests are counted, and not told one by one."""


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--upstream", required=True, help="address of the store")
    parser.add_argument("--port", type=int, required=True, help="port to listen at, on this machine only")
    parser.add_argument("--share", type=float, default=0.1, help="share of the requests that fail (default 0.1)")
    parser.add_argument("--seed", type=int, default=1, help="decides which (default 1)")
    parser.add_argument("--count", help="file for the number of faults of each kind")
    args = parser.parse_args()
    Handler.upstream = urllib.parse.urlsplit(args.upstream)
    Handler.faults = Faults(args.share, args.seed, args.count)
    http.server.ThreadingHTTPServer(("127.0.0.1", args.port), Handler).serve_forever()


if __name__ == "__main__":
    main()
