"""The recording of an unfinished grid, read back: its numbers are those of the report and of the curves."""

import json
import shutil
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import rerun as rr
from matplotlib.figure import Figure

from gym_open.errors import ArtefactError, UsageError
from gym_open.evaluate.config import ReportConfig
from gym_open.evaluate.report import write_report
from gym_open.evaluate.report.figures import ReportFigure
from gym_open.results.records import TrainingCurve, read_curve
from gym_open.viz import curves
from gym_open.viz.config import Choice, VizConfig
from gym_open.viz.curves import figure
from gym_open.viz.curves.sources import ReportTable, find, summaries, summaries_of_report
from gym_open.viz.puzzles.tables import read_tables

ReadBack = Callable[[Path], Any]
SCRATCH, EVIL = "/score/goal-seeking/scratch", r"/score/goal-seeking/\<b\>x\<\/b\>\|\`\\x1b\[2J"


class Recording:
    """A recording of curves read back."""

    def __init__(self, read_back: ReadBack, folder: Path, *sources: Path) -> None:
        view = curves.view(VizConfig(), sources, Choice())
        with rr.RecordingStream("test", recording_id="test") as rec:
            rec.save(folder / "curves.rrd", default_blueprint=view.blueprint)
            view.fill(rec)
        self._recording = read_back(folder / "curves.rrd")
        self.entities = self._recording.entities()

    def curve(self, entity: str) -> tuple[list[int], list[float]]:
        steps, values = self._recording.column(entity, "Scalars:scalars")
        return steps, [value[0] for value in values]

    def static(self, entity: str, component: str) -> Any:
        return self._recording.static(entity, component)[0]


@pytest.fixture(scope="module")
def drawn(read_back: ReadBack, benchmark: Path, tmp_path_factory: pytest.TempPathFactory) -> Recording:
    return Recording(read_back, tmp_path_factory.mktemp("rrd"), benchmark)


@pytest.fixture
def no_figures(monkeypatch: pytest.MonkeyPatch) -> None:
    """A report is written without its figures, which take most of its time."""
    monkeypatch.setattr("gym_open.evaluate.report.figures.draw", lambda _: [])


@pytest.fixture(scope="module")
def report(benchmark: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The report of the same scores."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(
            "gym_open.evaluate.report.figures.draw", lambda _: [ReportFigure("none.svg", b"<svg/>", "none", "none")]
        )
        out = tmp_path_factory.mktemp("report") / "report"
        return write_report(ReportConfig(), [benchmark / "evaluate"], out).path


def cells(report: Path) -> dict[str, Any]:
    return {cell["agent"]: cell for cell in json.loads((report / "table.json").read_bytes())["results"]["cells"]}


def test_scores_and_intervals_are_the_reports(drawn: Recording, report: Path) -> None:
    learning = cells(report)["scratch"]["learning"]
    assert learning["x"] == [400, 800]
    for part, key in (("mean", "value"), ("low", "low"), ("high", "high")):
        x, y = drawn.curve(f"{SCRATCH}/{part}")
        assert x == learning["x"]
        assert y == pytest.approx(learning[key])
    for agent in ("scratch", "random"):
        returns = cells(report)[agent]["returns"]
        for part, key in (("mean", "value"), ("low", "low"), ("high", "high")):
            assert drawn.curve(f"/return/goal-seeking/{agent}/{part}") == (returns["x"], pytest.approx(returns[key]))


@pytest.mark.usefixtures("no_figures")
def test_names_numbers_and_intervals_are_exactly_the_reports(benchmark: Path, tmp_path: Path) -> None:
    """Also where a run was not scored to its end."""
    scores = shutil.copytree(benchmark / "evaluate/scores", tmp_path / "scores")
    shutil.rmtree(scores / "scratch-goal-seeking-seed1-at800")
    made = write_report(ReportConfig(), [scores], tmp_path / "report").path
    results = json.loads((made / "table.json").read_bytes())["results"]
    rows, left_behind = summaries(find([scores]).runs)
    assert rows == summaries_of_report(ReportTable("report", {"results": results}))
    assert [row.agent for row in rows] == results["agents"] == ["scratch", "<b>x</b>|`\\x1b[2J", "random"]
    assert left_behind == results["left_behind"]
    assert left_behind == ["scratch, goal-seeking, seed 1: scored at 400, not 800 steps; left out."]
    (table,) = read_tables([scores / f"{name}-goal-seeking-seed0-at{at}" for name, at in (
        ("scratch", 800), ("hostile", 400),
    )])  # fmt: skip
    assert [agent.name for agent in table.agents] == results["agents"][:2]
    assert [agent.run.values.mean() for agent in table.agents] == [row.score.value for row in rows[:2]]


