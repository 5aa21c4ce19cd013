"""Fragments of MJCF, MuJoCo's XML format."""

from collections.abc import Iterable

from gym_open.envs import constants as c


def box(
    name: str,
    place: Iterable[float],
    half: Iterable[float],
    colour: str,
    *,
    kind: str = "scenery",
    euler: Iterable[float] = (0, 0, 0),
    solref: str = "",
) -> str:
    """A box of scenery with half edges `half`, in the class `kind`."""
    extra = f' solref="{solref}"' if solref else ""
    return (
        f'<geom name="{name}" class="{kind}" type="box" pos="{text(place)}" size="{text(half)}" '
        f'euler="{text(euler)}" rgba="{rgba(c.SCENERY_COLOUR[colour])}"{extra}/>'
    )


def rgba(colour: tuple[int, int, int]) -> str:
    """A colour of 0–255 in MJCF."""
    return text([*(value / 255 for value in colour), 1])


def text(values: Iterable[float]) -> str:
    """Numbers as text, exact to nine digits."""
    return " ".join(f"{float(value):.9g}" for value in values)


def indented(lines: list[str], levels: int = 1) -> list[str]:
    """The lines, indented by `levels`."""
    return ["  " * levels + line for line in lines]
