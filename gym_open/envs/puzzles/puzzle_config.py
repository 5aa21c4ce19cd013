"""The paper's `puzzle_config`: a sandbox puzzle asked for by a dictionary of counts and cells."""

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
    """Every key of the supplement's `puzzle_config`, under the supplement's names."""

    main_sphere: Annotated[int, Meta(ge=1, le=1)] = 1
    """The agent: a puzzle has exactly one."""
    touch_sphere: Annotated[int, Meta(ge=0, le=CAPACITY["yellow"])] | None = None
    """Yellow goal spheres; without it, as many as `touch_sphere_i_j` has cells."""
    high_value_target: Annotated[int, Meta(ge=0, le=CAPACITY["green"])] = 0
    """Green goal spheres."""
    cube: Annotated[int, Meta(ge=0, le=MOST_CUBES)] = 0
    """Cubes, each heavy or light with probability ½ as far as the model holds enough of that kind."""
    push_sphere: Annotated[int, Meta(ge=0, le=CAPACITY["push"])] = 0
    """Push spheres."""
    rectangle: Annotated[int, Meta(ge=0, le=CAPACITY["rectangle"])] = 0
    """Rectangles, lying along either axis."""
    cone: Annotated[int, Meta(ge=0, le=CAPACITY["cone"])] = 0
    """Cones."""
    adversarial_patch: Annotated[int, Meta(ge=0, le=1)] = 0
    """Danger patches of 3×3 cells."""
    stack: Annotated[int, Meta(ge=0, le=CAPACITY["light"] // STACK_HEIGHT)] = 0
    """Stacks of two light cubes."""
    ramp: Annotated[int, Meta(ge=0, le=1)] = 0
    """Ramps, each with the walled pen around it and the agent inside."""
    main_sphere_i_j: Annotated[Cells, Meta(max_length=1)] = ()
    """The agent's cell (row, column)."""
    touch_sphere_i_j: Annotated[Cells, Meta(max_length=CAPACITY["yellow"])] = ()
    """Cells of yellow spheres; spheres beyond these are placed at random."""
    radius: PositiveInt = 3
    """Goal spheres without a cell of their own lie within this many cells of the agent, off its row and column."""


def from_puzzle_config(puzzle_config: Mapping[str, Any], rng: np.random.Generator) -> Puzzle:
    """Draw the sandbox puzzle that a `puzzle_config` dictionary asks for; never one of the fixed sets.

    Args:
        puzzle_config: keys and values of `PuzzleConfig`; what is left out takes its default.
        rng: the only source of randomness.

    Raises:
        ConfigError: if a key is unknown or a value is of the wrong type or out of bounds, naming both.
        PuzzleError: if the values cannot be had together.
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
        rng.bit_generator.state = before  # what is refused leaves no trace
        raise PuzzleError(f"puzzle_config {dict(puzzle_config)}: {error}") from None


def _check_goals(config: PuzzleConfig, yellow: int) -> None:
    """Refuse more goals than there are cells within the radius off the agent's row and column."""
    drawn, room = yellow - len(config.touch_sphere_i_j) + config.high_value_target, 4 * config.radius**2
    if drawn > room:
        fit = f"at most {room} goal spheres fit around the agent, got {drawn}"
        raise PuzzleError(f"puzzle_config: radius is {config.radius}, so {fit}; ask for fewer or a larger radius")


def _split(config: PuzzleConfig, rng: np.random.Generator) -> tuple[int, int]:
    """How many of the cubes are heavy and how many light."""
    most_light = CAPACITY["light"] - STACK_HEIGHT * config.stack
    if config.cube > CAPACITY["heavy"] + most_light:
        most = CAPACITY["heavy"] + most_light
        raise PuzzleError(
            f"puzzle_config: cube is {config.cube}, but at most {most} are left beside {config.stack} stacks"
        )
    heavy = int(rng.binomial(config.cube, 0.5))
    heavy = min(max(heavy, config.cube - most_light), CAPACITY["heavy"])
    return heavy, config.cube - heavy