def test_what_no_training_made_is_a_level_over_all_steps(drawn: Recording, report: Path) -> None:
    x, y = drawn.curve("/score/goal-seeking/random/mean")
    assert (x[0], x[-1]) == (0, 800)
    assert y == pytest.approx([cells(report)["random"]["score"]["value"]] * len(x))


def test_a_report_alone_shows_the_same(drawn: Recording, report: Path, tmp_path: Path, read_back: ReadBack) -> None:
    alone = Recording(read_back, tmp_path, report)
    assert alone.curve(f"{SCRATCH}/low") == (
        drawn.curve(f"{SCRATCH}/low")[0],
        pytest.approx(drawn.curve(f"{SCRATCH}/low")[1]),
    )
    assert "What was exploration worth" in alone.static(r"/about/report\ 1", "TextDocument:text")


def test_training_is_thin_by_seed_and_thick_where_all_seeds_know(drawn: Recording, benchmark: Path) -> None:
    own = [
        {row[0]: row[1] for row in json.loads((folder / "curve.json").read_bytes())["rows"] if row[1] is not None}
        for folder in sorted((benchmark / "train/policies").glob("scratch-*"))
    ]
    for seed, rows in enumerate(own):
        entity = f"/training/goal-seeking/scratch/runs/{seed}-seed-{seed}"
        assert drawn.curve(entity) == (list(rows), list(rows.values()))
        assert drawn.static(entity, "SeriesLines:widths") < 1 < drawn.static(f"{SCRATCH}/mean", "SeriesLines:widths")
    common = [step for step in own[0] if step in own[1]]
    assert common == list(range(200, 801, 100))
    mean = [(own[0][step] + own[1][step]) / 2 for step in common]
    assert drawn.curve("/training/goal-seeking/scratch/mean") == (common, pytest.approx(mean))


def test_an_agent_has_one_colour_everywhere_and_no_other_agent_has_it(drawn: Recording) -> None:
    def look(entity: str) -> int:
        return drawn.static(entity, "SeriesLines:colors") >> 8

    own = {look(f"/{kind}/goal-seeking/scratch/mean") for kind in ("score", "return", "training")}
    assert len(own) == 1
    assert own.isdisjoint({look(f"{EVIL}/mean"), look("/score/goal-seeking/random/mean")})


def test_a_hostile_name_is_shown_and_does_nothing(drawn: Recording) -> None:
    assert f"{EVIL}/mean" in drawn.entities
    assert drawn.static(f"{EVIL}/mean", "SeriesLines:names") == r"<b>x</b>|`\x1b[2J"
    text = drawn.static("/about/task/goal-seeking", "TextDocument:text")
    assert r"\<b\>x\</b\>\|\`\\x1b\[2J | 1 | 400 |" in text


def test_an_encoders_curve_is_drawn_where_it_is_known(drawn: Recording) -> None:
    assert drawn.curve(r"/encoder/curl/loss/encoder-curl-of-play") == ([100, 200], [0.5, 0.25])
    assert drawn.curve(r"/encoder/curl/held_out_loss/encoder-curl-of-play") == ([200], [0.75])


def test_what_is_damaged_is_told_of_in_a_folder_and_an_error_by_itself(benchmark: Path, tmp_path: Path) -> None:
    root = shutil.copytree(benchmark, tmp_path / "half")
    shutil.copytree(root / "evaluate/scores/scratch-goal-seeking-seed0-at800", root / "evaluate/scores/.x.partial")
    broken = root / "train/policies/scratch-goal-seeking-seed1"
    shutil.copytree(broken, broken.with_name(f"{broken.name}-1"))  # set aside by a newer one
    (broken / "curve.json").write_bytes((broken / "curve.json").read_bytes().replace(b"0.", b"1.", 1))
    found = find([root])
    assert [(one.kind, one.seed) for one in found.models if one.name == "scratch"] == [("policy", 0)]
    assert len(found.runs) == 6
    (line,) = found.left_out
    assert "scratch-goal-seeking-seed1" in line
    assert "SHA-256" in line
    with pytest.raises(ArtefactError, match=r"curve\.json.*SHA-256"):
        find([broken])


