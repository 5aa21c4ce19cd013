"""An analytic ray caster for spheres, boxes and meshes: it draws the observation without OpenGL.

It computes colour, depth, segmentation and normals together. Shading is Lambertian, from one directional and one
ambient light, as in `mujoco.Renderer` without specular reflection and shadow; the parity test checks this.
Numba's cache does not notice changed constants of other modules, so all values are arguments.
"""

import math
from typing import NamedTuple

import numpy as np

from gym_open.envs.jit import compiled

SPHERE, BOX, MESH = 0, 1, 2
"""Values of `Shapes.form`."""


class Camera(NamedTuple):
    """A pinhole camera, and the light of the scene."""

    position: np.ndarray
    """(3,) metres."""
    axes: np.ndarray
    """(3, 3): unit vectors right, up and forward."""
    rays: np.ndarray
    """(height, width, 3): vectors through the pixels' centres, of length 1 along forward."""
    slope: float
    """Tangent of half the field of view."""
    light: np.ndarray
    """(5,): unit vector towards the light, its strength, strength of the ambient light."""


class Shapes(NamedTuple):
    """Shapes to draw, one per row."""

    position: np.ndarray
    """(n, 3) metres."""
    rotation: np.ndarray
    """(n, 3, 3): the columns are the body's axes."""
    size: np.ndarray
    """(n, 3): half edges of a box; or three equal numbers, the radius of a sphere or of a mesh's bounding sphere."""
    form: np.ndarray
    """(n,) int8: `SPHERE`, `BOX` or `MESH`."""
    mesh: np.ndarray
    """(n, 2) int32: indices of a mesh's first triangle, and of the one after its last."""
    colour: np.ndarray
    """(n, 3): 0–255."""
    label: np.ndarray
    """(n,) int32: value in the segmentation."""


class Triangles(NamedTuple):
    """The triangles of all meshes, in their bodies' frames; visible where their corners run counter-clockwise."""

    corner: np.ndarray
    """(T, 3, 3) metres."""
    normal: np.ndarray
    """(T, 3, 3): unit normal at each corner; brightness is interpolated between corners."""
    plane: np.ndarray
    """(T, 4): a point x is in front of the triangle if plane[:3] · x > plane[3]."""


class Image(NamedTuple):
    """The output of the camera."""

    rgb: np.ndarray
    """(height, width, 3) uint8."""
    depth: np.ndarray
    """(height, width): metres along forward; infinite where there is nothing."""
    label: np.ndarray
    """(height, width) int32: label of the visible shape; −1 where there is nothing."""
    normal: np.ndarray
    """(height, width, 3) float32: unit normals of visible surfaces, in the world's frame; 0 where there is nothing."""


def square_camera(
    position: np.ndarray, axes: np.ndarray, field_of_view_deg: float, size: int, light: np.ndarray
) -> Camera:
    """A camera with images of `size` × `size` pixels; the other arguments are as in `Camera`."""
    # NumPy's own tangent rounds differently on processors with AVX-512.
    slope = math.tan(math.radians(field_of_view_deg) / 2)
    grid = ((np.arange(size) + 0.5) / size * 2 - 1) * slope
    rays = grid[None, :, None] * axes[0] - grid[:, None, None] * axes[1] + axes[2]
    return Camera(position, axes, rays, slope, light)


def empty_image(size: int) -> Image:
    """A black image without shapes."""
    return Image(
        np.zeros((size, size, 3), np.uint8),
        np.full((size, size), np.inf),
        np.full((size, size), -1, np.int32),
        np.zeros((size, size, 3), np.float32),
    )


@compiled
def _span(across: float, ahead: float, reach: float, slope: float, pixels: int) -> tuple[int, int]:
    """Range of pixels (first, past-last) on one image axis that a ball of radius `reach` can cover."""
    near, far = ahead - reach, ahead + reach
    if far <= 0:
        return 0, 0
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
    """Ray parameter where the ray from the origin enters the ball at `offset` (infinite: never); sets the normal."""
    a = ray[0] * ray[0] + ray[1] * ray[1] + ray[2] * ray[2]
    b = ray[0] * offset[0] + ray[1] * offset[1] + ray[2] * offset[2]
    q = offset[0] * offset[0] + offset[1] * offset[1] + offset[2] * offset[2] - radius * radius
    under = b * b - a * q
    if under <= 0:
        return np.inf
    t = (b - np.sqrt(under)) / a
    for k in range(3):
        normal[k] = (t * ray[k] - offset[k]) / radius
    return t if t > 0 else np.inf


