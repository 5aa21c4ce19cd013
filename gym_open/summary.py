"""Summaries of artefacts, read from disk: tables for people, and records for programs."""

import re
import shlex
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

import msgspec
from rich.cells import cell_len
from rich.console import Console, ConsoleOptions
from rich.measure import Measurement
from rich.table import Table
from rich.text import Text

from gym_open import artefacts
from gym_open.terminal import markup, printable, titled_table

PAPER_NOTE = "paper, goal-seeking, 1M steps: PPO from scratch .509, CURL+RIDE .532, human .584"


def short(path: Path) -> str:
    """The path as a user would type it in the current folder."""
    return str(path.relative_to(Path.cwd())) if path.is_relative_to(Path.cwd()) else str(path)


def word(path: Path) -> str:
    """The result of `short`, quoted for the shell if necessary."""
    return shlex.quote(short(path))


def read_json(path: Path) -> dict[str, Any]:
    """Read a JSON file of an artefact as plain data."""
    return msgspec.json.decode(path.read_bytes())


def stage_record(stage: str, made: artefacts.Outcome, seconds: float) -> dict[str, Any]:
    """The record of a finished stage for programs, as plain data for JSON.

    `figures` holds the numbers, texts and booleans among the facts of the artefact's lineage. Scores add their results,
    and a probe adds the gain of each target.
    """
    about = artefacts.lineage(made.path)
    figures = {name: fact for name, fact in about.facts.items() if isinstance(fact, int | float | str)}
    if about.kind == "scores":
        scores = read_json(made.path / "scores.json")
        figures |= {name: scores[name] for name in _SCORES} | {"proof": scores["proof"]["verdict"]}
    if about.kind == "probe":
        targets = read_json(made.path / "probe.json")["targets"]
        figures |= {f"gain_{target}": row["gain"]["value"] for target, row in targets.items()}
    return {
        "stage": stage,
        "result": "made" if made.made else "up-to-date",
        "seconds": round(seconds, 1),
        "path": str(made.path),
        "digest": artefacts.digest(made.path),
        "kind": about.kind,
        "figures": figures,
    }


_SCORES = ("a_success", "a_success_half_width_95", "mean_return", "mean_steps", "trained")


class Name:
    """A name in a table. If its column is too narrow, the name breaks after a hyphen, a slash or a space."""

    def __init__(self, name: str) -> None:
        self.parts = re.findall(r"[^-/\s]+[-/\s]*|[-/\s]+", printable(name)) or [""]

    def __rich_console__(self, console: Console, options: ConsoleOptions) -> Iterator[Text]:
        """Put as many parts on a line as fit."""
        lines = [""]
        for part in self.parts:
            if cell_len((lines[-1] + part).rstrip()) > options.max_width and lines[-1]:
                lines.append("")
            lines[-1] += part
        yield Text("\n".join(line.rstrip() for line in lines), overflow="fold")

    def __rich_measure__(self, console: Console, options: ConsoleOptions) -> Measurement:
        """From the longest part to the whole name."""
        return Measurement(max(cell_len(part.rstrip()) for part in self.parts), cell_len("".join(self.parts)))


def score_table(scores: Mapping[str, Path]) -> Table:
    """One row per agent: A-Success with its 95% interval over puzzles, mean return, mean actions, training steps."""
    first = read_json(next(iter(scores.values())) / "scores.json")
    title = f"{first['task']}: the same {first['puzzles']} {first['split']} puzzles for every agent"
    numbers = ("A-Success (95%)", "return", "actions", "trained")
    table = titled_table(title, ("agent", *numbers), right=numbers, unbroken=numbers, compact=True)
    table.add_column(Name("task-free"), max_width=len("no encoder"))
    for name, path in scores.items():
        record = read_json(path / "scores.json")
        table.add_row(
            Name(name),
            f"{record['a_success']:.3f} ± {record['a_success_half_width_95']:.3f}",
            f"{record['mean_return']:.2f}",
            f"{record['mean_steps']:.0f}",
            f"{record['trained']:,}",
            markup(record["proof"]["verdict"]),
        )
    return table


def probe_table(path: Path) -> Table:
    """One row per target: how well a linear map predicts it from features on held-out worlds, and training's gain."""
    targets = read_json(path / "probe.json")["targets"]
    rows = sorted(targets.items(), key=lambda row: ("error_cells" not in row[1]["scores"]["trained"], row[0]))
    features = [name for name in ("trained", "untrained", "pixels") if name in rows[0][1]["scores"]]
    title = "linear probe: R² unless stated otherwise (error in cells)"
    numbers = ("gain (95%)", *features, "guess")  # on a narrow terminal, errors go below their values
    table = titled_table(title, ("target", *numbers), right=numbers, unbroken=("target", "gain (95%)"), compact=True)
    for target, row in rows:
        gain, measure = row["gain"], "" if row["measure"] == "r2" else f", {row['measure']}"
        table.add_row(
            markup(target + measure),
            f"{gain['low']:+.2f}…{gain['high']:+.2f}",
            *(_probe_cell(row["scores"][name]) for name in features),
            f"{row['guess']:.2f}",
        )
    return table


def _probe_cell(score: Mapping[str, float]) -> str:
    error = f" ({score['error_cells']:.1f})" if "error_cells" in score else ""
    return f"{score['value']:.2f}{error}"


def proof_text(name: str, scores: Path) -> str:
    """The task-free proof of one agent in a few lines."""
    proof = read_json(scores / "scores.json")["proof"]
    if proof["verdict"] == "proven":
        chain = " ← ".join(proof["chain"])
        return f"{name}: task-free, proven: {chain}; sandbox only, no extrinsic reward, no evaluation puzzle"
    return f"{name}: {proof['verdict']}: {'; '.join(proof['reasons'])}"


def stage_table(rows: list[tuple[str, str, str, str]]) -> Table:
    """One row per stage: name, result, seconds, digest."""
    table = titled_table("stages", ("stage", "result", "time", "digest"), right=("time",), compact=True)
    for row in rows:
        table.add_row(*row)
    return table
