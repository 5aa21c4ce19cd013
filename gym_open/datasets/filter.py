"""Make a release from selected episodes of another one: `filter_release(config, release, out)`."""

from collections.abc import Iterator
from pathlib import Path

import numpy as np

from gym_open import artefacts
from gym_open.datasets.config import FilterConfig
from gym_open.datasets.derived import derive
from gym_open.datasets.documents.facts import X_EDGES, Y_EDGES
from gym_open.errors import UsageError
from gym_open.formats.releases import Release, open_release
from gym_open.formats.releases.features import learned


def filter_release(
    config: FilterConfig, release: Path, out: Path, *, workers: int | None = None, replace: bool = False
) -> artefacts.Outcome:
    """Make the release `out` from the episodes of `release` that meet all conditions of `config`.

    If a condition has several values, an episode must match one of them. Splits do not change.

    Args:
        config: the conditions, and name, version and so on of the result.
        release: folder of a release, which becomes the parent.
        out: folder of the result. The versions of a release are sibling folders named X.Y.Z.
        workers: number of threads; by default one per processor.
        replace: set aside an artefact of other inputs at `out`; otherwise refuse.

    Raises:
        ArtefactError: if the release is damaged, or the version does not follow from what changed since the previous
            one.
        UsageError: if the release has no such explorer, world, split or feature, or no episode meets all conditions.
    """
    opened = open_release(release)
    left_out = _left_out(config, opened)
    chosen = [(opened, _chosen(config, opened))]
    return derive(config, "filter", out, chosen, left_out=left_out, workers=workers, replace=replace)


def _left_out(config: FilterConfig, release: Release) -> tuple[str, ...]:
    """Names of the features that the result does not have."""
    there = learned(release.info["features"])
    for name in config.leave_out:
        if name not in there and name != "explorer":
            given = ", ".join(("explorer", *there)) if there else "nothing: it has no explorer's values"
            raise UsageError(f"{release.root}: leave_out: no explorer's feature {name!r}; give {given}")
    return tuple(there) if "explorer" in config.leave_out else config.leave_out


def _chosen(config: FilterConfig, release: Release) -> np.ndarray:
    """Numbers of the episodes that meet all conditions, ascending."""
    rows = release.episodes
    meets = np.ones(len(rows), dtype=bool)
    for name, wanted in (("explorer", config.explorer), ("split", config.split)):
        for value in wanted:
            if value not in set(rows[name]):
                raise UsageError(
                    f"{release.root}: no {name} {value!r}; give one of {', '.join(sorted(set(rows[name])))}"
                )
        if wanted:
            meets &= rows[name].isin(wanted).to_numpy()
    if config.world:
        meets &= rows["puzzle"].isin(_worlds(config, release)).to_numpy()
    if config.min_contact or config.min_coverage:
        meets[meets] = [
            contact >= config.min_contact and coverage >= config.min_coverage
            for contact, coverage in _measured(release, np.flatnonzero(meets))
        ]
    if not meets.any():
        raise UsageError(f"{release.root}: none of its {len(rows):,} episodes meets all conditions; relax a condition")
    return np.flatnonzero(meets)


def _worlds(config: FilterConfig, release: Release) -> set[str]:
    """Digests of the layouts whose beginnings `config.world` gives."""
    there = sorted(set(release.episodes["puzzle"]))
    found: set[str] = set()
    for beginning in config.world:
        named = {digest for digest in there if digest.startswith(beginning)}
        if not named:
            some = ", ".join(digest[:12] for digest in there[:5]) + (" …" if len(there) > 5 else "")
            raise UsageError(f"{release.root}: no world {beginning!r}; give one of its {len(there):,}: {some}")
        found |= named
    return found


def _measured(release: Release, episodes: np.ndarray) -> Iterator[tuple[float, float]]:
    """For each episode: share of steps with a contact of the agent, and share of the table's cells that it visited."""
    cells = (len(X_EDGES) - 1) * (len(Y_EDGES) - 1)
    rows = release.episodes
    for number in episodes:
        frames = release.numbers(int(rows["dataset_from_index"][number]), int(rows["dataset_to_index"][number]))
        touching = frames["contact.agent"][frames["transition.valid"]] > 0
        x, y = frames["observation.state"][:, :2].T
        visited = np.histogram2d(x, y, bins=(X_EDGES, Y_EDGES))[0] > 0
        yield float(touching.mean()) if touching.size else 0.0, visited.sum() / cells
