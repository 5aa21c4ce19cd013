"""The Gymnasium environment: one class for the sandbox and all tasks."""

import operator
from typing import Any, ClassVar, Literal, get_args

import gymnasium
import msgspec
import numpy as np
from gymnasium import spaces

from gym_open.config import check
from gym_open.envs import constants as c
from gym_open.envs.options import WorldOptions
from gym_open.envs.puzzles import Puzzle, PuzzleError, Task
from gym_open.envs.puzzles.generators import SandboxConfig, sample_puzzle
from gym_open.envs.tasks import judge, rewarded, step_budget
from gym_open.envs.world import StepOutcome, World
from gym_open.errors import UsageError

ObservationMode = Literal["image", "dict"]
Look = Literal["observation", "handsome"]

_LARGEST_RENDER = 4096
# Far beyond all states ever observed on the table. States outside are clipped.
_STATE_BOUND = np.repeat([5.0, 1.0, 100.0, 10_000.0], [3, 4, 3, 3]).astype(np.float32)
"""(13,): position in m, quaternion, velocity in m/s, angular velocity in rad/s."""


class EnvSnapshot(msgspec.Struct, frozen=True):
    """All that an environment's future depends on, as plain data that JSON can hold exactly."""

    puzzle: Puzzle
    world: list[float]
    """`World.save_state`."""
    steps: int
    """Steps taken in this episode."""
    episode_return: float
    """Rewards of this episode so far."""
    hits: int
    """Goals hit in this episode."""
    rng: dict[str, Any]
    """State of the generator that draws puzzles."""
    terminated: bool = False
    truncated: bool = False


