"""Options of a world, as plain data: objects, camera, light, image, timestep, and the user's meshes.

The defaults are the published world, v1. Any change makes another world, whose scores are not comparable.
"""

import math
import re
from typing import Any, Final

import msgspec

from gym_open.config import Config
from gym_open.envs import constants as c
from gym_open.errors import ConfigError

Vector = tuple[float, float, float]
Colour = tuple[int, int, int]

MESH: Final = "mesh:"
"""Prefix of the kind of a user's mesh; the mesh's name follows."""
SMALLEST_SIZE: Final = 0.04
"""Metres across: a smaller object could pass through the pen's wall between two substeps."""
LARGEST_SIZE: Final = 0.139
"""Metres across: objects on neighbouring cells must not touch, because they start asleep."""
_NAME = re.compile(r"[A-Za-z0-9][A-Za-z0-9_-]*")
_MASSES = (0.1, 1000.0)
_FRICTIONS = (0.0, 2.0)
_BOUNCINESSES = (0.0, 0.9)


def _check_dynamics(name: str, options: "ObjectOptions | MeshObject") -> None:
    for field, (low, high) in (("mass", _MASSES), ("friction", _FRICTIONS), ("bounciness", _BOUNCINESSES)):
        value = getattr(options, field)
        if value is not None:
            _check_range(f"{name} {field}", value, low, high)
    colour = options.colour
    if colour is not None and (len(colour) != 3 or not all(0 <= value <= 255 for value in colour)):
        raise ConfigError(f"{name} colour: expected three numbers from 0 to 255, got {colour}")


def _check_range(name: str, value: float, low: float, high: float) -> None:
    if not low <= value <= high:
        raise ConfigError(f"{name}: expected {low:g} to {high:g}, got {value}")


class ObjectOptions(Config, frozen=True, kw_only=True, omit_defaults=True):
    """Physics and look of all objects of one kind. None means the value of v1.

    Raises:
        ConfigError: if a value is out of its bounds.
    """

    mass: float | None = None
    """Kilograms, 0.1–1000."""
    friction: float | None = None
    """Coulomb's coefficient with the table, 0–2. There is no friction with anything else."""
    bounciness: float | None = None
    """0–0.9. Two objects keep the mean of their values as share of their closing speed; a wall counts as 0."""
    size: float | None = None
    """Metres across, 0.04–0.139: diameter of a sphere, edge of a cube. A rectangle is three times as long."""
    colour: Colour | None = None
    """Red, green and blue, 0–255. If rewards are on, a touched goal still turns v1's hit colour."""

    def __post_init__(self) -> None:
        _check_dynamics("object", self)
        if self.size is not None and not SMALLEST_SIZE <= self.size <= LARGEST_SIZE:
            fits = f"choose {SMALLEST_SIZE} to {LARGEST_SIZE}"
            raise ConfigError(f"object size: {self.size} m does not fit a cell of {c.PITCH} m; {fits}")


class MeshObject(Config, frozen=True, kw_only=True, omit_defaults=True):
    """A kind of object with a shape from the user: `mesh:NAME` in a puzzle.

    Raises:
        ConfigError: if a value is out of its bounds.
    """

    name: str
    """Letters, digits, `-` and `_`."""
    file: str
    """Path of an OBJ, STL, PLY or GLB file, in metres after scaling, z up (GLB: y up)."""
    count: int = 1
    """Largest number of them in a puzzle, 1–8."""
    mass: float = 5.0
    friction: float = c.FRICTION
    bounciness: float = c.BOUNCINESS
    scale: float = 1.0
    """Factor on all lengths in the file."""
    colour: Colour | None = None
    """None means the main colour in the file."""

    def __post_init__(self) -> None:
        if not _NAME.fullmatch(self.name):
            raise ConfigError(f"mesh name {self.name!r}: expected letters, digits, '-' and '_'")
        _check_dynamics(f"mesh {self.name!r}", self)
        _check_range(f"mesh {self.name!r}: count", self.count, 1, 8)
        if not (math.isfinite(self.scale) and self.scale > 0):
            raise ConfigError(f"mesh {self.name!r}: scale: expected a positive number, got {self.scale}")

    @property
    def kind(self) -> str:
        """The object's kind in a puzzle."""
        return MESH + self.name


