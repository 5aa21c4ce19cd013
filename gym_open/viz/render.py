"""Contact sheets of puzzles and videos of episodes, in either look; each file appears whole or not at all."""

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
"""`handsome` needs OpenGL; `observation` is what an agent sees, its pixels enlarged."""
Painter = Callable[[World], np.ndarray]

DIRECTIONS = (
    "• no move", "→ east", "↗ north-east", "↑ north", "↖ north-west",
    "← west", "↙ south-west", "↓ south", "↘ south-east",
)  # fmt: skip
"""What each action is called in a caption; north is away from the camera."""


class Moment(NamedTuple):
    """What a caption says."""

    step: int
    """0 before the first."""
    action: int
    reward: float
    total: float
    """Rewards so far."""


_HELD_S = 0.8
"""Seconds for which a video holds its first and last picture."""


def contact_sheet(
    puzzles: Mapping[str, Puzzle],
    out: Path,
    *,
    look: Look = "handsome",
    size: int = 192,
    columns: int = 10,
    options: WorldOptions | None = None,
) -> Path:
    """Draw puzzles as they begin, side by side, each over its name, as a PNG.

    Args:
        puzzles: by name, in the order of the sheet.
        out: the picture's file.
        look: which look.
        size: edge of one picture in pixels.
        columns: pictures in a row.
        options: of the world; None for v1.

    Raises:
        UsageError: if there is no puzzle, `out` is no PNG, or the size is out of bounds.
        OpenGLError: if the look needs OpenGL and there is none.
    """
    check_suffix(out, (".png",))
    sheet = draw_sheet(puzzles, look=look, size=size, columns=columns, options=options)
    return write_whole(out, lambda beside: sheet.save(beside, format="PNG"))


def draw_sheet(
    puzzles: Mapping[str, Puzzle], *, look: Look, size: int, columns: int, options: WorldOptions | None = None
) -> Image.Image:
    """The picture that `contact_sheet` writes.

    Raises:
        UsageError: if there is no puzzle, or the size is out of bounds.
        OpenGLError: if the look needs OpenGL and there is none.
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
    """Play the actions and film it, as MP4 (H.264) or GIF by the suffix; under it step, action, reward and return.

    Things are filmed between steps as well, `frames_per_step` times a step of 0.04 s, so that they are seen to move.
    The film ends with the episode, or with the actions.

    Args:
        puzzle: where.
        actions: 0–8 each.
        out: the film's file.
        name: what the caption calls the puzzle; its task if empty.
        look: which look.
        size: width of the film in pixels; the caption comes below a square picture.
        fps: pictures a second; a GIF can show at most 50.
        frames_per_step: pictures a step, which must divide the substeps of a step.
        options: of the world; None for v1.

    Raises:
        UsageError: if the suffix is another one, a number is out of bounds, or `frames_per_step` does not divide the
            substeps.
        OpenGLError: if the look needs OpenGL and there is none.
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
            for i, (shown, moment) in enumerate(moments(world, puzzle, actions, frames_per_step)):
                frame = _captioned(paint(shown), title, moment)
                yield from [frame] * (held if i == 0 else 1)
                bar.advance(i > 0 and i % frames_per_step == 0)
            yield from [frame] * held

        return write_film(out, frames(), fps)


def random_actions(puzzle: Puzzle, rng: np.random.Generator, steps: int | None = None) -> list[int]:
    """Uniformly random actions, as the random agent draws them; as many as the task's budget if `steps` is None.

    Raises:
        PuzzleError: if `steps` is None and the task has no budget.
    """
    return rng.integers(c.N_ACTIONS, size=steps if steps is not None else step_budget(puzzle.task)).tolist()


def scored_actions(scores: Path, puzzle_id: str) -> list[int]:
    """What was played on a puzzle in a `scores` artefact.

    Raises:
        ArtefactError: if it is damaged, no `scores`, or does not hold the puzzle.
    """
    return scored_row(scores, puzzle_id)["actions"]


def pose(world: World, state: np.ndarray, touched: Iterable[str] = ()) -> None:
    """Show a loaded world as it was recorded, which nothing is simulated of.

    Args:
        world: that is only drawn from then on.
        state: (objects, 13) of its inventory: position (m), quaternion, velocities.
        touched: goals that were hit by then.
    """
    world.data.qpos[:] = state[:, :7].ravel()
    world.stepper.hit[:] = np.isin(world.inventory, list(touched))


def moments(
    world: World, puzzle: Puzzle, actions: Iterable[int], frames_per_step: int
) -> Iterator[tuple[World, Moment]]:
    """What is seen at the beginning and `frames_per_step` times a step, until the episode ends.

    The world takes whole steps; a double of it is stopped on the way to be seen.
    """
    double, length = World(world.options), world.options.substeps // frames_per_step
    for each in (world, double):
        each.load(puzzle, recolour_hits=rewarded(puzzle.task))
    hits, total = 0, 0.0
    yield world, Moment(0, 0, 0.0, 0.0)
    for step, action in enumerate(actions, 1):
        double.restore_state(world.save_state())
        outcome = world.step(action)
        verdict = judge(puzzle.task, puzzle, hits, outcome)
        double.data.qvel[:2] += c.MOVE_SPEED * np.array(c.MOVES[action])
        for _ in range(frames_per_step - 1):
            double.advance(length if action else 0)
            yield double, Moment(step, action, 0.0, total)
        hits, total = hits + len(outcome.hits), total + verdict.reward
        yield world, Moment(step, action, verdict.reward, total)
        if verdict.terminated:
            return


def _captioned(picture: np.ndarray, title: str, moment: Moment) -> np.ndarray:
    """The picture over two lines of text; both edges even, as H.264 wants them."""
    height, width = picture.shape[:2]
    font = typeface(max(9, width // 26))
    line = round(1.5 * font.size)
    frame = Image.new("RGB", (width, height + 2 * line + line // 3), PAPER)
    frame.paste(Image.fromarray(picture))
    draw, margin = ImageDraw.Draw(frame), line // 2
    first, second = height + 0.65 * line, height + 1.65 * line
    draw.text((margin, first), f"{title}   step {moment.step}", fill=INK, font=font, anchor="lm")
    if moment.step:
        paid = f"reward {moment.reward:g}   return {moment.total:g}"
        draw.text((margin, second), DIRECTIONS[moment.action], fill=INK, font=font, anchor="lm")
        draw.text((width - margin, second), paid, fill=FAINT, font=font, anchor="rm")
    return even(frame)


def shown_look(look: Look) -> Look:
    """The look that can be drawn here: without OpenGL the observation's, which is told."""
    if look == "handsome" and find_backend() is None:
        progress.console.print(f"no OpenGL here: drawn as an agent sees it; {INSTALL}", highlight=False, markup=False)
        return "observation"
    return look


@contextmanager
def painter(world: World, look: Look, size: int) -> Iterator[Painter]:
    """What draws the world in this look, (size, size, 3) uint8."""
    if look == "observation":
        yield lambda world: enlarged(world.observe(), size)
        return
    from gym_open.envs.look.renderer import Renderer

    with Renderer(world.options, (size, size)) as renderer:
        yield renderer.render


def _check_range(name: str, value: int, low: int, high: int) -> None:
    if not low <= value <= high:
        raise UsageError(f"{name}: expected {low} to {high}, got {value}")