@compiled
def _hit_box(ray: np.ndarray, offset: np.ndarray, turn: np.ndarray, half: np.ndarray, normal: np.ndarray) -> float:
    """Ray parameter where the ray from the origin enters the box at `offset` (infinite: never); sets the normal."""
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
def _brightness(normal: np.ndarray, light: np.ndarray) -> float:
    facing = normal[0] * light[0] + normal[1] * light[1] + normal[2] * light[2]
    return light[4] + light[3] * max(facing, 0.0)


@compiled
def _set_pixel(  # noqa: PLR0917  # numba takes arrays, not objects
    image: Image, row: int, column: int, shapes: Shapes, i: int, depth: float, bright: float, normal: np.ndarray
) -> None:
    """Draw shape `i` at this pixel, with its colour times `bright`."""
    image.depth[row, column] = depth
    image.label[row, column] = shapes.label[i]
    for k in range(3):
        image.rgb[row, column, k] = np.uint8(min(shapes.colour[i, k] * bright, 255.0) + 0.5)
        image.normal[row, column, k] = normal[k]


@compiled
def _turned(turn: np.ndarray, x: float, y: float, z: float) -> tuple[float, float, float]:
    return (
        turn[0, 0] * x + turn[0, 1] * y + turn[0, 2] * z,
        turn[1, 0] * x + turn[1, 1] * y + turn[1, 2] * z,
        turn[2, 0] * x + turn[2, 1] * y + turn[2, 2] * z,
    )


@compiled
def _corner(view: np.ndarray, place: np.ndarray, corner: np.ndarray, t: int, j: int) -> tuple[float, float, float]:
    """Corner `j` of triangle `t` in the camera's frame."""
    x, y, z = _turned(view, corner[t, j, 0], corner[t, j, 1], corner[t, j, 2])
    return x + place[0], y + place[1], z + place[2]


@compiled
def _cross(a: tuple[float, float, float], b: tuple[float, float, float]) -> tuple[float, float, float]:
    return a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]


@compiled
def _centres_between(a: float, b: float, c: float, slope: float, pixels: int) -> tuple[int, int]:
    """Range of pixels (first, past-last) on one image axis with centres between the extremes of three slopes."""
    low, high = min(a, b, c) / slope, max(a, b, c) / slope
    first = np.ceil((max(low, -1.0) + 1) / 2 * pixels - 0.5)
    last = np.floor((min(high, 1.0) + 1) / 2 * pixels - 0.5)
    return int(first), min(int(last) + 1, pixels)


@compiled
def _paint_triangle(  # noqa: PLR0917  # numba takes arrays, not objects
    shapes: Shapes,
    i: int,
    planes: np.ndarray,
    volume: float,
    normals: np.ndarray,
    window: tuple[int, int, int, int],
    camera: Camera,
    image: Image,
) -> None:
    """Draw a triangle of mesh `i` inside the window (top, bottom, left, right).

    Args:
        shapes: all shapes.
        i: index of the mesh in `shapes`.
        planes: (4, 3): normals of the planes through the camera and each side; the last row is working memory.
        volume: six times the volume of the pyramid from the camera to the triangle.
        normals: (3, 3): normals at the triangle's corners, in the world's frame.
        window: range of pixels to draw in.
        camera: the camera; `planes` is in its frame.
        image: the image to draw into.
    """
    height, width = image.depth.shape
    p, q, r, normal = planes[0], planes[1], planes[2], planes[3]
    for row in range(window[0], window[1]):
        y = -((row + 0.5) / height * 2 - 1) * camera.slope
        for column in range(window[2], window[3]):
            x = ((column + 0.5) / width * 2 - 1) * camera.slope
            # The ray (x, y, 1) meets the triangle at depth volume / Σ weights, if no weight is negative.
            u, v, w = x * p[0] + y * p[1] + p[2], x * q[0] + y * q[1] + q[2], x * r[0] + y * r[1] + r[2]
            total = u + v + w
            if min(u, v, w) < 0 or volume >= image.depth[row, column] * total:
                continue
            bright = 0.0
            for weight, own in ((u, normals[0]), (v, normals[1]), (w, normals[2])):
                bright += weight / total * _brightness(own, camera.light)
            for k in range(3):
                normal[k] = u * normals[0, k] + v * normals[1, k] + w * normals[2, k]
            normal /= np.sqrt(normal[0] * normal[0] + normal[1] * normal[1] + normal[2] * normal[2])
            _set_pixel(image, row, column, shapes, i, volume / total, bright, normal)


