"""A person plays the fixed puzzles with the keyboard, is logged like any explorer and scored like any policy.

What is kept while it goes on is the moves alone, after every one of them. When the last puzzle is over, they are played
again in a fresh world, and log and scores are written of that: the same moves give the same bits.
"""

from collections.abc import Callable, Mapping, Sequence
from importlib import metadata
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal

import msgspec
import numpy as np
from msgspec import Meta

from gym_open import artefacts, progress
from gym_open.config import Config, Count, check, to_dict
from gym_open.envs.env import OpenEnv
from gym_open.envs.options import WorldOptions
from gym_open.envs.physics.model import model_xml
from gym_open.envs.puzzles import Puzzle, Task
from gym_open.envs.puzzles.sets import PER_SET, Split, puzzle_id, puzzles_of
from gym_open.envs.tasks import judge, rewarded, step_budget
from gym_open.envs.world import World
from gym_open.errors import ArtefactError, ConfigError, GymOpenError
from gym_open.evaluate import scores
from gym_open.evaluate.proof import human_proof
from gym_open.evaluate.scores import Episodes
from gym_open.files import write_atomically
from gym_open.formats.logs import LogHead, LogWriter, SegmentStart, StepRecord, Switch, log_name
from gym_open.formats.scores import Scores
from gym_open.hardware import hardware

if TYPE_CHECKING:
    from gym_open.evaluate.human_window import Window

LOG = log_name(0, 0)
SIDE = 672
"""Pixels of the window's edge at first."""
PAUSE_S = 0.8
"""How long the end of a puzzle is shown."""
HELP = """\
Each press of a key is a move of one cell:
    Q W E        7 8 9
    A   D   or   4   6  on the number pad,  or the arrow keys
    Z X C        1 2 3
Fewer moves score higher. Esc or a closed window stops; the same command goes on from there."""
"""What is printed when a window opens."""
AIMS: dict[Task, str] = {
    "goal-seeking": "touch yellow",
    "preferences": "touch green and yellow, green is worth more",
    "avoidance": "touch yellow, keep out of the patch",
    "tool-use": "leave the pen by the ramp, touch yellow",
}


class HumanConfig(Config, frozen=True, kw_only=True):
    """Who plays what, and what the person sees."""

    task: Literal["goal-seeking", "preferences", "avoidance", "tool-use"] = "goal-seeking"
    """Task whose fixed puzzles are played."""
    split: Split = "test"
    """The set: `test` is what policies are scored on, `validation` is there to practise."""
    puzzles: tuple[Count, Count] = (0, PER_SET)
    """First puzzle, and the one after the last."""
    player: Annotated[str, Meta(min_length=1, max_length=80)] = "player"
    """Name in the record."""
    picture: Literal["sharp", "agent"] = "sharp"
    """Drawn in the window's pixels, or as a policy sees it: 84×84, enlarged."""


class StoppedError(GymOpenError):
    """The person closed the window before the last puzzle was over; what was played is kept."""


class Round(msgspec.Struct):
    """What a person did in one puzzle so far."""

    actions: list[int] = []
    rewards: list[float] = []
    terminated: bool = False
    over: bool = False


Save = Callable[[], None]


def play_as_person(config: HumanConfig, out: Path) -> artefacts.Outcome:
    """Let a person play, and write the scores: an artefact of kind `scores` with the log beside them.

    Payload: `scores.json` and `episodes.parquet` as `evaluate` writes them, and `stream-000-000.mcap`.

    Raises:
        ConfigError: if the range of puzzles is none.
        StoppedError: if the window was closed; the same call goes on from there.
        GymOpenError: if no window can be opened.
    """
    config = check(config, source="options")
    first, last = config.puzzles
    if not (first + 2 <= last <= PER_SET):
        raise ConfigError(
            f"key `puzzles`: first and last + 1 of at least two puzzles, within 0 and {PER_SET}, got {first} {last}"
        )
    return artefacts.build(out, kind="scores", config=config, parents=[], work=lambda folder: _work(config, folder))


def _work(config: HumanConfig, folder: Path) -> Mapping[str, Any]:
    first, last = config.puzzles
    puzzles = puzzles_of(config.task, config.split)[first:last]
    ids = [puzzle_id(config.task, config.split, i) for i in range(first, last)]
    record = folder / artefacts.SCRATCH / "played.json"
    rounds = msgspec.json.decode(record.read_bytes(), type=list[Round]) if record.is_file() else [Round() for _ in ids]
    if not all(one.over for one in rounds):
        play_rounds(config, ids, puzzles, rounds, lambda: write_atomically(record, msgspec.json.encode(rounds)))
    write_log(folder, config, puzzles, rounds)
    write_scores(folder, config, ids, puzzles, rounds)
    return {
        "task": config.task,
        "agent": "human",
        "player": config.player,
        "puzzles": len(puzzles),
        "extrinsic_reward": True,
    }


