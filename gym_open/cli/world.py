"""The world's own sub-commands: look at puzzles, check them, serve worlds, let a person play."""

from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Literal

import tyro

from gym_open import workspace
from gym_open.cli.base import Command, out, report, say
from gym_open.envs.puzzles import Task
from gym_open.envs.puzzles.sets import Split
from gym_open.errors import UsageError
from gym_open.seeding import generator
from gym_open.summary import score_table, short

if TYPE_CHECKING:
    from gym_open.envs.puzzles import Puzzle

Look = Literal["handsome", "observation"]
EvaluationTask = Literal["goal-seeking", "preferences", "avoidance", "tool-use"]


@dataclass(frozen=True, kw_only=True)
class PuzzleShow(Command):
    """Show a fixed puzzle: its cells from above, its record, its digest, and a solution.

    Example: gym-open puzzle show tool-use/017
    """

    puzzle: Annotated[str, tyro.conf.Positional]
    """Id: tool-use/017 of the test set, tool-use/validation/017 of the validation set."""

    about = "a fixed puzzle and its solution, in the terminal"

    def run(self) -> None:
        """Show it."""
        from gym_open.envs.puzzle_report import show
        from gym_open.envs.puzzles.sets import puzzle_by_id

        out.print(show(self.puzzle))
        print(f"\n{puzzle_by_id(self.puzzle).to_json().decode()}\n")  # whole on one line, to be copied
        say(f"  next: gym-open render video {self.puzzle} --save solution.mp4")


@dataclass(frozen=True, kw_only=True)
class PuzzleVerify(Command):
    """Check that the fixed puzzles are the published ones and that every witness solves its puzzle here.

    Example: gym-open puzzle verify
    """

    about = "check the fixed puzzles and replay their solutions"

    def run(self) -> None:
        """Check them."""
        from gym_open.envs.puzzle_report import verify

        out.print(verify())


@dataclass(frozen=True, kw_only=True)
class RenderSheet(Command):
    """Draw puzzles side by side as a PNG. The handsome look needs OpenGL, the observation look nothing.

    Example: gym-open render sheet --task tool-use --save tool-use.png
    """

    task: Task = "goal-seeking"
    """Task whose fixed puzzles are drawn; of the sandbox, worlds drawn from `--seed`."""
    split: Split = "test"
    """Which set of fixed puzzles."""
    puzzles: tuple[int, int] = (0, 20)
    """The first, and the one after the last."""
    look: Look = "handsome"
    """With shadows and gloss, or as an agent sees it."""
    size: int = 192
    """Edge of one picture in pixels."""
    columns: int = 5
    """Pictures in a row."""
    seed: int = 0
    """Of the sandbox's worlds."""
    save: Path
    """The .png file to write."""

    about = "a picture of many puzzles (PNG)"

    def run(self) -> None:
        """Draw them."""
        from gym_open.viz.render import contact_sheet

        made = contact_sheet(self._puzzles(), self.save, look=self.look, size=self.size, columns=self.columns)
        say(short(made), verb="made")

    def _puzzles(self) -> "dict[str, Puzzle]":
        from gym_open.envs.puzzles.generators import sample_puzzle
        from gym_open.envs.puzzles.sets import PER_SET, puzzle_id, puzzles_of

        first, last = self.puzzles
        if not 0 <= first < last <= PER_SET:
            raise UsageError(f"--puzzles: expected first < last within 0 and {PER_SET}, got {first} {last}")
        if self.task == "sandbox":
            rng = generator(self.seed, "render", "sandbox")
            return {f"sandbox {i}": sample_puzzle("sandbox", rng) for i in range(last)[first:]}
        fixed = puzzles_of(self.task, self.split)
        return {puzzle_id(self.task, self.split, i): fixed[i] for i in range(first, last)}


