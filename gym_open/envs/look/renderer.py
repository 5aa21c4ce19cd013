"""The handsome look, for people: shadows, gloss and cloth, at any size, drawn by `mujoco.Renderer`.

It uses the same model with other materials and lights, so a world's state can be copied without change. Textures are
computed here from fixed seeds: there are no image files.
"""

from typing import Literal, Self

import mujoco
import numpy as np

from gym_open.envs.look.gl import open_renderer
from gym_open.envs.options import WorldOptions
from gym_open.envs.physics.model import model_xml
from gym_open.envs.world import World

View = Literal["people", "observation"]
"""`observation` is the camera of the world's options; `people` is further back, with a longer lens."""

Size = tuple[int, int]
"""Width and height in pixels."""

_PEOPLE_POSITION = (-0.9, -2.7, 2.7)
_PEOPLE_AIM = (0.042, -0.301, 0.0)
_PEOPLE_FIELD_OF_VIEW = 31.0
_SHADOWED = 2.2
"""Half edge in metres of the square around the table's middle that has shadows."""
_MATERIALS = {
    # name: specular, shininess, reflectance, texture, repeats of the texture
    "table": (0.25, 0.5, 0.0, "felt", 4),
    "floor": (0.05, 0.1, 0.0, "burlap", 40),
    "wall": (0.35, 0.4, 0.0, "grain", 1),
    "patch": (0.2, 0.3, 0.0, "felt", 1),
    "object": (0.7, 0.75, 0.0, "", 1),
}


class Renderer:
    """Draws worlds with these options. Use and close it on one thread; it is a context manager.

    Raises:
        OpenGLError: if there is no OpenGL; names the packages to install.
    """

    def __init__(self, options: WorldOptions, size: Size = (512, 512), view: View = "people") -> None:
        self._model = handsome_model(model_xml(options), size)
        self._data = mujoco.MjData(self._model)
        self._view = view
        self._movers = [i for i in range(self._model.ngeom) if self._model.body_dofnum[self._model.geom_bodyid[i]]]
        self._renderer = open_renderer(self._model, *size)

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def close(self) -> None:
        """Free OpenGL's memory."""
        self._renderer.close()

    def render(self, world: World) -> np.ndarray:
        """Draw the world's current state, (height, width, 3) uint8; hit goals have the same colours as in `observe`."""
        data, model = self._data, self._model
        for field in ("qpos", "mocap_pos", "mocap_quat"):
            getattr(data, field)[:] = getattr(world.data, field)
        geoms, colours = world.shown_colours()
        model.geom_rgba[self._movers, 3] = 0  # parked objects are not drawn
        model.geom_rgba[geoms, :3] = colours / 255
        model.geom_rgba[geoms, 3] = 1
        mujoco.mj_kinematics(model, data)
        mujoco.mj_camlight(model, data)
        self._renderer.update_scene(data, camera=self._view)
        return self._renderer.render()


def handsome_model(xml: str, size: Size) -> mujoco.MjModel:
    """The same bodies as in the world's model, with materials and lights for people."""
    spec = mujoco.MjSpec.from_string(xml)
    spec.visual.global_.offwidth, spec.visual.global_.offheight = size
    spec.visual.quality.offsamples = 8
    spec.visual.quality.shadowsize = 4096
    spec.visual.map.shadowclip = _SHADOWED / spec.stat.extent
    spec.visual.quality.numslices, spec.visual.quality.numstacks = 64, 48
    _add_materials(spec)
    _add_lights(spec)
    spec.worldbody.add_camera(
        name="people", pos=_PEOPLE_POSITION, quat=_looking_at(_PEOPLE_POSITION, _PEOPLE_AIM), fovy=_PEOPLE_FIELD_OF_VIEW
    )
    for geom in spec.geoms:
        geom.material = _material_of(geom)
    return spec.compile()


def _material_of(geom: mujoco.MjsGeom) -> str:
    if geom.name in ("table", "floor", "patch"):
        return geom.name
    return "wall" if geom.name.startswith(("seen_", "pen_", "ramp_")) else "object"


def _add_materials(spec: mujoco.MjSpec) -> None:
    for name, pixels in (("felt", _felt()), ("burlap", _burlap()), ("grain", _grain())):
        height, width = pixels.shape
        texture = spec.add_texture(
            name=name, type=mujoco.mjtTexture.mjTEXTURE_2D, width=width, height=height, nchannel=3
        )
        texture.data = np.repeat(np.round(pixels * 255).astype(np.uint8), 3).tobytes()
    for name, (specular, shininess, reflectance, texture, repeat) in _MATERIALS.items():
        material = spec.add_material(
            name=name, specular=specular, shininess=shininess, reflectance=reflectance, texrepeat=(repeat, repeat)
        )
        if texture:
            material.textures[mujoco.mjtTextureRole.mjTEXROLE_RGB] = texture


def _add_lights(spec: mujoco.MjSpec) -> None:
    """Let the world's directional light cast shadows, and add a lamp next to the camera that softens them."""
    (sun,) = spec.lights
    sun.castshadow = True
    sun.pos = -4 * np.array(sun.dir) / np.linalg.norm(sun.dir)  # the shadow map is centred on the sun's ray
    sun.diffuse, sun.ambient, sun.specular = [0.6] * 3, [0.0] * 3, [0.45] * 3
    spec.worldbody.add_light(
        type=mujoco.mjtLightType.mjLIGHT_DIRECTIONAL,
        pos=(0, -2, 3),
        dir=(0.1, 0.75, -0.65),
        castshadow=False,
        diffuse=[0.22] * 3,
        ambient=[0.4] * 3,  # on this lamp, because in a shadow MuJoCo removes the sun's ambient light
        specular=[0.15] * 3,
    )


def _looking_at(position: tuple[float, float, float], aim: tuple[float, float, float]) -> np.ndarray:
    """Quaternion of a camera at `position` that has `aim` in the middle of its image, with z upwards."""
    back = np.subtract(position, aim)
    back /= np.linalg.norm(back)
    right = np.cross((0, 0, 1), back)
    right /= np.linalg.norm(right)
    quaternion = np.zeros(4)
    mujoco.mju_mat2Quat(quaternion, np.stack([right, np.cross(back, right), back], axis=1).ravel())
    return quaternion


def _felt() -> np.ndarray:
    """Cloth of short fibres: fine noise with a little coarse noise."""
    noise = np.random.default_rng(0).normal(size=(512, 512))
    return np.clip(0.93 + 0.035 * noise + 0.05 * _blurred(noise, 4), 0, 1)


def _burlap() -> np.ndarray:
    """Woven threads of uneven thickness."""
    rng = np.random.default_rng(1)
    x, y = np.meshgrid(np.arange(256), np.arange(256))
    weave = np.where((x // 16 + y // 16) % 2, np.abs(np.sin(np.pi * x / 16)), np.abs(np.sin(np.pi * y / 16)))
    return np.clip(0.7 + 0.2 * weave + 0.05 * rng.normal(size=weave.shape), 0, 1)


def _grain() -> np.ndarray:
    """Wood: noise stretched along one axis."""
    noise = np.random.default_rng(2).normal(size=(256, 256))
    return np.clip(0.9 + 0.12 * _blurred(noise, 24, axes=(1,)), 0, 1)


def _blurred(noise: np.ndarray, width: int, axes: tuple[int, ...] = (0, 1)) -> np.ndarray:
    """Periodic means over `width` neighbours, scaled to standard deviation 1."""
    for axis in axes:
        noise = np.mean([np.roll(noise, shift, axis) for shift in range(width)], axis=0)
    return noise / noise.std()
