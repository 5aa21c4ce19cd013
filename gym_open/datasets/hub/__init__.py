"""Releases to and from a Hugging Face hub: what verifies is sent, a tag a version, and what is fetched must verify.

Nothing here touches a network unless it is told to `send`. The hub is not trusted: what it says that it holds is
compared with the manifest, before and after.
"""

from gym_open.datasets.hub.pull import pull_release
from gym_open.datasets.hub.push import push_release

__all__ = ["pull_release", "push_release"]
