"""The web viewer's page on loopback, under a policy by which a browser fetches and sends nothing elsewhere.

Rerun's page asks Google for a font, and tells Rerun's makers about its use; a browser has no setting against that.
So it is passed on from Rerun's own server with a header that forbids it.
"""

import threading
import urllib.request
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from types import TracebackType
from typing import Self

LOOPBACK = "127.0.0.1"
_FILES = {"/", "/re_viewer.js", "/re_viewer_bg.wasm", "/favicon.svg", "/favicon.ico"}


class Page:
    """Serves the page in a thread while entered."""

    def __init__(self, port: int, inner: int, data: int) -> None:
        """Bind the page's port.

        Args:
            port: where the page is served.
            inner: port of Rerun's own page server.
            data: port of the data that the page shows.
        """
        self.port = port
        self._server = ThreadingHTTPServer((LOOPBACK, port), _handler(inner, data))
        self._server.daemon_threads = True
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
            if self.path == "/":
                self.send_response(302)
                self.send_header("Location", start)
                self.send_header("Content-Length", "0")
                self.end_headers()
            elif name in _FILES:
                self._pass_on(name)
            else:
                self.send_error(404)

        def _pass_on(self, name: str) -> None:
            with urllib.request.urlopen(f"http://{LOOPBACK}:{inner}{name}", timeout=30) as answer:
                body = answer.read()
            self.send_response(200)
            self.send_header("Content-Type", answer.headers["Content-Type"])
            self.send_header("Content-Length", str(len(body)))
            self.send_header("Content-Security-Policy", policy)
            self.end_headers()
            self.wfile.write(body)

        def log_request(self, code: int | str = "-", size: int | str = "-") -> None:
            del code, size  # nobody wants a line a request

    return Handler
