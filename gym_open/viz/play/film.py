"""Play as a film: the table for people, what the agent sees, where it was so far, and the series below."""

from collections.abc import Callable, Iterator
from contextlib import contextmanager

import numpy as np
from PIL import Image, ImageDraw

from gym_open import progress
from gym_open.envs.constants import CONTROL_DT_S
from gym_open.envs.puzzles import Puzzle
from gym_open.envs.world import World
from gym_open.viz.film import FAINT, INK, PAPER, coverage_picture, enlarged, even, typeface
from gym_open.viz.play.glance import Glance, Moment
from gym_open.viz.render import DIRECTIONS, Look, painter, pose
from gym_open.viz.strip import Strip

FPS = 20
_LARGE, _SMALL, _GAP, _CELL = 480, 252, 8, 13
"""Pixels: edges of the picture and of the observation, between them, and of a cell of the coverage."""
_PLOT = 120
_LINE = 30
Draw = Callable[[Moment], np.ndarray]


def film(title: str, play: Glance, look: Look) -> Iterator[np.ndarray]:
    """Frames (H, W, 3) uint8 of the moments of a stream.

    Args:
        title: of the log or release, printable.
        play: the stream.
        look: of the large picture; where the log's objects are not those of the default world, the observation's.
    """
    stream, moments = play.stream, play.moments
    span = float(stream.steps.start), float(stream.steps.stop)
    strip = Strip(play.plots(), _LARGE + _GAP + _SMALL, _PLOT, span, "steps of the stream")
    words = f"{title}, stream {stream.number}", f"each {play.every}th step" if play.every > 1 else "every step"
    with _painter(moments, look) as draw, progress.bar("film", len(moments)) as bar:
        for moment in moments:
            yield _frame(words, moment, draw(moment), strip.at(moment.step))
            bar.advance()


@contextmanager
def _painter(moments: list[Moment], look: Look) -> Iterator[Draw]:
    """What draws a moment: its world is laid out as it was recorded, and not simulated."""
    world = World()
    if look == "observation" or any(moment.names != world.inventory for moment in moments):
        yield lambda moment: enlarged(moment.image, _LARGE)
        return
    loaded: Puzzle | None = None

    def draw(moment: Moment) -> np.ndarray:
        nonlocal loaded
        if moment.puzzle is not loaded:
            world.load(moment.puzzle)
            loaded = moment.puzzle
        pose(world, moment.state)
        return paint(world)

    with painter(world, look, _LARGE) as paint:
        yield draw


def _frame(words: tuple[str, str], moment: Moment, large: np.ndarray, strip: np.ndarray) -> np.ndarray:
    """The large picture beside the observation and the coverage; below, two lines of words and the series."""
    page = Image.new("RGB", (_LARGE + _GAP + _SMALL, _LARGE + 2 * _LINE + len(strip)), PAPER)
    draw, font = ImageDraw.Draw(page), typeface(15)
    page.paste(Image.fromarray(large))
    left = _LARGE + _GAP
    page.paste(Image.fromarray(enlarged(moment.image, _SMALL)), (left, 0))
    cells = coverage_picture(moment.coverage, _CELL)
    page.paste(Image.fromarray(cells), (left + (_SMALL - cells.shape[1]) // 2, _SMALL + _GAP))
    draw.text((left + _SMALL / 2, _LARGE - 6), "coverage so far", fill=FAINT, font=typeface(12), anchor="mm")
    title, every = words
    action = "" if moment.action is None else DIRECTIONS[moment.action]
    now = f"step {moment.step:,}   {moment.step * CONTROL_DT_S:,.1f} s   world {moment.world}   {action}"
    draw.text((_GAP, _LARGE + _LINE / 2), title, fill=INK, font=font, anchor="lm")
    draw.text((_GAP, _LARGE + 1.5 * _LINE), now, fill=INK, font=font, anchor="lm")
    draw.text((page.width - _GAP, _LARGE + _LINE / 2), every, fill=FAINT, font=font, anchor="rm")
    page.paste(Image.fromarray(strip), (0, _LARGE + 2 * _LINE))
    return even(page)
