"""Images, neighbours and point clouds as Rerun entities.

Timeline `frame`: number of the image.

    shown/image, shown/{trained, untrained}/{1, 2, …}    the image, and its nearest neighbours by either's features
    shown/words                                          what the images show
    {trained, untrained}/{plane, space}/{COLOURING}      all images as points: the first two or three components
    {trained, untrained}/{plane, space}/{here, near}     the current image and its neighbours among these points
"""

from collections.abc import Mapping

import numpy as np
import rerun as rr

from gym_open.envs import constants as c
from gym_open.viz.features.analysis import FeatureAnalysis
from gym_open.viz.features.frames import Frames
from gym_open.viz.view import BLUE, GREEN, GREY, ORANGE, PURPLE, SKY, VERMILION, YELLOW

TIMELINE = "frame"
HERE, NEAR = (230, 0, 0), PURPLE
_WORLD_COLOURS = (ORANGE, SKY, GREEN, YELLOW, BLUE, VERMILION, PURPLE)
_FAR = 1.5
"""Distance from a goal, in metres, at the end of the colour scale."""
_GAP, _TITLE = 8, 12
"""Pixels between images, and above a row for its title."""

COLOURINGS = {
    "agent_x": ("agent's x", f"violet −{c.WALL_X:.2f} m, yellow {c.WALL_X:.2f} m"),
    "agent_y": ("agent's y", f"violet −{c.WALL_Y:.2f} m, yellow {c.WALL_Y:.2f} m"),
    "goal": ("nearest goal", f"violet touching, yellow {_FAR:.1f} m or more"),
    "world": ("world", f"the {len(_WORLD_COLOURS)} most frequent in colour, others grey"),
}
"""Title and key of each colouring of the points."""


def colours_of(frames: Frames) -> dict[str, np.ndarray]:
    """Colours (n, 3) uint8 for each of `COLOURINGS`; points without a value are grey."""
    return {
        "agent_x": _scale(frames.agent[:, 0], -c.WALL_X, c.WALL_X),
        "agent_y": _scale(frames.agent[:, 1], -c.WALL_Y, c.WALL_Y),
        "goal": _scale(frames.goal, 2 * c.RADIUS, _FAR),
        "world": _by_world(frames.worlds),
    }


def _scale(values: np.ndarray, low: float, high: float) -> np.ndarray:
    from matplotlib import colormaps

    shades = colormaps["viridis"](np.clip((values - low) / (high - low), 0, 1), bytes=True)[:, :3]
    shades[~np.isfinite(values)] = GREY
    return shades


def _by_world(worlds: np.ndarray) -> np.ndarray:
    found, counts = np.unique(worlds, return_counts=True)
    colours = np.full((len(worlds), 3), GREY, np.uint8)
    for world, colour in zip(found[np.argsort(-counts, kind="stable")], _WORLD_COLOURS, strict=False):
        colours[worlds == world] = colour
    return colours


def log_images(rec: rr.RecordingStream, frames: Frames, analyses: Mapping[str, FeatureAnalysis]) -> None:
    """Log each image with a description, and below it its neighbours by the features of each encoder."""
    pngs, size = frames.pngs(), c.IMAGE_SIZE
    _place(rec, "shown/image", 0, 0, 2.0)
    _send_images(rec, "shown/image", pngs)
    labels, corners = ["this frame"], [(float(size), 2.0 * size + 4)]
    top = 2 * size + _GAP + 2 * _TITLE
    for name, analysis in analyses.items():
        for k in range(analysis.near.shape[1]):
            left = k * (size + _GAP)
            entity = f"shown/{name}/{k + 1}"
            _place(rec, entity, left, top, 1.0)
            _send_images(rec, entity, [pngs[i] for i in analysis.near[:, k]])
            labels.append(f"{name} {k + 1}")
            corners.append((left + size / 2, top + size + 4))
        top += size + _GAP + _TITLE
    titles = rr.Points2D(corners, labels=labels, show_labels=True, radii=0.0, colors=GREY)
    rec.log("shown/titles", titles, static=True)
    words = [_words(frames, analyses, i) for i in range(len(frames))]
    columns = rr.TextDocument.columns(text=words, media_type=["text/markdown"] * len(words))
    rec.send_columns("shown/words", _times(len(frames)), columns)


def _times(count: int) -> list[rr.TimeColumn]:
    return [rr.TimeColumn(TIMELINE, sequence=np.arange(count))]


