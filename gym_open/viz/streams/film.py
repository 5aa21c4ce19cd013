"""A stream as a film: a large image of the table, the observation, the coverage so far, and the series below."""

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
from gym_open.viz.render import DIRECTIONS, Look, painter, pose
from gym_open.viz.streams.preview import ShownStep, StreamPreview, others_named
from gym_open.viz.strip import Strip

FPS = 20
_LARGE, _SMALL, _GAP, _CELL = 480, 252, 8, 13
"""Pixels: edge of the large image and of the observation, the gap between them, and edge of a cell of the coverage."""
_PLOT = 120
_LINE = 30
Draw = Callable[[ShownStep], np.ndarray]


def film(title: str, shown: StreamPreview, look: Look, others: int = 0) -> Iterator[np.ndarray]:
    """Yield a frame (H, W, 3) uint8 per shown step.

    Args:
        title: title of the log or release, printable.
        shown: the steps to show.
        look: look of the large image; if the log has other objects than the default world, the observation's look.
        others: number of the source's other streams, for the caption.
    """
    stream, steps = shown.stream, shown.steps
    span = float(stream.steps.start), float(stream.steps.stop)
    strip = Strip(shown.plots(), _LARGE + _GAP + _SMALL, _PLOT, span, "steps of the stream")
    every = f"every {shown.every}th step" if shown.every > 1 else "every step"
    words = f"{title}, stream {stream.number}", every, others_named(others)
    known = World().inventory
    if any(step.names != known for step in steps):
        look = "observation"
    with _painter(look) as draw, progress.bar("film", len(steps)) as bar:
        for step in steps:
            yield _frame(words, step, draw(step), strip.at(step.step), small=look != "observation")
            bar.advance()


@contextmanager
def _painter(look: Look) -> Iterator[Draw]:
    """Provide a function that draws a step from its recorded state."""
    if look == "observation":
        yield lambda step: enlarged(step.image, _LARGE)
        return
    world = World()
    loaded: Puzzle | None = None

    def draw(step: ShownStep) -> np.ndarray:
        nonlocal loaded
        if step.puzzle is not loaded:
            world.load(step.puzzle)
            loaded = step.puzzle
        pose(world, step.state)
        return paint(world)

    with painter(world, look, _LARGE) as paint:
        yield draw


def _frame(
    words: tuple[str, str, str], shown: ShownStep, large: np.ndarray, strip: np.ndarray, *, small: bool
) -> np.ndarray:
    """A frame: the large image, the coverage to its right, and below them two lines of text and the series.

    With `small`, the observation is to the right as well; without it, the large image is the observation.
    """
    page = Image.new("RGB", (_LARGE + _GAP + _SMALL, _LARGE + 2 * _LINE + len(strip)), PAPER)
    draw, font = ImageDraw.Draw(page), typeface(15)
    page.paste(Image.fromarray(large))
    left = _LARGE + _GAP
    if small:
        page.paste(Image.fromarray(enlarged(shown.image, _SMALL)), (left, 0))
    cells = coverage_image(shown.coverage, _CELL if small else 2 * _CELL)
    top = _SMALL + _GAP if small else 0
    page.paste(Image.fromarray(cells), (left + (_SMALL - cells.shape[1]) // 2, top))
    draw.text((left + _SMALL / 2, top + len(cells) + 13), "coverage so far", fill=FAINT, font=typeface(12), anchor="mm")
    title, every, others = words
    action = "" if shown.action is None else DIRECTIONS[shown.action]
    now = f"step {shown.step:,}   {shown.step * CONTROL_DT_S:,.1f} s   world {shown.world}   {action}"
    draw.text((_GAP, _LARGE + _LINE / 2), title, fill=INK, font=font, anchor="lm")
    draw.text((_GAP, _LARGE + 1.5 * _LINE), now, fill=INK, font=font, anchor="lm")
    draw.text((page.width - _GAP, _LARGE + _LINE / 2), every, fill=FAINT, font=font, anchor="rm")
    draw.text((page.width - _GAP, _LARGE + 1.5 * _LINE), others, fill=FAINT, font=typeface(12), anchor="rm")
    page.paste(Image.fromarray(strip), (0, _LARGE + 2 * _LINE))
    return even(page)
