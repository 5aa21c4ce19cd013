"""Puzzles of the evaluation: one puzzle played by several agents, side by side, or the results of all puzzles."""

from collections.abc import Sequence
from pathlib import Path

from gym_open.viz.config import Choice, VizConfig
from gym_open.viz.view import View


def view(config: VizConfig, sources: Sequence[Path], choice: Choice) -> View:
    """Show the chosen puzzle, played by the sources; without a choice, show the results of all puzzles of their task.

    Args:
        config: sets the length of the trails.
        sources: scores artefacts; with a chosen puzzle also policies, which play it.
        choice: only `puzzle` is used.

    Raises:
        ArtefactError: if a source is damaged, of another kind or task, or holds no episode of the puzzle.
        PuzzleError: if no fixed puzzle has this id.
        UsageError: if more than a puzzle was chosen, or there is no source.
    """
    choice.refuse_others("a puzzle", {"puzzle"})
    if choice.puzzle is None:
        from gym_open.viz.puzzles.overview import overview

        return overview(sources)
    from gym_open.viz.puzzles.episodes import play_all
    from gym_open.viz.puzzles.side_by_side import side_by_side

    return side_by_side(config, play_all(choice.puzzle, sources))
