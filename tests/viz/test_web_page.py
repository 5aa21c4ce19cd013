"""The server of the page answers only requests to this machine, and survives closed connections."""

import http.client
import http.server
import socket
import struct
import threading
from collections.abc import Iterator
from contextlib import closing

import pytest

from gym_open.viz.viewers import free_port
from gym_open.viz.web_page import LOOPBACK, PageServer
from tests.children import HANG_S, until


class Inner(http.server.BaseHTTPRequestHandler):
    """Replaces Rerun's server."""

    def do_GET(self) -> None:
        self.send_response(200)
        self.send_header("Content-Type", "text/plain")
        self.end_headers()
        self.wfile.write(b"inner" * 1_000_000)

    def log_message(self, format: str, *args: object) -> None:  # noqa: A002
        del format, args


@pytest.fixture
def page() -> Iterator[PageServer]:
    with http.server.ThreadingHTTPServer((LOOPBACK, 0), Inner) as inner:
        threading.Thread(target=inner.serve_forever, args=(0.05,), daemon=True).start()
        with PageServer(free_port(0), inner.server_address[1], 1) as served:
            yield served
        inner.shutdown()


def status(page: PageServer, host: str | None = None, path: str = "/favicon.svg") -> int:
    with closing(http.client.HTTPConnection(LOOPBACK, page.port, timeout=HANG_S)) as connection:
        connection.request("GET", path, headers={"Host": host} if host else {})
        return connection.getresponse().status


def test_another_host_name_is_refused_and_no_proxy_is_used(page: PageServer, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("http_proxy", f"http://{LOOPBACK}:9")
    assert [status(page, host) for host in (None, "localhost:8000", "localhost")] == [200] * 3
    assert [status(page, host) for host in ("evil.example", "evil.example:9090", "127.0.0.1.evil.example:1")] == [
        403
    ] * 3


def test_only_the_files_of_the_page_are_passed_on(page: PageServer) -> None:
    assert [status(page, path=path) for path in ("/re_viewer.js", "/favicon.ico?again", "/?url=x")] == [200] * 3
    assert [status(page, path=path) for path in ("/other", "/re_viewer.js/..")] == [404] * 2


def test_a_closed_tab_is_no_error(page: PageServer, capsys: pytest.CaptureFixture[str]) -> None:
    with socket.create_connection((LOOPBACK, page.port)) as browser:
        browser.sendall(b"GET /favicon.svg HTTP/1.0\r\nHost: localhost\r\n\r\n")
        browser.setsockopt(
            socket.SOL_SOCKET, socket.SO_LINGER, struct.pack("ii", 1, 0)
        )  # closes the connection at once
    assert status(page) == 200
    until(lambda: not [one for one in threading.enumerate() if "process_request" in one.name])
    assert capsys.readouterr().err == ""


def test_without_the_viewer_the_page_reports_an_error() -> None:
    with PageServer(free_port(0), free_port(0), 1) as page:
        assert status(page) == 502
