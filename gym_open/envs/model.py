"""The one fixed MuJoCo model: table, walls, an inventory of objects, and pieces that a puzzle moves into place.

Objects that a puzzle does not use are parked asleep on the same ground, behind the camera; pen, ramp and danger patch
are mocap bodies, parked there as well. Contact settings and their reasons are in docs/environment.md.
"""

import functools
from collections.abc import Iterable

import mujoco
import numpy as np

from gym_open.envs import constants as c

INVENTORY: tuple[str, ...] = tuple(
    name
    for kind, count in c.CAPACITY.items()
    for name in (["agent"] if kind == "agent" else [f"{kind}_{i}" for i in range(count)])
)
"""Names of all movable bodies, in the order of their bodies, joints and states in the model."""

SPHERES = ("agent", "yellow", "green", "push")

PARKING_Y = -30.0
"""Parked things stand beyond this y, far behind the camera and out of the table's reach."""

# Reference acceleration −k·depth − b·speed of a contact as "−k −b", in 1/s² and 1/s; MuJoCo scales it by the masses.
_BOUNCE_OBJECTS = "-40000 -72"
_BOUNCE_SCENERY = "-40000 -175"
_NO_BOUNCE = "0.01 1"
# Friction brakes a sliding body no harder than b·speed. Harder, MuJoCo's convex friction makes fast cubes hop.
_BRAKE = "-1 -10"
_FIRM = "0.99 0.99 0.001"
_FRICTION = 0.35
_ROLLING = 0.003

_CORNERS = (("north_east", 1, 1), ("north_west", -1, 1), ("south_east", 1, -1), ("south_west", -1, -1))


def kind_of(name: str) -> str:
    """Kind of an inventory object: "heavy" of "heavy_3"."""
    return name.split("_", maxsplit=1)[0]


def model_xml() -> str:
    """The model as MJCF text: with it alone, a logged trajectory can be replayed without this package."""
    return f"""\
<mujoco model="open">
  <compiler angle="radian"/>
  <option timestep="{c.TIMESTEP_S}" integrator="implicitfast" cone="elliptic" jacobian="dense" sleep_tolerance="0.005">
    <flag sleep="enable"/>
  </option>
  <statistic extent="2" center="0 0 0"/>
  <visual>
    <global fovy="{c.FIELD_OF_VIEW}" offwidth="1024" offheight="1024"/>
    <quality offsamples="0"/>
    <map znear="0.02" zfar="50"/>
    <headlight active="0"/>
  </visual>
  <default>
    <geom condim="1" solref="{_BOUNCE_OBJECTS}" solimp="{_FIRM}"/>
    <default class="seen"><geom contype="0" conaffinity="0" group="0"/></default>
    <default class="scenery"><geom contype="2" conaffinity="1" priority="1" solref="{_BOUNCE_SCENERY}"/></default>
    <default class="unseen">
      <geom contype="2" conaffinity="1" priority="1" group="4" solref="{_BOUNCE_SCENERY}"/>
    </default>
    <default class="lid"><geom contype="4" conaffinity="0" priority="1" group="4" solref="{_NO_BOUNCE}"/></default>
  </default>
  <asset>
    <mesh name="cone" vertex="{_text(_cone_vertices().ravel())}"/>
  </asset>
  <worldbody>
    <light type="directional" dir="{_text(c.LIGHT_DIRECTION)}" pos="0 0 5" castshadow="false" \
diffuse="{_text([c.LIGHT_DIFFUSE] * 3)}" ambient="{_text([c.LIGHT_AMBIENT] * 3)}" specular="0 0 0"/>
    <camera name="observation" pos="{_text(c.CAMERA_POSITION)}" xyaxes="{_text(c.camera_axes()[:2].ravel())}" \
fovy="{c.FIELD_OF_VIEW}"/>
{_indent(_table())}
{_indent(_keep_in())}
{_indent(_pieces())}
{_indent(_objects())}
  </worldbody>
  <contact>
{_indent(_pairs())}
  </contact>
</mujoco>
"""


@functools.cache
def fixed_model() -> mujoco.MjModel:
    """The compiled model, shared by all worlds, which never change it."""
    return mujoco.MjModel.from_xml_string(model_xml())


