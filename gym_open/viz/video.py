"""`write_video`: play, or a puzzle by several agents, as a film with the series under the picture."""

from collections.abc import Sequence
from pathlib import Path

from gym_open.errors import UsageError
from gym_open.terminal import printable
from gym_open.viz.choice import Choice
from gym_open.viz.config import VizConfig
from gym_open.viz.film import FILMS, check_suffix, write_film
from gym_open.viz.play.film import FPS, film
from gym_open.viz.play.glance import glance
from gym_open.viz.play.page import open_streams
from gym_open.viz.recording import LOG, kind_of
from gym_open.viz.render import shown_look


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
