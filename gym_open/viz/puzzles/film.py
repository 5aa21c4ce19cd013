"""A film of several agents on one puzzle, side by side, with their returns below."""

import math
from collections.abc import Iterator

import numpy as np
from PIL import Image, ImageDraw

from gym_open import progress
from gym_open.envs.world import World
from gym_open.plots import agent_style, rgb
from gym_open.viz.film import FAINT, INK, PAPER, even, typeface
from gym_open.viz.puzzles.episodes import PlayedPuzzle, PuzzleEpisode
from gym_open.viz.render import DIRECTIONS, FilmedStep, Look, Painter, painter, played_steps
from gym_open.viz.strip import Plot, PlotLine, Strip

_STEPS_A_SECOND = 6
_WIDTH, _WIDEST = 1280, 420
"""Width of the film in pixels, and largest width of one agent's image."""
_PLOT = 170
"""Height of a plot in pixels."""
_ACROSS = 4
"""Agents per row."""
_PAINTED = 600
"""Above this number of images, fewer are drawn per step: the handsome look takes a tenth of a second per image."""


def frames_a_step(played: PlayedPuzzle) -> int:
    """Return the number of images per step: it divides the substeps of a step, and the film does not get too long."""
    total = sum(episode.steps for episode in played.episodes)
    return next((each for each in (5, 2) if each * total <= _PAINTED), 1)


def film(played: PlayedPuzzle, look: Look) -> tuple[Iterator[np.ndarray], int]:
    """Return frames (H, W, 3) uint8 with all agents at the same pace, and frames per second.

    An agent whose episode has ended stands still.
    """
    each = frames_a_step(played)
    return _frames(played, look, each), _STEPS_A_SECOND * each


def _frames(played: PlayedPuzzle, look: Look, each: int) -> Iterator[np.ndarray]:
    episodes = played.episodes
    across = min(len(episodes), _ACROSS)
    size = min(_WIDTH // across, _WIDEST) // 2 * 2
    longest, held = max(episode.steps for episode in episodes), round(0.8 * _STEPS_A_SECOND * each)
    strip = Strip([returns_plot(episodes, longest)], across * size, _PLOT, (0, 1.02 * longest), "actions")
    with painter(World(), look, size) as paint, progress.bar("film", longest) as bar:
        panels = [_panels(played, number, paint, each) for number in range(len(episodes))]
        shown = [next(panel) for panel in panels]
        frame = _page(shown, strip.at(0), across)
        yield from [frame] * held
        for number in range(1, longest * each + 1):
            shown = [next(panel, last) for panel, last in zip(panels, shown, strict=True)]
            frame = _page(shown, strip.at(number / each), across)
            yield frame
            bar.advance(number % each == 0)
        yield from [frame] * (2 * held)


def returns_plot(episodes: list[PuzzleEpisode], longest: int) -> Plot:
    """Plot the return so far of each agent up to the end of the longest episode; lines are drawn slightly apart."""
    curves = list[PlotLine]()
    for number, episode in enumerate(episodes):
        earned = np.append(episode.returns, episode.returns[-1])
        at = np.append(np.arange(episode.steps + 1), 1.02 * longest)
        colour, line = agent_style(number)
        curves.append(PlotLine(at, earned + 0.012 * number, colour, episode.name, line))
    return Plot("return so far", curves)


def _panels(played: PlayedPuzzle, number: int, paint: Painter, each: int) -> Iterator[Image.Image]:
    """Yield the panels of one agent, from the beginning to the end of its episode."""
    episode, total = played.episodes[number], played.episodes[number].steps
    for world, moment in played_steps(World(), played.puzzle, episode.actions, each):
        at_end = moment.step == total and math.isclose(moment.total, episode.returns[-1], abs_tol=1e-9)
        yield _panel(paint(world), episode, rgb(agent_style(number)[0]), moment, ended=at_end)


def _panel(
    image: np.ndarray, episode: PuzzleEpisode, hue: tuple[int, int, int], moment: FilmedStep, *, ended: bool
) -> Image.Image:
    """Draw the image between the agent's name and a line about its action."""
    size = len(image)
    large, small = typeface(max(11, size // 20)), typeface(max(10, size // 24))
    line = round(1.7 * large.size)
    panel = Image.new("RGB", (size, size + 3 * line), PAPER)
    panel.paste(Image.fromarray(image), (0, line))
    draw, margin = ImageDraw.Draw(panel), line // 3
    draw.rectangle((0, 0, size, 3), fill=hue)
    draw.text((margin, line / 2 + 2), episode.name, fill=INK, font=large, anchor="lm")
    first, second = size + 1.5 * line, size + 2.5 * line
    if moment.step:
        draw.text((margin, first), f"{moment.step}  {DIRECTIONS[moment.action]}", fill=INK, font=small, anchor="lm")
        draw.text((size - margin, first), f"return {moment.total:g}", fill=FAINT, font=small, anchor="rm")
    if ended:
        draw.text((margin, second), episode.outcome, fill=INK, font=small, anchor="lm")
    return panel


def _page(panels: list[Image.Image], strip: np.ndarray, across: int) -> np.ndarray:
    width, height = panels[0].size
    rows = math.ceil(len(panels) / across)
    page = Image.new("RGB", (strip.shape[1], rows * height + strip.shape[0]), PAPER)
    for i, panel in enumerate(panels):
        page.paste(panel, (i % across * width, i // across * height))
    page.paste(Image.fromarray(strip), (0, rows * height))
    return even(page)
