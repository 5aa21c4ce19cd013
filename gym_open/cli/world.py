"""Sub-commands on puzzles and worlds: show, verify and draw puzzles, serve worlds, and let a person play."""

from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Literal

import tyro

from gym_open import workspace
from gym_open.cli.base import Command, report, say, say_made, say_next, show
from gym_open.envs.puzzles import Task
from gym_open.envs.puzzles.sets import Split
from gym_open.errors import UsageError
from gym_open.seeding import generator
from gym_open.summary import score_table

if TYPE_CHECKING:
    from gym_open.envs.puzzles import Puzzle

Look = Literal["handsome", "observation"]
EvaluationTask = Literal["goal-seeking", "preferences", "avoidance", "tool-use"]


@dataclass(frozen=True, kw_only=True)
class PuzzleShow(Command):
    """Show a fixed puzzle: its cells from above, its record, its digest and a solution.

    Example: gym-open puzzle show tool-use/017
    """

    puzzle: Annotated[str, tyro.conf.Positional]
    """Id: tool-use/017 of the test set, tool-use/validation/017 of the validation set."""

    about = "show a fixed puzzle and its solution in the terminal"

    def run(self) -> None:
        """Show the puzzle."""
        from gym_open.envs import puzzle_report
        from gym_open.envs.puzzles.sets import puzzle_by_id

        show(puzzle_report.show(self.puzzle))
        print(f"\n{puzzle_by_id(self.puzzle).to_json().decode()}\n")  # on one line, so that it can be copied
        say_next(f"gym-open render video {self.puzzle} --save solution.mp4")


@dataclass(frozen=True, kw_only=True)
class PuzzleVerify(Command):
    """Check that the fixed puzzles are the published ones, and that every witness solves its puzzle.

    Example: gym-open puzzle verify
    """

    about = "check the fixed puzzles, and replay their solutions"

    def run(self) -> None:
        """Check the puzzles."""
        from gym_open.envs.puzzle_report import verify

        show(verify())


@dataclass(frozen=True, kw_only=True)
class RenderSheet(Command):
    """Draw puzzles side by side as a PNG. The handsome look needs OpenGL; the observation look does not.

    Example: gym-open render sheet --task tool-use --save tool-use.png
    """

    task: Task = "goal-seeking"
    """Task of the fixed puzzles; the sandbox has random worlds, which depend on `--seed`."""
    split: Split = "test"
    """Set of fixed puzzles."""
    puzzles: tuple[int, int] = (0, 20)
    """Number of the first puzzle, and of the last puzzle plus one."""
    look: Look = "handsome"
    """`handsome` has shadows and gloss; `observation` is what an agent sees."""
    size: int = 192
    """Edge of one image in pixels."""
    columns: int = 5
    """Images per row."""
    seed: int = 0
    """Seed of the sandbox's worlds."""
    save: Path
    """The .png file to write."""

    about = "draw many puzzles as one figure (PNG)"

    def run(self) -> None:
        """Draw the puzzles."""
        from gym_open.viz.render import contact_sheet

        made = contact_sheet(self._puzzles(), self.save, look=self.look, size=self.size, columns=self.columns)
        say_made(made)

    def _puzzles(self) -> "dict[str, Puzzle]":
        from gym_open.envs.puzzles.generators import sample_puzzle
        from gym_open.envs.puzzles.sets import PER_SET, puzzle_id, puzzles_of

        first, last = self.puzzles
        if not 0 <= first < last <= PER_SET:
            raise UsageError(f"--puzzles: expected two rising numbers from 0 to {PER_SET}, got {first} {last}")
        if self.task == "sandbox":
            rng = generator(self.seed, "render", "sandbox")
            return {f"sandbox {i}": sample_puzzle("sandbox", rng) for i in range(last)[first:]}
        fixed = puzzles_of(self.task, self.split)
        return {puzzle_id(self.task, self.split, i): fixed[i] for i in range(first, last)}


