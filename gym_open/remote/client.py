"""A session on a server: the methods of `Session`, each as one remote call."""

import contextlib
from typing import Any, TypeVar

import grpc

from gym_open.errors import GymOpenError, UsageError
from gym_open.remote import protocol as p
from gym_open.remote.address import read_token, target
from gym_open.version import __version__

R = TypeVar("R", p.Opened, p.Done, p.Observed, p.Stepped)

_CLOSE_DEADLINE_S = 2.0


class RemoteSession:
    """A world on the server at `host` and `port`, for this client only. The token is in the environment variable.

    Raises:
        UsageError: if the server refuses, because it is full or of another version, or because the token is wrong.
        GymOpenError: if there is no server, or the call takes longer than `deadline_s`.
    """

    def __init__(self, host: str, port: int, *, debug: bool, deadline_s: float) -> None:
        self._where = target(host, port)
        self._deadline_s = deadline_s
        token = read_token(None)
        self._metadata = ((p.TOKEN_KEY, token),) if token else ()
        options = [
            ("grpc.enable_http_proxy", 0),
            ("grpc.max_receive_message_length", p.REPLY_BYTES),
            ("grpc.max_send_message_length", p.REQUEST_BYTES),
        ]
        self._channel = grpc.insecure_channel(f"dns:///{self._where}", options)
        self._call = self._channel.unary_unary(f"/{p.SERVICE}/{p.METHOD}")
        self._session = ""
        try:
            opened = self._ask(p.Open(p.PROTOCOL, __version__, debug), p.Opened)
        except BaseException:
            self._channel.close()
            raise
        self._session = opened.session

    def change_puzzle(self, mode: Any, task: Any, puzzle_config: Any) -> None:
        """As `Session.change_puzzle`."""
        self._ask(p.ChangePuzzle(mode, task, puzzle_config), p.Done)

    def set_observation(self, output: Any) -> None:
        """As `Session.set_observation`."""
        self._ask(p.SetObservation(output), p.Done)

    def configure(self, first: Any, action_space: Any, skip_frame: Any) -> None:
        """As `Session.configure`."""
        self._ask(p.Configure(first, action_space, skip_frame), p.Done)

    def turn_off_reward(self, off: Any) -> None:
        """As `Session.turn_off_reward`."""
        self._ask(p.TurnOffReward(off), p.Done)

    def reset(self, seed: Any = None) -> p.Observation:
        """As `Session.reset`."""
        return self._ask(p.Reset(seed), p.Observed).observation

    def step(self, action: Any) -> p.StepResult:
        """As `Session.step`."""
        return self._ask(p.Step(action), p.Stepped).result

    def close(self) -> None:
        """Free the session on the server. A server that does not answer frees it later without a call."""
        if self._session:
            self._deadline_s = min(self._deadline_s, _CLOSE_DEADLINE_S)
            with contextlib.suppress(GymOpenError):
                self._ask(p.Close(), p.Done)
            self._session = ""
        self._channel.close()

    def _ask(self, call: p.Call, expected: type[R]) -> R:
        try:
            body = p.encode(p.Request(self._session, call))
        except (OverflowError, TypeError, ValueError, RecursionError) as error:
            raise UsageError(f"{type(call).__name__}: an argument cannot be sent: {error}") from None
        try:
            answer = p.decode_reply(self._call(body, timeout=self._deadline_s, metadata=self._metadata))
        except grpc.RpcError as error:
            raise self._explained(error) from None
        except ValueError as error:  # a closed channel raises ValueError too
            raise GymOpenError(
                f"{self._where}: {error}; is it `gym-open serve`, and is this environment still open?"
            ) from None
        if isinstance(answer, p.Refused):
            raise p.raised(answer)
        if not isinstance(answer, expected):
            raise GymOpenError(f"{self._where}: expected {expected.__name__}, got {type(answer).__name__}")
        return answer

    def _explained(self, error: grpc.RpcError) -> GymOpenError:
        assert isinstance(error, grpc.Call)
        code, details = error.code(), error.details()
        where = f"the server at {self._where}"
        match code:
            case grpc.StatusCode.UNAVAILABLE:
                return GymOpenError(
                    f"no answer from {where}: it was not started, or it has stopped ({details}). "
                    "Its worlds are lost: start `gym-open serve` there again, then make a new environment"
                )
            case grpc.StatusCode.DEADLINE_EXCEEDED:
                return GymOpenError(
                    f"{where} did not answer within {self._deadline_s:g} s: it hangs, is overloaded, or a firewall "
                    "drops the messages; check the server, then make a new environment"
                )
            case grpc.StatusCode.RESOURCE_EXHAUSTED if "larger than max" in (details or ""):
                return GymOpenError(
                    f"{where}: message too large ({details}): at most {p.REQUEST_BYTES} bytes to the server and "
                    f"{p.REPLY_BYTES} back; make puzzle_config smaller"
                )
            case grpc.StatusCode.RESOURCE_EXHAUSTED:
                return GymOpenError(f"{where} is overloaded ({details}): try again later")
            case grpc.StatusCode.UNAUTHENTICATED:
                return UsageError(f"{where} refused: {details}")
            case _:
                return GymOpenError(f"{where} failed: {details} ({code.name})")
