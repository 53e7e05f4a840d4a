"""Files on the loopback, from servers that break off where a test wants it."""

import contextlib
import threading
import time
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer

PIECE = 10_000  # bytes


class Server(ThreadingHTTPServer):
    """Serves one file on the loopback, whole or from a place on.

    stops   bytes after which a connection ends, though more was promised; 0: it does not
    pause   seconds before each further 10,000 bytes
    ranges  it can begin elsewhere than at the beginning
    asked   the ranges that were asked for
    """

    def __init__(self, data, stops=0, ranges=True, pause=0.0):
        super().__init__(("127.0.0.1", 0), Handler)
        self.data, self.stops, self.ranges, self.asked = data, stops, ranges, []
        self.pause = pause
        self.address = f"http://127.0.0.1:{self.server_port}/agent.jd"


class Handler(BaseHTTPRequestHandler):
    server: Server  # pyrefly: ignore

    def do_GET(self):
        data, asked = self.server.data, self.headers["Range"]
        self.server.asked.append(asked)
        begin = int(asked[len("bytes=") : -1]) if asked and self.server.ranges else 0
        if begin and begin >= len(data):
            return self.send_error(416)
        self.send_response(206 if begin else 200)
        if begin:
            self.send_header("Content-Range", f"bytes {begin}-{len(data) - 1}/{len(data)}")
        self.send_header("Content-Length", str(len(data) - begin))
        self.end_headers()
        end = min(begin + (self.server.stops or len(data)), len(data))
        for at in range(begin, end, PIECE):
            time.sleep(self.server.pause)
            self.wfile.write(data[at : min(at + PIECE, end)])

    def log_message(self, *args):
        pass


@contextlib.contextmanager
def serving():
    """What starts servers; all are stopped in the end."""
    servers = []

    def start(*args, **options):
        servers.append(Server(*args, **options))
        threading.Thread(target=servers[-1].serve_forever, args=(0.01,), daemon=True).start()
        return servers[-1]

    try:
        yield start
    finally:
        for server in servers:
            server.shutdown()
            server.server_close()
