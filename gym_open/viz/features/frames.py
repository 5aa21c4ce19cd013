"""The images for an encoder, with facts about each image: from a release, or from random actions."""

import msgspec
import numpy as np

from gym_open import progress, seeding
from gym_open.envs import constants as c
from gym_open.formats.pngs import encode_pngs
from gym_open.formats.releases import Release

COUNT = 1_000
"""Number of images: enough to see the shape of a cloud, few enough to show each image with its neighbours."""
SEED = 0
_WORLDS, _APART = 40, 8
"""For random actions: number of worlds, and moves between two images of one world."""
_GOALS = ("yellow", "green")


class Frames(msgspec.Struct, frozen=True, eq=False):
    """n images in the order of the timeline."""

    origin: str
    """Text that says where they come from."""
    images: np.ndarray
    """(n, 84, 84, 3) uint8."""
    captions: list[str]
    """Text for each image."""
    worlds: np.ndarray
    """Number of the layout, (n,) int64, from 0; equal layouts have equal numbers."""
    agent: np.ndarray
    """Position of the agent on the table, (n, 2) float64, in metres."""
    goal: np.ndarray
    """Distance from the agent to the nearest goal, (n,) float64, in metres; NaN without a goal."""

    def __len__(self) -> int:
        """Number of images."""
        return len(self.images)

    def pngs(self) -> list[bytes]:
        """The images as PNG files."""
        return encode_pngs(self.images)


def of_release(release: Release, count: int = COUNT) -> Frames:
    """Draw `count` frames of a release without replacement and with a fixed seed, in the release's order.

    Raises:
        ArtefactError: if the release is damaged.
    """
    chosen = np.sort(seeding.generator(SEED, "viz", "frames").permutation(len(release))[:count])
    names = release.info["gym_open"]["objects"]
    episodes = release.episodes
    own = np.searchsorted(episodes["dataset_to_index"].to_numpy(), chosen, side="right")
    states = np.empty((len(chosen), len(names), 3))
    with progress.bar("read frames", len(chosen)) as bar:
        for i, frame in enumerate(chosen.tolist()):
            row = release.numbers(frame, frame + 1)["observation.environment_state"]
            states[i] = row.reshape(len(names), -1)[:, :3]
            bar.advance()
    _, worlds = np.unique(episodes["puzzle"].to_numpy()[own], return_inverse=True)
    firsts = episodes["dataset_from_index"].to_numpy()[own]
    steps = episodes["first_step"].to_numpy()[own] + chosen - firsts
    streams = episodes["stream"].to_numpy()[own]
    return Frames(
        origin=f"{len(chosen):,} of the {len(release):,} frames of {release.name} {release.version}, drawn at random",
        images=release.images(chosen),
        captions=[f"stream {s}, step {t:,}, episode {e}" for s, t, e in zip(streams, steps, own, strict=True)],
        worlds=worlds,
        agent=states[:, names.index("agent"), :2],
        goal=_to_goals(names, states),
    )


def of_random_actions(count: int = COUNT) -> Frames:
    """Make `count` images of random actions in new sandbox worlds, one every few moves, with a fixed seed."""
    from gym_open.envs.physics.model import INVENTORY
    from gym_open.envs.puzzles.generators import sample_puzzle
    from gym_open.envs.world import World

    world, rng = World(), seeding.generator(SEED, "viz", "random play")
    images = np.empty((count, c.IMAGE_SIZE, c.IMAGE_SIZE, 3), np.uint8)
    states = np.empty((count, len(INVENTORY), 3))
    each = -(-count // _WORLDS)
    with progress.bar("random actions", count) as bar:
        for i in range(count):
            if i % each == 0:
                world.load(sample_puzzle("sandbox", rng))
            for move in rng.integers(1, c.N_ACTIONS, size=_APART).tolist():
                world.step(move)
            world.observe(images[i])
            states[i] = world.object_state()[:, :3]
            bar.advance()
    worlds = np.arange(count) // each
    return Frames(
        origin=f"{count:,} images of random actions in {worlds[-1] + 1} sandbox worlds, one every {_APART} moves",
        images=images,
        captions=[f"world {w}, move {(i % each + 1) * _APART}" for i, w in enumerate(worlds)],
        worlds=worlds,
        agent=states[:, INVENTORY.index("agent"), :2],
        goal=_to_goals(INVENTORY, states),
    )


def _to_goals(names: tuple[str, ...] | list[str], states: np.ndarray) -> np.ndarray:
    """Distance in metres from the agent to the nearest goal on the table, (n,); NaN without a goal."""
    present = [i for i, name in enumerate(names) if name.split("_")[0] in _GOALS]
    goals, agent = states[:, present, :2], states[:, names.index("agent"), None, :2]
    distances = np.linalg.norm(goals - agent, axis=2)
    on_table = (np.abs(goals) <= (c.WALL_X, c.WALL_Y)).all(axis=2)
    nearest = np.where(on_table, distances, np.inf).min(axis=1, initial=np.inf)
    return np.where(np.isfinite(nearest), nearest, np.nan)
