"""The MuJoCo model of a world: table, walls, an inventory of objects, and pieces that a puzzle moves into place.

Objects that a puzzle does not use are parked behind the camera, asleep on the same ground. Pen, ramp and danger patch
are mocap bodies, which are parked there too. docs/environment.md explains the contact settings.
"""

import functools
import math
from itertools import combinations
from typing import NamedTuple

import mujoco
import numpy as np

from gym_open import extras
from gym_open.envs import constants as c
from gym_open.envs.options import MeshObject, WorldOptions
from gym_open.envs.physics import scenery
from gym_open.envs.physics.bounciness import contact_reference
from gym_open.envs.physics.mjcf import indented, rgba, text

SPHERES = ("agent", "yellow", "green", "push")

# Friction decelerates a sliding body by at most b · speed. With more, MuJoCo's convex friction makes fast cubes hop.
_BRAKE = "-1 -10"
# Time constant and damping ratio on the ground. A shorter one adds energy when the edge of a tumbling cube bounces.
_LANDING = "0.02 1"
_FIRM = "0.99 0.99 0.001"
_ROLLING = 0.003
_LID = c.LID_HEIGHT / (2 * c.RADIUS)
"""Ratio of the lid's height to the size of the largest object under it: a cube can just turn over."""


def inventory(options: WorldOptions) -> tuple[str, ...]:
    """Names of all movable bodies, in the order of their bodies, joints and states in the model."""
    built_in = (["agent"] if kind == "agent" else _numbered(kind, count) for kind, count in c.CAPACITY.items())
    meshes = (_numbered(mesh.kind, mesh.count) for mesh in options.meshes)
    return tuple(name for names in (*built_in, *meshes) for name in names)


def kind_of(name: str) -> str:
    """Kind of an inventory object: "heavy" of "heavy_3"."""
    return name.rsplit("_", maxsplit=1)[0]


def _numbered(kind: str, count: int) -> list[str]:
    return [f"{kind}_{i}" for i in range(count)]


INVENTORY: tuple[str, ...] = inventory(WorldOptions())
"""Names of the movable bodies of the world v1."""


def build_model(options: WorldOptions) -> mujoco.MjModel:
    """The compiled model. All worlds with these options share it, and never change it.

    Raises:
        MeshError: if a user's mesh cannot be used.
    """
    return _compiled(model_xml(options))


@functools.lru_cache(maxsize=64)
def _compiled(text_of_model: str) -> mujoco.MjModel:
    return mujoco.MjModel.from_xml_string(text_of_model)


def model_xml(options: WorldOptions | None = None) -> str:
    """The model as MJCF text. It is enough to replay a logged trajectory without this package.

    Raises:
        MeshError: if a user's mesh cannot be used.
    """
    options = options or WorldOptions()
    kinds = _kinds(options)
    lid = max(c.LID_HEIGHT, *(_LID * kind.size for name, kind in kinds.items() if name != "agent"))
    meshes = [line for name, kind in kinds.items() for line in kind.assets]
    camera = options.camera
    objects, walls = (contact_reference(b, options.timestep_s) for b in (c.BOUNCINESS, c.BOUNCINESS / 2))
    return f"""\
<mujoco model="open">
  <compiler angle="radian"/>
  <option timestep="{options.timestep_s}" integrator="Euler" cone="elliptic" jacobian="dense" \
sleep_tolerance="0.005">
    <flag sleep="enable"/>
  </option>
  <statistic extent="2" center="0 0 0"/>
  <visual>
    <global fovy="{camera.field_of_view}" offwidth="1024" offheight="1024"/>
    <quality offsamples="0"/>
    <map znear="0.02" zfar="50"/>
    <headlight active="0"/>
  </visual>
  <default>
    <geom condim="1" solref="{objects}" solimp="{_FIRM}"/>
    <default class="seen"><geom contype="0" conaffinity="0" group="0"/></default>
    <default class="scenery">
      <geom contype="2" conaffinity="1" priority="1" solref="{walls}"/>
    </default>
    <default class="unseen">
      <geom contype="2" conaffinity="1" priority="1" group="4" solref="{walls}"/>
    </default>
    <default class="lid">
      <geom contype="4" conaffinity="0" priority="1" group="4" solref="{scenery.NO_BOUNCE}"/>
    </default>
  </default>
  <asset>
{_block(meshes)}
  </asset>
  <worldbody>
    <light type="directional" dir="{text(options.light.direction)}" pos="0 0 5" castshadow="false" \
diffuse="{text([c.LIGHT_DIFFUSE] * 3)}" ambient="{text([c.LIGHT_AMBIENT] * 3)}" specular="0 0 0"/>
    <camera name="observation" pos="{text(camera.position)}" \
xyaxes="{text(c.camera_axes(camera.direction)[:2].ravel())}" fovy="{camera.field_of_view}"/>
{_block(scenery.table())}
{_block(scenery.keep_in())}
{_block(scenery.pieces(lid))}
{_block(_objects(options, kinds))}
  </worldbody>
  <contact>
{_block(_pairs(options, kinds))}
  </contact>
</mujoco>
"""


