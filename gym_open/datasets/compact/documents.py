"""README.md of a compact release."""

from gym_open.formats.compact import Compact
from gym_open.formats.releases.features import fps


def compact_card(compact: Compact) -> str:
    """Text of the card: what the compact release is, and how to use it. The release's own card says what it holds."""
    info = compact.info
    frames = info.steps + info.episodes
    columns = ", ".join(f"`{name}`" for name in info.columns) or "none: the release leaves them out"
    ours = compact.release_info["gym_open"]
    return f"""\
---
license: {ours["license"]}
pretty_name: {info.name}
task_categories: [robotics, reinforcement-learning]
tags: [gym-open, exploration, task-free, compact]
---
# {info.name} {info.version}, compact

The release {info.name} {info.version} as its actions: {info.steps:,} actions in {info.episodes:,} episodes,
{info.steps / fps() / 60:,.1f} simulated minutes. Its {frames:,} frames are simulated again, identical to the bit, on
any x86-64 processor. [release/README.md](release/README.md) is the release's own card.

```
gym-open dataset verify FOLDER                  # simulates every frame, and compares it with its digest
gym-open dataset restore FOLDER --out RELEASE   # the LeRobot release: images, states, tables, documents
gym-open train encoder --release FOLDER         # or use it as it is
gym-open viz FOLDER
```

| file | holds |
| --- | --- |
| `compact.json` | name, version, counts, and the digests of the release |
| `actions.zst` | one byte per action |
| `episodes.jsonl.zst` | where and how each episode begins, and the digest of its content |
| `worlds.jsonl.zst`, `streams.jsonl.zst`, `switches.jsonl.zst` | the release's tables |
| `columns/` | the explorer's own values, which no simulation gives back: {columns} |
| `release/` | the release's documents and records, byte for byte |

| digest of the release |  |
| --- | --- |
| artefact | `{info.release}` |
| payload | `{info.payload}` |
| content | `{info.content}` |
"""