def _table() -> list[str]:
    high, thin = c.WALL_HEIGHT / 2, c.WALL_THICKNESS / 2
    x, y = c.WALL_X + thin, c.WALL_Y + thin
    edge_x, edge_y = c.WALL_X + c.WALL_THICKNESS, c.WALL_Y + c.WALL_THICKNESS
    lines = [
        # An infinite plane holds things up; what is seen of it is a plate.
        f'<geom name="ground" type="plane" size="0 0 1" class="scenery" group="4" solref="{_NO_BOUNCE}"/>',
        _box("floor", (0, 0, -c.TABLE_HEIGHT - 0.05), (15, 15, 0.05), "floor", kind="seen"),
        _box("table", (0, 0, -0.02), (edge_x, edge_y, 0.02), "table", kind="seen"),
    ]
    for name, place, size in (
        ("east", (x, 0, high), (thin, edge_y, high)),
        ("west", (-x, 0, high), (thin, edge_y, high)),
        ("north", (0, y, high), (c.WALL_X, thin, high)),
        ("south", (0, -y, high), (c.WALL_X, thin, high)),
    ):
        lines.append(_box(f"seen_wall_{name}", place, size, "wall", kind="seen"))
    for name, sx, sy in _CORNERS:
        place = sx * (c.CORNER[0] + thin / np.sqrt(2)), sy * (c.CORNER[1] + thin / np.sqrt(2)), high
        size = _corner_half_length(), thin, high
        lines.append(_box(f"seen_corner_{name}", place, size, "wall", kind="seen", euler=(0, 0, -sx * sy * np.pi / 4)))
    return lines


def _keep_in() -> list[str]:
    """What the walls are to touch: thick, and so high that nothing gets over them, flush with the visible ones.

    A lid keeps cubes and goals, not the agent, from coming to rest on one another.
    """
    high, thick = 1.0, 0.5
    x, y = c.WALL_X + thick, c.WALL_Y + thick
    lines = [
        _box("wall_east", (x, 0, high), (thick, y + thick, high), "wall", kind="unseen"),
        _box("wall_west", (-x, 0, high), (thick, y + thick, high), "wall", kind="unseen"),
        _box("wall_north", (0, y, high), (c.WALL_X, thick, high), "wall", kind="unseen"),
        _box("wall_south", (0, -y, high), (c.WALL_X, thick, high), "wall", kind="unseen"),
        _box("lid", (0, 0, c.LID_HEIGHT + thick), (c.WALL_X, c.WALL_Y, thick), "wall", kind="lid"),
    ]
    for name, sx, sy in _CORNERS:
        place = sx * (c.CORNER[0] + thick / np.sqrt(2)), sy * (c.CORNER[1] + thick / np.sqrt(2)), high
        size = _corner_half_length() + thick, thick, high
        lines.append(_box(f"corner_{name}", place, size, "wall", kind="unseen", euler=(0, 0, -sx * sy * np.pi / 4)))
    return lines


def _corner_half_length() -> float:
    """Half length of a corner piece whose inner face passes through `CORNER` and ends at both walls."""
    return float(np.sqrt(2) * max(c.WALL_X - c.CORNER[0], c.WALL_Y - c.CORNER[1]))


def _pieces() -> list[str]:
    """Pen, ramp and patch, each as one mocap body around its own centre; the ramp rises towards +x."""
    half, thin, high = c.PEN_HALF, c.PEN_WALL_THICKNESS / 2, c.WALL_HEIGHT / 2
    pen = [
        _box("pen_east", (half, 0, high), (thin, half + thin, high), "pen"),
        _box("pen_west", (-half, 0, high), (thin, half + thin, high), "pen"),
        _box("pen_north", (0, half, high), (half - thin, thin, high), "pen"),
        _box("pen_south", (0, -half, high), (half - thin, thin, high), "pen"),
    ]
    end = half - thin
    top = end - c.RAMP_PLATFORM
    run = top - c.RAMP_FOOT
    slope = float(np.arctan2(c.RAMP_HEIGHT, run))
    long, thick = float(np.hypot(run, c.RAMP_HEIGHT)) / 2, 0.01
    middle = (c.RAMP_FOOT + top) / 2 + thick * np.sin(slope), 0, c.RAMP_HEIGHT / 2 - thick * np.cos(slope)
    ramp = [
        _box("ramp_slope", middle, (long, c.RAMP_WIDTH / 2, thick), "ramp", euler=(0, -slope, 0), solref=_NO_BOUNCE),
        _box(
            "ramp_platform",
            ((top + end) / 2, 0, c.RAMP_HEIGHT / 2),
            (c.RAMP_PLATFORM / 2, c.RAMP_WIDTH / 2, c.RAMP_HEIGHT / 2),
            "ramp",
            solref=_NO_BOUNCE,
        ),
    ]
    patch = [_box("patch", (0, 0, 0.001), (c.PATCH_HALF, c.PATCH_HALF, 0.001), "patch", kind="seen")]
    return [
        line
        for index, (name, geoms) in enumerate((("pen", pen), ("ramp", ramp), ("patch", patch)))
        for line in (
            f'<body name="{name}" mocap="true" pos="{_text(piece_parking(index))}">',
            *_indented(geoms),
            "</body>",
        )
    ]