class OpenEnv(gymnasium.Env[Any, np.int64]):
    """A Gymnasium environment: a puzzle on the table, observed as an image, with nine actions.

    Each reset draws a new training puzzle, or takes `options={"puzzle": Puzzle}`. The sandbox has no rewards and never
    ends. The tasks are truncated at their step budget.

    An observation is the image, (84, 84, 3) uint8; the `image_size` in the world's options changes its size. With
    `observation="dict"`, an observation is a dictionary with

    - `image`: the same image;
    - `object_state`: (N, 13) float32, one row per object of the model: position (m), quaternion (scalar first),
      velocity (m/s), angular velocity (rad/s), in the world's frame; zeros for objects that the puzzle does not have;
    - `present`: (N,) int8, 1 for each object that the puzzle has.

    After reset and after each step, `info` holds

    - `puzzle_digest`: digest of the layout;
    - `object_state`: (N, 13) float64, exact, with parked objects (`env.unwrapped.world.inventory` names the rows);
    - `contacts`: tuple of `Contact`, all contacts during the step except those with the table top;
    - `hits`: tuple of names of the goals that the agent touched for the first time;
    - `in_danger`: whether the agent was in the danger patch at any substep.

    Args:
        task: the task; puzzles are drawn for it.
        sandbox: the contents of sandbox worlds.
        world: options of the world; None means the published world.
        observation: "image" or "dict", see above.
        rewards: if False, all rewards are 0, no episode is terminated or truncated by the task, and goals keep their
            colour.
        render_mode: None, or "rgb_array".
        render_look: "observation" or "handsome": the image that `render` returns. The handsome look needs OpenGL.
        render_size: width and height in pixels of the handsome look.
        max_episode_steps: number of steps after which an episode is truncated, unless it ends before.

    Raises:
        UsageError: if an argument is not one of its choices.
        ConfigError: if a value in `sandbox` or `world` has the wrong type or is out of bounds.
        MeshError: if a mesh of the world's options cannot be used.
    """

    metadata: ClassVar[dict[str, Any]] = {  # pyright: ignore[reportIncompatibleVariableOverride]
        "render_modes": ["rgb_array"],
        "render_fps": round(1 / c.CONTROL_DT_S),
    }

    def __init__(
        self,
        task: Task = "sandbox",
        *,
        sandbox: SandboxConfig | None = None,
        world: WorldOptions | None = None,
        observation: ObservationMode = "image",
        rewards: bool = True,
        render_mode: str | None = None,
        render_look: Look = "observation",
        render_size: tuple[int, int] = (640, 480),
        max_episode_steps: int | None = None,
    ) -> None:
        _check_choice("task", task, get_args(Task))
        _check_choice("observation", observation, get_args(ObservationMode))
        _check_choice("render_mode", render_mode, (None, *self.metadata["render_modes"]))
        _check_choice("render_look", render_look, get_args(Look))
        for name, value, kind in (("sandbox", sandbox, SandboxConfig), ("world", world, WorldOptions)):
            if value is not None and not isinstance(value, kind):
                raise UsageError(f"{name}: expected {kind.__name__} or None, got {type(value).__name__}")
        if not all(isinstance(edge, int) and 1 <= edge <= _LARGEST_RENDER for edge in render_size):
            raise UsageError(f"render_size: expected two whole numbers from 1 to {_LARGEST_RENDER}, got {render_size}")
        if max_episode_steps is not None and max_episode_steps < 1:
            raise UsageError(f"max_episode_steps: expected 1 or more, got {max_episode_steps}")
        self.task: Task = task
        self._max_steps = max_episode_steps
        self.render_mode = render_mode
        # A configuration that was built in Python is not checked yet.
        self.world = World(check(world, source="world") if world else None)
        self.observation_space = _observation_space(self.world, observation)
        self.action_space = spaces.Discrete(c.N_ACTIONS)
        self._judged: Task = task if rewards else "sandbox"
        self._sandbox = check(sandbox, source="sandbox") if sandbox else SandboxConfig()
        self._handsome = render_look == "handsome"
        self._render_size = render_size
        self._renderer: Any = None
        self._begin_count()

    def __getstate__(self) -> dict[str, Any]:
        """All except the handsome look's renderer, which belongs to one thread: a copy opens a new renderer."""
        return {**self.__dict__, "_renderer": None}

    @property
    def ended(self) -> bool:
        """Whether the episode is terminated or truncated."""
        return self._terminated or self._truncated

    @property
    def puzzle(self) -> Puzzle:
        """The puzzle of the current episode."""
        return self.world.puzzle

    def reset(self, *, seed: int | None = None, options: dict[str, Any] | None = None) -> tuple[Any, dict[str, Any]]:
        """Start an episode on a new training puzzle, or on `options["puzzle"]`.

        Raises:
            PuzzleError: if an option is unknown, or `options["puzzle"]` is not a puzzle of this task.
        """
        self.begin(seed, options or {})
        return self.observe(), self.info(self.world.advance(0))

    def step(self, action: np.int64 | int) -> tuple[Any, float, bool, bool, dict[str, Any]]:
        """Take one step: action 0 does nothing, 1–8 move the agent by one cell (1 is +x, then counter-clockwise).

        After the end of an episode, the world goes on, rewards are 0, and the episode stays ended.

        Raises:
            TypeError: if the action is not an integer.
            ValueError: if it is not one of 0–8.
        """
        outcome = self.world.step(operator.index(action))
        return self.observe(), *self.score(outcome), self.info(outcome)

    def begin(self, seed: int | None, options: dict[str, Any]) -> None:
        """Start an episode as `reset` does, without an observation."""
        super().reset(seed=seed)
        self._load(self._chosen(options) or sample_puzzle(self.task, self.np_random, self._sandbox))

    def score(self, outcome: StepOutcome) -> tuple[float, bool, bool]:
        """Count a step, and return its reward and whether the episode is terminated and truncated."""
        if self.ended:
            return 0.0, self._terminated, self._truncated
        verdict = judge(self._judged, self.puzzle, self._hits, outcome)
        self._steps += 1
        self._hits += len(outcome.hits)
        self._return += verdict.reward
        out_of_budget = rewarded(self._judged) and self._steps >= step_budget(self._judged)
        out_of_budget |= self._max_steps is not None and self._steps >= self._max_steps
        self._terminated, self._truncated = verdict.terminated, out_of_budget and not verdict.terminated
        return verdict.reward, self._terminated, self._truncated

    def observe(self) -> Any:
        """The current observation, in new arrays."""
        if not isinstance(self.observation_space, spaces.Dict):
            return self.world.observe()
        states = np.empty((len(self.world.inventory), 13), np.float32)
        show_states(self.world.object_state(), self.world.present, states)
        present = self.world.present.astype(np.int8)
        return {"image": self.world.observe(), "object_state": states, "present": present}

    def info(self, outcome: StepOutcome) -> dict[str, Any]:
        """The `info` dictionary of a step."""
        return {
            "puzzle_digest": self.puzzle.digest,
            "object_state": self.world.object_state(),
            "contacts": outcome.contacts,
            "hits": outcome.hits,
            "in_danger": outcome.in_danger,
        }

    def render(self) -> np.ndarray | None:  # pyright: ignore[reportIncompatibleMethodOverride]
        """With `render_mode="rgb_array"`: an image (height, width, 3) uint8 in the chosen look.

        Raises:
            OpenGLError: if the look is handsome and there is no OpenGL; names the packages to install.
        """
        if self.render_mode is None:
            gymnasium.logger.warn('render() draws nothing: make the environment with render_mode="rgb_array"')
            return None
        if not self._handsome:
            return self.world.observe()
        if self._renderer is None:
            from gym_open.envs.look.renderer import Renderer

            self._renderer = Renderer(self.world.options, self._render_size)
        return self._renderer.render(self.world)

    def close(self) -> None:
        """Free OpenGL's memory. Call this on the thread that rendered."""
        if self._renderer is not None:
            self._renderer.close()
            self._renderer = None

    def snapshot(self) -> EnvSnapshot:
        """The state from which another process can go on, bit for bit."""
        state = self.np_random.bit_generator.state
        return EnvSnapshot(
            puzzle=self.puzzle,
            world=self.world.save_state().tolist(),
            steps=self._steps,
            episode_return=self._return,
            hits=self._hits,
            rng=dict(state),
            terminated=self._terminated,
            truncated=self._truncated,
        )

    def restore(self, snapshot: EnvSnapshot) -> Any:
        """Restore a snapshot and return its observation.

        Raises:
            PuzzleError: if the snapshot is of another task.
            ArtefactError: if the snapshot is of another world.
        """
        if snapshot.puzzle.task != self.task:
            raise PuzzleError(f"snapshot: expected task {self.task!r}, got {snapshot.puzzle.task!r}")
        self._load(snapshot.puzzle)
        self.world.restore_state(np.array(snapshot.world))
        self._steps, self._return, self._hits = snapshot.steps, snapshot.episode_return, snapshot.hits
        self._terminated, self._truncated = snapshot.terminated, snapshot.truncated
        self.np_random.bit_generator.state = snapshot.rng
        return self.observe()

    def _load(self, puzzle: Puzzle) -> None:
        self.world.load(puzzle, recolour_hits=rewarded(self._judged))
        self._begin_count()

    def _begin_count(self) -> None:
        self._steps, self._return, self._hits = 0, 0.0, 0
        self._terminated = self._truncated = False

    def _chosen(self, options: dict[str, Any]) -> Puzzle | None:
        if unknown := set(options) - {"puzzle"}:
            raise PuzzleError(f"reset options: unknown {sorted(unknown)}; the only one is 'puzzle'")
        puzzle = options.get("puzzle")
        if puzzle is not None and not isinstance(puzzle, Puzzle):
            raise PuzzleError(f"reset option 'puzzle': expected a Puzzle, got {type(puzzle).__name__}")
        if puzzle is not None and puzzle.task != self.task:
            raise PuzzleError(
                f"reset option 'puzzle': expected a puzzle of task {self.task!r}, got task {puzzle.task!r}"
            )
        return puzzle


def show_states(states: np.ndarray, present: np.ndarray, out: np.ndarray) -> None:
    """Write states (…, N, 13) as in a dictionary observation: clipped, and zeros where `present` (…, N) is False."""
    np.clip(states, -_STATE_BOUND, _STATE_BOUND, out=out, casting="same_kind")
    out[~present] = 0


def _check_choice(name: str, value: Any, choices: tuple[Any, ...]) -> None:
    if value not in choices:
        raise UsageError(f"{name}: expected one of {', '.join(map(repr, choices))}, got {value!r}")


def _observation_space(world: World, mode: ObservationMode) -> spaces.Space[Any]:
    size, n = world.options.image_size, len(world.inventory)
    image = spaces.Box(0, 255, (size, size, 3), np.uint8)
    if mode == "image":
        return image
    bound = np.tile(_STATE_BOUND, (n, 1))
    state = spaces.Box(-bound, bound, dtype=np.float32)
    return spaces.Dict({"image": image, "object_state": state, "present": spaces.MultiBinary(n)})
