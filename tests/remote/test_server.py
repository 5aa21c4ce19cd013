"""A world on a server: the same bits as in this process, and an error for each kind of failure."""

import os
import re
import signal
import subprocess
import sys
import threading
from collections.abc import Callable, Iterator
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager
from pathlib import Path
from typing import Any, NamedTuple

import gymnasium
import numpy as np
import pytest

from gym_open.envs.puzzles import PuzzleError
from gym_open.errors import ConfigError, GymOpenError, UsageError
from gym_open.remote import protocol as p
from gym_open.remote.address import is_loopback, read_token
from gym_open.remote.server import Server
from tests.children import HANG_S, started

Client = Callable[..., Any]

TOKEN = "correct-horse-battery-staple"


class Served(NamedTuple):
    """`serve` in another process."""

    process: subprocess.Popen[str]
    greeting: str
    port: int


@contextmanager
def serving(**arguments: Any) -> Iterator[Served]:
    code = f"from gym_open.remote.server import serve; serve(port=0, **{arguments!r})"
    environment = {key: value for key, value in os.environ.items() if key != p.TOKEN_VARIABLE}
    with started([sys.executable, "-c", code], stdout=subprocess.PIPE, text=True, env=environment) as process:
        assert process.stdout
        greeting = ""
        for line in process.stdout:
            greeting += line
            if "Ctrl-C" in line:
                break
        yield Served(process, greeting, int(re.findall(r":(\d+),", greeting)[0]))


def near(**changes: Any) -> Any:
    return gymnasium.make("gym_open:open_puzzle_proc-v0", **changes)


@pytest.mark.parametrize("debug", [False, True])
def test_far_is_near_bit_for_bit(client: Client, server: Server, debug: bool) -> None:
    pair = near(debug=debug), client(server.port, debug=debug)
    rng = np.random.default_rng(0)
    for one in pair:
        one.add_change_puzzle(mode=0, puzzle_config={"main_sphere": 1, "cube": np.int64(4), "touch_sphere": 2})
        one.set_observation(True)
    for seed, change in enumerate([None, None, (1, 2), (1, 4)]):
        for one in pair:
            if change:
                one.add_change_puzzle(*change)
            one.configure_env(False, action_space="full", skip_frame=seed != 1)
            one.turn_off_reward(seed == 2)
        here, there = (one.reset(seed=seed) for one in pair)
        assert_same(here, there)
        for action in rng.integers(0, 9, 40):
            here, there = (one.step(action) for one in pair)
            assert_same(here[0], there[0])
            assert here[1:] == there[1:]
    pair[1].close()


def assert_same(here: Any, there: Any) -> None:
    assert here["image"].dtype == there["image"].dtype
    assert np.array_equal(here["image"], there["image"])
    assert here["object_information"] == there["object_information"]
    assert there["image"].flags.writeable


@pytest.mark.parametrize(
    ("call", "kind"),
    [
        (lambda env: env.step(9), UsageError),
        (lambda env: env.reset(seed=2**63), UsageError),
        (lambda env: env.add_change_puzzle(0, 0, {"cubes": 1}), ConfigError),
        (
            lambda env: env.add_change_puzzle(0, 0, {"touch_sphere": 3, "high_value_target": 3, "radius": 1}),
            PuzzleError,
        ),
    ],
)
def test_an_error_is_the_same_near_and_far(env: Any, call: Any, kind: type[GymOpenError]) -> None:
    said = []
    for one in (env, near()):
        one.add_change_puzzle(1, 1)
        with pytest.raises(GymOpenError) as caught:
            call(one)
        said.append((type(caught.value), str(caught.value)))
        one.step(1)  # goes on
    assert said[0] == said[1]
    assert said[0][0] is kind


def test_each_client_has_a_world_of_its_own_until_the_places_are_taken(client: Client, server: Server) -> None:
    one, two = client(server.port), client(server.port)
    for seed, env in enumerate((one, two)):
        env.add_change_puzzle(1, 1)
        env.reset(seed=seed)
    before = two.step(0)
    one.step(3)
    assert two.step(0) == before
    with pytest.raises(UsageError, match=r"all 2 places are taken: close another .* `--clients`"):
        client(server.port)
    one.close()
    three = client(server.port)
    assert two.step(0) == before
    for env in (two, three):
        env.close()
    assert len(server.sessions) == 0


