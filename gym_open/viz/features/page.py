"""An encoder: its features of some pictures in two and three dimensions, linked to the pictures themselves."""

from pathlib import Path
from typing import TYPE_CHECKING

from gym_open import artefacts, seeding
from gym_open.errors import ArtefactError
from gym_open.viz.config import Choice, VizConfig
from gym_open.viz.view import View

if TYPE_CHECKING:
    import numpy as np
    import rerun as rr

    from gym_open.agents.encoder import Encoder

_BATCH = 250
TRAINED, UNTRAINED = "trained", "untrained"


def view(config: VizConfig, source: Path, choice: Choice) -> View:  # noqa: ARG001  (as every view)
    """What the encoder in `source` makes of pictures, beside an untrained one of the same shape.

    The pictures are of the release that `choice` names, or, without one, of random play in sandbox worlds. Its
    training curve is in a tab of its own, if there is one.

    Args:
        config: not asked: so many pictures are shown that each can have its neighbours beside it.
        source: an encoder or policy artefact, or a log whose explorer had an encoder.
        choice: perhaps a release.

    Raises:
        ArtefactError: if an artefact is damaged, or `source` has no encoder that looks at pictures.
        UsageError: if something else than a release was picked.
    """
    from gym_open.formats.releases import open_release
    from gym_open.results.records import read_curve
    from gym_open.viz.features import layout

    choice.refuse_others("an encoder", {"release"})
    artefacts.verify(source, hashed=lambda name: not name.endswith(".mcap"))  # of a log, only its encoder is read
    encoder = _load(source)
    release = None if choice.release is None else open_release(choice.release)
    curve, name = read_curve(source), source.resolve().name

    def fill(rec: "rr.RecordingStream") -> None:
        from gym_open.viz.curves.figure import draw_curve
        from gym_open.viz.documents import lineage, settings
        from gym_open.viz.features import drawing
        from gym_open.viz.features.analysis import analyse
        from gym_open.viz.features.frames import of_random_play, of_release
        from gym_open.viz.features.words import document, draw_variance
        from gym_open.viz.view import log_document, log_figure

        frames = of_random_play() if release is None else of_release(release)
        both = {TRAINED: encoder, UNTRAINED: _untrained(encoder)}
        looked = {which: analyse(_features(one, frames.images)) for which, one in both.items()}
        drawing.log_pictures(rec, frames, looked)
        colours = drawing.colours_of(frames)
        for which, analysis in looked.items():
            drawing.log_cloud(rec, which, frames, analysis, colours)
        log_document(rec, "about/features", document(encoder.config, frames, looked))
        log_figure(rec, "about/variance", draw_variance(looked))
        if curve is not None:
            log_figure(rec, "about/learning", draw_curve(curve))
        log_document(rec, "about/config", settings(f"Configuration of {name}", {}, artefacts.config_of(source)))
        log_document(rec, "about/lineage", lineage(f"Lineage of {name}", artefacts.lineage(source), {}))

    return View(f"features of {name}", fill, layout.blueprint((TRAINED, UNTRAINED), curve=curve is not None))


def _load(source: Path) -> "Encoder":
    from gym_open.agents.encoder import Encoder
    from gym_open.formats.models import load_encoder, load_policy

    if artefacts.lineage(source).kind != "policy":
        return load_encoder(source)
    encoder = load_policy(source).encoder
    if not isinstance(encoder, Encoder):
        raise ArtefactError(
            f"{source}: its policy is told the state and looks at no picture, so it has no features of pictures; give "
            "one that sees"
        )
    return encoder


def _untrained(trained: "Encoder") -> "Encoder":
    """The same network with weights as they are drawn, and the trained one's mean picture."""
    import torch

    from gym_open.agents.encoder import Encoder

    encoder = Encoder(trained.config, torch.Generator().manual_seed(seeding.integer(0, "viz", "untrained")))
    encoder.mean_image.copy_(trained.mean_image)
    return encoder


def _features(encoder: "Encoder", images: "np.ndarray") -> "np.ndarray":
    """(n, D) float32 features of pictures (n, 84, 84, 3)."""
    import numpy as np

    return np.concatenate([encoder.encode(images[i : i + _BATCH]).numpy() for i in range(0, len(images), _BATCH)])
