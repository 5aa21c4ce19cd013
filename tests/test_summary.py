"""Tables at a terminal's usual width: figures whole, names broken only where a reader would break them."""

import io
from pathlib import Path

import msgspec
import pytest
from rich.console import Console, RenderableType

from gym_open.summary import Name, probe_table, score_table


def shown(table: RenderableType, width: int = 80) -> list[str]:
    console = Console(width=width, file=io.StringIO(), record=True)
    console.print(table)
    return [line.rstrip() for line in console.export_text().splitlines()]


def scores(folder: Path, verdict: str) -> Path:
    folder.mkdir()
    record = {
        "task": "goal-seeking", "split": "test", "puzzles": 100, "a_success": 0.5, "a_success_half_width_95": 0.05,
        "mean_return": -0.5, "mean_steps": 99.0, "trained": 1_000_000, "proof": {"verdict": verdict},
    }  # fmt: skip
    (folder / "scores.json").write_bytes(msgspec.json.encode(record))
    return folder


def test_names_of_scores_are_broken_behind_hyphens_and_figures_not_at_all(tmp_path: Path) -> None:
    names = {"goal-seeking-random": "no encoder", "policy-goal-seeking-seed0-at200000": "proven", "oracle": "missing"}
    lines = shown(score_table({name: scores(tmp_path / name, verdict) for name, verdict in names.items()}))
    first = [line.split("  ")[0] for line in lines[3:]]
    assert first == ["goal-seeking-random", "policy-goal-seeking-", "seed0-at200000", "oracle"]
    assert sum("0.500 ± 0.050" in line and "1,000,000" in line for line in lines) == len(names)


@pytest.mark.parametrize(
    ("name", "width", "lines"),
    [
        ("goal-seeking-random", 19, ["goal-seeking-random"]),
        ("goal-seeking-random", 18, ["goal-seeking-", "random"]),
        ("PPO from scratch", 8, ["PPO from", "scratch"]),
        ("a/b/c", 4, ["a/b/", "c"]),
        ("unbreakable", 6, ["unbrea", "kable"]),
        ("\x1b[31mred", 20, ["\\x1b[31mred"]),
        ("[bold]x", 20, ["[bold]x"]),
        ("", 20, [""]),
    ],
)
def test_a_name_fits_its_column(name: str, width: int, lines: list[str]) -> None:
    assert shown(Name(name), width) == lines


def test_the_gain_of_a_probe_is_never_cut(tmp_path: Path) -> None:
    """Neither are values, however bad: where there is no room, errors go below them."""
    value = {"value": -1234.5, "low": -1234.5, "high": -1234.5}
    features = ("trained", "untrained", "pixels")
    gain = {"value": -1.0, "low": -117.49, "high": -116.4}
    rows = {
        name: {"measure": measure, "guess": 0.5, "gain": gain, "scores": dict.fromkeys(features, cell)}
        for name, measure, cell in [("agent", "r2", {**value, "error_cells": 12.3}), ("move", "accuracy", value)]
    }
    (tmp_path / "probe.json").write_bytes(msgspec.json.encode({"targets": rows}))
    lines = shown(probe_table(tmp_path))
    assert lines[1].split() == ["target", "gain", "(95%)", "trained", "untrained", "pixels", "guess"]
    for line, name in ((lines[3], "agent"), (next(x for x in lines if x.startswith("move")), "move, accuracy")):
        assert line.split("  ")[0] == name
        assert line.removeprefix(name).split() == ["-117.49…-116.40", "-1234.50", "-1234.50", "-1234.50", "0.50"]
    assert lines[4].split() == ["(12.3)"] * 3
