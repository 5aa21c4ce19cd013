"""Export a split of a release as one NumPy file or as a Minari data set. The result is whole or absent."""

import shutil
import zipfile
from collections.abc import Iterator, Mapping
from contextlib import ExitStack, contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.lib import format as npy

from gym_open import extras, progress
from gym_open.errors import UsageError
from gym_open.files import unwritable
from gym_open.formats.releases import IMAGE, Release
from gym_open.formats.releases.features import numeric
from gym_open.formats.releases.layout import PART
from gym_open.replay.compact import open_dataset

if TYPE_CHECKING:
    import pandas as pd
    from minari.data_collector.episode_buffer import EpisodeBuffer

_ZIP_DATE = (1980, 1, 1, 0, 0, 0)
_INFOS = ("reward.intrinsic", "world_model.loss", "policy.entropy", "policy.value", "contact.count", "contact.agent",
          "contact.impulse")  # fmt: skip


def export_npz(root: Path, split: str, out: Path) -> Path:
    """Write a split of the release at `root` as one file for `numpy.load(out, allow_pickle=False)`.

    The file holds the n frames of the m episodes of the split, in their order. Keys:

        observation.image           (n, 84, 84, 3) uint8 RGB
        any other feature           (n,) or (n, d), as in the release; `episode_index` counts within the release
        episode_starts              (m + 1,) int64: episode i has the rows from `starts[i]` to `starts[i + 1]`
        episode_explorer            (m,) text
        episode_puzzle              (m,) text: digests of the layouts

    An episode of T actions has T + 1 rows; `transition.valid` is False in the last. Memory does not depend on n:
    images are written to the file as they are decoded.

    Args:
        root: folder of a release. Every byte of it is checked.
        split: `train` or `val`.
        out: file to write.

    Raises:
        ArtefactError: if the release is damaged.
        UsageError: if there is no such split, or `out` exists already.
    """
    release, rows = _opened(root, split)
    lengths = rows["length"].to_numpy()
    frames = int(lengths.sum())
    with beside(out) as partial, progress.bar("dataset export", 2 * frames) as bar:
        partial.mkdir()
        members = _write_numbers(release, rows, partial, bar)
        for name, values in {
            "episode_starts": np.concatenate([[0], np.cumsum(lengths)]).astype(np.int64),
            "episode_explorer": np.array(rows["explorer"].tolist(), dtype=np.str_),
            "episode_puzzle": np.array(rows["puzzle"].tolist(), dtype=np.str_),
        }.items():
            members[name] = partial / f"{name}.npy"
            np.save(members[name], values, allow_pickle=False)
        packed = partial / "packed"
        with zipfile.ZipFile(packed, "w") as file:
            for name, path in sorted(members.items()):
                with path.open("rb") as source, _member(file, name) as target:
                    shutil.copyfileobj(source, target, 2**20)
                path.unlink()
            with _member(file, IMAGE) as target:
                _begin(target, np.dtype(np.uint8), (frames, *release.info["features"][IMAGE]["shape"]))
                for first, stop in _spans(rows):
                    target.write(release.images(np.arange(first, stop)).data)
                    bar.advance(stop - first)
        packed.rename(out)
        shutil.rmtree(partial)
    return out


def export_minari(root: Path, split: str, out: Path, dataset_id: str) -> Path:
    """Write a split of the release at `root` as a Minari data set, in a folder of Minari's own.

    With MINARI_DATASETS_PATH set to `out`, `minari.load_dataset(dataset_id)` reads it; so does
    `minari.MinariDataset(out / dataset_id / "data")`. An episode of T actions has T + 1 observations: the images as
    `image` (not compressed to JPEG), `state` and `environment_state`. Actions are Discrete(9). Rewards are extrinsic
    and always 0. Every episode ends truncated. `infos` has the explorer's values for each step, at the index of the
    observation after the step. The first value is NaN or 0.

    Args:
        root: folder of a release. Every byte of it is checked.
        split: `train` or `val`.
        out: folder of Minari data sets; others in it are kept.
        dataset_id: NAMESPACE/NAME-vN.

    Raises:
        ArtefactError: if the release is damaged.
        UsageError: if there is no such split, the data set exists already, or the id is not valid in Minari.
        MissingExtraError: if Minari is not installed.
    """
    extras.check("minari")
    import minari
    from minari.dataset.minari_dataset import parse_dataset_id
    from minari.dataset.minari_storage import MinariStorage
    from minari.namespace import NAMESPACE_METADATA_FILENAME

    try:
        namespace = parse_dataset_id(dataset_id)[0]
    except ValueError as error:
        raise UsageError(f"dataset id must be NAMESPACE/NAME-vN, got {dataset_id!r}: {error}") from None
    release, rows = _opened(root, split)
    rows = rows[rows["steps"] > 0]
    target = out / dataset_id
    with beside(out, target) as partial, progress.bar("dataset export", int(rows["length"].sum())) as bar:
        data = partial / "data"
        data.mkdir(parents=True)
        storage = MinariStorage.new(data, *_spaces(release), jpeg_encoding=False)
        about = f"Split {split} of {release.name} {release.version}: exploration without a task, recorded by gym-open."
        storage.update_metadata({"dataset_id": dataset_id, "minari_version": minari.__version__, "description": about})
        for number, row in enumerate(rows.to_dict("records")):
            span = (row["dataset_from_index"], row["dataset_to_index"])
            storage.update_episodes([_buffer(release, *span)])
            metadata = {
                name: row[name] for name in ("explorer", "puzzle", "stream", "segment", "piece", "continued", "ended")
            }
            storage.update_episode_metadata([metadata], [number])
            bar.advance(row["length"])
        target.parent.mkdir(parents=True, exist_ok=True)
        for folder in (out / namespace, *(out / namespace).parents) if namespace else ():
            if folder.is_relative_to(out) and folder != out:
                (folder / NAMESPACE_METADATA_FILENAME).write_text("{}")
        partial.rename(target)
    return target


