"""`gym-open report` on the command line."""

from collections.abc import Callable
from pathlib import Path

import pytest

from gym_open.cli import main


@pytest.mark.usefixtures("no_figures")
def test_without_a_folder_it_is_of_the_workspaces_scores(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str], make_run: Callable[..., Path]
) -> None:
    monkeypatch.chdir(tmp_path)
    assert main(["report"]) == 2
    last = capsys.readouterr().err.splitlines()[-1]
    assert last == "error: evaluate/scores: no such folder; give folders that hold scores"
    make_run(tmp_path / "evaluate" / "scores" / "random", agent="random")
    assert main(["report", "--resamples", "100"]) == 0
    assert (tmp_path / "evaluate" / "reports" / "report" / "report.html").is_file()
