"""The recording of an encoder is read back: images, points and neighbours match the release and the encoder."""

from collections.abc import Callable
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import pytest
import rerun as rr
import torch

from gym_open import artefacts
from gym_open.agents.architectures import make_encoder
from gym_open.agents.config import EncoderConfig
from gym_open.agents.encoder import Encoder
from gym_open.agents.policy import ActorCritic
from gym_open.config import Config
from gym_open.datasets.build import build_release
from gym_open.datasets.config import ReleaseConfig
from gym_open.envs.physics.model import INVENTORY
from gym_open.errors import ArtefactError, UsageError
from gym_open.formats.models import save_encoder, save_policy
from gym_open.formats.pngs import decode_png
from gym_open.formats.releases import Release, open_release
from gym_open.viz import features
from gym_open.viz.config import Choice, VizConfig
from gym_open.viz.features.frames import of_random_actions, of_release
from gym_open.viz.view import View

MakeLog = Callable[..., Path]
SMALL = EncoderConfig(features=16)
CURVE = '{"columns": ["update", "loss", "held_out_loss"], "rows": [[100, 0.5, null], [200, 0.25, 0.75]]}'


class Nothing(Config, frozen=True):
    """An empty configuration."""


class Drawn(NamedTuple):
    """The view of an encoder's features of a release."""

    path: Path
    release: Release
    encoder: Encoder
    read_back: Callable[[Path], Any]

    def column(self, entity: str, component: str) -> list[Any]:
        """The component at each frame."""
        frames, values = self.read_back(self.path).column(entity, component, index="frame")
        assert frames == list(range(len(self.release)))
        return values

    def static(self, entity: str, component: str) -> Any:
        return self.read_back(self.path).static(entity, component)


def build(folder: Path, kind: str, save: Callable[[Path], None]) -> Path:
    def work(partial: Path) -> dict[str, Any]:
        save(partial)
        return {}

    return artefacts.build(folder, kind=kind, config=Nothing(), parents=[], work=work).path


def fill(view: View, path: Path) -> None:
    with rr.RecordingStream("test", recording_id="test") as rec:
        rec.save(path, default_blueprint=view.blueprint)
        view.fill(rec)


