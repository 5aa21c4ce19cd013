"""A person plays the fixed puzzles with the keyboard, is logged like an explorer and scored like a policy.

During play, only the moves are saved, after each move. After the last puzzle they are replayed in a new world, and the
replay is logged and scored: the same moves give the same bits.
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
    from gym_open.evaluate.human_window import PlayWindow

LOG = log_name(0, 0)
SIDE = 672
"""Edge of the window in pixels when it opens."""
PAUSE_S = 0.8
"""Seconds for which the end of a puzzle is shown."""
HELP = """\
Each press of a key is a move of one cell:
    Q W E        7 8 9
    A   D   or   4   6  on the number pad,  or the arrow keys
    Z X C        1 2 3
Fewer moves score higher. Esc or a closed window stops; the same command goes on from there."""
"""Printed when a window opens."""
AIMS: dict[Task, str] = {
    "goal-seeking": "touch yellow",
    "preferences": "touch green and yellow, green is worth more",
    "avoidance": "touch yellow, keep out of the patch",
    "tool-use": "leave the pen by the ramp, touch yellow",
}


class HumanConfig(Config, frozen=True, kw_only=True):
    """Who plays which puzzles, and what the person sees."""

    task: Literal["goal-seeking", "preferences", "avoidance", "tool-use"] = "goal-seeking"
    """Task whose fixed puzzles are played."""
    split: Split = "test"
    """Set of puzzles: policies are scored on `test`; `validation` is for practice."""
    puzzles: tuple[Count, Count] = (0, PER_SET)
    """First puzzle, and last puzzle + 1."""
    player: Annotated[str, Meta(min_length=1, max_length=80)] = "player"
    """Name in the record."""
    picture: Literal["sharp", "agent"] = "sharp"
    """Draw at the window's resolution (`sharp`), or the 84×84 image that a policy sees, enlarged (`agent`)."""


class StoppedError(GymOpenError):
    """The person closed the window before the end of the last puzzle; the moves so far are kept."""


class HumanEpisode(msgspec.Struct):
    """A person's episode on one puzzle so far."""

    actions: list[int] = []
    rewards: list[float] = []
    terminated: bool = False
    ended: bool = msgspec.field(default=False, name="over")


Save = Callable[[], None]