@compiled
def _paint_mesh(  # noqa: PLR0917  # numba takes arrays, not objects
    shapes: Shapes, i: int, triangles: Triangles, camera: Camera, place: np.ndarray, image: Image
) -> None:
    """Draw mesh `i`, with its origin at `place` in the camera's frame. Most triangles cover no pixel's centre."""
    height, width = image.depth.shape
    turn, slope, plane = shapes.rotation[i], camera.slope, triangles.plane
    view, planes, normals = np.empty((3, 3)), np.empty((4, 3)), np.empty((3, 3))
    for k in range(3):
        view[0, k], view[1, k], view[2, k] = _turned(camera.axes, turn[0, k], turn[1, k], turn[2, k])
    x, y, z = camera.position - shapes.position[i]
    eye = _turned(turn.T, x, y, z)
    for t in range(shapes.mesh[i, 0], shapes.mesh[i, 1]):
        if plane[t, 0] * eye[0] + plane[t, 1] * eye[1] + plane[t, 2] * eye[2] <= plane[t, 3]:
            continue  # its back faces the camera
        a, b, c = (
            _corner(view, place, triangles.corner, t, 0),
            _corner(view, place, triangles.corner, t, 1),
            _corner(view, place, triangles.corner, t, 2),
        )
        p = _cross(b, c)
        volume = a[0] * p[0] + a[1] * p[1] + a[2] * p[2]
        if volume <= 0 or (a[2] <= 0 and b[2] <= 0 and c[2] <= 0):  # the triangle is edge-on, or behind the camera
            continue
        left, right, top, bottom = 0, width, 0, height
        if a[2] > 0 and b[2] > 0 and c[2] > 0:
            left, right = _centres_between(a[0] / a[2], b[0] / b[2], c[0] / c[2], slope, width)
            top, bottom = _centres_between(-a[1] / a[2], -b[1] / b[2], -c[1] / c[2], slope, height)
        if left >= right or top >= bottom:
            continue
        planes[0, 0], planes[0, 1], planes[0, 2] = p
        planes[1, 0], planes[1, 1], planes[1, 2] = _cross(c, a)
        planes[2, 0], planes[2, 1], planes[2, 2] = _cross(a, b)
        for j in range(3):
            way = triangles.normal[t, j]
            normals[j, 0], normals[j, 1], normals[j, 2] = _turned(turn, way[0], way[1], way[2])
        _paint_triangle(shapes, i, planes, volume, normals, (top, bottom, left, right), camera, image)


@compiled
def paint(shapes: Shapes, triangles: Triangles, camera: Camera, image: Image) -> None:
    """Draw the shapes into the image, each only inside its bounding rectangle."""
    height, width = image.depth.shape
    normal, offset, place = np.empty(3), np.empty(3), np.empty(3)
    for i in range(shapes.label.shape[0]):
        half, turn, form = shapes.size[i], shapes.rotation[i], shapes.form[i]
        for k in range(3):
            offset[k] = shapes.position[i, k] - camera.position[k]
        reach = np.sqrt(half[0] * half[0] + half[1] * half[1] + half[2] * half[2]) if form == BOX else half[0]
        place[0], place[1], place[2] = _turned(camera.axes, offset[0], offset[1], offset[2])
        left, right = _span(place[0], place[2], reach, camera.slope, width)
        top, bottom = _span(-place[1], place[2], reach, camera.slope, height)
        if form == MESH:
            if left < right and top < bottom:
                _paint_mesh(shapes, i, triangles, camera, place, image)
            continue
        sphere = form == SPHERE
        for row in range(top, bottom):
            for column in range(left, right):
                ray = camera.rays[row, column]
                t = _hit_sphere(ray, offset, reach, normal) if sphere else _hit_box(ray, offset, turn, half, normal)
                if t < image.depth[row, column]:
                    _set_pixel(image, row, column, shapes, i, t, _brightness(normal, camera.light), normal)