def piece_parking(index: int) -> tuple[float, float, float]:
    """Where pen (0), ramp (1) and patch (2) stand while they are parked."""
    return 2.0 * index, PARKING_Y - 5.0, 0.0


def _objects() -> list[str]:
    lines: list[str] = []
    for index, name in enumerate(INVENTORY):
        kind = kind_of(name)
        parked = _text((0.4 * index, PARKING_Y, c.RADIUS))  # on the ground, apart from all others
        rest, touches = ("never", 3) if kind == "agent" else ("allowed", 7)
        look = f'{_shape(kind)} rgba="{_rgba(c.COLOUR[kind])}"'
        lines += [
            f'<body name="{name}" pos="{parked}" sleep="{rest}">',
            f'  <freejoint name="{name}"/>',
            f'  <geom name="{name}" {look} mass="{c.MASS[kind]}" contype="1" conaffinity="{touches}"/>',
            "</body>",
        ]
    return lines


def _shape(kind: str) -> str:
    if kind in SPHERES:
        return f'type="sphere" size="{c.RADIUS}"'
    if kind == "cone":
        return 'type="mesh" mesh="cone"'
    length = c.RECTANGLE_LENGTH / 2 if kind == "rectangle" else c.RADIUS
    return f'type="box" size="{_text((length, c.RADIUS, c.RADIUS))}"'


def _cone_vertices() -> np.ndarray:
    """(25, 3) metres: a cone's base and tip around the middle of its height, so that it rests as high as a cube."""
    angles = np.linspace(0, 2 * np.pi, 24, endpoint=False)
    base = np.stack([np.cos(angles), np.sin(angles), np.full(24, -1.0)], axis=1)
    return c.RADIUS * np.vstack([base, (0, 0, 1)])


def _pairs() -> list[str]:
    """Contacts with settings of their own: friction acts with the ground alone, so that nothing climbs on another.

    The agent glides, spheres roll and come to rest, all else slides.
    """
    friction = f'friction="{_FRICTION} {_FRICTION} 0.005 {_ROLLING} {_ROLLING}" solreffriction="{_BRAKE}"'
    still = f'solref="{_NO_BOUNCE}" solimp="{_FIRM}"'
    ramp = [f'<pair geom1="{name}" geom2="agent" condim="1" {still}/>' for name in ("ramp_slope", "ramp_platform")]
    return ramp + [
        f'<pair geom1="ground" geom2="{name}" condim="{_condim(kind_of(name))}" {friction} {still}/>'
        for name in INVENTORY
    ]


def _condim(kind: str) -> int:
    if kind == "agent":
        return 1
    return 6 if kind in SPHERES else 3


def _box(
    name: str,
    place: Iterable[float],
    half: Iterable[float],
    colour: str,
    *,
    kind: str = "scenery",
    euler: Iterable[float] = (0, 0, 0),
    solref: str = "",
) -> str:
    extra = f' solref="{solref}"' if solref else ""
    return (
        f'<geom name="{name}" class="{kind}" type="box" pos="{_text(place)}" size="{_text(half)}" '
        f'euler="{_text(euler)}" rgba="{_rgba(c.SCENERY_COLOUR[colour])}"{extra}/>'
    )


def _rgba(colour: tuple[int, int, int]) -> str:
    return _text([*(value / 255 for value in colour), 1])


def _text(values: Iterable[float]) -> str:
    return " ".join(f"{float(value):.9g}" for value in values)


def _indented(lines: list[str]) -> list[str]:
    return [f"  {line}" for line in lines]


def _indent(lines: list[str]) -> str:
    return "\n".join(f"    {line}" for line in lines)