@pytest.fixture(scope="module")
def release(make_log: MakeLog, no_figures: None, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """14 frames in two worlds."""
    log = make_log(lengths=((5, 7),), seed=4)
    return build_release(ReleaseConfig(), [log], tmp_path_factory.mktemp("release") / "r").path


@pytest.fixture(scope="module")
def drawn(release: Path, tmp_path_factory: pytest.TempPathFactory, read_back: Callable[[Path], Any]) -> Drawn:
    folder = tmp_path_factory.mktemp("features")
    encoder = Encoder(SMALL, torch.Generator().manual_seed(1))

    def save(partial: Path) -> None:
        save_encoder(partial, encoder)
        (partial / "curve.json").write_text(CURVE)

    source = build(folder / "encoder", "encoder", save)
    fill(features.view(VizConfig(), source, Choice(release=release)), folder / "features.rrd")
    return Drawn(folder / "features.rrd", open_release(release), encoder, read_back)


def neighbours(drawn: Drawn) -> np.ndarray:
    """Neighbours (14, 4), computed with the encoder and a separate search."""
    images = torch.from_numpy(drawn.release.images(np.arange(len(drawn.release))))
    found = drawn.encoder.encode(images).double()
    apart = torch.cdist(found, found).numpy()
    np.fill_diagonal(apart, np.inf)
    return np.argsort(apart, axis=1)[:, :4]


def test_images_are_the_releases_and_neighbours_the_encoders(drawn: Drawn) -> None:
    """A release with few frames is shown completely, in its own order."""
    images = drawn.release.images(np.arange(len(drawn.release)))
    shown = [decode_png(bytes(blob[0])) for blob in drawn.column("/shown/image", "EncodedImage:blob")]
    assert np.array_equal(shown, images)
    near = neighbours(drawn)
    for k in range(4):
        found = [decode_png(bytes(b[0])) for b in drawn.column(f"/shown/trained/{k + 1}", "EncodedImage:blob")]
        assert np.array_equal(found, images[near[:, k]])


@pytest.mark.parametrize(("kind", "archetype"), [("plane", "Points2D"), ("space", "Points3D")])
def test_marked_points_are_the_frame_and_its_neighbours(drawn: Drawn, kind: str, archetype: str) -> None:
    cloud = np.array(drawn.static(f"/trained/{kind}/world", f"{archetype}:positions"))
    here = np.array(drawn.column(f"/trained/{kind}/here", f"{archetype}:positions"))
    assert np.array_equal(here[:, 0], cloud)
    near = np.array(drawn.column(f"/trained/{kind}/near", f"{archetype}:positions"))
    assert np.array_equal(near, cloud[neighbours(drawn)])
    untrained = np.array(drawn.static(f"/untrained/{kind}/world", f"{archetype}:positions"))
    assert untrained.shape == cloud.shape
    assert not np.allclose(untrained, cloud)


def test_the_untrained_encoder_shares_only_the_mean_image(drawn: Drawn, release: Path, tmp_path: Path) -> None:
    clouds = [drawn.static("/untrained/space/world", "Points3D:positions")]
    for seed, mean in ((2, 0.0), (1, 100.0)):
        encoder = Encoder(SMALL, torch.Generator().manual_seed(seed))
        encoder.mean_image.fill_(mean)
        source = build(tmp_path / f"encoder{seed}", "encoder", lambda partial, one=encoder: save_encoder(partial, one))
        other = drawn._replace(path=tmp_path / f"{seed}.rrd")
        fill(features.view(VizConfig(), source, Choice(release=release)), other.path)
        clouds.append(other.static("/untrained/space/world", "Points3D:positions"))
    same, other_weights, other_mean = np.array(clouds)
    assert np.array_equal(same, other_weights)
    assert not np.allclose(same, other_mean, atol=0.01)


def test_the_second_component_goes_up(drawn: Drawn) -> None:
    """The y axis points down in Rerun's 2D views."""
    plane = np.array(drawn.static("/trained/plane/world", "Points2D:positions"))
    space = np.array(drawn.static("/trained/space/world", "Points3D:positions"))
    assert np.array_equal(plane, space[:, :2] * (1, -1))


def test_colours_tell_worlds_apart_and_points_say_which_frame_they_are(drawn: Drawn) -> None:
    colours = np.array(drawn.static("/trained/plane/world", "Points2D:colors"))
    episodes = drawn.release.episodes
    own = np.repeat(episodes["world"].to_numpy(), episodes["length"].to_numpy())
    assert len({(world, colour) for world, colour in zip(own, colours, strict=True)}) == len(set(own)) == 2
    labels = drawn.static("/trained/plane/world", "Points2D:labels")
    assert labels[0] == "frame 0: stream 0, step 0, episode 0"
    assert labels[-1] == "frame 13: stream 0, step 12, episode 1"


def test_words_and_documents(drawn: Drawn) -> None:
    words = [text[0] for text in drawn.column("/shown/words", "TextDocument:text")]
    first = neighbours(drawn)[3, 0]
    assert "**frame 3**: stream 0, step 3, episode 0" in words[3]
    assert f"| trained 1 | {first} |" in words[3]
    about = drawn.static("/about/features", "TextDocument:text")[0]
    assert "14 of the 14 frames of" in about
    assert "| units | 16 | 16 |" in about
    for entity in ("/about/variance", "/about/learning"):
        assert bytes(drawn.static(entity, "EncodedImage:blob")[0]).startswith(b"\x89PNG")
    assert "Settings" in drawn.static("/about/config", "TextDocument:text")[0]


def test_a_sample_is_drawn_without_replacement_and_always_the_same(release: Path) -> None:
    opened = open_release(release)
    one, other = of_release(opened, 9), of_release(opened, 9)
    assert one.captions == other.captions
    assert len(set(one.captions)) == 9
    assert np.array_equal(one.images, other.images)


def test_facts_about_a_frame_are_those_of_the_release(release: Path) -> None:
    opened = open_release(release)
    frames = of_release(opened)
    assert np.allclose(frames.agent, opened.column("observation.state")[:, :2])
    states = opened.column("observation.environment_state").reshape(len(opened), len(INVENTORY), 13)
    for i, state in enumerate(states):
        apart = [
            float(np.hypot(*(state[j, :2] - frames.agent[i])))
            for j, name in enumerate(INVENTORY)
            if name[:-2] in {"yellow", "green"} and abs(state[j, 0]) <= 0.641 and abs(state[j, 1]) <= 1.1218
        ]
        assert np.isnan(frames.goal[i]) if not apart else frames.goal[i] == pytest.approx(min(apart))


def test_random_actions_are_in_new_worlds() -> None:
    frames = of_random_actions(45)
    assert len(frames) == 45
    assert np.array_equal(frames.worlds, np.arange(45) // 2)
    assert len(np.unique(frames.images.reshape(45, -1), axis=0)) == 45
    assert (np.abs(frames.agent) <= (0.641, 1.1218)).all()
    assert (frames.goal > 0.09).all()  # both are balls of 0.05 m
    assert np.array_equal(of_random_actions(3).images[0], frames.images[0])


def test_a_source_without_an_encoder_of_images_is_refused(tmp_path: Path, release: Path, make_log: MakeLog) -> None:
    told = EncoderConfig(architecture="state", features=8)
    policy = ActorCritic(make_encoder(told, torch.Generator()), 9, torch.Generator())
    state = build(tmp_path / "state", "policy", lambda partial: save_policy(partial, policy))
    with pytest.raises(ArtefactError, match="gets the simulator state instead of images"):
        features.view(VizConfig(), state, Choice())
    with pytest.raises(ArtefactError, match="a log without an encoder"):
        features.view(VizConfig(), make_log(lengths=((2,),)), Choice())
    encoder = build(tmp_path / "e", "encoder", lambda partial: save_encoder(partial, Encoder(SMALL, torch.Generator())))
    with pytest.raises(UsageError, match="--episode"):
        features.view(VizConfig(), encoder, Choice(episode=1))
    with pytest.raises(ArtefactError, match="release"):
        features.view(VizConfig(), encoder, Choice(release=encoder))


def test_a_policys_own_encoder_and_that_of_a_log_are_shown(tmp_path: Path) -> None:
    policy = ActorCritic(make_encoder(SMALL, torch.Generator()), 9, torch.Generator())
    source = build(tmp_path / "policy", "policy", lambda partial: save_policy(partial, policy))
    assert features.view(VizConfig(), source, Choice()).title == "features of policy"
    log = build(tmp_path / "log", "log", lambda p: save_encoder(p / "encoder", Encoder(SMALL, torch.Generator())))
    assert features.view(VizConfig(), log, Choice()).title == "features of log"