def test_clients_play_side_by_side(client: Client, server: Server) -> None:
    """Two threads at the same time get the same results as one after the other."""

    def played(seed: int, out: dict[int, Any]) -> None:
        env = client(server.port)
        env.add_change_puzzle(1, 3)
        env.reset(seed=seed)
        out[seed] = [env.step(action)[:3] for action in np.random.default_rng(seed).integers(0, 9, 60)]
        env.close()

    together: dict[int, Any] = {}
    threads = [threading.Thread(target=played, args=(seed, together)) for seed in (0, 1)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    alone: dict[int, Any] = {}
    for seed in (0, 1):
        played(seed, alone)
    assert together == alone


def test_more_clients_than_places_get_a_place_or_a_clear_refusal(client: Client, server: Server) -> None:
    """Thirty calls at a time are more than the server accepts."""
    got: list[Any] = []

    def ask(_: int) -> None:
        try:
            got.append(client(server.port))
        except GymOpenError as error:
            got.append(str(error))

    with ThreadPoolExecutor(30) as threads:
        list(threads.map(ask, range(30)))
    refused = [one for one in got if isinstance(one, str)]
    assert all("all 2 places are taken" in one or "is overloaded" in one for one in refused)
    assert len(server.sessions) == len(got) - len(refused) <= 2
    for one in got:
        if not isinstance(one, str):
            one.close()
    client(server.port).close()


def test_only_loopback_goes_without_a_token(client: Client, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.delenv(p.TOKEN_VARIABLE, raising=False)
    for host in ("0.0.0.0", "::", "192.168.1.2", "example.org"):
        with pytest.raises(UsageError, match=rf"host: {host} can be reached from other machines, so a token is needed"):
            Server(host, 0, None)
    with Server("0.0.0.0", 0, TOKEN) as server:
        monkeypatch.setenv(p.TOKEN_VARIABLE, TOKEN)
        client(server.port).close()
    assert [is_loopback(host) for host in ("localhost", "127.0.0.1", "127.9.9.9", "::1")] == [True] * 4


def test_a_token_comes_from_a_file_or_the_environment(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.delenv(p.TOKEN_VARIABLE, raising=False)
    assert read_token(None) is None
    monkeypatch.setenv(p.TOKEN_VARIABLE, TOKEN)
    assert read_token(None) == TOKEN
    file = tmp_path / "token"
    with pytest.raises(UsageError, match="token: the token cannot be read"):
        read_token(file)
    for text, fault in (("", "has 0 characters"), ("short\n", "has 5"), ("two words are too many", "without spaces")):
        file.write_text(text)
        with pytest.raises(UsageError, match=rf"token: the token .*{fault}.*secrets.token_urlsafe"):
            read_token(file)
    file.write_text(f"{TOKEN}-2\n")
    assert read_token(file) == f"{TOKEN}-2"


def test_a_port_that_is_taken_is_named(server: Server) -> None:
    with pytest.raises(UsageError, match=f"cannot listen on 127.0.0.1:{server.port}: the port is taken"):
        Server("127.0.0.1", server.port, None)


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ({"clients": 0}, "clients: expected 1 or more, got 0"),
        ({"idle_s": 0.0}, "idle_s: expected more than 0 seconds, got 0"),
        ({"idle_s": float("nan")}, "idle_s: expected more than 0 seconds, got nan"),
    ],
)
def test_wrong_arguments_of_the_server_are_named(arguments: dict[str, Any], message: str) -> None:
    with pytest.raises(UsageError, match=message):
        Server("127.0.0.1", 0, None, **arguments)


def test_without_a_server_the_error_says_where_and_what_to_do(client: Client) -> None:
    with Server("127.0.0.1", 0, None) as server:
        port = server.port
    with pytest.raises(GymOpenError, match=rf"no answer from the server at 127.0.0.1:{port}: .*start `gym-open serve`"):
        client(port)


def test_a_vanished_clients_place_is_freed(client: Client) -> None:
    def pass_time(seconds: float) -> None:
        for place in server.sessions._by_name.values():
            place.used -= seconds

    with Server("127.0.0.1", 0, None, clients=1, idle_s=50_000) as server:
        gone = client(server.port)
        gone.add_change_puzzle(1, 1)
        pass_time(40_000)
        with pytest.raises(UsageError, match="all 1 places are taken"):
            client(server.port)
        gone.step(1)  # used again
        pass_time(40_000)
        with pytest.raises(UsageError, match="action"):
            gone.step(9)  # a refused call counts as a use
        pass_time(40_000)
        gone.step(1)
        pass_time(50_001)
        env = client(server.port)  # takes the unused place
        env.add_change_puzzle(1, 1)
        with pytest.raises(UsageError, match=r"freed after 50000 s without a call.* make a new environment"):
            gone.step(1)
        env.step(1)
        pass_time(50_001)
        server.sessions.sweep()
        assert len(server.sessions) == 0


def test_a_killed_server_ends_in_an_error_that_says_where_and_what_to_do(client: Client) -> None:
    with serving() as server:
        env = client(server.port)
        env.add_change_puzzle(1, 1)
        env.step(1)
        server.process.send_signal(signal.SIGKILL)
        server.process.wait()
        for _ in range(2):
            with pytest.raises(
                GymOpenError,
                match=rf"no answer from the server at 127.0.0.1:{server.port}: .*make a new environment",
            ):
                env.step(1)
        env.close()


def test_a_hanging_server_reaches_the_deadline_and_a_stopped_server_ends_well(client: Client) -> None:
    with serving(clients=1) as server:
        env = client(server.port)
        env.add_change_puzzle(1, 1)
        server.process.send_signal(signal.SIGSTOP)
        env._session._deadline_s = 0.5
        with pytest.raises(GymOpenError, match=rf"127.0.0.1:{server.port} did not answer within 0.5 s"):
            env.step(1)
        env._session._deadline_s = HANG_S
        server.process.send_signal(signal.SIGCONT)
        env.step(1)
        server.process.send_signal(signal.SIGTERM)
        output, _ = server.process.communicate()
        assert server.process.returncode == 0
        assert "gym-open serve: listening on 127.0.0.1:" in server.greeting
        assert f"env_ip='127.0.0.1', port={server.port})" in server.greeting
        assert output == "gym-open serve: stopped\n"
        with pytest.raises(GymOpenError, match="no answer"):
            env.step(1)
        env.close()
