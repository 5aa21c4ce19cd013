"""Writer of the log of one stream; its bytes depend only on the records.

The caller enqueues records and continues; each writer has one thread that encodes and writes them. Records are enqueued
in batches, because passing an object between two Python threads is the main cost.
"""

from pathlib import Path
from queue import Queue
from threading import Thread
from types import TracebackType
from typing import NamedTuple, Self

from gym_open.formats.logs.parts import LogParts
from gym_open.formats.logs.schemas import LogHead, Record, SegmentStart, StepRecord, Stuck, Switch

ROLL_BYTES = 256 * 2**20
"""At the first keyframe after a file has this many bytes, the next file begins."""
BATCH = 256
"""Records per batch; with 84×84 images, about 6 MB."""
QUEUE = 3
"""Batches that may wait in the queue; if it is full, the caller waits."""


class _RecordBatch(NamedTuple):
    records: list[Record]
    flush: bool = False
    sync: bool = False


class LogWriter:
    """Writes the log of one stream in `folder`; use it as a context manager, or call `close`.

    For each segment, call `segment`, then `step` for each action, with another `segment` before every
    `keyframe_every`-th step. Call `switch` before the first segment and after every segment. Another thread writes the
    records later, so their arrays must not be changed. Records logged before a `sync` survive a kill and a power cut.

    Raises:
        LogError: from any method, if the disk is full, or a record differs from the one logged before a kill.
        ValueError: if a step has another number of reward parts than the head, or an earlier image another shape.
    """

    def __init__(
        self, folder: Path, head: LogHead, *, roll_bytes: int = ROLL_BYTES, begun: LogParts | None = None
    ) -> None:
        """With `begun`, continue files of an earlier writer: see `resume`."""
        self._files = begun or LogParts(folder, head, roll_bytes)
        self._reward_parts = head.reward_parts
        self._records: list[Record] = []
        self._error: BaseException | None = None
        self._queue: Queue[_RecordBatch | None] = Queue(QUEUE)
        self._thread = Thread(target=self._work, name=f"log of stream {head.stream}", daemon=True)
        self._thread.start()

    @property
    def messages(self) -> int:
        """Number of messages in the files; correct right after a `sync`."""
        return self._files.messages

    def segment(self, start: SegmentStart) -> None:
        """Log that the stream enters a world, or a keyframe within a segment, with the observation of that moment."""
        self._put(start)

    def step(self, record: StepRecord) -> None:
        """Log an action at the time of its beginning and the observation at the time of its end."""
        found, expected = len(record.metrics.reward_parts), len(self._reward_parts)
        if found != expected:
            names = ", ".join(self._reward_parts)
            raise ValueError(f"step {record.step}: expected {expected} reward parts ({names}), got {found}")
        self._put(record)

    def switch(self, switch: Switch) -> None:
        """Log a decision of the curriculum, as a record and as text."""
        self._put(switch)

    def stuck(self, stuck: Stuck) -> None:
        """Log that an object can no longer move or can move again, as a record and as text."""
        self._put(stuck)

    def flush(self) -> None:
        """End the chunk, without waiting: once it is written, all records so far survive a kill of this process."""
        self._hand_over(flush=True)

    def sync(self) -> None:
        """Wait until all records are on the disk: they survive a power cut."""
        self._hand_over(flush=True, sync=True)
        self._queue.join()
        self._check()

    def close(self) -> None:
        """Wait for all records and write the index, which completes the log. A second call does nothing."""
        if not self._thread.is_alive():
            return
        try:
            self.sync()
            self._stop()
            self._files.finish()
        finally:
            self.abandon()

    def abandon(self) -> None:
        """Stop without an index, so that readers see that the log is incomplete."""
        self._stop()
        self._files.abandon()

    def _put(self, record: Record) -> None:
        self._check()
        self._records.append(record)
        if len(self._records) == BATCH:
            self._hand_over()

    def _hand_over(self, *, flush: bool = False, sync: bool = False) -> None:
        self._check()
        self._queue.put(_RecordBatch(self._records, flush, sync))
        self._records = []

    def _check(self) -> None:
        if self._error is not None:
            raise self._error

    def _work(self) -> None:
        """Run the thread: write batch after batch; after an error, drop the rest, so that nobody waits for ever."""
        while (batch := self._queue.get()) is not None:
            try:
                if self._error is None:
                    self._write(batch)
            except BaseException as error:  # the caller's thread raises it
                self._error = error
            self._queue.task_done()

    def _write(self, batch: _RecordBatch) -> None:
        for record in batch.records:
            self._files.add(record)
        if batch.flush:
            self._files.flush()
        if batch.sync:
            self._files.sync()

    def _stop(self) -> None:
        if self._thread.is_alive():
            self._queue.put(None)
            self._thread.join()

    def __enter__(self) -> Self:
        return self

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None, at: TracebackType | None) -> None:
        if kind is None:
            self.close()
        else:
            self.abandon()
