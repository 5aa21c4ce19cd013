"""Bytes that are no message, and messages too big, too deep or of another version, are refused; the session goes on."""

import contextlib
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from typing import Any

import grpc
import msgspec
import pytest
from hypothesis import given
from hypothesis import strategies as st

import gym_open
from gym_open.errors import GymOpenError, UsageError
from gym_open.remote import protocol as p
from gym_open.remote.server import Server
from tests.children import HANG_S

Client = Callable[..., Any]
TOKEN = "correct-horse-battery-staple"


def raw(port: int, body: bytes, method: str = f"/{p.SERVICE}/{p.METHOD}", **options: Any) -> bytes:
    """Send bytes without the client's checks."""
    with grpc.insecure_channel(f"127.0.0.1:{port}", [("grpc.max_send_message_length", -1)]) as channel:
        return channel.unary_unary(method)(body, timeout=HANG_S, **options)


def refused_with(port: int, body: bytes, **options: Any) -> tuple[grpc.StatusCode, str]:
    with pytest.raises(grpc.RpcError) as caught:
        raw(port, body, **options)
    error: Any = caught.value
    return error.code(), error.details()


@given(st.binary(max_size=300))
def test_bytes_are_a_request_or_refused(body: bytes) -> None:
    with contextlib.suppress(ValueError):
        p.decode_request(body)


@given(st.integers(0, 40), st.binary(min_size=1, max_size=4))
def test_a_changed_request_is_valid_or_refused(at: int, change: bytes) -> None:
    body = p.encode(p.Request("0" * 8, p.ChangePuzzle(0, None, {"cube": 3})))
    with contextlib.suppress(ValueError):
        p.decode_request(body[:at] + change + body[at + len(change) :])


@pytest.mark.parametrize(
    "body",
    [
        b"",
        b"\xc1",
        b"\x93" * 30_000,
        msgspec.msgpack.encode({"session": "", "call": {"type": "Exec", "code": "1"}}),
        msgspec.msgpack.encode({"session": "", "call": {"type": "Open"}}),
        msgspec.msgpack.encode({"session": 3, "call": {"type": "Close"}}),
        msgspec.msgpack.encode({"session": "\ud800".encode("utf-8", "surrogatepass"), "call": {"type": "Close"}}),
    ],
    ids=["empty", "no MessagePack", "too deep", "unknown call", "fields missing", "wrong type", "bytes for text"],
)
def test_a_malformed_message_is_refused_and_the_session_plays_on(env: Any, server: Server, body: bytes) -> None:
    env.add_change_puzzle(1, 1)
    before = env.step(0)
    code, details = refused_with(server.port, body)
    assert code is grpc.StatusCode.INVALID_ARGUMENT
    assert "not a message of protocol 1" in details
    assert env.step(0) == before


def test_an_argument_too_deep_is_refused_and_the_session_plays_on(env: Any, server: Server) -> None:
    env.add_change_puzzle(1, 1)
    deep = b"\x91" * 20_000 + b"\xc0"
    request = p.encode(p.Request(env._session._session, p.Step(msgspec.Raw(deep))))
    assert refused_with(server.port, request)[0] is grpc.StatusCode.INVALID_ARGUMENT
    env.step(0)


def test_an_unknown_method_or_session_is_refused(server: Server) -> None:
    body = p.encode(p.Request("0" * 32, p.Step(1)))
    assert refused_with(server.port, body, method="/gym_open.World/Other")[0] is grpc.StatusCode.UNIMPLEMENTED
    answer = p.decode_reply(raw(server.port, body))
    assert isinstance(answer, p.Refused)
    assert "does not know this session" in answer.message


