"""`gym-open train probe`: measure what a linear map can read from a frozen encoder about new worlds."""

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import torch
import torch.nn.functional as F
from torch import Tensor

from gym_open import artefacts, progress, seeding
from gym_open.agents.architectures import make_image_encoder
from gym_open.agents.encoder import ImageEncoder
from gym_open.agents.threads import threads
from gym_open.artefacts import Lineage
from gym_open.envs.constants import MOVES as DIRECTIONS
from gym_open.envs.constants import PITCH
from gym_open.formats.models import load_encoder
from gym_open.train.config import ProbeConfig
from gym_open.train.probe.ridge import fit_ridge
from gym_open.train.probe.scores import ProbeScore, auc, auc_score, mean_score, r2_score, ratio_score, resample
from gym_open.train.probe.worlds import BODIES, MOVES, ProbeSample, draw_samples

PROBE = "probe.json"
PARTS = ("train", "validation", "test")
PLACES = (*BODIES, "to_yellow")
TARGETS = (*PLACES, "displacement", "contact", "move")
"""What the probes predict: the position of each body; where the goal is, seen from the agent; for a given move, how far
it takes the agent and whether it touches something; and the move itself, from the images before and after it."""
MEASURES = {"displacement": "r2", "contact": "auc", "move": "accuracy"}
"""Measure of each target; places have `r2`."""
BATCH = 500


@dataclass(frozen=True)
class ProbeResult:
    """Results for one kind of features: scores by target, and mean distances in cells by place."""

    scores: dict[str, ProbeScore]
    cells: dict[str, float]


def probe(config: ProbeConfig, encoder: Path, out: Path) -> artefacts.Outcome:
    """Probe a frozen encoder, untrained encoders of the same architecture, and the pixels.

    All maps are ridge regressions (`fit_ridge`) on features of images of an agent that moves at random. Payload,
    `probe.json`:

        {"targets": {TARGET: {
             "measure": "r2" | "auc" | "accuracy",
             "guess": score without the image,
             "scores": {FEATURES: {"value", "low", "high", "error_cells"}},
             "gain": {"value", "low", "high"}}},
         "worlds": {"train", "validation", "test"}, "moves": moves in each world}

    Targets:

    - positions of `agent`, `yellow`, `green`, `heavy` and `light`, and of yellow relative to the agent, `to_yellow`: r2
      over both coordinates; `error_cells`, for these only, is the mean distance in cells of the grid;
    - `displacement` of the agent in its next move (r2 over the mean of that move) and `contact` in it (area under the
      ROC curve), with one map per move;
    - `move`, one of eight, from the difference of the features after and before it: the map predicts its direction, and
      the nearest of the eight is the answer (share of right answers).

    Features: `trained`, `untrained` (mean over `config.untrained` draws of the weights) and, on request, `pixels`.
    `gain` is `trained` minus `untrained`. Intervals have level 95% and come from resampling the test worlds.

    Args:
        config: numbers of worlds, strengths of regularisation, seed.
        encoder: an encoder artefact, or a log whose explorer had an encoder.
        out: folder of the result.

    Raises:
        ArtefactError: if the encoder is damaged.
    """

    def work(partial: Path) -> Mapping[str, Any]:
        torch.set_num_threads(config.threads)
        trained = load_encoder(encoder)
        known = logged_puzzles(artefacts.lineage(encoder))
        sizes = {"train": config.train_worlds, "validation": config.validation_worlds, "test": config.test_worlds}
        samples = draw_samples(sizes, config.moves, known, config.seed)
        record = {"targets": score(config, trained, samples), "worlds": sizes, "moves": config.moves}
        (partial / PROBE).write_bytes(artefacts.canonical_json(record))
        return {"worlds": sum(sizes.values())}

    return artefacts.build(out, kind="probe", config=config, parents=[encoder], work=work)


def logged_puzzles(lineage: Lineage) -> set[str]:
    """Digests of all puzzles in the logs that an artefact comes from."""
    own = set(lineage.facts.get("puzzles", []))
    return own.union(*(logged_puzzles(parent.lineage) for parent in lineage.parents))


