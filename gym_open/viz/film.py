"""Files that viz writes, completely or not at all: films as MP4 (PyAV) or GIF (Pillow), and helpers for frames."""

import os
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numpy as np
from PIL import Image, ImageFont

from gym_open import artefacts
from gym_open.errors import UsageError
from gym_open.files import unwritable
from gym_open.processes import interruptible

FILMS = (".mp4", ".gif")
PAPER, INK, FAINT = (250, 250, 248), (25, 25, 25), (110, 110, 110)


def write_film(out: Path, frames: Iterator[np.ndarray], fps: int) -> Path:
    """Write frames (H, W, 3) uint8 as MP4 or GIF; the suffix decides.

    MP4 is coded as H.264, which needs an even width and height. A GIF is held in memory until it is written, and shows
    at most 50 frames per second.
    """
    write = _write_mp4 if out.suffix == ".mp4" else _write_gif
    return write_whole(out, lambda partial: write(partial, frames, fps))


def write_whole(out: Path, write: Callable[[Path], Any]) -> Path:
    """Write a temporary file next to `out`, then rename it to `out`.

    Raises:
        ArtefactError: if the file cannot be written.
        UsageError: if `out` lies in a finished artefact.
    """
    refuse_artefact(out)
    partial = out.with_name(f".{out.name}.{os.getpid()}.tmp")
    try:
        out.parent.mkdir(parents=True, exist_ok=True)
        partial.touch()
    except OSError as error:
        raise unwritable(out, error) from None
    with interruptible():
        try:
            write(partial)
            return partial.replace(out)
        except OSError as error:
            raise unwritable(out, error) from None
        finally:
            partial.unlink(missing_ok=True)


def refuse_artefact(out: Path) -> None:
    """Refuse to write into a finished artefact, because its manifest lists all its files.

    Raises:
        UsageError: if `out` lies in one.
    """
    for folder in out.resolve().parents:
        finished = not folder.name.startswith(".")  # hidden folders are unfinished artefacts, which may get this file
        if finished and all((folder / name).is_file() for name in (artefacts.MANIFEST, artefacts.LINEAGE)):
            raise UsageError(f"{out}: lies in the artefact {folder}, whose files are fixed; give a path outside it")


def check_suffix(out: Path, known: tuple[str, ...]) -> None:
    """Refuse a file name with another suffix.

    Raises:
        UsageError: if the suffix is not in `known`.
    """
    if out.suffix not in known:
        found = repr(out.suffix) if out.suffix else "none"
        raise UsageError(f"{out}: expected a file name that ends in {' or '.join(known)}, got {found}")


def typeface(size: int) -> ImageFont.FreeTypeFont:
    """The font DejaVu Sans, which has arrows and is part of matplotlib."""
    import matplotlib as mpl

    return ImageFont.truetype(str(Path(mpl.get_data_path(), "fonts", "ttf", "DejaVuSans.ttf")), size)


def even(frame: Image.Image) -> np.ndarray:
    """The frame with an even width and height, as H.264 needs it: (H, W, 3) uint8."""
    width, height = frame.size
    page = Image.new("RGB", (width + width % 2, height + height % 2), PAPER)
    page.paste(frame)
    return np.asarray(page)


def enlarged(image: np.ndarray, size: int) -> np.ndarray:
    """A square image at another size without smoothing: (size, size, 3) uint8."""
    return np.asarray(Image.fromarray(image).resize((size, size), Image.Resampling.NEAREST))


def _write_mp4(path: Path, frames: Iterator[np.ndarray], fps: int) -> None:
    import av

    with av.open(str(path), "w", format="mp4") as container:
        stream = container.add_stream("libx264", rate=fps, options={"crf": "18"})
        stream.pix_fmt = "yuv420p"
        for number, frame in enumerate(frames):
            if number == 0:
                stream.height, stream.width = frame.shape[:2]
            container.mux(stream.encode(av.VideoFrame.from_ndarray(frame, format="rgb24")))
        container.mux(stream.encode())


def _write_gif(path: Path, frames: Iterator[np.ndarray], fps: int) -> None:
    images = [Image.fromarray(frame).quantize(128, dither=Image.Dither.NONE) for frame in frames]
    images[0].save(
        path, format="GIF", save_all=True, append_images=images[1:], duration=max(20, round(1000 / fps)), loop=0
    )