@dataclass(frozen=True, kw_only=True)
class RenderVideo(Command):
    """Film an episode on a fixed puzzle: its witness, random actions, or what a scored policy or person did.

    Example: gym-open render video tool-use/017 --save solution.mp4
    """

    puzzle: Annotated[str, tyro.conf.Positional]
    """Id of the puzzle, such as tool-use/017."""
    actions: str = "witness"
    """`witness`, `random`, or a folder of scores that holds an episode of this puzzle."""
    look: Look = "handsome"
    """With shadows and gloss, or as an agent sees it."""
    size: int = 512
    """Width of the film in pixels."""
    seed: int = 0
    """Of random actions."""
    save: Path
    """The .mp4 or .gif file to write."""

    about = "a film of an episode (MP4, GIF)"

    def run(self) -> None:
        """Film it."""
        from gym_open.envs.puzzles.sets import puzzle_by_id
        from gym_open.viz.render import episode_video

        puzzle = puzzle_by_id(self.puzzle)
        made = episode_video(puzzle, self._actions(puzzle), self.save, name=self.puzzle, look=self.look, size=self.size)
        say(short(made), verb="made")

    def _actions(self, puzzle: "Puzzle") -> list[int]:
        from gym_open.envs.puzzles.witnesses import witness_of
        from gym_open.viz.render import random_actions, scored_actions

        if self.actions == "witness":
            return list(witness_of(self.puzzle).actions)
        if self.actions == "random":
            return random_actions(puzzle, generator(self.seed, "render", self.puzzle))
        return scored_actions(Path(self.actions), self.puzzle)


@dataclass(frozen=True, kw_only=True)
class Serve(Command):
    """Serve worlds to other hosts, for the paper's own interface; stops at Ctrl-C.

    Example: gym-open serve --port 10710
    """

    host: str = "127.0.0.1"
    """Address to listen on; any but this machine's own needs a token."""
    port: int = 10710
    """TCP port; 0 takes a free one."""
    token_file: Path | None = None
    """File with the token that clients must send; without it, the variable GYM_OPEN_TOKEN."""
    clients: int = 4
    """Clients at a time, each with a world of its own."""
    idle_s: float = 1800.0
    """Seconds without a call after which a client's world is freed."""

    about = "worlds for other hosts, behind the paper's interface"

    def run(self) -> None:
        """Serve."""
        from gym_open.remote.server import serve

        serve(self.host, self.port, token_file=self.token_file, clients=self.clients, idle_s=self.idle_s)


@dataclass(frozen=True, kw_only=True)
class Play(Command):
    """Play the fixed puzzles with the keyboard; every move is logged, and you are scored like a policy.

    Example: gym-open play --task avoidance --player Ada --puzzles 0 20
    """

    task: EvaluationTask = "goal-seeking"
    """Task whose fixed puzzles are played."""
    split: Split = "test"
    """The set: `test` is what policies are scored on, `validation` is there to practise."""
    puzzles: tuple[int, int] = (0, 100)
    """The first, and the one after the last."""
    player: str = "player"
    """Name in the record."""
    picture: Literal["sharp", "agent"] = "sharp"
    """Drawn in the window's pixels, or as a policy sees it: 84×84, enlarged."""
    workspace: Path = Path()
    """Folder with the five stage folders."""
    save: Path | None = None
    """Folder of the scores; default evaluate/scores/ and the task's, player's and set's names."""

    about = "play the fixed puzzles yourself, logged and scored"

    def run(self) -> None:
        """Open the window."""
        from gym_open.evaluate.human import HumanConfig, StoppedError, play_as_person

        config = HumanConfig(
            task=self.task, split=self.split, puzzles=self.puzzles, player=self.player, picture=self.picture
        )
        name = f"{self.task}-{self.player}".replace("/", "-") + ("" if self.split == "test" else f"-{self.split}")
        folder = self.save or workspace.check(self.workspace) / "evaluate/scores" / name
        try:
            made = play_as_person(config, folder)
        except StoppedError as stopped:  # as it was meant: no error, but not done either
            say(str(stopped))
            raise SystemExit(130) from None
        out.print(score_table({name: made.path}))
        report(made)