def score(config: ProbeConfig, trained: ImageEncoder, samples: Mapping[str, ProbeSample]) -> dict[str, dict[str, Any]]:
    """The value of `targets` in probe.json."""
    resamples = resample(len(samples["test"].images), seeding.generator(config.seed, "probe", "resamples"))
    found: dict[str, ProbeResult] = {}
    with progress.bar("probe", 1 + config.untrained + config.pixels) as bar:

        def look(encoder: ImageEncoder | None) -> ProbeResult:
            with threads(config.threads):
                features = {part: _features(encoder, sample.images) for part, sample in samples.items()}
            looked = _look(config, features, samples, resamples)
            bar.advance()
            return looked

        found["trained"] = look(trained)
        found["untrained"] = _mean([look(_untrained(config, trained, i)) for i in range(config.untrained)])
        if config.pixels:
            found["pixels"] = look(None)
    guesses = _guesses(samples)
    return {target: _row(target, found, guesses.get(target, 0.0)) for target in TARGETS}


def _row(target: str, found: Mapping[str, ProbeResult], guess: float) -> dict[str, Any]:
    scores = {name: one.scores[target].record() for name, one in found.items()}
    for name, one in found.items():
        if target in one.cells:
            scores[name]["error_cells"] = one.cells[target]
    gain = (found["trained"].scores[target] - found["untrained"].scores[target]).record()
    return {"measure": MEASURES.get(target, "r2"), "guess": guess, "scores": scores, "gain": gain}


def _guesses(samples: Mapping[str, ProbeSample]) -> dict[str, float]:
    """Scores without an image, where they are not 0."""
    train, test = samples["train"], samples["test"]
    rates = _by_move(train.contacts.double()[..., None], train.moves)[test.moves]
    return {"contact": auc(rates.numpy(), test.contacts.numpy()), "move": 1 / MOVES}


def _mean(found: list[ProbeResult]) -> ProbeResult:
    scores = {target: mean_score([one.scores[target] for one in found]) for target in TARGETS}
    return ProbeResult(scores, {place: float(np.mean([one.cells[place] for one in found])) for place in PLACES})


def _untrained(config: ProbeConfig, trained: ImageEncoder, number: int) -> ImageEncoder:
    init = torch.Generator().manual_seed(seeding.integer(config.seed, "probe", "untrained", number))
    encoder = make_image_encoder(trained.config, init)
    encoder.mean_image.copy_(trained.mean_image)
    return encoder


def _features(encoder: ImageEncoder | None, images: Tensor) -> Tensor:
    """(W, T + 1, D) features in fp64 of images (W, T + 1, 84, 84, 3); without an encoder, the pixels as they are."""
    if encoder is None:
        return images.flatten(2)
    features = torch.cat([encoder.encode(batch) for batch in images.flatten(0, 1).split(BATCH)])
    return features.double().reshape(*images.shape[:2], -1)


def _numbers(features: Tensor) -> Tensor:
    """Features for a regression. Pixels are fp32, in which twenty thousand columns take half the time."""
    return features if features.is_floating_point() else features.float()


def _look(
    config: ProbeConfig, features: Mapping[str, Tensor], samples: Mapping[str, ProbeSample], resamples: np.ndarray
) -> ProbeResult:
    scores, cells = _positions(config, features, samples, resamples)
    scores.update(_consequences(config, features, samples, resamples))
    scores["move"] = _which_move(config, features, samples, resamples)
    return ProbeResult(scores, cells)