class CameraOptions(Config, frozen=True, kw_only=True, omit_defaults=True):
    """The camera of the observation.

    Raises:
        ConfigError: if a value is out of its bounds.
    """

    position: Vector = c.CAMERA_POSITION
    """x, y, z in metres; the table top is z = 0."""
    direction: Vector = c.CAMERA_EULER
    """Pitch down, yaw to the right of +y, and roll, in degrees, as in Unity."""
    field_of_view: float = c.FIELD_OF_VIEW
    """Vertical, degrees."""

    def __post_init__(self) -> None:
        for field in ("position", "direction"):
            value = getattr(self, field)
            if len(value) != 3 or not all(math.isfinite(number) for number in value):
                raise ConfigError(f"camera {field}: expected three finite numbers, got {value}")
        _check_range("camera field_of_view", self.field_of_view, 1, 170)


class LightOptions(Config, frozen=True, kw_only=True, omit_defaults=True):
    """The direction of the light's source.

    Raises:
        ConfigError: if a value is out of its bounds.
    """

    angle_deg: float = c.LIGHT_ANGLE_DEG
    """Azimuth: counter-clockwise from +x, seen from above."""
    elevation_deg: float = c.LIGHT_ELEVATION_DEG
    """Angle above the horizon; 90 is vertical."""

    def __post_init__(self) -> None:
        if not math.isfinite(self.angle_deg):
            raise ConfigError(f"light angle_deg: expected a finite number, got {self.angle_deg}")
        _check_range("light elevation_deg", self.elevation_deg, 5, 90)

    @property
    def direction(self) -> Vector:
        """Unit vector of the light's direction of travel."""
        return c.light_direction(self.angle_deg, self.elevation_deg)


class WorldOptions(Config, frozen=True, kw_only=True, omit_defaults=True):
    """All options of a world. `WorldOptions()` is v1.

    Raises:
        ConfigError: if a value is out of its bounds, or a kind is unknown.
    """

    objects: dict[str, ObjectOptions] = msgspec.field(default_factory=dict[str, ObjectOptions])
    """By kind; the kinds are the keys of `constants.CAPACITY`. A stack is two light cubes."""
    camera: CameraOptions = CameraOptions()
    light: LightOptions = LightOptions()
    meshes: tuple[MeshObject, ...] = ()
    image_size: int = c.IMAGE_SIZE
    """Height and width of the observation in pixels."""
    timestep_s: float = c.TIMESTEP_S
    substeps: int = c.SUBSTEPS
    """Substeps per step. A move is one cell long if `timestep_s` × `substeps` is v1's 0.04 s."""

    def __post_init__(self) -> None:
        if unknown := sorted(set(self.objects) - set(c.CAPACITY)):
            raise ConfigError(f"world objects: no kind {unknown[0]!r}; the kinds are {', '.join(c.CAPACITY)}")
        names = [mesh.name for mesh in self.meshes]
        if twice := sorted({name for name in names if names.count(name) > 1}):
            raise ConfigError(f"world meshes: two are named {twice[0]!r}; give each its own name")
        _check_range("world image_size", self.image_size, 16, 1024)
        _check_range("world timestep_s", self.timestep_s, 0.0002, c.TIMESTEP_S)
        _check_range("world substeps", self.substeps, 1, 1000)

    def mass(self, kind: str) -> float:
        """Kilograms of each object of a built-in kind."""
        return _chosen(self.objects.get(kind), "mass", c.MASS.get(kind))

    def friction(self, kind: str) -> float:
        """Coefficient of friction between a built-in kind and the table: 0 for the agent, which glides."""
        return _chosen(self.objects.get(kind), "friction", 0.0 if kind == "agent" else c.FRICTION)

    def bounciness(self, kind: str) -> float:
        """Bounciness of a built-in kind."""
        return _chosen(self.objects.get(kind), "bounciness", c.BOUNCINESS)

    def size(self, kind: str) -> float:
        """Metres across of a built-in kind."""
        return _chosen(self.objects.get(kind), "size", 2 * c.RADIUS)

    def colour(self, kind: str) -> Colour:
        """Red, green and blue, 0–255, of a built-in kind."""
        return _chosen(self.objects.get(kind), "colour", c.COLOUR.get(kind))


def _chosen(options: ObjectOptions | None, field: str, default: Any) -> Any:
    value = getattr(options, field, None)
    return default if value is None else value
