"""Play as a film: the table for people, what the agent sees, where it was so far, and the series below."""

from collections.abc import Callable, Iterator
from contextlib import contextmanager

import numpy as np
from PIL import Image, ImageDraw

from gym_open import progress
from gym_open.envs.constants import CONTROL_DT_S
from gym_open.envs.puzzles import Puzzle
from gym_open.envs.world import World
from gym_open.plots import coverage_image
from gym_open.viz.film import FAINT, INK, PAPER, enlarged, even, typeface
from gym_open.viz.play.glance import Glance, Moment, others_named
from gym_open.viz.render import DIRECTIONS, Look, painter, pose
from gym_open.viz.strip import Strip

FPS = 20
_LARGE, _SMALL, _GAP, _CELL = 480, 252, 8, 13
"""Pixels: edges of the picture and of the observation, between them, and of a cell of the coverage."""
_PLOT = 120
_LINE = 30
Draw = Callable[[Moment], np.ndarray]


def film(title: str, play: Glance, look: Look, others: int = 0) -> Iterator[np.ndarray]:
    """Frames (H, W, 3) uint8 of the moments of a stream.

    Args:
        title: of the log or release, printable.
        play: the stream.
        look: of the large picture; where the log's objects are not those of the default world, the observation's.
        others: streams beside this one, which the caption tells of.
    """
    stream, moments = play.stream, play.moments
    span = float(stream.steps.start), float(stream.steps.stop)
    strip = Strip(play.plots(), _LARGE + _GAP + _SMALL, _PLOT, span, "steps of the stream")
    every = f"each {play.every}th step" if play.every > 1 else "every step"
    words = f"{title}, stream {stream.number}", every, others_named(others)
    known = World().inventory
    if any(moment.names != known for moment in moments):
        look = "observation"
    with _painter(look) as draw, progress.bar("film", len(moments)) as bar:
        for moment in moments:
            yield _frame(words, moment, draw(moment), strip.at(moment.step), beside=look != "observation")
            bar.advance()


@contextmanager
def _painter(look: Look) -> Iterator[Draw]:
    """What draws a moment: its world is laid out as it was recorded, and not simulated."""
    if look == "observation":
        yield lambda moment: enlarged(moment.image, _LARGE)
        return
    world = World()
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


def _frame(
    words: tuple[str, str, str], moment: Moment, large: np.ndarray, strip: np.ndarray, *, beside: bool
) -> np.ndarray:
    """The large picture with the coverage beside it; below, two lines of words and the series.

    The observation is `beside` it, too, unless it is the large picture itself.
    """
    page = Image.new("RGB", (_LARGE + _GAP + _SMALL, _LARGE + 2 * _LINE + len(strip)), PAPER)
    draw, font = ImageDraw.Draw(page), typeface(15)
    page.paste(Image.fromarray(large))
    left = _LARGE + _GAP
    if beside:
        page.paste(Image.fromarray(enlarged(moment.image, _SMALL)), (left, 0))
    cells = coverage_image(moment.coverage, _CELL if beside else 2 * _CELL)
    top = _SMALL + _GAP if beside else 0
    page.paste(Image.fromarray(cells), (left + (_SMALL - cells.shape[1]) // 2, top))
    draw.text((left + _SMALL / 2, top + len(cells) + 13), "coverage so far", fill=FAINT, font=typeface(12), anchor="mm")
    title, every, others = words
    action = "" if moment.action is None else DIRECTIONS[moment.action]
    now = f"step {moment.step:,}   {moment.step * CONTROL_DT_S:,.1f} s   world {moment.world}   {action}"
    draw.text((_GAP, _LARGE + _LINE / 2), title, fill=INK, font=font, anchor="lm")
    draw.text((_GAP, _LARGE + 1.5 * _LINE), now, fill=INK, font=font, anchor="lm")
    draw.text((page.width - _GAP, _LARGE + _LINE / 2), every, fill=FAINT, font=font, anchor="rm")
    draw.text((page.width - _GAP, _LARGE + 1.5 * _LINE), others, fill=FAINT, font=typeface(12), anchor="rm")
    page.paste(Image.fromarray(strip), (0, _LARGE + 2 * _LINE))
    return even(page)
