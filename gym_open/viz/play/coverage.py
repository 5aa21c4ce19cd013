"""Where the agent has been: a map of the table that grows."""

import numpy as np
import rerun as rr

from gym_open.envs.constants import CELL_0, COLUMNS, PITCH, ROWS
from gym_open.viz.play.columns import tensors, times


class Coverage:
    """Counts after how many steps the agent was in each cell of the placement grid, (16, 9), far row first.

    Outside of the grid's cells the nearest one counts, as in a log's summary.
    """

    def __init__(self) -> None:
        self.counts = np.zeros((ROWS, COLUMNS), dtype=np.uint32)

    def add(self, places: np.ndarray) -> None:
        """Count places (n, 2 or more), metres, each after one step."""
        rows = np.rint((CELL_0[1] - places[:, 1]) / PITCH).clip(0, ROWS - 1).astype(np.int64)
        columns = np.rint((places[:, 0] - CELL_0[0]) / PITCH).clip(0, COLUMNS - 1).astype(np.int64)
        np.add.at(self.counts, (rows, columns), 1)

    def log(self, rec: rr.RecordingStream, entity: str, first_step: int, places: np.ndarray, shown: np.ndarray) -> None:
        """Count a span and log the map, as it is then, at some of its steps.

        Args:
            rec: the recording.
            entity: the stream's.
            first_step: number of the span's first step.
            places: (T, 2 or more), after each step.
            shown: of 0…T, after how many of the span's steps it is logged, in order.
        """
        maps: list[rr.Tensor] = []
        done = 0
        for number in shown.tolist():
            self.add(places[done:number])
            done = number
            maps.append(rr.Tensor(self.counts.copy(), dim_names=("far to near", "left to right")))
        self.add(places[done:])
        if maps:
            rec.send_columns(f"{entity}/coverage", times(first_step + shown), tensors(maps))