def _opened(root: Path, split: str) -> "tuple[Release, pd.DataFrame]":
    """Open a release, check every byte of it, and return it with the rows of `meta/episodes` of a split."""
    release = open_dataset(root, check="bytes")
    rows = release.episodes[release.episodes["split"] == split]
    if not len(rows):
        there = ", ".join(sorted(release.info["splits"]))
        raise UsageError(f"{root}: no split {split!r} there; it has {there}")
    return release, rows


@contextmanager
def beside(out: Path, target: Path | None = None) -> Iterator[Path]:
    """A path next to `out`, to write and to rename to `out` or to `target` in it. Leftovers are removed.

    Raises:
        UsageError: if the result exists already.
        ArtefactError: if the disk is full or not writable.
    """
    for taken in (target, None if out.is_dir() and target else out):
        if taken is not None and taken.exists():
            raise UsageError(f"{taken}: exists; give another --out or remove it")
    partial = out.absolute().with_name(f".{out.name}.partial")  # Minari joins a relative path to itself
    try:
        out.parent.mkdir(parents=True, exist_ok=True)
        shutil.rmtree(partial, ignore_errors=True)
        yield partial
    except OSError as error:
        raise unwritable(out, error) from error
    finally:
        shutil.rmtree(partial, ignore_errors=True)


def _spans(rows: "pd.DataFrame") -> Iterator[tuple[int, int]]:
    """First frame and the frame after the last, for each episode."""
    yield from zip(rows["dataset_from_index"].tolist(), rows["dataset_to_index"].tolist(), strict=True)


def _write_numbers(release: Release, rows: "pd.DataFrame", folder: Path, bar: progress.Bar) -> dict[str, Path]:
    """Write every numeric feature to a `.npy` file of its own, and return the files by name."""
    described, frames = release.info["features"], int(rows["length"].sum())
    paths = {name: folder / f"{name}.npy" for name in numeric(described)}
    with ExitStack() as stack:
        files = {name: stack.enter_context(path.open("wb")) for name, path in paths.items()}
        for name, file in files.items():
            shape = described[name]["shape"]
            _begin(file, np.dtype(described[name]["dtype"]), (frames, *(() if shape == [1] else shape)))
        for first, stop in _spans(rows):
            for name, values in release.numbers(first, stop).items():
                files[name].write(np.ascontiguousarray(values).data)
            bar.advance(stop - first)
    return paths


def _begin(file: Any, dtype: np.dtype, shape: tuple[int, ...]) -> None:
    """Write the header of a `.npy` file. The values follow in C order."""
    head = {"descr": npy.dtype_to_descr(dtype.newbyteorder("<")), "fortran_order": False, "shape": shape}
    npy.write_array_header_1_0(file, head)


def _member(file: zipfile.ZipFile, name: str) -> Any:
    return file.open(zipfile.ZipInfo(f"{name}.npy", _ZIP_DATE), "w", force_zip64=True)


def _spaces(release: Release) -> tuple[Any, Any]:
    from gymnasium import spaces

    described = release.info["features"]

    def numbers(name: str) -> spaces.Box:
        return spaces.Box(-np.inf, np.inf, tuple(described[name]["shape"]), np.float32)

    observation = spaces.Dict(
        {
            "image": spaces.Box(0, 255, tuple(described[IMAGE]["shape"]), np.uint8),
            "state": numbers("observation.state"),
            "environment_state": numbers("observation.environment_state"),
        }
    )
    return observation, spaces.Discrete(described["action"]["shape"][0])


def _buffer(release: Release, first: int, stop: int) -> "EpisodeBuffer":
    """An episode in the form of Minari."""
    from minari.data_collector.episode_buffer import EpisodeBuffer

    values: Mapping[str, np.ndarray] = release.numbers(first, stop)
    infos = [name for name in values if name in _INFOS or name.startswith(PART)]
    return EpisodeBuffer(
        observations={
            "image": release.images(np.arange(first, stop)),
            "state": values["observation.state"],
            "environment_state": values["observation.environment_state"],
        },
        actions=values["action.index"][:-1],  # type: ignore[arg-type]  # an array works like a list
        rewards=values["next.reward"][:-1],  # type: ignore[arg-type]
        terminations=values["next.done"][:-1],  # type: ignore[arg-type]
        truncations=values["next.truncated"][:-1],  # type: ignore[arg-type]
        infos={name: _led_to(values[name]) for name in infos},
    )


def _led_to(values: np.ndarray) -> np.ndarray:
    """Move the values of steps, as frames have them, to the frames after the steps."""
    nothing = np.nan if np.issubdtype(values.dtype, np.floating) else 0
    return np.concatenate([np.array([nothing], dtype=values.dtype), values[:-1]])
