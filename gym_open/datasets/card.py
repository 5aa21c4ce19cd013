"""The card of a release: a README in the hub's form, written from the data, without dates or paths."""

from collections import Counter
from typing import Any

from gym_open.datasets.config import ReleaseConfig
from gym_open.formats.releases.features import Features, fps

_CARD = """\
---
license: mit
tags: [LeRobot, gym-open, exploration, task-free]
task_categories: [robotics]
configs:
- config_name: default
  data_files: data/*/*.parquet
---
# {name}

What an exploration policy saw and did in gym-open's sandbox: an agent on a table with spheres and cubes, pushed about
by nine discrete moves, no task and no extrinsic reward. {frames:,} frames of 84×84 RGB in {episodes:,} episodes from
{streams:,} stream(s) and {worlds:,} world(s), {steps:,} actions, {rate} a simulated second.

| split | episodes | frames | actions | worlds |
|---|---|---|---|---|
{splits}

Episodes ended by: {ended}.

## Load
```python
import os
os.environ["HF_HUB_OFFLINE"] = "1"                      # before the import: nothing is looked up on a network
from lerobot.datasets.lerobot_dataset import LeRobotDataset
dataset = LeRobotDataset("{name}", root="PATH/TO/THIS/FOLDER")

from pathlib import Path
from gym_open.datasets import open_release               # checks every byte first
release = open_release(Path("PATH/TO/THIS/FOLDER"))      # .frames, .column(name), .images(indices), .split("train")

import pandas
pandas.read_parquet("PATH/TO/THIS/FOLDER/data")          # pictures are PNG files in the column observation.image
```

## What is in it
| feature | type | shape |
|---|---|---|
{features}

`meta/episodes` says of each episode: stream, segment, piece, world, puzzle (digest of the layout), first_step, steps,
continued, ended, split. `meta/streams`, `worlds` (puzzles as JSON), `switches` and `segments` (with the state that a
replay starts from) are parquet too. `manifest.json` has the SHA-256 of every file, `lineage.json` says where it comes
from.

## What surprises
- An episode of T actions has T + 1 frames. The last one carries only the observation: `transition.valid` is False,
  `action` is all zero, `action.index` is -1, rewards and losses are 0. Leave such frames out where an action is needed.
- An episode's start is no reset: where `continued` is true, the world goes on from where an earlier episode left it.
- `ended` = `length_cap` is a cut at {cap:,} steps and no switch: the next episode begins with the same observation.
- Nothing terminates in play: `next.done` is always False, `next.truncated` marks the last action and the frame after.
- `next.reward` is the extrinsic reward, which is always 0. `reward.intrinsic` is the explorer's own.
- Splits go by {split_by}, never by step: neighbouring frames are near copies. Draw validation data from `val` only.
- `world_model.loss` is the explorer's own at that moment of its learning: later it would be another for the same frame.
  It is NaN throughout if the explorer had no world model.
- Statistics (`meta/stats.json`) are over all finite values, the last frames of episodes included.
"""


def card(config: ReleaseConfig, facts: dict[str, int], episodes: list[dict[str, Any]], described: Features) -> str:
    """Text of the card of the release `config.name` that holds `episodes` (rows of `meta/episodes`)."""
    ended = Counter(row["ended"] for row in episodes)
    return _CARD.format(
        name=config.name,
        frames=facts["frames"],
        episodes=facts["episodes"],
        steps=facts["steps"],
        streams=len({row["stream"] for row in episodes}),
        worlds=len({row["puzzle"] for row in episodes}),
        rate=fps(),
        splits="\n".join(_split_row(name, episodes) for name in ("train", "val")),
        ended=", ".join(f"{reason} {count:,}" for reason, count in sorted(ended.items())),
        features="\n".join(_feature_row(name, feature) for name, feature in described.items()),
        cap=config.max_episode_steps,
        split_by=config.split_by,
    )


def _split_row(name: str, episodes: list[dict[str, Any]]) -> str:
    rows = [row for row in episodes if row["split"] == name]
    frames, steps = sum(row["length"] for row in rows), sum(row["steps"] for row in rows)
    return f"| {name} | {len(rows):,} | {frames:,} | {steps:,} | {len({row['puzzle'] for row in rows}):,} |"


def _feature_row(name: str, feature: dict[str, Any]) -> str:
    return f"| `{name}` | {feature['dtype']} | {'×'.join(map(str, feature['shape']))} |"
