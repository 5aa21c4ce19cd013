"""Films and figures for people without Rerun: `write_video` and `write_still`."""

from collections.abc import Callable, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, NamedTuple

from gym_open.errors import UsageError
from gym_open.plots import draw_png
from gym_open.terminal import printable
from gym_open.viz.config import Choice, VizConfig
from gym_open.viz.film import FILMS, check_suffix, write_film, write_whole
from gym_open.viz.recording import LOG, kind_of
from gym_open.viz.render import shown_look
from gym_open.viz.streams.film import FPS, film
from gym_open.viz.streams.page import open_streams
from gym_open.viz.streams.preview import preview

if TYPE_CHECKING:
    from matplotlib.figure import Figure


class PageDrawing(NamedTuple):
    """A figure to draw, and its size in inches."""

    width: float
    height: float
    paint: "Callable[[Figure], None]"


def write_still(config: VizConfig, sources: Sequence[Path], choice: Choice, out: Path) -> Path:
    """Draw one page as PNG.

    For a log or release it shows images over time, coverage and series; for a puzzle, a film strip per agent; for
    scores, all puzzles of their task.

    Args:
        config: decides the look.
        sources: one log or release; scores and policies with a puzzle; or only scores.
        choice: the part of it.
        out: the `.png` file, written completely or not at all.

    Raises:
        ArtefactError: if a source is missing or damaged.
        UsageError: if `out` has another suffix, the selected part does not exist, or these sources have no page.
    """
    check_suffix(out, (".png",))
    png = draw_png(*_page(config, sources, choice))
    return write_whole(out, lambda partial: partial.write_bytes(png))


def _page(config: VizConfig, sources: Sequence[Path], choice: Choice) -> PageDrawing:
    look = shown_look(config.film_look)
    if choice.puzzle is not None:
        from gym_open.viz.puzzles.episodes import play_all
        from gym_open.viz.puzzles.still import strips

        choice.refuse_others("a puzzle", {"puzzle"})
        return PageDrawing(*strips(play_all(choice.puzzle, sources), look))
    kinds = {kind_of(source) for source in sources}
    if kinds == {"scores"}:
        from gym_open.viz.puzzles.still import overview
        from gym_open.viz.puzzles.tables import read_tables

        choice.refuse_others("scores", {"puzzle"})
        return PageDrawing(*overview(read_tables(sources)))
    if len(sources) == 1 and kinds <= {LOG, "release", "compact"}:
        from gym_open.viz.streams.still import play_page

        title, streams = open_streams(sources[0], choice)
        return PageDrawing(*play_page(printable(title), streams))
    raise UsageError(
        f"--png: cannot draw {', '.join(sorted(kinds)) or 'nothing'} as a page; give one log or release, scores, or "
        "scores and policies with --puzzle TASK/NUMBER; for other sources use --save"
    )


def write_video(config: VizConfig, sources: Sequence[Path], choice: Choice, out: Path) -> Path:
    """Film a stream of a log or release (by default the first), or all agents and the witness on one puzzle.

    Args:
        config: decides the number of frames and the look.
        sources: one log or release; or scores and policies with a puzzle.
        choice: the part of it.
        out: the `.mp4` or `.gif` file, written completely or not at all.

    Raises:
        ArtefactError: if a source is missing or damaged.
        UsageError: if `out` has another suffix, the selected part does not exist, or the sources cannot be filmed.
    """
    check_suffix(out, FILMS)
    look = shown_look(config.film_look)
    if choice.puzzle is not None:
        from gym_open.viz.puzzles.episodes import play_all
        from gym_open.viz.puzzles.film import film as film_of_puzzle

        choice.refuse_others("a puzzle", {"puzzle"})
        return write_film(out, *film_of_puzzle(play_all(choice.puzzle, sources), look))
    kinds = {kind_of(source) for source in sources}
    if len(sources) != 1 or not kinds <= {LOG, "release", "compact"}:
        raise UsageError(
            f"--video: cannot film {', '.join(sorted(kinds))}; give one log or release, or scores and policies with "
            "--puzzle TASK/NUMBER"
        )
    title, streams = open_streams(sources[0], choice)
    shown = preview(streams[0], config.film_pictures)
    return write_film(out, film(printable(title), shown, look, len(streams) - 1), FPS)
