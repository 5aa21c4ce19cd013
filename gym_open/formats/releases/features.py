"""Features of a release's frames: LeRobot's description and the Arrow schema."""

from collections.abc import Collection, Sequence
from typing import Any, Literal

import msgspec
import pyarrow as pa

from gym_open.envs.constants import CONTROL_DT_S, IMAGE_SIZE, N_ACTIONS
from gym_open.formats.releases.layout import IMAGE, LEARNED, PART

STATE_FIELDS = ("x", "y", "z", "qw", "qx", "qy", "qz", "vx", "vy", "vz", "wx", "wy", "wz")
"""Position (m), quaternion, linear velocity (m/s), angular velocity (rad/s) of one object, in the world frame."""
ACTION_NAMES = ("stay", "east", "northeast", "north", "northwest", "west", "southwest", "south", "southeast")
"""Names of `envs.constants.MOVES`; north is away from the camera."""

Features = dict[str, dict[str, Any]]


def fps() -> int | float:
    """Steps per simulated second; an int if it is a whole number, as LeRobot expects."""
    rate = round(1 / CONTROL_DT_S, 9)
    return int(rate) if rate == int(rate) else rate


def features(
    object_names: Sequence[str], reward_parts: Sequence[str] = (), pictures: Literal["png", "video"] = "png",
    left_out: Collection[str] = (),
) -> Features:  # fmt: skip
    """LeRobot's description of every feature.

    Args:
        object_names: movable objects of the model.
        reward_parts: names of the parts of intrinsic rewards.
        pictures: whether images are PNG files or video.
        left_out: those of `LEARNED` that the release does not have.
    """
    scalars = {
        "action.index": "int64",
        "reward.intrinsic": "float32",
        **{PART + name: "float32" for name in reward_parts},
        "world_model.loss": "float32",
        "policy.entropy": "float32",
        "policy.value": "float32",
        "contact.count": "int64",
        "contact.agent": "int64",
        "contact.impulse": "float32",
        "next.reward": "float32",
        "next.done": "bool",
        "next.truncated": "bool",
        "transition.valid": "bool",
        "timestamp": "float32",
        "frame_index": "int64",
        "episode_index": "int64",
        "index": "int64",
        "task_index": "int64",
    }
    names = [f"{name}.{field}" for name in object_names for field in STATE_FIELDS]
    return {
        IMAGE: _image(pictures),
        "observation.state": _vector(STATE_FIELDS),
        "observation.environment_state": _vector(names),
        "action": _vector(ACTION_NAMES),
        **{
            name: {"dtype": dtype, "shape": [1], "names": None}
            for name, dtype in scalars.items()
            if name not in left_out
        },
    }


def _image(kind: Literal["png", "video"]) -> dict[str, Any]:
    described = {"shape": [IMAGE_SIZE, IMAGE_SIZE, 3], "names": ["height", "width", "channels"]}
    if kind == "png":
        return {"dtype": "image", **described}
    coding = {
        "codec": "h264",
        "pix_fmt": "gbrp",
        "fps": fps(),
        "height": IMAGE_SIZE,
        "width": IMAGE_SIZE,
        "channels": 3,
    }
    info = {
        **{f"video.{name}": value for name, value in coding.items()},
        "video.is_depth_map": False,
        "has_audio": False,
    }
    return {"dtype": "video", **described, "info": info}


def _vector(names: Sequence[str]) -> dict[str, Any]:
    return {"dtype": "float32", "shape": [len(names)], "names": list(names)}


def objects(described: Features) -> list[str]:
    """The object names from which `features` made this description."""
    names = described["observation.environment_state"]["names"]
    return [name.removesuffix(f".{STATE_FIELDS[0]}") for name in names[:: len(STATE_FIELDS)]]


def learned(described: Features) -> list[str]:
    """Names of the features with the explorer's own values: those of `LEARNED`, and parts of the reward."""
    return [name for name in described if name in LEARNED or name.startswith(PART)]


def numeric(described: Features) -> list[str]:
    """Names of all features except the image."""
    return [name for name in described if name != IMAGE]


def schema(described: Features) -> pa.Schema:
    """Arrow schema of the data files, with columns sorted by name, as in the JSON.

    Its metadata lets Hugging Face's `datasets` decode images. It has no fingerprint, which would depend on the path.
    """
    assert len(ACTION_NAMES) == N_ACTIONS
    fields, hub = [], {}
    for name, feature in sorted(described.items()):
        if feature["dtype"] == "video":
            continue
        if feature["dtype"] == "image":
            fields.append(pa.field(name, pa.struct([("bytes", pa.binary()), ("path", pa.string())])))
            hub[name] = {"_type": "Image"}
            continue
        kind, value = pa.type_for_alias(feature["dtype"]), {"dtype": feature["dtype"], "_type": "Value"}
        if feature["shape"] == [1]:
            fields.append(pa.field(name, kind))
            hub[name] = value
        else:
            length = feature["shape"][0]
            fields.append(pa.field(name, pa.list_(kind, length)))
            hub[name] = {"feature": value, "length": length, "_type": "List"}
    return pa.schema(fields, metadata={"huggingface": msgspec.json.encode({"info": {"features": hub}})})
