"""Films and figures for people without Rerun: `write_video` and `write_still`."""

from collections.abc import Callable, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, NamedTuple

from gym_open.errors import UsageError
from gym_open.plots import draw_png
from gym_open.terminal import printable
from gym_open.viz.config import Choice, VizConfig
from gym_open.viz.film import FILMS, check_suffix, write_film, write_whole
from gym_open.viz.play.film import FPS, film
from gym_open.viz.play.glance import glance
from gym_open.viz.play.page import open_streams
from gym_open.viz.recording import LOG, kind_of
from gym_open.viz.render import shown_look

if TYPE_CHECKING:
    from matplotlib.figure import Figure


class Page(NamedTuple):
    """A drawing, and its size in inches."""

    width: float
    height: float
    paint: "Callable[[Figure], None]"


def write_still(config: VizConfig, sources: Sequence[Path], choice: Choice, out: Path) -> Path:
    """Draw one page: of play, pictures through time, coverage and curves; of a puzzle, a film strip of each agent.

    Args:
        config: in which look.
        sources: one log or release; scores and policies with a puzzle; or scores alone, for all puzzles of their task.
        choice: what of it.
        out: the picture, `.png`; it appears whole or not at all.

    Raises:
        ArtefactError: if a source is missing or damaged.
        UsageError: if `out` ends in something else, what was picked is not there, or there is no page of the sources.
    """
    check_suffix(out, (".png",))
    picture = draw_png(*_page(config, sources, choice))
    return write_whole(out, lambda beside: beside.write_bytes(picture))


def _page(config: VizConfig, sources: Sequence[Path], choice: Choice) -> Page:
    look = shown_look(config.film_look)
    if choice.puzzle is not None:
        from gym_open.viz.puzzles.episodes import play_all
        from gym_open.viz.puzzles.still import strips

        choice.refuse_others("a puzzle", {"puzzle"})
        return Page(*strips(play_all(choice.puzzle, sources), look))
    kinds = {kind_of(source) for source in sources}
    if kinds == {"scores"}:
        from gym_open.viz.puzzles.still import overview
        from gym_open.viz.puzzles.tables import read_tables

        choice.refuse_others("scores", {"puzzle"})
        return Page(*overview(read_tables(sources)))
    if len(sources) == 1 and kinds <= {LOG, "release"}:
        from gym_open.viz.play.still import play_page

        title, streams = open_streams(sources[0], choice)
        return Page(*play_page(printable(title), streams))
    raise UsageError(
        f"--png: no page of {', '.join(sorted(kinds)) or 'nothing'}; give one log or release, scores, or scores and "
        "policies with --puzzle TASK/NUMBER; --save has all else for Rerun"
    )


def write_video(config: VizConfig, sources: Sequence[Path], choice: Choice, out: Path) -> Path:
    """Film the first stream of a log or release, or what was picked; or a puzzle by all sources, and its witness.

    Args:
        config: how many pictures, and in which look.
        sources: one log or release; or scores and policies, with a puzzle.
        choice: what of it.
        out: the film, `.mp4` or `.gif`; it appears whole or not at all.

    Raises:
        ArtefactError: if a source is missing, damaged, or nothing in it moves.
        UsageError: if `out` ends in something else, or what was picked is not there.
    """
    check_suffix(out, FILMS)
    look = shown_look(config.film_look)
    if choice.puzzle is not None:
        from gym_open.viz.puzzles.episodes import play_all
        from gym_open.viz.puzzles.film import film as film_of_puzzle

        choice.refuse_others("a puzzle", {"puzzle"})
        return write_film(out, *film_of_puzzle(play_all(choice.puzzle, sources), look))
    kinds = {kind_of(source) for source in sources}
    if len(sources) != 1 or not kinds <= {LOG, "release"}:
        raise UsageError(
            f"--video: nothing moves in {', '.join(sorted(kinds))}; give one log or release, or scores and policies "
            "with --puzzle TASK/NUMBER"
        )
    title, streams = open_streams(sources[0], choice)
    play = glance(streams[0], config.film_pictures)
    return write_film(out, film(printable(title), play, look, len(streams) - 1), FPS)
