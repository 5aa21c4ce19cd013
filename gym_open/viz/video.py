"""`write_video`: play, or a puzzle by several agents, as a film with the series under the picture."""

from collections.abc import Sequence
from pathlib import Path

from gym_open.errors import UsageError
from gym_open.viz.choice import Choice
from gym_open.viz.config import VizConfig
from gym_open.viz.film import FILMS, check_suffix, write_film
from gym_open.viz.recording import kind_of


def write_video(config: VizConfig, sources: Sequence[Path], choice: Choice, out: Path) -> Path:
    """Film a log, a release or part of one; or a puzzle, played by all sources, the witness beside them.

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
    if choice.puzzle is not None:
        from gym_open.viz.puzzles.episodes import play_all
        from gym_open.viz.puzzles.film import film

        choice.refuse_others("a puzzle", {"puzzle"})
        return write_film(out, *film(play_all(choice.puzzle, sources), "handsome"))
    kinds = [kind_of(source) for source in sources]
    raise UsageError(f"{kinds}")
