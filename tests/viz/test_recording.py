"""The sources decide about the view; a source without a view is refused, and the message names those with one."""

import importlib
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from gym_open import artefacts
from gym_open.config import Config
from gym_open.errors import ArtefactError, UsageError
from gym_open.formats.logs.reader import log_files
from gym_open.viz.config import Choice, VizConfig
from gym_open.viz.recording import kind_of, open_view, visualize

MakeLog = Callable[..., Path]
SEVERAL = {"puzzles", "curves"}
"""Views that accept several sources."""


class Nothing(Config, frozen=True):
    """An empty configuration."""


@pytest.fixture(scope="module")
def sources(make_log: MakeLog, tmp_path_factory: pytest.TempPathFactory) -> dict[str, Path]:
    """One artefact of each kind, by name; only the logs have content."""
    folder = tmp_path_factory.mktemp("sources")
    made = {"log": make_log(lengths=((3,),))}
    made["file"] = log_files(made["log"])[0][0]
    for kind in ("release", "encoder", "policy", "probe", "scores", "report", "recording", "figure", "other"):

        def work(partial: Path, kind: str = kind) -> dict[str, Any]:
            if kind in {"recording", "figure"}:
                (partial / ("seen.rrd" if kind == "recording" else "seen.png")).touch()
            return {}

        made[kind] = artefacts.build(folder / kind, kind=kind, config=Nothing(), parents=[], work=work).path
    for name in ("empty", "grid", "killed", "odd"):
        (folder / name).mkdir()
        made[name] = folder / name
    (made["grid"] / "jobs").mkdir()
    for name in ("killed", "odd"):
        (made[name] / "stream-000-000.mcap").write_bytes(made["file"].read_bytes()[:-100])
    (made["odd"] / artefacts.LINEAGE).write_text("{damaged")
    return made


@pytest.fixture
def opened(monkeypatch: pytest.MonkeyPatch) -> list[tuple[str, Any]]:
    """Collects the modules of opened views with their sources."""
    calls: list[tuple[str, Any]] = []
    for name in ("streams", "puzzles", "features", "curves"):

        def view(config: VizConfig, given: Any, choice: Choice, name: str = name) -> None:
            del config, choice
            calls.append((name, given))

        monkeypatch.setattr(importlib.import_module(f"gym_open.viz.{name}"), "view", view)
    return calls


@pytest.mark.parametrize(
    ("names", "choice", "view"),
    [
        (["log"], {}, "streams"),
        (["file"], {"stream": 0}, "streams"),
        (["killed"], {}, "streams"),
        (["odd"], {}, "streams"),
        (["release"], {"episode": 3}, "streams"),
        (["encoder"], {}, "features"),
        (["encoder"], {"release": Path("r")}, "features"),
        (["log"], {"release": Path("r")}, "features"),
        (["policy"], {"release": Path("r")}, "features"),
        (["policy"], {}, "curves"),
        (["encoder", "encoder"], {}, "curves"),
        (["encoder", "policy", "probe", "report", "grid"], {}, "curves"),
        (["scores"], {}, "puzzles"),
        (["scores", "scores"], {}, "puzzles"),
        (["scores", "policy"], {"puzzle": "tool-use/017"}, "puzzles"),
        (["policy"], {"puzzle": "tool-use/017"}, "puzzles"),
    ],
)
def test_each_kind_has_its_view(
    sources: dict[str, Path], opened: list[tuple[str, Any]], names: list[str], choice: dict[str, Any], view: str
) -> None:
    given = [sources[name] for name in names]
    open_view(VizConfig(), given, Choice(**choice))
    assert opened == [(view, given if view in SEVERAL else given[0])]


@pytest.mark.parametrize(
    ("names", "choice", "error", "message"),
    [
        ([], {}, UsageError, "no source given; give a log"),
        (["log", "log"], {}, UsageError, r"2 sources \(log, log\) have no common view; give one log or release"),
        (["log", "scores"], {}, UsageError, r"2 sources \(log, scores\) have no common view"),
        (["scores", "policy"], {}, UsageError, "have no common view.*--puzzle"),
        (["encoder"], {"puzzle": "tool-use/017"}, UsageError, "--puzzle shows scores and policies; .*'encoder'"),
        (["other"], {}, ArtefactError, "there is no view of an artefact of kind 'other'; give a log"),
        (["recording"], {}, ArtefactError, r"it can be opened directly: rerun .*recording/seen\.rrd"),
        (["figure"], {}, ArtefactError, r"it can be opened directly: open .*figure/seen\.png"),
        (["empty"], {}, ArtefactError, "not made by gym-open, or incomplete"),
    ],
)
def test_sources_without_a_view_are_refused(
    sources: dict[str, Path], names: list[str], choice: dict[str, Any], error: type[Exception], message: str
) -> None:
    with pytest.raises(error, match=message):
        open_view(VizConfig(), [sources[name] for name in names], Choice(**choice))


def test_a_missing_source_is_refused(tmp_path: Path) -> None:
    with pytest.raises(ArtefactError, match="nowhere: no such file or folder; give a log"):
        kind_of(tmp_path / "nowhere")


def test_a_log_is_written_as_a_recording(
    sources: dict[str, Path], tmp_path: Path, read_back: Callable[[Path], Any]
) -> None:
    path = visualize(VizConfig(), sources["log"], tmp_path / "play.rrd")
    assert read_back(path).column("/stream_0/observation/image", "EncodedImage:blob")[0] == [0, 1, 2, 3]
