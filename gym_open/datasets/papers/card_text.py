"""The card's words."""

FRONT = """\
---
license: {license}
pretty_name: {name}
task_categories: [robotics, reinforcement-learning]
tags: [LeRobot, gym-open, exploration, task-free, intrinsic-motivation, world-models, mujoco]
size_categories: ["{size}"]
configs:
- config_name: default
  data_files:
{splits}
---
"""

BODY = """\
# {name} {version}

{description}

{glance}

![frames of each explorer in its worlds](figures/frames.png)

## How it was collected
Each explorer played in a pool of random worlds of gym-open's sandbox, simulated by MuJoCo; a curriculum decided when a
stream left its world and for which. Nothing was ever reset, and there was no task and no reward from outside: an
explorer is driven by its own world model, or acts at random. One row a log; the whole configurations are in
`meta/streams` and in `rebuild/`.

{collected}

## Splits
By {split_by}: train and val share none.

{splits}

## Statistics
{played}

The table is counted in squares of 5 cm by where the agent's centre was; those at its edges cannot be reached, so nobody
comes to 100%.

![where the agent was, by explorer](figures/coverage.png)

Actions, as a share of the steps (north is away from the camera):

{actions}

![actions taken, and contacts of the agent](figures/actions.png)

![why episodes ended, and how long they were](figures/episodes.png)

What explorers thought of their own steps. Scales are each explorer's own: do not compare them.

{ranges}

## Load
```python
import os
os.environ["HF_HUB_OFFLINE"] = "1"                      # before the import: nothing is looked up on a network
from lerobot.datasets.lerobot_dataset import LeRobotDataset
dataset = LeRobotDataset("{name}", root="PATH/TO/THIS/FOLDER")

import datasets
train = datasets.load_dataset("PATH/TO/THIS/FOLDER", split="train")

import pandas
table = pandas.read_parquet("PATH/TO/THIS/FOLDER/data", columns=["episode_index", "action.index", "reward.intrinsic"])

import duckdb
duckdb.sql("SELECT split, count(*) FROM 'PATH/TO/THIS/FOLDER/meta/episodes/*/*.parquet' GROUP BY split")

from pathlib import Path
from gym_open.datasets import open_release               # .frames, .column(name), .images(indices), .split("train")
from gym_open.formats.windows import Pictures, Windows   # random windows of frames for training, the fastest way
release = open_release(Path("PATH/TO/THIS/FOLDER"))
windows = Windows(Pictures(release), "train", length=4)
```
`croissant.json` describes the same for whatever reads [Croissant](https://github.com/mlcommons/croissant).

## Verify, and make again
```
gym-open dataset verify PATH/TO/THIS/FOLDER             # every byte, structure, statistics, and a replay of the play
gym-open dataset verify PATH/TO/THIS/FOLDER --quick     # without the replay
sh PATH/TO/THIS/FOLDER/rebuild/rebuild.sh               # from seeds, to ./rebuilt, and compare
```
`manifest.json` has the SHA-256 of every file, `meta/digests.json` digests of what is in them (*content*: the same under
another compression, PNG encoder or cut into files), `provenance.json` an in-toto statement of how it was made,
`lineage.json` its parents. What is promised:

| | what | where |
|---|---|---|
| L0 | the bytes are those that were published | anywhere |
| L1 | the same logs, code and packages give the same bytes | the same type of machine |
| L2 | other versions of libraries give the same content digest | anywhere |
| L3 | the play is simulated again to the last bit | the same MuJoCo, the same architecture |
| L4 | short windows of it are, within a tolerance | another processor |
| L5 | what is learned from it is compared by scores | anywhere |

## What is in it
{features}

`meta/episodes` says of each episode: explorer, stream, segment, piece, world, puzzle (digest of the layout),
first_step, steps, continued, ended, split, and statistics of each feature. `meta/streams` (with configurations),
`worlds` (layouts as JSON), `switches`, `segments`, `keyframes` (states of the simulation that a replay starts from) and
`content` (digests of each episode's features) are parquet too.
"""

VIDEO = """\
- **Pictures are video** (H.264 in RGB), which is smaller than PNG and slower to read at random; browsers do not play
  it. Decoded as it was built and held against the logged pictures, the levels of all pixels and channels were off by
  {mean:.2f} of 255 in the mean and by {max:.0f} at most{psnr}.
"""

SURPRISES = """
## What surprises
- An episode of T actions has T + 1 frames. The last one carries only the observation: `transition.valid` is False,
  `action` is all zero, `action.index` is -1, rewards and losses are 0 or not a number. Leave such frames out where an
  action is needed.
- An episode's start is no reset: where `continued` is true, the world goes on from where an earlier episode left it.
- `ended` = `length_cap` is a cut at {cap} steps and no switch: the next episode begins with the same observation.
- Nothing terminates in play: `next.done` is always False, `next.truncated` marks the last action and the frame after.
- `next.reward` is the extrinsic reward, which is always 0. `reward.intrinsic` is the explorer's own.
- Splits go by {split_by}, never by step: neighbouring frames are near copies and would leak. Draw validation data from
  `val` only.
- `world_model.loss` is the explorer's own at that moment of its learning: later it would be another for the same frame.
  It is NaN throughout if the explorer had no world model. So are parts of the reward that an explorer does not have.
- Explorers differ in how much they moved anything: look at the statistics before you mix them.
- Depth and segmentation, if the logs held them, were left out: simulate again from `meta/keyframes` to have them.
- Statistics (`meta/stats.json`) are over all finite values, the last frames of episodes included.
- Hugging Face's cache goes by path and time of change: a release put where another lay can be answered with old data.
  Give another `cache_dir`, or another path.
{pictures}"""

MEANINGS = {
    "observation.image": "what the camera sees, RGB",
    "observation.state": "the agent: position (m), quaternion wxyz, linear (m/s) and angular velocity (rad/s)",
    "observation.environment_state": "as `observation.state`, of every object; unused ones stand parked at y = −30 m",
    "action": "one-hot of nine moves",
    "action.index": "number of the action; −1 on an episode's last frame",
    "reward.intrinsic": "the explorer's own reward",
    "reward_part": "what the intrinsic reward is made of; NaN for explorers without it",
    "world_model.loss": "the world model's on the world being played in, as the curriculum scales it; or NaN",
    "policy.entropy": "nats, of the policy that chose the action",
    "policy.value": "what the policy's critic expected",
    "contact.count": "contacts in the step",
    "contact.agent": "contacts of the agent in the step",
    "contact.impulse": "sum of the impulses of all contacts (N s)",
    "next.reward": "from outside: always 0",
    "next.done": "always False",
    "next.truncated": "nothing comes after in this episode",
    "transition.valid": "False on an episode's last frame, which holds no action",
    "timestamp": "seconds since the episode's start",
    "frame_index": "within the episode",
    "episode_index": "within the release",
    "index": "within the release",
    "task_index": "always 0: there is no task",
}
"""What features are."""
