"""Contact sheets of puzzles and videos of episodes, in either look."""

from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Literal, NamedTuple

import numpy as np
from PIL import Image, ImageDraw

from gym_open import progress
from gym_open.envs import constants as c
from gym_open.envs.look.backend import INSTALL, find_backend
from gym_open.envs.options import WorldOptions
from gym_open.envs.puzzles import Puzzle
from gym_open.envs.tasks import judge, rewarded, step_budget
from gym_open.envs.world import World
from gym_open.errors import UsageError
from gym_open.replay.episodes import scored_row
from gym_open.viz.film import FAINT, FILMS, INK, PAPER, check_suffix, enlarged, even, typeface, write_film, write_whole

Look = Literal["handsome", "observation"]
"""`handsome` needs OpenGL; `observation` is what an agent sees, enlarged."""
Painter = Callable[[World], np.ndarray]
"""Draws a world as (size, size, 3) uint8."""

DIRECTIONS = (
    "• no move", "→ east", "↗ north-east", "↑ north", "↖ north-west",
    "← west", "↙ south-west", "↓ south", "↘ south-east",
)  # fmt: skip
"""Name of each action in a caption; north is away from the camera."""


class FilmedStep(NamedTuple):
    """What a caption says about a step."""

    step: int
    """0 before the first step."""
    action: int
    reward: float
    total: float
    """Sum of the rewards so far."""


_HELD_S = 0.8
"""Seconds for which a video shows its first and its last frame."""


def contact_sheet(
    puzzles: Mapping[str, Puzzle],
    out: Path,
    *,
    look: Look = "handsome",
    size: int = 192,
    columns: int = 10,
    options: WorldOptions | None = None,
) -> Path:
    """Draw the first states of puzzles side by side as a PNG, each above its name.

    Args:
        puzzles: puzzles by name, in the order of the sheet.
        out: the `.png` file, written completely or not at all.
        look: the look.
        size: edge of one image in pixels.
        columns: images per row.
        options: options of the world; None for version 1.

    Raises:
        UsageError: if there is no puzzle, `out` does not end in `.png`, or the size is out of bounds.
        OpenGLError: if the look needs OpenGL and OpenGL is missing.
    """
    check_suffix(out, (".png",))
    sheet = draw_sheet(puzzles, look=look, size=size, columns=columns, options=options)
    return write_whole(out, lambda partial: sheet.save(partial, format="PNG"))


