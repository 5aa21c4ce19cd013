"""`gym-open serve`: worlds for clients on this host or other hosts, one session per client.

The server never executes or unpickles a client's data: it decodes a body into one of a few message types, or refuses
it.
"""

import hmac
import secrets
import signal
import sys
import threading
import time
import traceback
from collections.abc import Callable, Iterator
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager
from pathlib import Path
from types import FrameType, TracebackType
from typing import Any, NoReturn, Self

import grpc

from gym_open.errors import GymOpenError, UsageError
from gym_open.remote import protocol as p
from gym_open.remote.address import check_host, check_port, is_loopback, read_token, target
from gym_open.remote.session import Session
from gym_open.version import __version__

CLIENTS = 4
IDLE_S = 1800.0
_GRACE_S = 5.0
"""Time limit for unfinished calls when the server is stopped."""
_SWEEP_S = 1.0


class _ClientSession:
    """One client's session, and the time of its last use."""

    def __init__(self, *, debug: bool, now: float) -> None:
        self.session = Session(debug=debug)
        self.lock = threading.Lock()
        self.used = now


class Sessions:
    """The sessions of a server: at most `clients`. A session is freed after `idle_s` seconds without a call."""

    def __init__(self, clients: int, idle_s: float) -> None:
        self._clients, self._idle_s = clients, idle_s
        self._by_name: dict[str, _ClientSession] = {}
        self._lock = threading.Lock()

    def __len__(self) -> int:
        return len(self._by_name)

    def open(self, asked: p.Open) -> p.Opened:
        """Open a session with a new world.

        Raises:
            UsageError: if the client has another version, or there are `clients` sessions already.
        """
        if (asked.protocol, asked.package) != (p.PROTOCOL, __version__):
            raise UsageError(
                f"the server is gym-open {__version__} with protocol {p.PROTOCOL}, the client {asked.package} "
                f"with protocol {asked.protocol}: install the same version on both"
            )
        self.sweep()
        with self._lock:
            if len(self._by_name) >= self._clients:
                raise UsageError(
                    f"all {self._clients} places are taken: close another environment, wait until an unused one "
                    f"is freed ({self._idle_s:g} s without a call), or start the server with more `--clients`"
                )
            name = secrets.token_hex(16)
            self._by_name[name] = _ClientSession(debug=asked.debug, now=time.monotonic())
        return p.Opened(name)

    @contextmanager
    def use(self, name: str) -> Iterator[Session]:
        """Context manager: the session with this name, for one call at a time.

        Raises:
            UsageError: if there is no session with this name.
        """
        found = self._by_name.get(name)
        if found is None:
            raise UsageError(
                f"the server does not know this session: it was freed after {self._idle_s:g} s without a call, or the "
                "server was restarted; make a new environment"
            )
        with found.lock:
            try:
                yield found.session
            finally:
                found.used = time.monotonic()

    def close(self, name: str) -> None:
        """Free a session."""
        self._by_name.pop(name, None)

    def sweep(self) -> None:
        """Free the sessions that have been unused for too long."""
        limit = time.monotonic() - self._idle_s
        with self._lock:
            for name, client in list(self._by_name.items()):
                if client.used < limit and not client.lock.locked():
                    self.close(name)


