"""Windows of consecutive frames of a split: by number, or in random batches."""

import itertools
from collections import deque
from collections.abc import Iterator, Sequence
from concurrent.futures import Future, ThreadPoolExecutor
from typing import TYPE_CHECKING

import numpy as np

from gym_open.errors import ArtefactError, UsageError
from gym_open.formats.releases import IMAGE
from gym_open.formats.windows.cache import Pictures

ACTION = "action.index"
Batch = dict[str, np.ndarray]
"""By feature: the image (…, L, 84, 84, 3) uint8, `action.index` (…, L) int64, others (…, L) or (…, L, d)."""

if TYPE_CHECKING:  # torch takes seconds to import, and `Windows` needs nothing from its class
    from torch.utils.data import Dataset

    _MapStyle = Dataset[Batch]
else:
    _MapStyle = object


class Windows(_MapStyle):
    """Every window of `length` frames, `stride` apart, within one episode of a split.

    The last frame of an episode has action -1, because no action follows it. Windows are numbered through the split's
    episodes, in order. Only the bounds of episodes and the requested features are in memory.

    `Windows` is a map-style dataset for `torch.utils.data.DataLoader`. `batches` works without other processes.

    Args:
        pictures: the images of the release.
        split: `train` or `val`.
        length: number of frames of a window, L.
        stride: distance between its frames.
        features: further numeric features; each is held in memory for the whole release.

    Raises:
        ArtefactError: if no episode of the split is long enough.
        KeyError: if the release lacks one of the features.
        UsageError: if length or stride is less than 1.
    """

    def __init__(
        self, pictures: Pictures, split: str, length: int, *, stride: int = 1, features: Sequence[str] = ()
    ) -> None:
        if length < 1 or stride < 1:
            raise UsageError(f"a window needs length and stride of at least 1, got {length} and {stride}")
        release = pictures.release
        episodes = release.episodes[release.episodes["split"] == split]
        span = (length - 1) * stride + 1
        counts = np.maximum(episodes["length"].to_numpy() - span + 1, 0)
        if not counts.any():
            raise ArtefactError(
                f"{release.root}: split {split!r} has no episode of {span} frames, which {length} frames {stride} "
                "apart need; make length or stride smaller, or collect more steps"
            )
        self._pictures = pictures
        self._stops = np.cumsum(counts)
        self._shift = episodes["dataset_from_index"].to_numpy() - (self._stops - counts)
        self._steps = np.arange(length) * stride
        self._columns = {name: release.column(name) for name in dict.fromkeys((ACTION, *features))}

    def __len__(self) -> int:
        """Number of windows."""
        return int(self._stops[-1])

    def __getitem__(self, number: int) -> Batch:
        """One window: arrays without the batch axis.

        Raises:
            IndexError: if there is no window with this number.
        """
        return {name: values[0] for name, values in self.fetch(np.array([number])).items()}

    def frames(self, numbers: np.ndarray) -> np.ndarray:
        """Frame numbers in the release of the windows `numbers` (B,): (B, L) int64.

        Raises:
            IndexError: if there is no window with one of these numbers.
        """
        if numbers.size and not 0 <= numbers.min() <= numbers.max() < len(self):
            raise IndexError(f"window numbers must be in [0, {len(self)}), got {numbers.min()}…{numbers.max()}")
        first = numbers + self._shift[np.searchsorted(self._stops, numbers, side="right")]
        return first[:, None] + self._steps

    def fetch(self, numbers: np.ndarray) -> Batch:
        """The windows `numbers` (B,), in that order. Threads may call this at the same time.

        Raises:
            IndexError: if there is no window with one of these numbers.
        """
        frames = self.frames(numbers)
        return {
            IMAGE: self._pictures.take(frames),
            **{name: column[frames] for name, column in self._columns.items()},
        }

    def batches(self, rng: np.random.Generator, batch_size: int, *, workers: int = 1, skip: int = 0) -> Iterator[Batch]:
        """Endless batches of `batch_size` different windows, drawn uniformly at random.

        The caller's thread draws the windows and other threads only fetch them, so batches and their order do not
        depend on `workers`. The generator is ahead of the batches that were returned. To continue after an
        interruption, pass a generator with the same seed and `skip`.

        Args:
            rng: draws the windows.
            batch_size: windows in a batch.
            workers: threads that fetch. At most two batches per thread wait.
            skip: number of batches that were used earlier; they are drawn and skipped.

        Raises:
            UsageError: if there are fewer windows than `batch_size`, or `workers` is less than 1.
        """
        if not 1 <= batch_size <= len(self) or workers < 1:
            raise UsageError(
                f"batch_size must be in [1, {len(self)}], the number of windows, and workers at least 1; got "
                f"{batch_size} and {workers}"
            )
        draws = (rng.choice(len(self), size=batch_size, replace=False) for _ in itertools.count())
        return self._fetched(itertools.islice(draws, skip, None), workers)

    def _fetched(self, draws: Iterator[np.ndarray], workers: int) -> Iterator[Batch]:
        waiting: deque[Future[Batch]] = deque()
        with ThreadPoolExecutor(workers) as pool:
            try:
                for numbers in draws:
                    waiting.append(pool.submit(self.fetch, numbers))
                    if len(waiting) > 2 * workers:
                        yield waiting.popleft().result()
            finally:
                for future in waiting:
                    future.cancel()
