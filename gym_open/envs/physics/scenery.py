"""The model without its movable objects: table, walls, and the pieces that a puzzle moves into place."""

import math

import numpy as np

from gym_open.envs import constants as c
from gym_open.envs.physics.mjcf import box, indented, text
from gym_open.envs.puzzles import Side

PARKING_Y = -30.0
"""Parked objects have smaller y than this, far behind the camera and away from the table."""

PIECES = ("pen", "ramp", "patch", "lid")
"""Mocap bodies, in this order."""

NO_BOUNCE = "0.01 1"
"""`solref` of a contact that removes all closing speed; see `model`."""

UNTURNED = (1.0, 0.0, 0.0, 0.0)
RAMP_TURNS: dict[Side, tuple[float, float, float, float]] = {
    "north": (0.7071067811865476, 0.0, 0.0, 0.7071067811865475),
    "east": UNTURNED,
    "south": (0.7071067811865476, 0.0, 0.0, -0.7071067811865475),
    "west": (6.123233995736766e-17, 0.0, 0.0, 1.0),
}
"""Quaternion of a ramp that leads to each side, with all digits, because poses do not pass through MJCF text."""

BOUNCING = (
    *("wall_east", "wall_west", "wall_north", "wall_south"),
    *("corner_north_east", "corner_north_west", "corner_south_east", "corner_south_west"),
    *("pen_east", "pen_west", "pen_north", "pen_south"),
)
"""Geoms from which objects bounce."""

_CORNERS = (("north_east", 1, 1), ("north_west", -1, 1), ("south_east", 1, -1), ("south_west", -1, -1))
_THICK = 0.5
"""Half thickness of invisible walls and lid."""


def table() -> list[str]:
    """The ground under all objects, and the visible table, walls and floor."""
    high, thin = c.WALL_HEIGHT / 2, c.WALL_THICKNESS / 2
    x, y = c.WALL_X + thin, c.WALL_Y + thin
    edge_x, edge_y = c.WALL_X + c.WALL_THICKNESS, c.WALL_Y + c.WALL_THICKNESS
    lines = [
        # An infinite plane supports all objects; a plate is visible instead.
        f'<geom name="ground" type="plane" size="0 0 1" class="scenery" group="4" solref="{NO_BOUNCE}"/>',
        box("floor", (0, 0, -c.TABLE_HEIGHT - 0.05), (15, 15, 0.05), "floor", kind="seen"),
        box("table", (0, 0, -0.02), (edge_x, edge_y, 0.02), "table", kind="seen"),
    ]
    for name, place, size in (
        ("east", (x, 0, high), (thin, edge_y, high)),
        ("west", (-x, 0, high), (thin, edge_y, high)),
        ("north", (0, y, high), (c.WALL_X, thin, high)),
        ("south", (0, -y, high), (c.WALL_X, thin, high)),
    ):
        lines.append(box(f"seen_wall_{name}", place, size, "wall", kind="seen"))
    for name, sx, sy in _CORNERS:
        place = sx * (c.CORNER[0] + thin / np.sqrt(2)), sy * (c.CORNER[1] + thin / np.sqrt(2)), high
        size = _corner_half_length(), thin, high
        lines.append(box(f"seen_corner_{name}", place, size, "wall", kind="seen", euler=(0, 0, -sx * sy * np.pi / 4)))
    return lines


def keep_in() -> list[str]:
    """The invisible walls that collide: thick, too high to cross, and flush with the visible walls."""
    high, thick = 1.0, _THICK
    x, y = c.WALL_X + thick, c.WALL_Y + thick
    lines = [
        box("wall_east", (x, 0, high), (thick, y + thick, high), "wall", kind="unseen"),
        box("wall_west", (-x, 0, high), (thick, y + thick, high), "wall", kind="unseen"),
        box("wall_north", (0, y, high), (c.WALL_X, thick, high), "wall", kind="unseen"),
        box("wall_south", (0, -y, high), (c.WALL_X, thick, high), "wall", kind="unseen"),
    ]
    for name, sx, sy in _CORNERS:
        place = sx * (c.CORNER[0] + thick / np.sqrt(2)), sy * (c.CORNER[1] + thick / np.sqrt(2)), high
        size = _corner_half_length() + thick, thick, high
        lines.append(box(f"corner_{name}", place, size, "wall", kind="unseen", euler=(0, 0, -sx * sy * np.pi / 4)))
    return lines


def _corner_half_length() -> float:
    """Half length of a corner piece with an inner face that passes through `CORNER` and ends at both walls."""
    return float(np.sqrt(2) * max(c.WALL_X - c.CORNER[0], c.WALL_Y - c.CORNER[1]))


def pieces(lid_height: float) -> list[str]:
    """Pen, ramp, patch and lid, each as one mocap body around its centre. The ramp rises towards +x.

    The lid prevents objects, except the agent, from lying on one another. A puzzle with a stack lifts the lid.
    """
    half, thin, high = c.PEN_HALF, c.PEN_WALL_THICKNESS / 2, c.WALL_HEIGHT / 2
    pen = [
        box("pen_east", (half, 0, high), (thin, half + thin, high), "pen"),
        box("pen_west", (-half, 0, high), (thin, half + thin, high), "pen"),
        box("pen_north", (0, half, high), (half - thin, thin, high), "pen"),
        box("pen_south", (0, -half, high), (half - thin, thin, high), "pen"),
    ]
    end = half - thin
    top = end - c.RAMP_PLATFORM
    run = top - c.RAMP_FOOT
    slope = math.atan2(c.RAMP_HEIGHT, run)
    long, thick = math.hypot(run, c.RAMP_HEIGHT) / 2, 0.01
    middle = (c.RAMP_FOOT + top) / 2 + thick * math.sin(slope), 0, c.RAMP_HEIGHT / 2 - thick * math.cos(slope)
    ramp = [
        box("ramp_slope", middle, (long, c.RAMP_WIDTH / 2, thick), "ramp", euler=(0, -slope, 0), solref=NO_BOUNCE),
        box(
            "ramp_platform",
            ((top + end) / 2, 0, c.RAMP_HEIGHT / 2),
            (c.RAMP_PLATFORM / 2, c.RAMP_WIDTH / 2, c.RAMP_HEIGHT / 2),
            "ramp",
            solref=NO_BOUNCE,
        ),
    ]
    patch = [box("patch", (0, 0, 0.001), (c.PATCH_HALF, c.PATCH_HALF, 0.001), "patch", kind="seen")]
    lid = [box("lid", (0, 0, lid_height + _THICK), (c.WALL_X, c.WALL_Y, _THICK), "wall", kind="lid")]
    return [
        line
        for name, geoms in zip(PIECES, (pen, ramp, patch, lid), strict=True)
        for line in (
            f'<body name="{name}" mocap="true" pos="{text(piece_at_rest(name))}">',
            *indented(geoms),
            "</body>",
        )
    ]


def piece_at_rest(name: str) -> tuple[float, float, float]:
    """Position of a piece that the puzzle does not use; the lid is always over the table."""
    return (0.0, 0.0, 0.0) if name == "lid" else (2.0 * PIECES.index(name), PARKING_Y - 5.0, 0.0)