class Server:
    """Context manager that listens while it is entered.

    Args:
        host: address to listen on; an address other than loopback needs a token.
        port: TCP port; 0 means any free port.
        token: the token that clients must send; None means no token.
        clients: largest number of sessions at a time.
        idle_s: seconds without a call after which a session is freed.

    Raises:
        UsageError: if an argument is wrong, or the port is not available.
    """

    def __init__(
        self, host: str, port: int, token: str | None, *, clients: int = CLIENTS, idle_s: float = IDLE_S
    ) -> None:
        check_host(host, "host")
        check_port(port, "port", least=0)
        if clients < 1:
            raise UsageError(f"clients: expected 1 or more, got {clients}")
        if not 0 < idle_s < float("inf"):
            raise UsageError(f"idle_s: expected more than 0 seconds, got {idle_s:g}")
        if token is None and not is_loopback(host):
            raise UsageError(
                f"host: {host} can be reached from other machines, so a token is needed: give --token-file FILE or set "
                f"{p.TOKEN_VARIABLE}; or listen on 127.0.0.1 and let clients use `ssh -L`"
            )
        self.host = host
        self.sessions = Sessions(clients, idle_s)
        self._token = token
        self._server = grpc.server(
            ThreadPoolExecutor(max_workers=clients + 2, thread_name_prefix="gym-open-serve"),
            handlers=[grpc.method_handlers_generic_handler(p.SERVICE, {p.METHOD: _handler(self._answer)})],
            options=[
                ("grpc.max_receive_message_length", p.REQUEST_BYTES),
                ("grpc.max_send_message_length", p.REPLY_BYTES),
                ("grpc.so_reuseport", 0),  # a second server on this port fails instead of sharing it
            ],
            maximum_concurrent_rpcs=4 * clients + 4,
        )
        try:
            self.port: int = self._server.add_insecure_port(target(host, port))
        except RuntimeError:
            raise UsageError(
                f"cannot listen on {target(host, port)}: the port is taken, or the host is not this machine"
            ) from None

    def __enter__(self) -> Self:
        Session().warm_up()  # compiles the code, so that no call has to wait for that
        self._server.start()
        return self

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None, at: TracebackType | None) -> None:
        self._server.stop(_GRACE_S).wait()

    def _answer(self, body: bytes, context: grpc.ServicerContext) -> bytes:
        self._check_token(context)
        try:
            request = p.decode_request(body)
        except ValueError as error:
            _abort(context, grpc.StatusCode.INVALID_ARGUMENT, str(error))
        try:
            return p.encode(self._reply(request))
        except GymOpenError as error:
            return p.encode(p.refusal(error))
        except Exception:  # other clients must not be affected
            traceback.print_exc(file=sys.stderr)
            self.sessions.close(request.session)
            _abort(
                context, grpc.StatusCode.INTERNAL, "an error in the server, which has printed it; the session is closed"
            )

    def _check_token(self, context: grpc.ServicerContext) -> None:
        if self._token is None:
            return
        given = next((value for key, value in context.invocation_metadata() if key == p.TOKEN_KEY), "")
        if not hmac.compare_digest(str(given).encode(), self._token.encode()):
            what = "a wrong token" if given else "no token"
            _abort(
                context, grpc.StatusCode.UNAUTHENTICATED,
                f"{what} was sent; set {p.TOKEN_VARIABLE} to the server's token where the client runs",
            )  # fmt: skip

    def _reply(self, request: p.Request) -> p.Reply:
        call = request.call
        if isinstance(call, p.Open):
            return self.sessions.open(call)
        if isinstance(call, p.Close):
            self.sessions.close(request.session)
            return p.Done()
        with self.sessions.use(request.session) as session:
            return _do(session, call)


def _do(session: Session, call: p.Call) -> p.Reply:
    match call:
        case p.Step(action):
            return p.Stepped(session.step(action))
        case p.Reset(seed):
            return p.Observed(session.reset(seed))
        case p.ChangePuzzle(mode, task, puzzle_config):
            session.change_puzzle(mode, task, puzzle_config)
        case p.SetObservation(output):
            session.set_observation(output)
        case p.Configure(first, action_space, skip_frame):
            session.configure(first, action_space, skip_frame)
        case p.TurnOffReward(off):
            session.turn_off_reward(off)
    return p.Done()


def _handler(answer: Callable[[bytes, grpc.ServicerContext], bytes]) -> Any:
    return grpc.unary_unary_rpc_method_handler(answer)


def _abort(context: grpc.ServicerContext, code: grpc.StatusCode, details: str) -> NoReturn:
    context.abort(code, details)
    raise AssertionError  # abort always raises


def serve(
    host: str = "127.0.0.1",
    port: int = p.DEFAULT_PORT,
    *,
    token_file: Path | None = None,
    clients: int = CLIENTS,
    idle_s: float = IDLE_S,
) -> None:
    """Serve worlds until SIGINT or SIGTERM, then finish the unfinished calls.

    Args:
        host: address to listen on.
        port: TCP port; 0 means any free port.
        token_file: file with the token that clients must send; None means the environment variable.
        clients: largest number of sessions at a time.
        idle_s: seconds without a call after which a session is freed.

    Raises:
        UsageError: if an argument is wrong, the token is missing or too short, or the port is not available.
    """
    stop = threading.Event()
    with Server(host, port, read_token(token_file), clients=clients, idle_s=idle_s) as server, _signals(stop):
        print(_greeting(server, clients, idle_s), flush=True)
        while not stop.wait(_SWEEP_S):
            server.sessions.sweep()
    print("gym-open serve: stopped", flush=True)


def _greeting(server: Server, clients: int, idle_s: float) -> str:
    here = target(server.host, server.port)
    named = "THIS-HOST" if server.host in {"0.0.0.0", "::"} else server.host  # noqa: S104  # no name
    lines = [
        f"gym-open serve: listening on {here}, for {clients} clients; a world unused for {idle_s:g} s is freed",
        f"  connect: gymnasium.make('gym_open:open_puzzle_proc-v0', env_ip='{named}', port={server.port})",
    ]
    if is_loopback(server.host):
        lines.append(f"  from another host: first ssh -L {server.port}:{here} THIS-HOST, there")
    else:
        lines.append("  all data and the token are sent unencrypted (no TLS): use a network that you trust")
    return "\n".join([*lines, "  stop: Ctrl-C"])


@contextmanager
def _signals(stop: threading.Event) -> Iterator[None]:
    """Set `stop` on SIGINT and SIGTERM while entered."""

    def handle(number: int, frame: FrameType | None) -> None:
        del number, frame
        stop.set()

    before = {number: signal.signal(number, handle) for number in (signal.SIGINT, signal.SIGTERM)}
    try:
        yield
    finally:
        for number, handler in before.items():
            signal.signal(number, handler)
