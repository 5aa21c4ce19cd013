"""Sizes, masses and colours of the world, in metres, kilograms and seconds.

Frame: x to the right, y away from the camera, z up, table top at z = 0. Figures are the original's (its x, z, y − 0.83)
unless a comment says otherwise.
"""

import math
from typing import Final

import numpy as np

# Time and action
TIMESTEP_S: Final = 0.004
SUBSTEPS: Final = 10
CONTROL_DT_S: Final = TIMESTEP_S * SUBSTEPS
"""Seconds that one agent step takes (a no-op takes none)."""
N_ACTIONS: Final = 9
MOVE_SPEED: Final = 25.0 / 7.0
"""Velocity change in m/s of one move on each axis that it uses: an impulse of 25 N s on 7 kg."""
MOVES: Final = ((0, 0), (1, 0), (1, 1), (0, 1), (-1, 1), (-1, 0), (-1, -1), (0, -1), (1, -1))
"""Direction (x, y) of each action; action 0 is the no-op."""

# Image
IMAGE_SIZE: Final = 84

# Table
TABLE_HEIGHT: Final = 0.83
"""Height of the table top over the floor (which is only seen)."""
WALL_X: Final = 0.641
WALL_Y: Final = 1.1218
"""Inner faces of the table's walls, at ± these."""
WALL_HEIGHT: Final = 0.1
WALL_THICKNESS: Final = 0.01
CORNER: Final = (0.589, 1.0725)
"""Middle (x, y) of the 45° corner pieces, in each quadrant."""
LID_HEIGHT: Final = 0.18
"""Cubes and goals, but not the agent, are kept under an unseen lid; a cube standing on its corner is 0.173 high."""

# Placement grid: row i goes towards −y, column j towards +x
ROWS: Final = 16
COLUMNS: Final = 9
PITCH: Final = 0.141
CELL_0: Final = (-0.581, 1.0559)
"""Centre (x, y) of cell (0, 0)."""

# Objects
RADIUS: Final = 0.05
"""Radius of spheres and of a cone's base, half edge of cubes, half height of everything."""
RECTANGLE_LENGTH: Final = 0.3
"""Long edge of a rectangle: a box that lies on a cell and the two beside it."""
MASS: Final = {
    "agent": 7.0,
    "yellow": 10.0,
    "green": 10.0,
    "heavy": 100.0,
    "light": 5.0,
    "push": 5.0,
    "rectangle": 15.0,
    "cone": 5.0,
}
"""The original names no mass for push sphere, rectangle and cone: ours."""
COLOUR: Final = {
    "agent": (214, 52, 71),
    "yellow": (247, 183, 29),
    "green": (118, 162, 30),
    "heavy": (15, 76, 126),
    "light": (134, 42, 92),
    "push": (245, 245, 245),
    "rectangle": (91, 140, 133),
    "cone": (180, 0, 255),
}
"""Colours of push sphere and cone are ours: furthest from all others, also as colour-blind people see them."""
HIT_COLOUR: Final = {"yellow": (0, 189, 170), "green": (83, 90, 59)}
"""Colour of a goal that was touched, where rewards are on."""
CAPACITY: Final = {
    "agent": 1,
    "yellow": 3,
    "green": 3,
    "heavy": 12,
    "light": 8,
    "push": 2,
    "rectangle": 2,
    "cone": 2,
}
"""How many bodies of each kind the fixed model holds; a puzzle uses some, the others are parked."""

FRICTION: Final = 0.35
"""Of anything but the agent with the table: the original's 0.1, averaged by Unity with the table's default of 0.6."""
BOUNCINESS: Final = 0.6
"""Two objects keep the mean of theirs of their closing speed; the walls' own is 0, so that a wall leaves half of it."""

# Pen, ramp and danger patch, around a centre cell
PEN_HALF: Final = 2 * PITCH
"""Distance of the pen's wall centre lines from its centre: it holds 3×3 cells, 5×5 with the walls."""
PEN_WALL_THICKNESS: Final = 0.024
RAMP_HEIGHT: Final = 0.11
RAMP_WIDTH: Final = 0.14
RAMP_FOOT: Final = -0.5 * PITCH
"""Where the ramp begins, from the pen's centre towards the ramp's side; it ends at the wall: two cells in all."""
RAMP_PLATFORM: Final = 0.09
"""Length of the level piece at the ramp's high end."""
PATCH_HALF: Final = 1.5 * PITCH
"""Half edge of the danger patch as it is seen."""
DANGER_HALF: Final = 0.1601
"""The agent is in danger when its centre is within ± this of the patch's centre on both axes."""

SCENERY_COLOUR: Final = {
    "table": (44, 104, 74),
    "wall": (70, 65, 89),
    "floor": (140, 120, 92),
    "pen": (70, 65, 89),
    "ramp": (98, 55, 78),
    "patch": (232, 113, 20),
}
"""The original names neither the table's green, nor the floor's burlap, nor the patch's orange in figures: ours."""

# Camera: the original's position and Unity Euler angles in degrees (pitch down, yaw to the right, roll)
CAMERA_POSITION: Final = (-0.538, -1.767, 2.072 - TABLE_HEIGHT)
CAMERA_EULER: Final = (43.376, 25.489, 1.481)
FIELD_OF_VIEW: Final = 60.0

# Light: one directional light and an even one; no specular reflection, no shadow
LIGHT_ANGLE_DEG: Final = 232.0
"""Azimuth that it comes from, counter-clockwise from +x: from behind the camera, to the left."""
LIGHT_ELEVATION_DEG: Final = 55.0
LIGHT_DIFFUSE: Final = 0.55
LIGHT_AMBIENT: Final = 0.5


def cell_centre(row: int, column: int) -> tuple[float, float]:
    """Position (x, y) in metres of the centre of a grid cell."""
    return CELL_0[0] + column * PITCH, CELL_0[1] - row * PITCH


def light_direction(angle_deg: float, elevation_deg: float) -> tuple[float, float, float]:
    """Unit vector in which light travels that comes from this azimuth and height above the horizon."""
    angle, elevation = math.radians(angle_deg), math.radians(elevation_deg)
    level = math.cos(elevation)
    return -level * math.cos(angle), -level * math.sin(angle), -math.sin(elevation)


LIGHT_DIRECTION: Final = light_direction(LIGHT_ANGLE_DEG, LIGHT_ELEVATION_DEG)


def camera_axes(direction: tuple[float, float, float] = CAMERA_EULER) -> np.ndarray:
    """Camera frame (3, 3): rows are its right, up and forward unit vectors in our frame.

    `direction` is pitch down, yaw to the right and roll in degrees.
    Unity turns about z, then x, then y in a left-handed frame; swapping its y and z gives our right-handed one.
    """
    pitch, yaw, roll = (math.radians(angle) for angle in direction)
    cp, sp, cy, sy = math.cos(pitch), math.sin(pitch), math.cos(yaw), math.sin(yaw)
    cr, sr = math.cos(roll), math.sin(roll)
    # The product about y · about x · about z, written out: BLAS rounds differently on different processors.
    right = cy * cr + sy * sp * sr, cy * sp * sr - sy * cr, cp * sr
    up = sy * sp * cr - cy * sr, sy * sr + cy * sp * cr, cp * cr
    forward = sy * cp, cy * cp, -sp
    return np.array([right, up, forward])
