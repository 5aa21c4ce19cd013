"""The pictures that an encoder is shown, and what is true of each: of a release, or of random play made for it."""

import msgspec
import numpy as np

from gym_open import progress, seeding
from gym_open.envs import constants as c
from gym_open.formats.pngs import encode_pngs
from gym_open.formats.releases import Release

COUNT = 1_000
"""Pictures: so many that a cloud has a shape, so few that each can be shown with its neighbours."""
SEED = 0
_WORLDS, _APART = 40, 8
"""Random play: worlds, and moves between two pictures of one."""
_GOALS = ("yellow", "green")


class Frames(msgspec.Struct, frozen=True, eq=False):
    """n pictures in the order in which they are shown."""

    origin: str
    """Where they are from, in words."""
    images: np.ndarray
    """(n, 84, 84, 3) uint8."""
    moments: list[str]
    """What each is of, in words."""
    worlds: np.ndarray
    """(n,) int64: number of its layout, counted from 0; equal layouts have equal numbers."""
    agent: np.ndarray
    """(n, 2) float64: where the agent is on the table, in metres."""
    goal: np.ndarray
    """(n,) float64: metres from the agent to the nearest goal; not a number if there is none."""

    def __len__(self) -> int:
        """How many there are."""
        return len(self.images)

    def pngs(self) -> list[bytes]:
        """The pictures as PNG files."""
        return encode_pngs(self.images)


def of_release(release: Release, count: int = COUNT) -> Frames:
    """`count` frames of a release, drawn without replacement by a fixed seed, in the release's order.

    Raises:
        ArtefactError: if it is damaged.
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
        moments=[f"stream {s}, step {t:,}, episode {e}" for s, t, e in zip(streams, steps, own, strict=True)],
        worlds=worlds,
        agent=states[:, names.index("agent"), :2],
        goal=_to_goals(names, states),
    )


def of_random_play(count: int = COUNT) -> Frames:
    """`count` pictures of random moves in fresh sandbox worlds, every few moves one, by a fixed seed."""
    from gym_open.envs.physics.model import INVENTORY
    from gym_open.envs.puzzles.generators import sample_puzzle
    from gym_open.envs.world import World

    world, rng = World(), seeding.generator(SEED, "viz", "random play")
    images = np.empty((count, c.IMAGE_SIZE, c.IMAGE_SIZE, 3), np.uint8)
    states = np.empty((count, len(INVENTORY), 3))
    each = -(-count // _WORLDS)
    with progress.bar("random play", count) as bar:
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
        origin=f"{count:,} pictures of random play in {worlds[-1] + 1} sandbox worlds, one every {_APART} moves",
        images=images,
        moments=[f"world {w}, move {(i % each + 1) * _APART}" for i, w in enumerate(worlds)],
        worlds=worlds,
        agent=states[:, INVENTORY.index("agent"), :2],
        goal=_to_goals(INVENTORY, states),
    )


def _to_goals(names: tuple[str, ...] | list[str], states: np.ndarray) -> np.ndarray:
    """(n,) metres from the agent to the nearest goal that lies on the table."""
    there = [i for i, name in enumerate(names) if name.split("_")[0] in _GOALS]
    goals, agent = states[:, there, :2], states[:, names.index("agent"), None, :2]
    distances = np.linalg.norm(goals - agent, axis=2)
    on_table = (np.abs(goals) <= (c.WALL_X, c.WALL_Y)).all(axis=2)
    nearest = np.where(on_table, distances, np.inf).min(axis=1, initial=np.inf)
    return np.where(np.isfinite(nearest), nearest, np.nan)
