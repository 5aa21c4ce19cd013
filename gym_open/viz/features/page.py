"""The view of an encoder: its features of some images in two and three dimensions, linked to the images."""

from pathlib import Path
from typing import TYPE_CHECKING

from gym_open import artefacts, seeding
from gym_open.errors import ArtefactError
from gym_open.viz.config import Choice, VizConfig
from gym_open.viz.view import View

if TYPE_CHECKING:
    import numpy as np
    import rerun as rr

    from gym_open.agents.encoder import ImageEncoder

_BATCH = 250
TRAINED, UNTRAINED = "trained", "untrained"


def view(config: VizConfig, source: Path, choice: Choice) -> View:  # noqa: ARG001  (the same for every view)
    """The features of the encoder in `source`, next to those of an untrained encoder of the same shape.

    The images come from the release that `choice` names, or without one from random actions in sandbox worlds. If there
    is a training curve, it has its own tab.

    Args:
        config: not used: the number of images is fixed, so that each can be shown with its neighbours.
        source: an encoder or policy artefact, or a log whose explorer had an encoder.
        choice: may name a release.

    Raises:
        ArtefactError: if an artefact is damaged, or `source` has no encoder of images.
        UsageError: if `choice` selects anything else than a release.
    """
    from gym_open.replay.compact import open_dataset
    from gym_open.results.records import read_curve
    from gym_open.viz.features import layout

    choice.refuse_others("an encoder", {"release"})
    artefacts.verify(source, hashed=lambda name: not name.endswith(".mcap"))  # this reads only the encoder of a log
    encoder = _load(source)
    release = None if choice.release is None else open_dataset(choice.release)
    curve, name = read_curve(source), source.resolve().name

    def fill(rec: "rr.RecordingStream") -> None:
        from gym_open.viz.curves.figure import draw_curve
        from gym_open.viz.documents import lineage, settings
        from gym_open.viz.features import drawing
        from gym_open.viz.features.analysis import analyse
        from gym_open.viz.features.documents import document, draw_variance
        from gym_open.viz.features.frames import of_random_actions, of_release
        from gym_open.viz.view import log_document, log_figure

        frames = of_random_actions() if release is None else of_release(release)
        both = {TRAINED: encoder, UNTRAINED: _untrained(encoder)}
        analyses = {which: analyse(_features(network, frames.images)) for which, network in both.items()}
        drawing.log_images(rec, frames, analyses)
        colours = drawing.colours_of(frames)
        for which, analysis in analyses.items():
            drawing.log_cloud(rec, which, frames, analysis, colours)
        log_document(rec, "about/features", document(encoder.config, frames, analyses))
        log_figure(rec, "about/variance", draw_variance(analyses))
        if curve is not None:
            log_figure(rec, "about/learning", draw_curve(curve))
        log_document(rec, "about/config", settings(f"Configuration of {name}", {}, artefacts.config_of(source)))
        log_document(rec, "about/lineage", lineage(f"Lineage of {name}", artefacts.lineage(source), {}))

    return View(f"features of {name}", fill, layout.blueprint((TRAINED, UNTRAINED), curve=curve is not None))


def _load(source: Path) -> "ImageEncoder":
    from gym_open.agents.encoder import ImageEncoder
    from gym_open.formats.models import load_encoder, load_policy

    if artefacts.lineage(source).kind != "policy":
        return load_encoder(source)
    encoder = load_policy(source).encoder
    if not isinstance(encoder, ImageEncoder):
        raise ArtefactError(
            f"{source}: its policy gets the simulator state instead of images, so it has no features of images; give "
            "a policy that gets images"
        )
    return encoder


def _untrained(trained: "ImageEncoder") -> "ImageEncoder":
    """The same network with freshly drawn weights, and with the trained network's mean image."""
    import torch

    from gym_open.agents.architectures import make_image_encoder

    encoder = make_image_encoder(trained.config, torch.Generator().manual_seed(seeding.integer(0, "viz", "untrained")))
    encoder.mean_image.copy_(trained.mean_image)
    return encoder


def _features(encoder: "ImageEncoder", images: "np.ndarray") -> "np.ndarray":
    """(n, D) float32 features of images (n, 84, 84, 3)."""
    import numpy as np

    return np.concatenate([encoder.encode(images[i : i + _BATCH]).numpy() for i in range(0, len(images), _BATCH)])
