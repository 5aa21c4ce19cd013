"""Check that LeRobot (off-line) and pandas read the same frames as our reader."""

import os
import subprocess
import sys
import tempfile
from importlib.util import find_spec
from pathlib import Path

import numpy as np

from gym_open.datasets.verify import lerobot_frames
from gym_open.datasets.verify.report import Findings
from gym_open.errors import UsageError
from gym_open.formats.pngs import decode_untrusted
from gym_open.formats.releases.layout import IMAGE, data_path
from gym_open.formats.releases.reader import Release

VARIABLE = "GYM_OPEN_LEROBOT"
"""Environment variable: a Python with LeRobot, usually of a separate environment, since LeRobot needs old packages."""
_LIMIT_S = 900
_ROUNDING = 0.01
"""Largest difference in levels of 255 between our image and one in float32 from 0 to 1."""


def chosen(release: Release) -> list[int]:
    """Episodes to read: the first, one in the middle, and the last."""
    count = len(release.episodes)
    return sorted({0, count // 2, count - 1})


def python_with_lerobot() -> str | None:
    """The Python with LeRobot: from `GYM_OPEN_LEROBOT`, else this one if LeRobot is installed, else None."""
    return os.environ.get(VARIABLE) or (sys.executable if find_spec("lerobot") else None)


def check_lerobot(release: Release, findings: Findings) -> bool:
    """Check that LeRobot loads the release off-line with our frames. False if there is no LeRobot.

    Raises:
        UsageError: if `GYM_OPEN_LEROBOT` is no program.
    """
    python = python_with_lerobot()
    if python is None:
        return False
    episodes = chosen(release)
    with tempfile.TemporaryDirectory() as folder:
        out = Path(folder) / "frames.npz"
        offline = {"HF_HUB_OFFLINE": "1", "HF_DATASETS_OFFLINE": "1", "HF_HOME": folder, "HF_LEROBOT_HOME": folder}
        plain = Path(folder) / "release"  # Hugging Face reads [, * and ? in a path as patterns
        plain.symlink_to(release.root.absolute(), target_is_directory=True)
        # Run the file, since that Python may lack this package; -P keeps its folder out of the imports.
        words = [python, "-P", lerobot_frames.__file__, str(plain), release.name, str(out)]
        try:
            done = subprocess.run(  # noqa: S603  # our own module, by a list of words
                [*words, *map(str, episodes)], env={**os.environ, **offline, "HF_DATASETS_CACHE": f"{folder}/datasets"},
                capture_output=True, text=True, errors="replace", check=False, timeout=_LIMIT_S,
            )  # fmt: skip
        except subprocess.TimeoutExpired:
            findings.add("data", f"LeRobot did not load it within {_LIMIT_S} s")
            return True
        except OSError as error:
            raise UsageError(f"{VARIABLE}: {python}: cannot be run ({error.strerror}); name a Python") from None
        if done.returncode or not out.exists():
            last = (done.stderr.strip().splitlines() or ["it said nothing"])[-1]
            findings.add("data", f"LeRobot cannot load it: {last[:300]}")
            return True
        with np.load(out, allow_pickle=False) as found:
            _compare(release, dict(found), episodes, findings)
    return True


def _compare(release: Release, found: dict[str, np.ndarray], episodes: list[int], findings: Findings) -> None:
    for episode in episodes:
        row = release.episodes.iloc[episode]
        first, stop = int(row["dataset_from_index"]), int(row["dataset_to_index"])
        file = data_path(int(row["data/chunk_index"]), int(row["data/file_index"]))
        good = found[f"{episode}/length"][0] == stop - first
        good &= found[f"{episode}/total"].tolist() == [len(release.episodes), len(release)]
        findings.expect(bool(good), file, f"LeRobot finds another number of episodes or frames in episode {episode}")
        for place, index in (("first", first), ("last", stop - 1)):
            values, (image,) = release.numbers(index, index + 1), release.images([index])
            theirs = found[f"{episode}/{place}/{IMAGE}"].transpose(1, 2, 0) * 255
            off = np.abs(theirs - image).max()
            findings.expect(
                bool(off <= _ROUNDING), file,
                f"LeRobot's {place} image of episode {episode} differs by {off:.3g} levels",
            )  # fmt: skip
            for name, array in values.items():
                same = np.array_equal(array[0], found[f"{episode}/{place}/{name}"].reshape(array[0].shape), True)
                findings.expect(same, file, f"LeRobot's {name} of the {place} frame of episode {episode} differs")


def check_pandas(release: Release, findings: Findings) -> None:
    """Check that pandas reads our frames from the first and the last data file."""
    import pandas as pd

    rows = release.episodes
    for row in (rows.iloc[0], rows.iloc[-1]):
        place = int(row["data/chunk_index"]), int(row["data/file_index"])
        file = data_path(*place)
        inside = rows[(rows["data/chunk_index"] == place[0]) & (rows["data/file_index"] == place[1])]
        first, stop = int(inside["dataset_from_index"].min()), int(inside["dataset_to_index"].max())
        table = pd.read_parquet(release.root / file)
        findings.expect(len(table) == stop - first, file, f"pandas finds {len(table)} frames, expected {stop - first}")
        for index in (first, stop - 1):
            found = table.iloc[index - first]
            for name, array in release.numbers(index, index + 1).items():
                same = np.array_equal(array[0], np.reshape(found[name], array[0].shape), True)
                findings.expect(same, file, f"pandas finds another {name} in frame {index}")
            if release.info["features"][IMAGE]["dtype"] == "image":
                same = np.array_equal(decode_untrusted(found[IMAGE]["bytes"]), release.images([index])[0])
                findings.expect(same, file, f"pandas finds another image in frame {index}")
