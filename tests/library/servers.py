"""A server that answers as it is told, or hangs up."""

import json
from collections.abc import Iterator
from contextlib import contextmanager
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer

from benchmarks.servers import listening


@contextmanager
def answering(answers, context=None) -> Iterator[tuple[str, list]]:
    """Serve answers in turn: (status, JSON or bytes, headers if there are any), or None to hang up; a context is of TLS.

    Yields the address and the headers that were seen.
    """
    left, seen = list(answers), []

    class Handler(BaseHTTPRequestHandler):
        def _answer(self):
            self.rfile.read(int(self.headers.get("Content-Length") or 0))
            seen.append(dict(self.headers))
            answer = left.pop(0)
            if answer is None:
                self.connection.close()
                return
            status, body, headers = (*answer, {})[:3]
            content = body if isinstance(body, bytes) else json.dumps(body).encode()
            self.send_response(status)
            for name, value in ({"Content-Length": str(len(content))} | headers).items():
                self.send_header(name, value)
            self.end_headers()
            self.wfile.write(content)

        do_GET = do_POST = _answer  # noqa: N815 - names of the standard library

        def log_message(self, *_):
            pass

    server = ThreadingHTTPServer(("127.0.0.1", 0), Handler)
    server.handle_error = lambda *_: None  # what a client breaks off is no fault of the server's
    if context is not None:
        server.socket = context.wrap_socket(server.socket, server_side=True)
    with listening(server) as port:
        yield f"http{'s' if context else ''}://127.0.0.1:{port}", seen
