"""A server in this process, and its clients."""

from collections.abc import Callable, Iterator
from typing import Any

import gymnasium
import pytest

from gym_open.remote.server import Server
from tests.children import HANG_S

Client = Callable[..., Any]


@pytest.fixture(autouse=True)
def _patient(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("gym_open.remote.client._CLOSE_DEADLINE_S", HANG_S)


@pytest.fixture(scope="session")
def client() -> Client:
    """Makes an environment on the server at a port. A call that reaches its deadline hangs."""

    def make(port: int, **changes: Any) -> Any:
        given = {"env_ip": "127.0.0.1", "self_ip": "localhost", "port": port, "deadline_s": HANG_S}
        return gymnasium.make("gym_open:open_puzzle_proc-v0", **{**given, **changes})

    return make


@pytest.fixture(scope="module")
def server() -> Iterator[Server]:
    """A server for two clients, in a thread of this process."""
    with Server("127.0.0.1", 0, None, clients=2) as started:
        yield started


@pytest.fixture
def env(client: Client, server: Server) -> Iterator[Any]:
    """A client's environment."""
    made = client(server.port)
    yield made
    made.close()
    assert len(server.sessions) == 0
