"""Make the images of gallery.md: run a small experiment, and show its results with `gym-open viz`.

    python docs/make_gallery.py
    python docs/make_gallery.py --run DIR       keep the experiment in DIR, or use the one that is there

Headless Chromium takes the screenshots of Rerun's views. Without Chromium, only films and figures are made.
"""

import argparse
import itertools
import re
import subprocess
import sys
import tempfile
from collections.abc import Callable
from contextlib import ExitStack
from io import BytesIO
from pathlib import Path
from typing import NamedTuple

from browser import Browser, find
from PIL import Image

from gym_open import workspace

PICTURES = Path(__file__).parent / "pictures" / "gallery"
WIDTH, HEIGHT = 1280, 800
MOST_BYTES = 150_000
PATIENCE = 400.0
"""Limit of seconds per view, for a busy machine without a graphics card."""
CONFIGURATIONS = {
    "collect/gallery.toml": """
        steps = 4096
        streams = 2
        pool = 8
        explorer = {world_model = "icm", reward = "error", share_encoder = true}
        curriculum = {threshold = 0.0118}
        log = {depth = true, segmentation = true}
    """,
    "train/gallery-encoder.toml": """
        world_model = "icm"
        updates = 300
        report_every = 20
        batch_size = 64
    """,
    "train/gallery-probe.toml": """
        train_worlds = 200
        validation_worlds = 60
        test_worlds = 120
    """,
    "gallery.toml": """
        tasks = ["goal-seeking"]
        seeds = [0, 1]
        policy_steps = 40960
        checkpoints = [20480]
        probe = "train/gallery-probe.toml"
        [[agents]]
        name = "state"
        policy = "train/policy-state.toml"
        [[agents]]
        name = "icm"
        collect = "collect/gallery.toml"
        encoder = "train/gallery-encoder.toml"
        play_seed = 0
        policy = "train/policy-strong.toml"
    """,
}
LOG, RELEASE = "collect/logs/gallery-seed0", "datasets/open/gallery-seed0/1.0.0"
DAMAGED = "damaged/stream-000-000.mcap"
ENCODER = "train/encoders/gallery-encoder-of-gallery-seed0"
SCORES = ["evaluate/scores/state-goal-seeking-seed0", "evaluate/scores/icm-goal-seeking-seed0"]
REFERENCES = ["evaluate/scores/random-goal-seeking", "evaluate/scores/oracle-goal-seeking"]
POLICIES = [f"train/policies/{agent}-goal-seeking-seed{seed}" for agent in ("state", "icm") for seed in (0, 1)]
PUZZLE = ["--puzzle", "goal-seeking/017"]


class Screenshot(NamedTuple):
    """The name of an image, the arguments of `gym-open viz`, and positions to click first."""

    name: str
    words: list[str]
    clicks: tuple[tuple[int, int], ...] = ()


SHOTS = (
    Screenshot("log", [LOG, "--stream", "0", "--steps", "300:700"]),
    Screenshot("damaged", [DAMAGED, "--steps", "500:800"]),
    Screenshot("episode", [RELEASE, "--episode", "3"]),
    Screenshot("puzzle", [*SCORES, *PUZZLE]),
    Screenshot("policy", [POLICIES[0], *PUZZLE]),
    Screenshot("scores", [*SCORES, *REFERENCES]),
    Screenshot("encoder", [ENCODER, "--release", RELEASE]),
    Screenshot("policies", POLICIES),
    Screenshot("probe", ["train/probes/gallery-encoder-of-gallery-seed0"]),
    Screenshot("benchmark", ["."]),
)
FILES = {
    "still-log.png": [LOG, "--png"],
    "still-puzzle.png": [*SCORES, *PUZZLE, "--png"],
    "film-puzzle.gif": [*SCORES, *PUZZLE, "--film-look", "observation", "--video"],
}


def main() -> int:
    """Make all images, or those that the command line names."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--run", type=Path, help="folder of the experiment, which is used again if it exists")
    parser.add_argument("names", nargs="*", help="names of images; all by default")
    options = parser.parse_args()
    with ExitStack() as stack:
        root = options.run or Path(stack.enter_context(tempfile.TemporaryDirectory()))
        run = make_run(root.absolute())
        chosen: Callable[[str], bool] = lambda name: not options.names or name in options.names  # noqa: E731
        for name, words in FILES.items():
            if chosen(name):
                gym_open("viz", *words, str(PICTURES / name), folder=run)
                if name.endswith(".png"):
                    keep(PICTURES / name, (PICTURES / name).read_bytes())
        program = find()
        if program is None:
            print("Chromium is missing: the screenshots of Rerun's views do not change")
            return 1
        for shot in SHOTS:
            if chosen(shot.name):
                keep(PICTURES / f"{shot.name}.png", photograph(program, shot, run))
    return 0


def make_run(root: Path) -> Path:
    """Run a grid of two agents, add a damaged log, and return the folder."""
    if not (root / "gallery.toml").exists():
        workspace.init(root)
        for name, text in CONFIGURATIONS.items():
            (root / name).write_text(text)
    if not (root / "run" / "report").exists():
        gym_open("benchmark", "gallery.toml", "--out", "run", folder=root)
    damaged = root / "run" / DAMAGED
    whole = (root / "run" / LOG / damaged.name).read_bytes()
    damaged.parent.mkdir(exist_ok=True)
    damaged.write_bytes(whole[: len(whole) * 2 // 3])
    return root / "run"


def gym_open(*words: str, folder: Path) -> None:
    """Run a command in a folder; fail if it fails."""
    subprocess.run(command(*words), cwd=folder, check=True)  # noqa: S603  (our own command)


def command(*words: str) -> list[str]:
    """The command line of `gym-open` with these arguments."""
    return [sys.executable, "-m", "gym_open.cli", *words]


def photograph(program: str, shot: Screenshot, folder: Path) -> bytes:
    """Take a screenshot (PNG) of a view in Rerun's web viewer."""
    words = command("viz", *shot.words, "--web")
    with subprocess.Popen(words, cwd=folder, stdout=subprocess.PIPE, text=True) as viewer:  # noqa: S603
        try:
            assert viewer.stdout is not None
            said = "".join(itertools.takewhile(lambda line: "all data is loaded" not in line, viewer.stdout))
            address = re.search(r"http://127\.0\.0\.1:\d+", said)
            if address is None or viewer.poll() is not None:
                raise SystemExit(f"{shot.name}: gym-open viz did not serve the view")
            with Browser(program, WIDTH, HEIGHT) as browser:
                browser.open(address[0])
                picture = browser.still(limit=PATIENCE)
                for x, y in shot.clicks:
                    browser.click(x, y)
                    picture = browser.still(limit=PATIENCE)
        finally:
            viewer.terminate()
    return picture


def keep(path: Path, picture: bytes) -> None:
    """Write the image with the largest size and number of colours that the file limit allows."""
    image, small = Image.open(BytesIO(picture)).convert("RGB"), BytesIO()
    for width, colours in ((WIDTH, 256), (WIDTH, 64), (960, 256), (960, 64), (640, 64)):
        fitting = image.resize((width, round(image.height * width / image.width)), Image.Resampling.LANCZOS)
        few = fitting.quantize(colours, Image.Quantize.MAXCOVERAGE, kmeans=2, dither=Image.Dither.NONE)
        small = BytesIO()
        few.save(small, "PNG", optimize=True)
        if len(small.getvalue()) < MOST_BYTES:
            break
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_bytes(small.getvalue())
    print(f"{path}: {len(small.getvalue()) / 1000:.0f} kB")


if __name__ == "__main__":
    sys.exit(main())
