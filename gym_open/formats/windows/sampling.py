"""Windows of consecutive frames of a split: by number, or in batches drawn at random."""

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
"""By feature: the picture (…, L, 84, 84, 3) uint8, `action.index` (…, L) int64, others (…, L) or (…, L, d)."""

if TYPE_CHECKING:  # torch takes seconds to import, and asks of a dataset only what `Windows` has
    from torch.utils.data import Dataset

    _MapStyle = Dataset[Batch]
else:
    _MapStyle = object


class Windows(_MapStyle):
    """Every window of `length` frames, `stride` apart, that lies within one episode of a split.

    A window that ends with the last frame of its episode has action -1 there: nothing was done after it. Numbers run
    through the split's episodes in their order. Only bounds of episodes and the features asked for are in memory.

    It is a map-style dataset as `torch.utils.data.DataLoader` takes it. `batches` does without processes.

    Args:
        pictures: of the release.
        split: `train` or `val`.
        length: frames of a window, L.
        stride: frames from one to the next.
        features: numeric features wanted beside picture and action; each is held in memory for the whole release.

    Raises:
        ArtefactError: if no episode of the split is long enough.
        KeyError: if the release has no such numeric feature.
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
        """One window: arrays without the first axis of a batch.

        Raises:
            IndexError: if there is no window of this number.
        """
        return {name: values[0] for name, values in self.fetch(np.array([number])).items()}

    def frames(self, numbers: np.ndarray) -> np.ndarray:
        """Frame numbers in the release of the windows `numbers` (B,): (B, L) int64.

        Raises:
            IndexError: if there is no window of one of these numbers.
        """
        if numbers.size and not 0 <= numbers.min() <= numbers.max() < len(self):
            raise IndexError(f"window numbers must be in [0, {len(self)}), got {numbers.min()}…{numbers.max()}")
        first = numbers + self._shift[np.searchsorted(self._stops, numbers, side="right")]
        return first[:, None] + self._steps

    def fetch(self, numbers: np.ndarray) -> Batch:
        """The windows `numbers` (B,), in their order. Threads may call this at the same time.

        Raises:
            IndexError: if there is no window of one of these numbers.
        """
        frames = self.frames(numbers)
        return {
            IMAGE: self._pictures.take(frames),
            **{name: column[frames] for name, column in self._columns.items()},
        }

    def batches(self, rng: np.random.Generator, batch_size: int, *, workers: int = 1, skip: int = 0) -> Iterator[Batch]:
        """Batches without end: each of `batch_size` different windows, all equally likely.

        Which ones is drawn here, and threads only fetch them, so that neither what comes nor its order depends on
        `workers`. The generator runs ahead of what has come: to go on after an interruption, pass one of the same seed
        and `skip`.

        Args:
            rng: draws the windows.
            batch_size: windows in a batch.
            workers: threads that fetch. At most two batches for each are waiting.
            skip: batches used earlier: drawn and passed over.

        Raises:
            UsageError: if there are fewer windows than `batch_size`, or no worker.
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
