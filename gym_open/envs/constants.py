"""Sizes, masses and colours of the world, in metres, kilograms and seconds.

Frame: x to the right, y away from the camera, z up, table top at z = 0. The values are those of the original OPEn (its
x, z, y − 0.83) unless a comment says otherwise.
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
"""Velocity change in m/s of one move, on each axis of its direction: an impulse of 25 N s on 7 kg."""
MOVES: Final = ((0, 0), (1, 0), (1, 1), (0, 1), (-1, 1), (-1, 0), (-1, -1), (0, -1), (1, -1))
"""Direction (x, y) of each action; action 0 is the no-op."""

# Image
IMAGE_SIZE: Final = 84

# Table
TABLE_HEIGHT: Final = 0.83
"""Height of the table top above the floor. The floor is only visible; nothing touches it."""
WALL_X: Final = 0.641
WALL_Y: Final = 1.1218
"""Inner faces of the table's walls, at ± these values."""
WALL_HEIGHT: Final = 0.1
WALL_THICKNESS: Final = 0.01
CORNER: Final = (0.589, 1.0725)
"""Middle (x, y) of the 45° corner pieces, in each quadrant."""
LID_HEIGHT: Final = 0.18
"""Height of an invisible lid over all objects except the agent; a cube that stands on its corner is 0.173 high."""

# Placement grid: rows count towards −y, columns towards +x
ROWS: Final = 16
COLUMNS: Final = 9
PITCH: Final = 0.141
CELL_0: Final = (-0.581, 1.0559)
"""Centre (x, y) of cell (0, 0)."""

# Objects
RADIUS: Final = 0.05
"""Radius of spheres and of a cone's base, half edge of cubes, half height of all objects."""
RECTANGLE_LENGTH: Final = 0.3
"""Long edge of a rectangle: a box that covers a cell and both neighbours along its long side."""
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
"""The original gives no mass for push sphere, rectangle and cone; these are our choice."""
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
"""Push sphere and cone have colours of our choice: furthest from all others, also for colour-blind people."""
HIT_COLOUR: Final = {"yellow": (0, 189, 170), "green": (83, 90, 59)}
"""Colour of a goal after the first touch, if rewards are on."""
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
"""Number of bodies of each kind in the fixed model. A puzzle uses some; the others are parked."""

FRICTION: Final = 0.35
"""Between the table and all objects except the agent: Unity's mean of the original's 0.1 and the table's 0.6."""
BOUNCINESS: Final = 0.6
"""Two objects keep the mean of their bouncinesses as share of their closing speed. Walls have 0: a wall leaves half."""

# Pen, ramp and danger patch, around a centre cell
PEN_HALF: Final = 2 * PITCH
"""Distance from the pen's centre to the centre lines of its walls: 3×3 cells inside, 5×5 with the walls."""
PEN_WALL_THICKNESS: Final = 0.024
RAMP_HEIGHT: Final = 0.11
RAMP_WIDTH: Final = 0.14
RAMP_FOOT: Final = -0.5 * PITCH
"""Start of the ramp, from the pen's centre towards the ramp's side. It ends at the wall, two cells further."""
RAMP_PLATFORM: Final = 0.09
"""Length of the level piece at the ramp's high end."""
PATCH_HALF: Final = 1.5 * PITCH
"""Half edge of the visible danger patch."""
DANGER_HALF: Final = 0.1601
"""The agent is in danger while its centre is within ± this distance of the patch's centre on both axes."""

SCENERY_COLOUR: Final = {
    "table": (44, 104, 74),
    "wall": (70, 65, 89),
    "floor": (140, 120, 92),
    "pen": (70, 65, 89),
    "ramp": (98, 55, 78),
    "patch": (232, 113, 20),
}
"""Colours of table, floor and patch are our choice: the original gives no numbers for its green, burlap and orange."""

# Camera: the original's position and Unity Euler angles in degrees (pitch down, yaw to the right, roll)
CAMERA_POSITION: Final = (-0.538, -1.767, 2.072 - TABLE_HEIGHT)
CAMERA_EULER: Final = (43.376, 25.489, 1.481)
FIELD_OF_VIEW: Final = 60.0

# Light: one directional and one ambient light; no specular reflection, no shadow
LIGHT_ANGLE_DEG: Final = 232.0
"""Azimuth of the light's source, counter-clockwise from +x: behind the camera, to the left."""
LIGHT_ELEVATION_DEG: Final = 55.0
LIGHT_DIFFUSE: Final = 0.55
LIGHT_AMBIENT: Final = 0.5


def cell_centre(row: int, column: int) -> tuple[float, float]:
    """Position (x, y) in metres of the centre of a grid cell."""
    return CELL_0[0] + column * PITCH, CELL_0[1] - row * PITCH


def light_direction(angle_deg: float, elevation_deg: float) -> tuple[float, float, float]:
    """Unit vector of the direction of light from this azimuth and height above the horizon."""
    angle, elevation = math.radians(angle_deg), math.radians(elevation_deg)
    level = math.cos(elevation)
    return -level * math.cos(angle), -level * math.sin(angle), -math.sin(elevation)


LIGHT_DIRECTION: Final = light_direction(LIGHT_ANGLE_DEG, LIGHT_ELEVATION_DEG)


def camera_axes(direction: tuple[float, float, float] = CAMERA_EULER) -> np.ndarray:
    """Camera frame (3, 3): the rows are its right, up and forward unit vectors in our frame.

    `direction` is pitch down, yaw to the right, and roll, in degrees. Unity rotates about z, then x, then y in a
    left-handed frame. An exchange of its y and z gives our right-handed frame.
    """
    pitch, yaw, roll = (math.radians(angle) for angle in direction)
    cp, sp, cy, sy = math.cos(pitch), math.sin(pitch), math.cos(yaw), math.sin(yaw)
    cr, sr = math.cos(roll), math.sin(roll)
    # The product of the rotations about y, x and z, written out: BLAS rounds differently on different processors.
    right = cy * cr + sy * sp * sr, cy * sp * sr - sy * cr, cp * sr
    up = sy * sp * cr - cy * sr, sy * sr + cy * sp * cr, cp * cr
    forward = sy * cp, cy * cp, -sp
    return np.array([right, up, forward])