def draw_sheet(
    puzzles: Mapping[str, Puzzle], *, look: Look, size: int, columns: int, options: WorldOptions | None = None
) -> Image.Image:
    """The image that `contact_sheet` writes.

    Raises:
        UsageError: if there is no puzzle, or the size is out of bounds.
        OpenGLError: if the look needs OpenGL and OpenGL is missing.
    """
    _check_range("size", size, 32, 2048)
    if not puzzles:
        raise UsageError("a contact sheet needs at least one puzzle, got none")
    columns = max(1, min(columns, len(puzzles)))
    rows = -(-len(puzzles) // columns)
    gap, font = max(2, size // 24), typeface(max(9, size // 13))
    label = round(1.6 * font.size)
    sheet = Image.new("RGB", (columns * (size + gap) + gap, rows * (size + label + gap) + gap), PAPER)
    draw = ImageDraw.Draw(sheet)
    world = World(options)
    with painter(world, look, size) as paint, progress.bar("sheet", len(puzzles)) as bar:
        for i, (name, puzzle) in enumerate(puzzles.items()):
            world.load(puzzle, recolour_hits=rewarded(puzzle.task))
            left, top = gap + i % columns * (size + gap), gap + i // columns * (size + label + gap)
            sheet.paste(Image.fromarray(paint(world)), (left, top))
            draw.text((left + size / 2, top + size + label / 2), name, fill=INK, font=font, anchor="mm")
            bar.advance()
    return sheet


def episode_video(
    puzzle: Puzzle,
    actions: Sequence[int],
    out: Path,
    *,
    name: str = "",
    look: Look = "handsome",
    size: int = 512,
    fps: int = 30,
    frames_per_step: int = 5,
    options: WorldOptions | None = None,
) -> Path:
    """Film an episode as MP4 (H.264) or GIF, with a caption of step, action, reward and return.

    The film has `frames_per_step` frames per step of 0.04 s, so that motion is smooth. It ends when the episode ends or
    after the last action.

    Args:
        puzzle: the puzzle.
        actions: actions, 0 to 8.
        out: the `.mp4` or `.gif` file, written completely or not at all.
        name: name of the puzzle in the caption; its task if empty.
        look: the look.
        size: width of the film in pixels; the caption is below a square image.
        fps: frames per second; a GIF shows at most 50.
        frames_per_step: frames per step; must divide the number of substeps.
        options: options of the world; None for version 1.

    Raises:
        UsageError: if the suffix is another one, a number is out of bounds, or `frames_per_step` does not divide the
            number of substeps.
        OpenGLError: if the look needs OpenGL and OpenGL is missing.
    """
    check_suffix(out, FILMS)
    _check_range("size", size, 32, 2048)
    _check_range("fps", fps, 1, 120)
    world = World(options)
    if frames_per_step < 1 or world.options.substeps % frames_per_step:
        raise UsageError(f"frames_per_step: {frames_per_step} does not divide the {world.options.substeps} substeps")
    title, held = name or puzzle.task, round(_HELD_S * fps)
    with painter(world, look, size) as paint, progress.bar("film", len(actions)) as bar:

        def frames() -> Iterator[np.ndarray]:
            frame = np.zeros(0)
            for i, (shown, filmed) in enumerate(played_steps(world, puzzle, actions, frames_per_step)):
                frame = _captioned(paint(shown), title, filmed)
                yield from [frame] * (held if i == 0 else 1)
                bar.advance(i > 0 and i % frames_per_step == 0)
            yield from [frame] * held

        return write_film(out, frames(), fps)


def random_actions(puzzle: Puzzle, rng: np.random.Generator, steps: int | None = None) -> list[int]:
    """Uniformly random actions, as the random agent draws them; if `steps` is None, as many as the task's budget.

    Raises:
        PuzzleError: if `steps` is None and the task has no budget.
    """
    return rng.integers(c.N_ACTIONS, size=steps if steps is not None else step_budget(puzzle.task)).tolist()


def scored_actions(scores: Path, puzzle_id: str) -> list[int]:
    """The actions of a `scores` artefact on a puzzle.

    Raises:
        ArtefactError: if it is damaged, of another kind, or has no episode of the puzzle.
    """
    return scored_row(scores, puzzle_id)["actions"]


def pose(world: World, state: np.ndarray, touched: Iterable[str] = ()) -> None:
    """Set a loaded world to a recorded state, for drawing only; the world must not be stepped afterwards.

    Args:
        world: the world.
        state: state of the objects of its inventory, (objects, 13): position (m), quaternion, velocities.
        touched: names of the goals that were already touched.
    """
    world.data.qpos[:] = state[:, :7].ravel()
    world.stepper.hit[:] = np.isin(world.inventory, list(touched))


def played_steps(
    world: World, puzzle: Puzzle, actions: Iterable[int], frames_per_step: int
) -> Iterator[tuple[World, FilmedStep]]:
    """Yield the world to draw at the beginning and `frames_per_step` times per step, until the episode ends.

    The world itself takes complete steps. A second world shows the states between two steps.
    """
    double, length = World(world.options), world.options.substeps // frames_per_step
    for each in (world, double):
        each.load(puzzle, recolour_hits=rewarded(puzzle.task))
    hits, total = 0, 0.0
    yield world, FilmedStep(0, 0, 0.0, 0.0)
    for step, action in enumerate(actions, 1):
        double.restore_state(world.save_state())
        outcome = world.step(action)
        verdict = judge(puzzle.task, puzzle, hits, outcome)
        double.data.qvel[:2] += c.MOVE_SPEED * np.array(c.MOVES[action])
        for _ in range(frames_per_step - 1):
            double.advance(length if action else 0)
            yield double, FilmedStep(step, action, 0.0, total)
        hits, total = hits + len(outcome.hits), total + verdict.reward
        yield world, FilmedStep(step, action, verdict.reward, total)
        if verdict.terminated:
            return


def _captioned(image: np.ndarray, title: str, filmed: FilmedStep) -> np.ndarray:
    """The image above two lines of text, with an even width and height, as H.264 needs them."""
    height, width = image.shape[:2]
    font = typeface(max(9, width // 26))
    line = round(1.5 * font.size)
    frame = Image.new("RGB", (width, height + 2 * line + line // 3), PAPER)
    frame.paste(Image.fromarray(image))
    draw, margin = ImageDraw.Draw(frame), line // 2
    first, second = height + 0.65 * line, height + 1.65 * line
    draw.text((margin, first), f"{title}   step {filmed.step}", fill=INK, font=font, anchor="lm")
    if filmed.step:
        rewards = f"reward {filmed.reward:g}   return {filmed.total:g}"
        draw.text((margin, second), DIRECTIONS[filmed.action], fill=INK, font=font, anchor="lm")
        draw.text((width - margin, second), rewards, fill=FAINT, font=font, anchor="rm")
    return even(frame)


def shown_look(look: Look) -> Look:
    """The look that this machine can draw: without OpenGL it is the observation's, and a message says so."""
    if look == "handsome" and find_backend() is None:
        progress.console.print(f"no OpenGL here: drawn as an agent sees it; {INSTALL}", highlight=False, markup=False)
        return "observation"
    return look


@contextmanager
def painter(world: World, look: Look, size: int) -> Iterator[Painter]:
    """Provide a function that draws a world in this look, (size, size, 3) uint8."""
    if look == "observation":
        yield lambda world: enlarged(world.observe(), size)
        return
    from gym_open.envs.look.renderer import Renderer

    with Renderer(world.options, (size, size)) as renderer:
        yield renderer.render


def _check_range(name: str, value: int, low: int, high: int) -> None:
    if not low <= value <= high:
        raise UsageError(f"{name}: expected {low} to {high}, got {value}")
