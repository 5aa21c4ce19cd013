"""The web viewer's page on the loopback address, with a policy that keeps a browser from contacting other hosts.

Rerun's page loads a font from Google and sends usage statistics to Rerun's makers, and no setting prevents this. So a
proxy passes on the page from Rerun's own server with a header that forbids other connections.
"""

import http.client
import sys
import threading
from contextlib import closing
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from types import TracebackType
from typing import Any, Self

LOOPBACK = "127.0.0.1"
_HERE = {LOOPBACK, "localhost"}
"""Accepted host names, with any port, because the port may be forwarded from another host."""
_FILES = {"/", "/re_viewer.js", "/re_viewer_bg.wasm", "/favicon.svg", "/favicon.ico"}


class PageServer:
    """Serve the page in a thread while the context is open."""

    def __init__(self, port: int, inner: int, data: int) -> None:
        """Bind the page's port.

        Args:
            port: port of the page.
            inner: port of Rerun's own page server.
            data: port of the data server.
        """
        self.port = port
        self._server = _Server((LOOPBACK, port), _handler(inner, data))
        self._thread = threading.Thread(target=self._server.serve_forever, kwargs={"poll_interval": 0.1}, daemon=True)

    def __enter__(self) -> Self:
        self._thread.start()
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._server.shutdown()
        self._server.server_close()
        self._thread.join()


class _Server(ThreadingHTTPServer):
    daemon_threads = True

    def handle_error(self, request: Any, client_address: Any) -> None:
        if not isinstance(sys.exception(), OSError):  # a browser may close a connection at any time
            super().handle_error(request, client_address)


def _is_here(host: str) -> bool:
    """Whether a request's `Host` names this machine; this prevents DNS rebinding."""
    return host.rpartition(":")[0] in _HERE or host in _HERE


def _handler(inner: int, data: int) -> type[BaseHTTPRequestHandler]:
    source = f"http://{LOOPBACK}:{data}"
    start = f"/?url=rerun%2B{source}/proxy&hide_welcome_screen"
    policy = (
        f"default-src 'none'; script-src 'self' 'unsafe-inline' 'wasm-unsafe-eval'; connect-src 'self' {source}; "
        "style-src 'unsafe-inline'; img-src 'self' data: blob:; worker-src 'self' blob:"
    )

    class Handler(BaseHTTPRequestHandler):
        def do_GET(self) -> None:
            name = self.path.partition("?")[0]
            if not _is_here(self.headers.get("Host", "")):
                self.send_error(403)
            elif self.path == "/":
                self.send_response(302)
                self.send_header("Location", start)
                self.send_header("Content-Length", "0")
                self.end_headers()
            elif name in _FILES:
                self._pass_on(name)
            else:
                self.send_error(404)

        def _pass_on(self, name: str) -> None:
            try:
                with closing(http.client.HTTPConnection(LOOPBACK, inner, timeout=30)) as connection:
                    connection.request("GET", name)
                    answer = connection.getresponse()
                    body, kind = answer.read(), answer.getheader("Content-Type", "application/octet-stream")
            except (OSError, http.client.HTTPException):
                self.send_error(502)
                return
            self.send_response(answer.status)
            self.send_header("Content-Type", kind)
            self.send_header("Content-Length", str(len(body)))
            self.send_header("Content-Security-Policy", policy)
            self.end_headers()
            self.wfile.write(body)

        def log_message(self, format: str, *args: Any) -> None:  # noqa: A002  (the name in the base class)
            del format, args  # no output per request

    return Handler