def play_as_person(config: HumanConfig, out: Path) -> artefacts.Outcome:
    """Let a person play, and write the scores: an artefact of kind `scores` that also holds the log.

    Payload: `scores.json` and `episodes.parquet` as `evaluate` writes them, and `stream-000-000.mcap`.

    Raises:
        ConfigError: if the range of puzzles is not valid.
        StoppedError: if the window was closed; the same call continues from there.
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
    episodes = (
        msgspec.json.decode(record.read_bytes(), type=list[HumanEpisode])
        if record.is_file()
        else [HumanEpisode() for _ in ids]
    )
    if not all(episode.ended for episode in episodes):
        play_episodes(config, ids, puzzles, episodes, lambda: write_atomically(record, msgspec.json.encode(episodes)))
    write_log(folder, config, puzzles, episodes)
    write_scores(folder, config, ids, puzzles, episodes)
    return {
        "task": config.task,
        "agent": "human",
        "player": config.player,
        "puzzles": len(puzzles),
        "extrinsic_reward": True,
    }


def play_episodes(
    config: HumanConfig, ids: Sequence[str], puzzles: Sequence[Puzzle], episodes: Sequence[HumanEpisode], save: Save
) -> None:
    """Open a window and let the person play what has not ended yet; `save` is called after every move.

    Raises:
        StoppedError: if the window was closed.
    """
    from gym_open.evaluate.human_window import PlayWindow

    side = SIDE if config.picture == "sharp" else WorldOptions().image_size
    env = OpenEnv(config.task, world=WorldOptions(image_size=side), render_mode="rgb_array")
    env.reset(options={"puzzle": puzzles[0]})
    window = PlayWindow(env, SIDE / side)
    progress.console.print(HELP, highlight=False, markup=False, soft_wrap=True)
    try:
        for i, (puzzle, episode) in enumerate(zip(puzzles, episodes, strict=True)):
            if episode.ended:
                continue
            title = f"{ids[i]} ({i + 1} of {len(ids)}) {AIMS[config.task]}"
            env.reset(options={"puzzle": puzzle})
            for action in episode.actions:  # continue where the person stopped
                env.step(action)
            _play_on(env, window, episode, title, save)
            if not episode.ended:
                played = sum(episode.ended for episode in episodes)
                raise StoppedError(
                    f"stopped after {played} of {len(ids)} puzzles; all moves are kept, and the same command continues "
                    f"with {ids[i]}"
                )
            end = "finished" if episode.terminated else "out of steps"
            window.pause(f"{title}: {end}, return {sum(episode.rewards):g}", PAUSE_S)
    finally:
        window.close()


def _play_on(env: OpenEnv, window: "PlayWindow", episode: HumanEpisode, title: str, save: Save) -> None:
    """Play until the episode ends or the window is closed."""
    while not episode.ended:
        left = step_budget(env.task) - len(episode.actions)
        action = window.next_move(f"{title}: {left} steps left")
        if action is None:
            return
        _, reward, terminated, truncated, _ = env.step(action)
        episode.actions.append(action)
        episode.rewards.append(float(reward))
        episode.terminated, episode.ended = terminated, terminated or truncated
        save()


def write_log(folder: Path, config: HumanConfig, puzzles: tuple[Puzzle, ...], episodes: Sequence[HumanEpisode]) -> None:
    """Replay the episodes and log them in `folder`: one stream, one segment per puzzle.

    A person has no intrinsic reward, world model, policy or value, so these numbers are NaN. The losses of the worlds
    are infinite, as for every world that no model has seen.

    Raises:
        ArtefactError: if the replay differs (another machine, or changed packages).
    """
    packages = {name: metadata.version(name) for name in ("mcap", "mujoco", "numba", "numpy")}
    provenance = {"code": artefacts.code_version("scores"), "player": config.player, **packages}
    unknown = [np.inf] * len(puzzles)
    world, step = World(), 0
    with LogWriter(folder, LogHead(0, to_dict(config), puzzles, provenance, model_xml())) as log:
        log.switch(Switch(0, -1, 0, "start", unknown))
        for i, (puzzle, episode) in enumerate(zip(puzzles, episodes, strict=True)):
            _log_episode(log, world, puzzle, episode, index=i, first_step=step)
            step += len(episode.actions)
            following = i + 1 if i + 1 < len(puzzles) else -1
            log.switch(Switch(step, i, following, "terminated" if episode.terminated else "budget", unknown))


def _log_episode(
    log: LogWriter, world: World, puzzle: Puzzle, episode: HumanEpisode, *, index: int, first_step: int
) -> None:
    world.load(puzzle, recolour_hits=rewarded(puzzle.task))
    log.segment(
        SegmentStart(
            index=index, first_step=first_step, world=index, puzzle=puzzle, continued=False,
            object_names=world.inventory, object_state=world.object_state(), integration_state=world.save_state(),
            image=world.observe(),
        )
    )  # fmt: skip
    hits, rewards, terminated = 0, list[float](), False
    for i, action in enumerate(episode.actions):
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
    if (rewards, terminated) != (episode.rewards, episode.terminated):
        raise ArtefactError(
            f"puzzle {index} of the range: the replay of the moves differs from the play (another machine, or changed "
            "packages?), so they cannot be scored; move the unfinished folder away to begin again"
        )


def write_scores(
    folder: Path, config: HumanConfig, ids: Sequence[str], puzzles: Sequence[Puzzle], episodes: Sequence[HumanEpisode]
) -> None:
    """Write `scores.json` and `episodes.parquet` of episodes that have ended."""
    N = step_budget(config.task)
    played = Episodes(
        actions=_table([episode.actions for episode in episodes], N, -1, np.int8),
        rewards=_table([episode.rewards for episode in episodes], N, 0, np.float64),
        steps=np.array([len(episode.actions) for episode in episodes]),
        terminated=np.array([episode.terminated for episode in episodes]),
    )
    record = Scores(
        task=config.task, split=config.split, agent="human", seed=None, evaluation_seed=None, trained=0,
        actions="keyboard", policy=None, proof=human_proof(), code=artefacts.code_version("scores"),
        hardware=hardware(1), **scores.summarise(played),
    )  # fmt: skip
    scores.write_scores(folder, record, {"player": config.player, "picture": config.picture})
    scores.write_episodes(folder, ids, puzzles, played)


def _table(rows: Sequence[Sequence[float]], width: int, fill: float, kind: Any) -> np.ndarray:
    table = np.full((len(rows), width), fill, kind)
    for row, values in zip(table, rows, strict=True):
        row[: len(values)] = values
    return table