class _ObjectKind(NamedTuple):
    """Properties of all objects of one kind."""

    mass: float
    friction: float
    bounciness: float
    rolls: bool
    size: float
    """Greatest extent; for a rectangle, the height."""
    height: float
    """Height of the body's origin above the table, at rest."""
    seen: str
    """Attributes of the visible geom, which also collides if there are no `parts`."""
    parts: tuple[tuple[str, float], ...] = ()
    """Attributes and mass of the geoms that collide instead of the visible geom."""
    assets: tuple[str, ...] = ()


def _kinds(options: WorldOptions) -> dict[str, _ObjectKind]:
    kinds = {kind: _built_in(kind, options) for kind in c.CAPACITY}
    for mesh in options.meshes:
        kinds[mesh.kind] = _mesh_kind(mesh)
    return kinds


def _built_in(kind: str, options: WorldOptions) -> _ObjectKind:
    size = options.size(kind)
    half = size / 2
    assets: tuple[str, ...] = ()
    if kind in SPHERES:
        shape = f'type="sphere" size="{half:.9g}"'
    elif kind == "cone":
        shape = 'type="mesh" mesh="cone"'
        assets = (f'<mesh name="cone" vertex="{text(_cone(half).ravel())}"/>',)
    else:
        length = half * c.RECTANGLE_LENGTH / (2 * c.RADIUS) if kind == "rectangle" else half
        shape = f'type="box" size="{text((length, half, half))}"'
    return _ObjectKind(
        mass=options.mass(kind),
        friction=options.friction(kind),
        bounciness=options.bounciness(kind),
        rolls=kind in SPHERES,
        size=size,
        height=half,
        seen=f'{shape} rgba="{rgba(options.colour(kind))}"',
        assets=assets,
    )


def _mesh_kind(mesh: MeshObject) -> _ObjectKind:
    extras.check("meshes")
    from gym_open.envs.physics.meshes import mesh_shape  # loads large libraries that few worlds need

    shape = mesh_shape(mesh)
    pieces = [f"{mesh.kind}/{i}" for i in range(len(shape.pieces))]
    seen = f'vertex="{text(shape.vertices.ravel())}" face="{text(shape.faces.ravel())}" inertia="shell"'
    return _ObjectKind(
        mass=mesh.mass,
        friction=mesh.friction,
        bounciness=mesh.bounciness,
        rolls=False,
        size=float(shape.extents.max()),
        height=float(shape.extents[2] / 2),
        seen=f'type="mesh" mesh="{mesh.kind}" rgba="{rgba(mesh.colour or shape.colour)}"',
        parts=tuple(
            (f'type="mesh" mesh="{name}"', mesh.mass * share) for name, share in zip(pieces, shape.shares, strict=True)
        ),
        assets=(
            f'<mesh name="{mesh.kind}" {seen}/>',
            *(
                f'<mesh name="{name}" vertex="{text(points.ravel())}"/>'
                for name, points in zip(pieces, shape.pieces, strict=True)
            ),
        ),
    )