def play_rounds(
    config: HumanConfig, ids: Sequence[str], puzzles: Sequence[Puzzle], rounds: Sequence[Round], save: Save
) -> None:
    """Open a window and let the person play what is not over yet; `save` is called after every move.

    Raises:
        StoppedError: if the window was closed.
    """
    from gym_open.evaluate.human_window import Window

    side = SIDE if config.picture == "sharp" else WorldOptions().image_size
    env = OpenEnv(config.task, world=WorldOptions(image_size=side), render_mode="rgb_array")
    env.reset(options={"puzzle": puzzles[0]})
    window = Window(env, SIDE / side)
    progress.console.print(HELP, highlight=False, markup=False, soft_wrap=True)
    try:
        for i, (puzzle, one) in enumerate(zip(puzzles, rounds, strict=True)):
            if one.over:
                continue
            title = f"{ids[i]} ({i + 1} of {len(ids)}) {AIMS[config.task]}"
            env.reset(options={"puzzle": puzzle})
            for action in one.actions:  # to where the person left it
                env.step(action)
            _play_on(env, window, one, title, save)
            if not one.over:
                played = sum(one.over for one in rounds)
                raise StoppedError(
                    f"stopped after {played} of {len(ids)} puzzles; all that was played is kept, and the same command "
                    f"goes on with {ids[i]}"
                )
            window.pause(f"{title}: {'over' if one.terminated else 'out of steps'}, {sum(one.rewards):g}", PAUSE_S)
    finally:
        window.close()


def _play_on(env: OpenEnv, window: "Window", one: Round, title: str, save: Save) -> None:
    """Play until the puzzle is over or the window is closed."""
    while not one.over:
        left = step_budget(env.task) - len(one.actions)
        action = window.next_move(f"{title}: {left} steps left")
        if action is None:
            return
        _, reward, terminated, truncated, _ = env.step(action)
        one.actions.append(action)
        one.rewards.append(float(reward))
        one.terminated, one.over = terminated, terminated or truncated
        save()


def write_log(folder: Path, config: HumanConfig, puzzles: tuple[Puzzle, ...], rounds: Sequence[Round]) -> None:
    """Play the rounds again and log them in `folder`: one stream, a segment a puzzle.

    A person has no intrinsic reward, world model, policy or value: these figures are NaN. The losses of the worlds are
    infinite, as of any world that no model has seen.

    Raises:
        ArtefactError: if a round does not end as it did (another machine, or changed packages).
    """
    packages = {name: metadata.version(name) for name in ("mcap", "mujoco", "numba", "numpy")}
    provenance = {"code": artefacts.code_version("scores"), "player": config.player, **packages}
    unknown = [np.inf] * len(puzzles)
    world, step = World(), 0
    with LogWriter(folder, LogHead(0, to_dict(config), puzzles, provenance, model_xml())) as log:
        log.switch(Switch(0, -1, 0, "start", unknown))
        for i, (puzzle, one) in enumerate(zip(puzzles, rounds, strict=True)):
            _log_round(log, world, puzzle, one, index=i, first_step=step)
            step += len(one.actions)
            following = i + 1 if i + 1 < len(puzzles) else -1
            log.switch(Switch(step, i, following, "terminated" if one.terminated else "budget", unknown))


def _log_round(log: LogWriter, world: World, puzzle: Puzzle, one: Round, *, index: int, first_step: int) -> None:
    world.load(puzzle, recolour_hits=rewarded(puzzle.task))
    log.segment(
        SegmentStart(
            index=index, first_step=first_step, world=index, puzzle=puzzle, continued=False,
            object_names=world.inventory, object_state=world.object_state(), integration_state=world.save_state(),
            image=world.observe(),
        )
    )  # fmt: skip
    hits, rewards, terminated = 0, list[float](), False
    for i, action in enumerate(one.actions):
        outcome = world.step(action)
        verdict = judge(puzzle.task, puzzle, hits, outcome)
        hits += len(outcome.hits)
        rewards.append(verdict.reward)
        terminated = verdict.terminated
        log.step(
            StepRecord(
                step=first_step + i, segment=index, segment_step=i, action=action, object_state=world.object_state(),
                contacts=outcome.contacts, image=world.observe(),
            )
        )  # fmt: skip
    if (rewards, terminated) != (one.rewards, one.terminated):
        raise ArtefactError(
            f"puzzle {index} of the range: the moves do not play out as they did when they were made (another machine, "
            "or changed packages?), so they cannot be scored; move the unfinished folder away to start over"
        )


def write_scores(
    folder: Path, config: HumanConfig, ids: Sequence[str], puzzles: Sequence[Puzzle], rounds: Sequence[Round]
) -> None:
    """Write `scores.json` and `episodes.parquet` of rounds that are over."""
    N = step_budget(config.task)
    episodes = Episodes(
        actions=_table([one.actions for one in rounds], N, -1, np.int8),
        rewards=_table([one.rewards for one in rounds], N, 0, np.float64),
        steps=np.array([len(one.actions) for one in rounds]),
        terminated=np.array([one.terminated for one in rounds]),
    )
    record = Scores(
        task=config.task, split=config.split, agent="human", seed=None, evaluation_seed=None, trained=0,
        actions="keyboard", policy=None, proof=human_proof(), code=artefacts.code_version("scores"),
        hardware=hardware(1), **scores.summarise(episodes),
    )  # fmt: skip
    scores.write_scores(folder, record, {"player": config.player, "picture": config.picture})
    scores.write_episodes(folder, ids, puzzles, episodes)


def _table(rows: Sequence[Sequence[float]], width: int, fill: float, kind: Any) -> np.ndarray:
    table = np.full((len(rows), width), fill, kind)
    for row, values in zip(table, rows, strict=True):
        row[: len(values)] = values
    return table
