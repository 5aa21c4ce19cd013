"""`gym-open viz`: looking at whatever gym-open makes."""

from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, TypeVar

import tyro

from gym_open.cli.base import say
from gym_open.cli.stages import Settings, StageCommand
from gym_open.errors import UsageError
from gym_open.summary import short, word
from gym_open.viz.config import VizConfig

if TYPE_CHECKING:
    from gym_open.viz.config import Choice

T = TypeVar("T")
_NO_DEFAULT = tyro.conf.arg(help_behavior_hint="")
Perhaps = Annotated[T | None, tyro.conf.DisallowNone, _NO_DEFAULT]
"""An option that is left out or given, of whose default nothing is said."""


@dataclass(frozen=True, kw_only=True)
class Viz(StageCommand):
    """Look at a log, a release, an encoder, policies, scores, a benchmark or a report in Rerun.

    Without --save, --web, --video or --png Rerun's own window opens, and the data stream into it while they are read.

    Example: gym-open viz collect/logs/icm

    Others:
        gym-open viz collect/logs/icm --steps 10000:12000 --save part.rrd
        gym-open viz datasets/open/explore/1.0.0 --episode 3 --web
        gym-open viz evaluate/scores/a evaluate/scores/b --puzzle tool-use/017
        gym-open viz train/encoders/encoder-icm --release datasets/open/explore/1.0.0
        gym-open viz collect/logs/icm --segment 2 --video play.mp4
    """

    sources: Annotated[tuple[Path, ...], tyro.conf.Positional, _NO_DEFAULT]
    """What to look at: a folder of logs or one .mcap file, a release, an encoder, policies or scores (several stand
    side by side), a benchmark's folder, a report."""
    settings: Settings[VizConfig]
    puzzle: Perhaps[str] = None
    """Of scores or policies: the puzzle to see played, such as tool-use/017, the solution beside it."""
    episode: Perhaps[int] = None
    """Of a release: this episode alone."""
    segment: Perhaps[int] = None
    """Of a log or release: this segment of a stream alone."""
    steps: Perhaps[str] = None
    """Of a log or release: these steps of its streams alone, A:B, B excluded."""
    stream: Perhaps[int] = None
    """Of a log or release: this stream alone."""
    release: Perhaps[Path] = None
    """Of an encoder: the release whose pictures it is shown; its own random play by default."""
    save: Perhaps[Path] = None
    """Write the recording to this .rrd file."""
    web: bool = False
    """Show it in a browser, served on this machine alone, until Ctrl-C."""
    video: Perhaps[Path] = None
    """Write a film, .mp4 or .gif, with the series under the picture; of several streams the first, or --stream."""
    png: Perhaps[Path] = None
    """Write one still picture; of several streams the first, or --stream."""

    default = "viz/default.toml"
    needs_workspace = False
    about = "look at anything in Rerun, or as a film or picture"

    def run(self) -> None:
        """Open it, or write the file that was asked for."""
        from gym_open.viz.config import Choice, parse_steps

        asked = [name for name in ("save", "web", "video", "png") if getattr(self, name)]
        if len(asked) > 1:
            raise UsageError(f"{' and '.join(f'--{name}' for name in asked)}: give one of them")
        if not self.sources:
            raise UsageError("nothing to look at; give a folder or file, such as collect/logs/icm")
        steps = None if self.steps is None else parse_steps(self.steps)
        choice = Choice(self.puzzle, self.episode, self.segment, steps, self.release, self.stream)
        if self.video:
            from gym_open.viz.export import write_video

            _made(write_video(self.settings, self.sources, choice, self.video))
        elif self.png:
            from gym_open.viz.export import write_still

            _made(write_still(self.settings, self.sources, choice, self.png))
        else:
            self._show(choice)

    def _show(self, choice: "Choice") -> None:
        from gym_open.viz import viewers
        from gym_open.viz.recording import open_view

        view = open_view(self.settings, self.sources, choice)
        if self.save:
            path = viewers.save(view, self.save)
            _made(path, f"  next: rerun {word(path)}")
        elif self.web:
            viewers.web(view)
        else:
            viewers.native(view)


def _made(path: Path, then: str = "") -> None:
    say(f"{short(path)}  ({path.stat().st_size / 1e6:.1f} MB)" + (f"\n{then}" if then else ""), verb="made")