def test_there_must_be_something_to_draw(tmp_path: Path, benchmark: Path, make_log: Callable[..., Path]) -> None:
    with pytest.raises(ArtefactError, match="nothing to draw here; give"):
        curves.view(VizConfig(), [make_log(lengths=((2,),)).parent], Choice())
    with pytest.raises(ArtefactError, match="no such folder"):
        curves.view(VizConfig(), [tmp_path / "none"], Choice())
    with pytest.raises(UsageError, match="--segment"):
        curves.view(VizConfig(), [benchmark], Choice(segment=1))


@pytest.mark.parametrize(
    "record", [{"columns": ["update", "loss"], "rows": [[1]]}, {"columns": [], "rows": []},
               {"columns": ["update", "loss"], "rows": [[None, 1]]}, {"rows": []}, [],
               *({"columns": ["update", "loss"], "rows": rows} for rows in (
                   [[1e300, 1]], [[2**70, 1]], [[10**400, 1]], [[-1, 1]], [[1, 1], [1, 2]], [[2, 1], [1, 2]],
                   [[1, 1e300]],
               )),
               {"columns": ["update", "loss", "loss"], "rows": [[1, 2, 3]]}],
)  # fmt: skip
def test_a_curve_that_is_none_is_named(tmp_path: Path, record: Any) -> None:
    assert read_curve(tmp_path) is None
    (tmp_path / "curve.json").write_text(json.dumps(record))
    with pytest.raises(ArtefactError, match=r"curve\.json: not readable"):
        read_curve(tmp_path)


def painted(monkeypatch: pytest.MonkeyPatch, draw: Callable[[], object]) -> Figure:
    """The figure that `draw` draws, before it becomes a PNG file."""
    made: list[Figure] = []

    def keep(width: float, height: float, paint: Callable[[Figure], None]) -> bytes:
        made.append(Figure(figsize=(width, height)))
        paint(made[0])
        return b""

    monkeypatch.setattr(figure, "draw_png", keep)
    draw()
    return made[0]


def test_the_figure_of_probes_has_their_scores_and_intervals(benchmark: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    probes = find([benchmark / "train/probes"]).probes
    agent, contact, *_ = painted(monkeypatch, lambda: figure.draw_probes(probes)).axes
    assert [axes.get_title() for axes in (agent, contact)] == ["agent (r2)", "contact (auc)"]
    bars = {str(bar.get_label()): bar for bar in agent.containers}
    assert list(bars) == ["trained", "untrained", "pixels"]
    for kind, value in (("trained", 0.8), ("untrained", 0.5), ("pixels", 0.7)):
        line, _, (reach,) = bars[kind].lines  # type: ignore[attr-defined]
        assert line.get_xdata() == pytest.approx([value])
        assert reach.get_segments()[0][:, 0] == pytest.approx([value - 0.1, value + 0.05])
    assert [label.get_text() for label in agent.get_yticklabels()] == ["encoder-curl-of-play"]


def test_the_figure_of_a_curve_puts_held_out_data_beside_their_own(monkeypatch: pytest.MonkeyPatch) -> None:
    curve = TrainingCurve(
        ["update", "loss", "accuracy", "held_out_loss"], [[1, 0.5, None, None], [2, 0.25, None, 0.75]]
    )
    loss, accuracy, *_ = painted(monkeypatch, lambda: figure.draw_curve(curve)).axes
    lines = {str(line.get_label()): np.array(line.get_xydata()) for line in loss.lines}
    assert lines["in training"].tolist() == [[1, 0.5], [2, 0.25]]
    assert lines["held out"].tolist() == [[2, 0.75]]
    assert [text.get_text() for text in accuracy.texts] == ["no data"]
    assert painted(monkeypatch, lambda: figure.draw_curve(TrainingCurve(["update"], []))).axes  # nothing but an axis
