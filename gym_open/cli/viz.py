"""`gym-open viz`: show anything that gym-open makes."""

from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, TypeVar

import tyro

from gym_open.cli.base import say_made
from gym_open.cli.stages import Settings, StageCommand
from gym_open.errors import UsageError
from gym_open.summary import word
from gym_open.viz.config import VizConfig

if TYPE_CHECKING:
    from gym_open.viz.config import Choice

T = TypeVar("T")
_NO_DEFAULT = tyro.conf.arg(help_behavior_hint="")
Perhaps = Annotated[T | None, tyro.conf.DisallowNone, _NO_DEFAULT]
"""An optional value; the help text shows no default for it."""


@dataclass(frozen=True, kw_only=True)
class VizCommand(StageCommand):
    """Show a log, a release, an encoder, policies, scores, a benchmark or a report in Rerun.

    Without --save, --web, --video or --png, Rerun's window opens and fills while the source is read.

    Example: gym-open viz collect/logs/icm

    More examples:
        gym-open viz collect/logs/icm --steps 10000:12000 --save part.rrd
        gym-open viz datasets/open/explore/1.0.0 --episode 3 --web
        gym-open viz evaluate/scores/a evaluate/scores/b --puzzle tool-use/017
        gym-open viz train/encoders/encoder-icm --release datasets/open/explore/1.0.0
        gym-open viz collect/logs/icm --segment 2 --video play.mp4
    """

    sources: Annotated[tuple[Path, ...], tyro.conf.Positional, _NO_DEFAULT]
    """What to show: a log folder or one .mcap file, a release, an encoder, policies or scores (one or several), a
    benchmark's folder, a report."""
    settings: Settings[VizConfig]
    puzzle: Perhaps[str] = None
    """For scores or policies: show this puzzle, such as tool-use/017, with a solution."""
    episode: Perhaps[int] = None
    """For a release: show only this episode."""
    segment: Perhaps[int] = None
    """For a log or release: show only this segment of each stream."""
    steps: Perhaps[str] = None
    """For a log or release: show only the steps A:B, without B."""
    stream: Perhaps[int] = None
    """For a log or release: show only this stream."""
    release: Perhaps[Path] = None
    """For an encoder: use images of this release; by default, images of random actions."""
    save: Perhaps[Path] = None
    """Write a recording to this .rrd file."""
    web: bool = False
    """Serve a page for a browser on this machine, until Ctrl-C."""
    video: Perhaps[Path] = None
    """Write a film (.mp4 or .gif); of several streams, it shows the first one or --stream."""
    png: Perhaps[Path] = None
    """Write a figure (.png); of several streams, it shows the first one or --stream."""

    default = "viz/default.toml"
    needs_workspace = False
    about = "show anything in Rerun, or as a film or figure"

    def run(self) -> None:
        """Open a window, serve a page, or write a file."""
        from gym_open.viz.config import Choice, parse_steps

        asked = [name for name in ("save", "web", "video", "png") if getattr(self, name)]
        if len(asked) > 1:
            raise UsageError(f"{' and '.join(f'--{name}' for name in asked)}: give only one of these options")
        if not self.sources:
            raise UsageError("no source given; give a folder or file, such as collect/logs/icm")
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
            _made(path, f"rerun {word(path)}")
        elif self.web:
            viewers.web(view)
        else:
            viewers.native(view)


def _made(path: Path, *commands: str) -> None:
    say_made(path, *commands, note=f"{path.stat().st_size / 1e6:.1f} MB")
