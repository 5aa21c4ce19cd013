"""Push releases to a Hugging Face hub and pull them from one.

A release must verify before it is sent, and after it is fetched. Each version has a tag. Nothing uses the network
without `send`. The hub is not trusted: its list of files is compared with the manifest, before and after.
"""

from gym_open.datasets.hub.pull import pull_release
from gym_open.datasets.hub.push import push_release

__all__ = ["pull_release", "push_release"]
