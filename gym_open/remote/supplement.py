"""The interface in the paper's supplement, in this process or on a server.

    env = gymnasium.make("gym_open:open_puzzle_proc-v0", env_ip="localhost", self_ip="localhost", port=None)

The interface is older than Gymnasium's: `reset` returns only the observation, and `step` returns four values.
"""

from typing import TYPE_CHECKING, Any, ClassVar

import gymnasium
import numpy as np
from gymnasium import spaces

from gym_open import extras
from gym_open.envs import constants as c
from gym_open.errors import UsageError
from gym_open.remote.address import check_host, check_port, is_loopback
from gym_open.remote.protocol import DEFAULT_PORT, Observation, StepResult, plain
from gym_open.remote.session import Session

if TYPE_CHECKING:
    from gym_open.remote.client import RemoteSession

DEADLINE_S = 60.0
"""Time limit of a call to a server."""


class OpenPuzzleEnv(gymnasium.Env[Observation, np.int64]):
    """The paper's environment. Call `close` at the end, which frees its session on a server.

    Args:
        env_ip: host of the world. This machine, without a `port`, means this process.
        self_ip: has no effect, because the server never calls back.
        port: port of `gym-open serve`. None means this process or, on another host, `DEFAULT_PORT`.
        debug: whether the fourth value of `step` also holds contacts and the puzzle.
        deadline_s: seconds after which a call to a server fails.

    Raises:
        UsageError: if an argument is wrong, or the server refuses.
        GymOpenError: if no server answers.
    """

    metadata: ClassVar[dict[str, Any]] = {"render_modes": []}  # pyright: ignore[reportIncompatibleVariableOverride]

    def __init__(
        self,
        env_ip: str | None = None,
        self_ip: str | None = None,
        port: int | None = None,
        debug: bool = False,
        *,
        deadline_s: float = DEADLINE_S,
    ) -> None:
        for name, host in (("env_ip", env_ip), ("self_ip", self_ip)):
            if not (host is None or isinstance(host, str)):
                raise UsageError(f"{name}: expected None or text, got {host!r}")
            if host is not None:
                check_host(host, name)
        if port is not None:
            if isinstance(port, bool) or not isinstance(port, int):
                raise UsageError(f"port: expected None or a whole number, got {port!r}")
            check_port(port, "port")
        if not isinstance(debug, bool):
            raise UsageError(f"debug: expected True or False, got {debug!r}")
        self.action_space = spaces.Discrete(c.N_ACTIONS)
        image = spaces.Box(0, 255, (c.IMAGE_SIZE, c.IMAGE_SIZE, 3), np.uint8)
        self.observation_space: spaces.Space[Any] = spaces.Dict({"image": image})
        """Only of the image: the number of entries in `object_information` depends on the puzzle."""
        self._session = _session(env_ip, port, debug=debug, deadline_s=deadline_s)

    def add_change_puzzle(
        self, mode: int, task: int | None = None, puzzle_config: dict[str, Any] | None = None
    ) -> None:
        """Lay out a new puzzle: in mode 0 a sandbox by `puzzle_config`, in mode 1 one of the tasks 1–4.

        Raises:
            UsageError: if mode or task is not one of these, or `puzzle_config` is missing in mode 0.
            ConfigError: if `puzzle_config` holds an unknown key or a wrong value.
            PuzzleError: if no layout satisfies it.
        """
        self._session.change_puzzle(*_plain("add_change_puzzle", mode, task, puzzle_config))

    def set_observation(self, output: bool = False) -> None:
        """Set whether observations hold the `image`: at first, they hold only `object_information`."""
        self._session.set_observation(*_plain("set_observation", output))

    def configure_env(self, first: bool = False, action_space: str = "full", skip_frame: bool = True) -> None:
        """Set the length of a step.

        Args:
            first: only False. The paper passes False and does not explain this argument.
            action_space: only "full", the nine actions.
            skip_frame: True: a step is a whole move. False: a step is one substep of 0.004 s; the first action starts
                a move of ten steps, and the other nine actions are ignored.
        """
        self._session.configure(*_plain("configure_env", first, action_space, skip_frame))

    def turn_off_reward(self, value: bool) -> None:
        """If `value` is True, rewards are 0, done is False, and touched goals keep their colours."""
        self._session.turn_off_reward(*_plain("turn_off_reward", value))

    def reset(  # pyright: ignore[reportIncompatibleMethodOverride]
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> Observation:
        """Start the same puzzle again; with a `seed`, start a puzzle of the same kind, determined by the seed.

        Raises:
            UsageError: if there is no puzzle yet, or `options` is not empty.
        """
        if options:
            raise UsageError(f"reset: options: expected none, got {sorted(options)}; use add_change_puzzle")
        return self._session.reset(*_plain("reset", seed))

    def step(self, action: np.int64 | int) -> StepResult:  # pyright: ignore[reportIncompatibleMethodOverride]
        """Take one of the nine actions; return observation, reward, done and debug information.

        Done is True at the task's end and at its step budget, and stays True until the next reset or puzzle.
        """
        return self._session.step(*_plain("step", action))

    def close(self) -> None:
        """Close the world, here or on the server."""
        self._session.close()


def _session(env_ip: str | None, port: int | None, *, debug: bool, deadline_s: float) -> "Session | RemoteSession":
    if port is None and (env_ip is None or is_loopback(env_ip)):
        return Session(debug=debug)
    extras.check("remote")
    from gym_open.remote.client import RemoteSession  # gRPC is not needed in this process

    return RemoteSession(env_ip or "localhost", port or DEFAULT_PORT, debug=debug, deadline_s=deadline_s)


def _plain(name: str, *values: Any) -> list[Any]:
    try:
        return plain(values)
    except (TypeError, RecursionError) as error:
        raise UsageError(f"{name}: {error}") from None