def _place(rec: rr.RecordingStream, entity: str, x: float, y: float, scale: float) -> None:
    rec.log(entity, rr.Transform3D(translation=(x, y, 0), scale=scale), static=True)


def _send_images(rec: rr.RecordingStream, entity: str, pngs: list[bytes]) -> None:
    columns = rr.EncodedImage.columns(blob=pngs, media_type=["image/png"] * len(pngs))
    rec.send_columns(entity, _times(len(pngs)), columns)


def _words(frames: Frames, analyses: Mapping[str, FeatureAnalysis], i: int) -> str:
    x, y = frames.agent[i]
    goal = f", {frames.goal[i]:.2f} m from the nearest goal" if np.isfinite(frames.goal[i]) else ""
    lines = [f"**frame {i}**: {frames.captions[i]}; agent at ({x:.2f}, {y:.2f}) m{goal}", ""]
    if any(analysis.near.shape[1] for analysis in analyses.values()):
        lines += [
            "| neighbour | frame | feature distance | agent distance (m) | shows |",
            "|---|---:|---:|---:|---|",
        ]
    for name, analysis in analyses.items():
        for k, j in enumerate(analysis.near[i].tolist()):
            apart = np.linalg.norm(frames.agent[j] - frames.agent[i])
            numbers = f"{j} | {analysis.distances[i, k]:.2f} | {apart:.2f}"
            lines.append(f"| {name} {k + 1} | {numbers} | {frames.captions[j]} |")
    return "\n".join(lines)


def log_cloud(
    rec: rr.RecordingStream, name: str, frames: Frames, analysis: FeatureAnalysis, colours: Mapping[str, np.ndarray]
) -> None:
    """Log all images as points in each colouring, and on the timeline the current image and its neighbours."""
    labels = [f"frame {i}: {caption}" for i, caption in enumerate(frames.captions)]
    plane, space = flat(analysis.points), analysis.points
    for colouring, shades in colours.items():
        style = {"colors": shades, "labels": labels, "show_labels": False, "radii": rr.Radius.ui_points(2.5)}
        rec.log(f"{name}/plane/{colouring}", rr.Points2D(plane, **style), static=True)
        rec.log(f"{name}/space/{colouring}", rr.Points3D(space, **style), static=True)
    _log_axes(rec, name, analysis)
    count, k = analysis.near.shape
    for dimensions, points, archetype in (("plane", plane, rr.Points2D), ("space", space, rr.Points3D)):
        for mark, colour, size in (("here", HERE, 7.0), ("near", NEAR, 5.0)):
            style = archetype.from_fields(colors=colour, radii=rr.Radius.ui_points(size))
            rec.log(f"{name}/{dimensions}/{mark}", style, static=True)
        rec.send_columns(f"{name}/{dimensions}/here", _times(count), archetype.columns(positions=points))
        near = archetype.columns(positions=points[analysis.near].reshape(-1, points.shape[1]))
        rec.send_columns(f"{name}/{dimensions}/near", _times(count), near.partition([k] * count))


def flat(points: np.ndarray) -> np.ndarray:
    """The first two components (n, 2) with the second pointing up; y points down in Rerun's 2D views."""
    return points[:, :2] * (1, -1)


def _log_axes(rec: rr.RecordingStream, name: str, analysis: FeatureAnalysis) -> None:
    """A line and a title for each component through the middle of the cloud."""
    ends = np.diag(np.abs(analysis.points).max(axis=0) * 1.15 + 1e-6)
    shares = [*analysis.explained[:3], 0.0, 0.0, 0.0][:3]
    titles = [f"PC {i + 1} ({share:.0%})" for i, share in enumerate(shares)]
    lines = np.stack([-ends, ends], axis=1)
    rec.log(f"{name}/plane/axes", rr.LineStrips2D([flat(line) for line in lines[:2]], colors=GREY), static=True)
    tips = rr.Points2D(flat(0.8 * ends[:2]), labels=titles[:2], show_labels=True, radii=0.0, colors=GREY)
    rec.log(f"{name}/plane/titles", tips, static=True)
    rec.log(f"{name}/space/axes", rr.LineStrips3D(lines, colors=GREY), static=True)
    tips = rr.Points3D(0.9 * ends, labels=titles, show_labels=True, radii=0.0, colors=GREY)
    rec.log(f"{name}/space/titles", tips, static=True)