@pytest.mark.parametrize(
    ("call", "message"),
    [
        (lambda env: env.reset(seed=2**70), "Reset: an argument cannot be sent"),
        (lambda env: env.add_change_puzzle(0, 0, {"\ud800": 1}), "an argument cannot be sent"),
        (lambda env: env.add_change_puzzle(0, 0, _endless()), "add_change_puzzle: .*recursion"),
    ],
)
def test_a_value_that_no_message_can_hold_is_named(env: Any, call: Any, message: str) -> None:
    with pytest.raises(UsageError, match=message):
        call(env)
    env.add_change_puzzle(1, 1)


def _endless() -> dict[str, Any]:
    made: dict[str, Any] = {}
    made["cube"] = made
    return made


def test_a_closed_environment_says_so(client: Client, server: Server) -> None:
    env = client(server.port)
    env.close()
    env.close()
    with pytest.raises(GymOpenError, match="is this environment still open"):
        env.step(1)


def test_oversized_requests_are_refused_by_client_and_server(env: Any, server: Server) -> None:
    env.add_change_puzzle(1, 1)
    before = env.step(0)
    with pytest.raises(GymOpenError, match=rf"127.0.0.1:{server.port}: message too large .* 65536 .* puzzle_config"):
        env.add_change_puzzle(0, 0, {"cube": "x" * p.REQUEST_BYTES})
    code, details = refused_with(server.port, b"\0" * (p.REQUEST_BYTES + 1))
    assert code is grpc.StatusCode.RESOURCE_EXHAUSTED
    assert "larger than max" in details
    assert env.step(0) == before


def test_an_oversized_reply_is_refused(client: Client, server: Server, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(p, "REPLY_BYTES", 10_000)
    env = client(server.port)
    env.add_change_puzzle(1, 1)
    env.set_observation(True)
    with pytest.raises(GymOpenError, match=r"message too large .* 10000 back"):
        env.step(1)
    env.close()


@pytest.mark.parametrize(("protocol", "package"), [(p.PROTOCOL + 1, gym_open.__version__), (p.PROTOCOL, "0.0.1")])
def test_another_version_is_refused(server: Server, protocol: int, package: str) -> None:
    answer = p.decode_reply(raw(server.port, p.encode(p.Request("", p.Open(protocol, package, debug=False)))))
    assert isinstance(answer, p.Refused)
    assert f"the client {package} with protocol {protocol}: install the same version on both" in answer.message


def test_another_service_is_not_taken_for_a_server(client: Client) -> None:
    class Other(grpc.GenericRpcHandler):
        def service(self, handler_call_details: object) -> Any:  # noqa: ARG002
            return grpc.unary_unary_rpc_method_handler(lambda body, _: body)

    other = grpc.server(ThreadPoolExecutor(1), handlers=[Other()])
    port = other.add_insecure_port("127.0.0.1:0")
    other.start()
    with pytest.raises(GymOpenError, match=r"not a message of protocol 1.*is it `gym-open serve`"):
        client(port)
    other.stop(0).wait()


def test_a_token_is_needed_where_there_is_one(client: Client, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.delenv(p.TOKEN_VARIABLE, raising=False)
    with Server("127.0.0.1", 0, TOKEN) as server:
        with pytest.raises(UsageError, match=f"no token was sent; set {p.TOKEN_VARIABLE}"):
            client(server.port)
        for wrong in (TOKEN[:-1], TOKEN + "x", TOKEN.upper()):
            monkeypatch.setenv(p.TOKEN_VARIABLE, wrong)
            with pytest.raises(UsageError, match="a wrong token was sent"):
                client(server.port)
        assert len(server.sessions) == 0
        monkeypatch.setenv(p.TOKEN_VARIABLE, TOKEN)
        env = client(server.port)
        env.add_change_puzzle(1, 1)
        env.step(1)
        monkeypatch.delenv(p.TOKEN_VARIABLE)
        env.step(1)  # it keeps its first token
        session = env._session._session
        code, _ = refused_with(server.port, p.encode(p.Request(session, p.Step(1))))
        assert code is grpc.StatusCode.UNAUTHENTICATED  # the session's name is not enough
        env.close()