def _positions(
    config: ProbeConfig, features: Mapping[str, Tensor], samples: Mapping[str, ProbeSample], resamples: np.ndarray
) -> tuple[dict[str, ProbeScore], dict[str, float]]:
    """Predict the positions of bodies, and of yellow relative to the agent, from the first image of each world."""
    x = {part: _numbers(features[part][:, 0]) for part in PARTS}
    true = {part: _places(samples[part]) for part in PARTS}
    found = _fitted(config, x, {part: places.flatten(1) for part, places in true.items()})
    errors = (found.unflatten(1, (len(PLACES), 2)) - true["test"]).square().sum(dim=2)
    guess_errors = (true["test"] - true["train"].mean(dim=0)).square().sum(dim=2)
    scores = {
        place: r2_score(errors[:, i].numpy(), guess_errors[:, i].numpy(), resamples) for i, place in enumerate(PLACES)
    }
    return scores, {place: errors[:, i].sqrt().mean().item() / PITCH for i, place in enumerate(PLACES)}


def _places(sample: ProbeSample) -> Tensor:
    """(W, places, 2) in the order of `PLACES`."""
    bodies = sample.positions[:, 0]
    names = list(BODIES)
    relative = bodies[:, names.index("yellow")] - bodies[:, names.index("agent")]
    return torch.cat([bodies, relative[:, None]], dim=1)


def _consequences(
    config: ProbeConfig, features: Mapping[str, Tensor], samples: Mapping[str, ProbeSample], resamples: np.ndarray
) -> dict[str, ProbeScore]:
    """Predict displacement and contact from the image before a move, with one map per move."""
    outcomes = {part: _outcomes(sample) for part, sample in samples.items()}
    means = _by_move(outcomes["train"], samples["train"].moves)
    test = samples["test"]
    found = means[test.moves]
    for move in range(MOVES):
        rows = {part: samples[part].moves == move for part in PARTS}
        if all(chosen.any() for chosen in rows.values()):
            x = {part: _numbers(features[part][:, :-1][rows[part]]) for part in PARTS}
            y = {part: outcomes[part][rows[part]] for part in PARTS}
            found[rows["test"]] = _fitted(config, x, y)
    true = outcomes["test"]
    errors, guess_errors = (
        (guess - true)[..., :2].square().sum(dim=(1, 2)).numpy() for guess in (found, means[test.moves])
    )
    return {
        "displacement": r2_score(errors, guess_errors, resamples),
        "contact": auc_score(found[..., 2].numpy(), test.contacts.numpy(), resamples),
    }


def _which_move(
    config: ProbeConfig, features: Mapping[str, Tensor], samples: Mapping[str, ProbeSample], resamples: np.ndarray
) -> ProbeScore:
    """Predict the direction of the move from the first two images; the nearest of the eight moves is the answer."""
    directions = torch.tensor(DIRECTIONS[1:], dtype=torch.float64)
    x = {part: _numbers(features[part][:, 1]) - _numbers(features[part][:, 0]) for part in PARTS}
    y = {part: directions[samples[part].moves[:, 0]] for part in PARTS}
    right = torch.cdist(_fitted(config, x, y), directions).argmin(dim=1) == samples["test"].moves[:, 0]
    return ratio_score(right.double().numpy(), np.ones(len(right)), resamples)


def _fitted(config: ProbeConfig, x: Mapping[str, Tensor], y: Mapping[str, Tensor]) -> Tensor:
    """Fit a map and return its predictions for part `test`, (n, K) fp64."""
    kind = x["train"].dtype
    ridge = fit_ridge(x["train"], y["train"].to(kind), (x["validation"], y["validation"].to(kind)), config.ridge)
    return ridge.predict(x["test"]).double()


def _outcomes(sample: ProbeSample) -> Tensor:
    """(W, T, 3): displacement of the agent in metres, and 1 if it touched something."""
    agent = sample.positions[:, :, 0]
    return torch.cat([agent[:, 1:] - agent[:, :-1], sample.contacts.double()[..., None]], dim=2)


def _by_move(values: Tensor, moves: Tensor) -> Tensor:
    """Mean of values (W, T, K) by move: (8, K); 0 for a move that never occurred."""
    done = F.one_hot(moves.flatten(), MOVES).double()
    return done.T @ values.flatten(0, 1) / done.sum(dim=0).clamp(min=1)[:, None]
