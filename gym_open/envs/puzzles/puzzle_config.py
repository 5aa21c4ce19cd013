"""The paper's `puzzle_config`: a dictionary of counts and cells that describes a sandbox puzzle."""

from collections.abc import Mapping
from typing import Annotated, Any

import numpy as np
from msgspec import Meta

from gym_open.config import Config, PositiveInt, decode
from gym_open.envs.constants import CAPACITY
from gym_open.envs.puzzles.generators import SandboxConfig, sample_puzzle
from gym_open.envs.puzzles.puzzle import STACK_HEIGHT, Column, Puzzle, PuzzleError, Row

MOST_CUBES = CAPACITY["heavy"] + CAPACITY["light"]
Cells = tuple[tuple[Row, Column], ...]


class PuzzleConfig(Config, frozen=True):
    """All keys of the supplement's `puzzle_config`, with the supplement's names."""

    main_sphere: Annotated[int, Meta(ge=1, le=1)] = 1
    """The agent: a puzzle has exactly one."""
    touch_sphere: Annotated[int, Meta(ge=0, le=CAPACITY["yellow"])] | None = None
    """Yellow goal spheres; None means the number of cells in `touch_sphere_i_j`."""
    high_value_target: Annotated[int, Meta(ge=0, le=CAPACITY["green"])] = 0
    """Green goal spheres."""
    cube: Annotated[int, Meta(ge=0, le=MOST_CUBES)] = 0
    """Cubes, each heavy or light with probability ½, as far as the model has enough of that kind."""
    push_sphere: Annotated[int, Meta(ge=0, le=CAPACITY["push"])] = 0
    """Push spheres."""
    rectangle: Annotated[int, Meta(ge=0, le=CAPACITY["rectangle"])] = 0
    """Rectangles, along either axis."""
    cone: Annotated[int, Meta(ge=0, le=CAPACITY["cone"])] = 0
    """Cones."""
    adversarial_patch: Annotated[int, Meta(ge=0, le=1)] = 0
    """Danger patches of 3×3 cells."""
    stack: Annotated[int, Meta(ge=0, le=CAPACITY["light"] // STACK_HEIGHT)] = 0
    """Stacks of two light cubes."""
    ramp: Annotated[int, Meta(ge=0, le=1)] = 0
    """Ramps, each in a walled pen with the agent inside."""
    main_sphere_i_j: Annotated[Cells, Meta(max_length=1)] = ()
    """The agent's cell (row, column)."""
    touch_sphere_i_j: Annotated[Cells, Meta(max_length=CAPACITY["yellow"])] = ()
    """Cells of yellow spheres; further spheres get random cells."""
    radius: PositiveInt = 3
    """Largest distance in cells from the agent to random goal spheres, which are never in its row or column."""


def from_puzzle_config(puzzle_config: Mapping[str, Any], rng: np.random.Generator) -> Puzzle:
    """Draw a sandbox puzzle as a `puzzle_config` dictionary describes it; never a puzzle of the fixed sets.

    Args:
        puzzle_config: keys and values of `PuzzleConfig`; missing keys have their defaults.
        rng: the only source of randomness.

    Raises:
        ConfigError: if a key is unknown, or a value has the wrong type or is out of bounds; names both.
        PuzzleError: if the values exclude one another.
    """
    config = decode(dict(puzzle_config), PuzzleConfig, source="puzzle_config")
    yellow = len(config.touch_sphere_i_j) if config.touch_sphere is None else config.touch_sphere
    if yellow < len(config.touch_sphere_i_j):
        cells = f"{len(config.touch_sphere_i_j)} cells in touch_sphere_i_j"
        raise PuzzleError(
            f"puzzle_config: touch_sphere is {yellow}, but there are {cells}; give as many or fewer cells"
        )
    _check_goals(config, yellow)
    before = rng.bit_generator.state
    heavy, light = _split(config, rng)
    sandbox = SandboxConfig(
        yellow=(yellow, yellow),
        green=(config.high_value_target, config.high_value_target),
        heavy=(heavy, heavy),
        light=(light, light),
        push=(config.push_sphere, config.push_sphere),
        rectangle=(config.rectangle, config.rectangle),
        cone=(config.cone, config.cone),
        stack=(config.stack, config.stack),
        agent_cell=next(iter(config.main_sphere_i_j), None),
        yellow_cells=config.touch_sphere_i_j,
        radius=config.radius,
        pen_probability=float(config.ramp),
        patch_probability=float(config.adversarial_patch),
    )
    try:
        return sample_puzzle("sandbox", rng, sandbox)
    except PuzzleError as error:
        rng.bit_generator.state = before  # a refused request leaves no trace
        raise PuzzleError(f"puzzle_config {dict(puzzle_config)}: {error}") from None


def _check_goals(config: PuzzleConfig, yellow: int) -> None:
    """Raise PuzzleError if there are more goals than cells within the radius, outside the agent's row and column."""
    drawn, room = yellow - len(config.touch_sphere_i_j) + config.high_value_target, 4 * config.radius**2
    if drawn > room:
        fit = f"at most {room} goal spheres fit around the agent, got {drawn}"
        raise PuzzleError(f"puzzle_config: radius is {config.radius}, so {fit}; use fewer or a larger radius")


def _split(config: PuzzleConfig, rng: np.random.Generator) -> tuple[int, int]:
    """Draw the number of heavy and of light cubes."""
    most_light = CAPACITY["light"] - STACK_HEIGHT * config.stack
    if config.cube > CAPACITY["heavy"] + most_light:
        most = CAPACITY["heavy"] + most_light
        raise PuzzleError(
            f"puzzle_config: cube is {config.cube}, but with {config.stack} stacks at most {most} are left; use fewer"
        )
    heavy = int(rng.binomial(config.cube, 0.5))
    heavy = min(max(heavy, config.cube - most_light), CAPACITY["heavy"])
    return heavy, config.cube - heavy
