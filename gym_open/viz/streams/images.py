"""Images of a step: the observation, recorded depth and segmentation, and the map of where the agent was so far."""

from collections.abc import Sequence

import numpy as np
import rerun as rr

from gym_open.envs import constants as c
from gym_open.envs.constants import CELL_0, COLUMNS, PITCH, ROWS
from gym_open.envs.physics.model import kind_of
from gym_open.terminal import printable
from gym_open.viz.streams.model import Span
from gym_open.viz.view import tensors, times

IMAGE, DEPTH, SEGMENTATION = "observation/image", "observation/depth", "observation/segmentation"
NOTHING = 2**16 - 1
"""Value of a segmentation's pixel without a geom; it stands for −1 in the log."""
_DEPTH_RANGE = (0.9, 4.6)
"""Metres from the camera to the nearest corner of the table, and to the ground behind the farthest corner."""


def log_classes(rec: rr.RecordingStream, entity: str, geoms: Sequence[str]) -> None:
    """Log the name and colour of each geom for the segmentation under `entity`."""
    classes = [(number, printable(name), _colour(name)) for number, name in enumerate(geoms)]
    nothing = [(NOTHING, "nothing", (0, 0, 0))]
    rec.log(f"{entity}/{SEGMENTATION}", rr.AnnotationContext([*classes, *nothing]), static=True)


def _colour(name: str) -> tuple[int, int, int]:
    """Colour of the object that a geom belongs to; for scenery, the first word of the name decides."""
    kind = kind_of(name) if kind_of(name) in c.COLOUR else name.removeprefix("seen_").split("_", maxsplit=1)[0]
    return {**c.SCENERY_COLOUR, "corner": c.SCENERY_COLOUR["wall"], **c.COLOUR}.get(kind, (200, 200, 200))


def log_images(rec: rr.RecordingStream, entity: str, span: Span, numbers: np.ndarray) -> None:
    """Log the observations with these numbers (0…T) of the span under `entity`; other observations are not decoded."""
    at = times(span.first_step + numbers)
    images = rr.EncodedImage.columns(blob=span.pngs(numbers), media_type=["image/png"] * len(numbers))
    rec.send_columns(f"{entity}/{IMAGE}", at, images)
    if span.depth is not None:
        shown = span.depth[numbers].astype("<f4")
        depths = rr.DepthImage.columns(
            buffer=_bytes(shown),
            format=_formats(shown, rr.encodings.ChannelDatatype.F32),
            meter=[1.0] * len(shown),
            depth_range=[_DEPTH_RANGE] * len(shown),
            colormap=[rr.components.Colormap.Viridis] * len(shown),
        )
        rec.send_columns(f"{entity}/{DEPTH}", at, depths)
    if span.segmentation is not None:
        shown = np.where(span.segmentation[numbers] < 0, NOTHING, span.segmentation[numbers]).astype("<u2")
        ids = rr.SegmentationImage.columns(
            buffer=_bytes(shown), format=_formats(shown, rr.encodings.ChannelDatatype.U16)
        )
        rec.send_columns(f"{entity}/{SEGMENTATION}", at, ids)


def _bytes(images: np.ndarray) -> list[np.ndarray]:
    return [np.frombuffer(image.tobytes(), np.uint8) for image in images]


def _formats(images: np.ndarray, kind: rr.encodings.ChannelDatatype) -> list[rr.encodings.ImageFormat]:
    height, width = images.shape[1:]
    return [rr.encodings.ImageFormat(width=width, height=height, channel_datatype=kind)] * len(images)


class CoverageMap:
    """Count the steps after which the agent was in each cell of the placement grid, (16, 9), far row first.

    A position outside the grid counts for the nearest cell, as in a log's summary.
    """

    def __init__(self) -> None:
        self.counts = np.zeros((ROWS, COLUMNS), dtype=np.uint32)

    def add(self, places: np.ndarray) -> None:
        """Count positions (n, 2 or more) in metres, one per step."""
        rows = np.rint((CELL_0[1] - places[:, 1]) / PITCH).clip(0, ROWS - 1).astype(np.int64)
        columns = np.rint((places[:, 0] - CELL_0[0]) / PITCH).clip(0, COLUMNS - 1).astype(np.int64)
        np.add.at(self.counts, (rows, columns), 1)

    def log(self, rec: rr.RecordingStream, entity: str, first_step: int, places: np.ndarray, shown: np.ndarray) -> None:
        """Count a span, and log the map at some of its steps.

        Args:
            rec: the recording.
            entity: entity of the stream.
            first_step: number of the span's first step.
            places: positions after each step, (T, 2 or more).
            shown: numbers (0…T) of steps after which the map is logged, in order.
        """
        maps: list[rr.Tensor] = []
        counted = 0
        for number in shown.tolist():
            self.add(places[counted:number])
            counted = number
            maps.append(rr.Tensor(self.counts.copy(), dim_names=("far to near", "left to right")))
        self.add(places[counted:])
        if maps:
            rec.send_columns(f"{entity}/coverage", times(first_step + shown), tensors(maps))