def _cone(half: float) -> np.ndarray:
    """(25, 3) metres: base and tip of a cone around the middle of its height; at rest it is as high as a cube."""
    angles = np.linspace(0, 2 * np.pi, 24, endpoint=False).tolist()
    base = [(math.cos(angle), math.sin(angle), -1.0) for angle in angles]
    return half * np.array([*base, (0.0, 0.0, 1.0)])


def _touched(name: str, kind: _ObjectKind) -> list[str]:
    """Names of the geoms with which an object collides."""
    return [f"{name}/{i}" for i in range(len(kind.parts))] or [name]


def _objects(options: WorldOptions, kinds: dict[str, _ObjectKind]) -> list[str]:
    lines: list[str] = []
    for index, name in enumerate(inventory(options)):
        kind = kinds[kind_of(name)]
        parked = text((0.4 * index, scenery.PARKING_Y, kind.height))  # on the ground, apart from all others
        rest, touches = ("never", 3) if name == "agent" else ("allowed", 7)
        solid = f'contype="1" conaffinity="{touches}"'
        if kind.parts:
            geoms = [f'<geom name="{name}" class="seen" {kind.seen} mass="0"/>'] + [
                f'<geom name="{part}" {shape} mass="{mass:.9g}" {solid} group="4"/>'
                for part, (shape, mass) in zip(_touched(name, kind), kind.parts, strict=True)
            ]
        else:
            geoms = [f'<geom name="{name}" {kind.seen} mass="{kind.mass}" {solid}/>']
        lines += [
            f'<body name="{name}" pos="{parked}" sleep="{rest}">',
            *indented([f'<freejoint name="{name}"/>', *geoms]),
            "</body>",
        ]
    return lines


def _pairs(options: WorldOptions, kinds: dict[str, _ObjectKind]) -> list[str]:
    """Contacts with special settings: only the ground has friction, so that no object climbs on another.

    The agent glides, other spheres roll until they stop, and all other objects slide.
    """
    still = f'solref="{scenery.NO_BOUNCE}" solimp="{_FIRM}"'
    lines = [f'<pair geom1="{name}" geom2="agent" condim="1" {still}/>' for name in ("ramp_slope", "ramp_platform")]
    for name in inventory(options):
        kind = kinds[kind_of(name)]
        condim = 1 if kind.friction == 0 else 6 if kind.rolls and name != "agent" else 3
        friction = text((kind.friction, kind.friction, 0.005, _ROLLING, _ROLLING))
        lines += [
            f'<pair geom1="ground" geom2="{part}" condim="{condim}" friction="{friction}" '
            f'solref="{_LANDING}" solreffriction="{_BRAKE}" solimp="{_FIRM}"/>'
            for part in _touched(name, kind)
        ]
    return lines + _bounces(options, kinds)


def _bounces(options: WorldOptions, kinds: dict[str, _ObjectKind]) -> list[str]:
    """Pairs whose bounciness differs from v1: MuJoCo itself takes the smaller of two values, not their mean."""
    if all(kind.bounciness == c.BOUNCINESS for kind in kinds.values()):
        return []
    names = inventory(options)
    found: list[tuple[str, str, float]] = []
    for a, b in combinations(names, 2):
        mean = (kinds[kind_of(a)].bounciness + kinds[kind_of(b)].bounciness) / 2
        found += [(x, y, mean) for x in _touched(a, kinds[kind_of(a)]) for y in _touched(b, kinds[kind_of(b)])]
    for name in names:
        kind = kinds[kind_of(name)]
        found += [(wall, part, kind.bounciness / 2) for wall in scenery.BOUNCING for part in _touched(name, kind)]
    usual = {False: c.BOUNCINESS, True: c.BOUNCINESS / 2}
    lines: list[str] = []
    for x, y, value in found:
        if abs(value - usual[x in scenery.BOUNCING]) > 1e-9:
            reference = contact_reference(value, options.timestep_s)
            lines.append(f'<pair geom1="{x}" geom2="{y}" condim="1" solref="{reference}" solimp="{_FIRM}"/>')
    return lines


def _block(lines: list[str]) -> str:
    return "\n".join(indented(lines, 2))
