"""An analytic ray caster for spheres and boxes: the observation, without OpenGL.

Colour, depth and segmentation come out together. Light is Lambert's, from one directional and one even light, as
`mujoco.Renderer` shades the same scene without specular reflection and shadow: the parity test holds it to that.
Numba does not notice changed constants of other modules in its cache, so everything comes in as an argument.
"""

from typing import NamedTuple

import numpy as np

from gym_open.envs import constants as c
from gym_open.envs.jit import compiled


class Camera(NamedTuple):
    """A pinhole camera and the light that it sees by."""

    position: np.ndarray
    """(3,) metres."""
    axes: np.ndarray
    """(3, 3): right, up and forward."""
    rays: np.ndarray
    """(height, width, 3): through each pixel's centre, of length 1 along forward."""
    slope: float
    """Tangent of half the field of view."""
    light: np.ndarray
    """(5,): unit vector towards the light, its strength, strength of the even light."""


class Shapes(NamedTuple):
    """Bodies to cast, one a row."""

    position: np.ndarray
    """(n, 3) metres."""
    rotation: np.ndarray
    """(n, 3, 3): columns are the body's axes."""
    size: np.ndarray
    """(n, 3): half edges; a sphere's radius three times."""
    sphere: np.ndarray
    """(n,) bool."""
    colour: np.ndarray
    """(n, 3): 0–255."""
    label: np.ndarray
    """(n,) int32: what segmentation shows."""


class Picture(NamedTuple):
    """What the camera sees."""

    rgb: np.ndarray
    """(height, width, 3) uint8."""
    depth: np.ndarray
    """(height, width) metres along forward; infinite where there is nothing."""
    label: np.ndarray
    """(height, width) int32; −1 where there is nothing."""


def observation_camera() -> Camera:
    """The original's camera."""
    axes = c.camera_axes()
    slope = float(np.tan(np.deg2rad(c.FIELD_OF_VIEW) / 2))
    grid = ((np.arange(c.IMAGE_SIZE) + 0.5) / c.IMAGE_SIZE * 2 - 1) * slope
    rays = grid[None, :, None] * axes[0] - grid[:, None, None] * axes[1] + axes[2]
    light = -np.array(c.LIGHT_DIRECTION) / np.linalg.norm(c.LIGHT_DIRECTION)
    return Camera(np.array(c.CAMERA_POSITION), axes, rays, slope, np.array([*light, c.LIGHT_DIFFUSE, c.LIGHT_AMBIENT]))


def empty_picture() -> Picture:
    """A black picture of nothing."""
    size = (c.IMAGE_SIZE, c.IMAGE_SIZE)
    return Picture(np.zeros((*size, 3), np.uint8), np.full(size, np.inf), np.full(size, -1, np.int32))


@compiled
def rotations(quaternion: np.ndarray, out: np.ndarray) -> None:
    """Rotation matrices (n, 3, 3) of unit quaternions (n, 4), scalar first."""
    for i in range(quaternion.shape[0]):
        w, x, y, z = quaternion[i]
        out[i, 0, 0], out[i, 0, 1], out[i, 0, 2] = 1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)
        out[i, 1, 0], out[i, 1, 1], out[i, 1, 2] = 2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)
        out[i, 2, 0], out[i, 2, 1], out[i, 2, 2] = 2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)


@compiled
def _span(across: float, ahead: float, reach: float, slope: float, pixels: int) -> tuple[int, int]:
    """First and past-last pixel of one image axis that a ball of radius `reach` can touch."""
    near, far = ahead - reach, ahead + reach
    if near <= 0:
        return 0, pixels
    low, high = across - reach, across + reach
    low = low / near if low < 0 else low / far
    high = high / near if high > 0 else high / far
    first = int(np.floor((low / slope + 1) / 2 * pixels))
    last = int(np.ceil((high / slope + 1) / 2 * pixels))
    return max(first, 0), min(last, pixels)


@compiled
def _hit_sphere(ray: np.ndarray, offset: np.ndarray, radius: float, normal: np.ndarray) -> float:
    """Where the ray from the origin enters the ball at `offset` (infinite if it does not); sets the normal there."""
    a = ray[0] * ray[0] + ray[1] * ray[1] + ray[2] * ray[2]
    b = ray[0] * offset[0] + ray[1] * offset[1] + ray[2] * offset[2]
    q = offset[0] * offset[0] + offset[1] * offset[1] + offset[2] * offset[2] - radius * radius
    under = b * b - a * q
    if under <= 0:
        return np.inf
    t = (b - np.sqrt(under)) / a
    for k in range(3):
        normal[k] = (t * ray[k] - offset[k]) / radius
    return t


@compiled
def _hit_box(ray: np.ndarray, offset: np.ndarray, turn: np.ndarray, half: np.ndarray, normal: np.ndarray) -> float:
    """Where the ray from the origin enters the box at `offset` (infinite if it does not); sets the normal there."""
    enter, leave = 0.0, np.inf
    face, sign = -1, 0.0
    for k in range(3):
        along = turn[0, k] * ray[0] + turn[1, k] * ray[1] + turn[2, k] * ray[2]
        start = turn[0, k] * offset[0] + turn[1, k] * offset[1] + turn[2, k] * offset[2]
        if along == 0.0:
            if abs(start) > half[k]:
                return np.inf
            continue
        near, far = (start - half[k]) / along, (start + half[k]) / along
        if near > far:
            near, far = far, near
        if near > enter:
            enter, face, sign = near, k, -1.0 if along > 0 else 1.0
        leave = min(leave, far)
    if face < 0 or enter > leave:
        return np.inf
    for k in range(3):
        normal[k] = sign * turn[k, face]
    return enter


@compiled
def paint(shapes: Shapes, count: int, camera: Camera, picture: Picture) -> None:
    """Cast the first `count` shapes into the picture, each only inside its screen rectangle."""
    height, width = picture.depth.shape
    normal, offset, place = np.empty(3), np.empty(3), np.empty(3)
    for i in range(count):
        half, turn, sphere = shapes.size[i], shapes.rotation[i], shapes.sphere[i]
        offset[:] = shapes.position[i] - camera.position
        reach = half[0] if sphere else np.sqrt(half[0] * half[0] + half[1] * half[1] + half[2] * half[2])
        for k in range(3):
            axis = camera.axes[k]
            place[k] = axis[0] * offset[0] + axis[1] * offset[1] + axis[2] * offset[2]
        left, right = _span(place[0], place[2], reach, camera.slope, width)
        top, bottom = _span(-place[1], place[2], reach, camera.slope, height)
        for row in range(top, bottom):
            for column in range(left, right):
                ray = camera.rays[row, column]
                t = _hit_sphere(ray, offset, reach, normal) if sphere else _hit_box(ray, offset, turn, half, normal)
                if t >= picture.depth[row, column]:
                    continue
                facing = normal[0] * camera.light[0] + normal[1] * camera.light[1] + normal[2] * camera.light[2]
                bright = camera.light[4] + camera.light[3] * max(facing, 0.0)
                picture.depth[row, column] = t
                picture.label[row, column] = shapes.label[i]
                for k in range(3):
                    picture.rgb[row, column, k] = np.uint8(min(shapes.colour[i, k] * bright, 255.0) + 0.5)