@dataclass(frozen=True, kw_only=True)
class RenderVideo(Command):
    """Film an episode on a fixed puzzle: its witness, random actions, or the actions of a scored policy or person.

    Example: gym-open render video tool-use/017 --save solution.mp4
    """

    puzzle: Annotated[str, tyro.conf.Positional]
    """Id of the puzzle, such as tool-use/017."""
    actions: str = "witness"
    """`witness`, `random`, or a folder of scores with an episode of this puzzle."""
    look: Look = "handsome"
    """`handsome` has shadows and gloss; `observation` is what an agent sees."""
    size: int = 512
    """Width of the film in pixels."""
    seed: int = 0
    """Seed of random actions."""
    save: Path
    """The .mp4 or .gif file to write."""

    about = "film an episode (MP4, GIF)"

    def run(self) -> None:
        """Film the episode."""
        from gym_open.envs.puzzles.sets import puzzle_by_id
        from gym_open.viz.render import episode_video

        puzzle = puzzle_by_id(self.puzzle)
        made = episode_video(puzzle, self._actions(puzzle), self.save, name=self.puzzle, look=self.look, size=self.size)
        say_made(made)

    def _actions(self, puzzle: "Puzzle") -> list[int]:
        from gym_open.envs.puzzles.witnesses import witness_of
        from gym_open.viz.render import random_actions, scored_actions

        if self.actions == "witness":
            return list(witness_of(self.puzzle).actions)
        if self.actions == "random":
            return random_actions(puzzle, generator(self.seed, "render", self.puzzle))
        return scored_actions(Path(self.actions), self.puzzle)


@dataclass(frozen=True, kw_only=True)
class ServeCommand(Command):
    """Serve worlds to other hosts through the paper's interface, until Ctrl-C.

    Example: gym-open serve --port 10710
    """

    host: str = "127.0.0.1"
    """Address to listen on; other addresses than the loopback address need a token."""
    port: int = 10710
    """TCP port; 0 chooses a free port."""
    token_file: Path | None = None
    """File with the token that clients must send; by default the environment variable GYM_OPEN_TOKEN."""
    clients: int = 4
    """Number of clients at a time; each has its own world."""
    idle_s: float = 1800.0
    """Seconds without a call after which the server frees a client's world."""

    about = "serve worlds to other hosts through the paper's interface"

    def run(self) -> None:
        """Serve worlds."""
        from gym_open.remote.server import serve

        serve(self.host, self.port, token_file=self.token_file, clients=self.clients, idle_s=self.idle_s)


@dataclass(frozen=True, kw_only=True)
class PlayCommand(Command):
    """Play the fixed puzzles with the keyboard. Every move is logged, and you are scored like a policy.

    Example: gym-open play --task avoidance --player Ada --puzzles 0 20
    """

    task: EvaluationTask = "goal-seeking"
    """Task of the fixed puzzles."""
    split: Split = "test"
    """Set of fixed puzzles: policies are scored on `test`; `validation` is for practice."""
    puzzles: tuple[int, int] = (0, 100)
    """Number of the first puzzle, and of the last puzzle plus one."""
    player: str = "player"
    """Your name in the record."""
    picture: Literal["sharp", "agent"] = "sharp"
    """`sharp` uses all pixels of the window; `agent` is what a policy sees, 84×84 pixels, enlarged."""
    workspace: Path = Path()
    """Folder with the five stage folders."""
    save: Path | None = None
    """Folder of the scores; default evaluate/scores/ with the names of task, player and set."""

    about = "play the fixed puzzles yourself, with log and score"

    def run(self) -> None:
        """Open the window, and score the episodes."""
        from gym_open.evaluate.human import HumanConfig, StoppedError, play_as_person

        config = HumanConfig(
            task=self.task, split=self.split, puzzles=self.puzzles, player=self.player, picture=self.picture
        )
        name = f"{self.task}-{self.player}".replace("/", "-") + ("" if self.split == "test" else f"-{self.split}")
        folder = self.save or workspace.check(self.workspace) / "evaluate/scores" / name
        try:
            made = play_as_person(config, folder)
        except StoppedError as stopped:  # the player asked to stop: no error, but the set is not finished
            say(str(stopped))
            raise SystemExit(130) from None
        show(score_table({name: made.path}))
        report(made)
