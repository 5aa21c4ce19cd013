"""What a view is: a title, something that fills a recording, and how that is laid out on the screen."""

from collections.abc import Callable
from typing import NamedTuple

import rerun as rr
import rerun.blueprint as rrb


class View(NamedTuple):
    """Something to look at in Rerun, not yet read: `viewers` saves it, opens it or serves it."""

    title: str
    """What the recording is called in Rerun's list of recordings."""
    fill: Callable[[rr.RecordingStream], None]
    """Writes everything, in the order in which it is wanted on the screen."""
    blueprint: rrb.Blueprint
