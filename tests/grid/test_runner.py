"""Parallel jobs: order, failures, what is up to date; no child outlives the runner. Jobs are small scripts here."""

import dataclasses
import io
import itertools
import signal
import subprocess
import sys
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import pytest
from rich.console import Console

from gym_open import artefacts, progress
from gym_open.collect.config import CollectConfig
from gym_open.errors import GymOpenError
from gym_open.evaluate.config import EvaluateConfig
from gym_open.files import lock
from gym_open.grid import AgentConfig, GridConfig, child, run_grid, runner
from gym_open.grid.child import GridJobStatus
from gym_open.grid.plan import GridJob, StageName
from gym_open.grid.runner import Runner
from gym_open.grid.table import Screen, table
from tests.children import is_alive, started, until

ROOT = Path(__file__).parents[2]

MAKE = """
import pathlib, sys, time
out = pathlib.Path(sys.argv[1])
begun = time.monotonic_ns()
time.sleep(float(sys.argv[2]))
if not (out / "manifest.json").exists():
    out.mkdir(parents=True)
    (out / "manifest.json").write_text(f"{begun} {time.monotonic_ns()}")
"""
MEET = f"""
import pathlib, sys, time
here = pathlib.Path(sys.argv[1])
(here.parent / f"{{here.name}}.begun").touch()
while len(list(here.parent.glob("*.begun"))) < 2:
    time.sleep(0.01)
{MAKE}
"""
FAIL = "import sys; print('so far so good'); print('error: \\x1b[31mno such thing', file=sys.stderr); sys.exit(1)"
BOX = """
import sys
print('''╭─ Unrecognized options ─────────────╮
│ Unrecognized options: --polcy, a   │
│ path that goes on                  │
│ ────────────────────────────────── │
│ For full helptext, run --help      │
╰────────────────────────────────────╯''')
sys.exit(2)
"""
TRACEBACK = "raise RuntimeError('broken')"


@dataclass(frozen=True)
class Script(GridJob):
    """A job that is a Python script. Its arguments are the job's folder and `seconds`."""

    script: str = MAKE
    seconds: float = 0.0

    def words(self, folder: Path) -> list[str]:  # noqa: ARG002  (it has no configuration)
        return ["-c", self.script, str(self.out), str(self.seconds)]


@pytest.fixture(autouse=True)
def _scripts(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(child, "PROGRAM", (sys.executable,))
    monkeypatch.setattr(runner, "_LOOK", 0.01)


def job(root: Path, name: str, *needs: GridJob, stage: StageName = "collect", units: int = 1, **more: Any) -> Script:
    config = EvaluateConfig() if stage == "evaluate" else CollectConfig()
    return Script(name, stage, root / name, config, units, (), needs, **more)


def run(root: Path, jobs: Sequence[GridJob], width: int = 2) -> tuple[Runner, str]:
    made = Runner(jobs, root / "jobs", width)
    said = io.StringIO()
    with Screen(Console(file=said, width=60)) as screen:
        made.run(screen)
    return made, said.getvalue()


def states(made: Runner) -> dict[str, str]:
    return {name: found.state for name, found in made.statuses.items()}


def times(root: Path, name: str) -> tuple[int, int]:
    begun, ended = (root / name / "manifest.json").read_text().split()
    return int(begun), int(ended)


def test_a_job_waits_for_what_it_needs_and_others_do_not(tmp_path: Path) -> None:
    first, beside = (
        job(tmp_path, name, script=MEET) for name in ("first", "beside")
    )  # each ends only while the other runs
    second = job(tmp_path, "second", first, beside)
    made, said = run(tmp_path, [first, beside, second])
    assert set(states(made).values()) == {"made"}
    assert times(tmp_path, "second")[0] > max(times(tmp_path, "first")[1], times(tmp_path, "beside")[1])
    assert [line for line in said.splitlines() if "made" in line][-1].startswith("second: made (")


def test_width_one_is_one_job_at_a_time_longest_chain_first(tmp_path: Path) -> None:
    short, long, start = job(tmp_path, "a", units=1000), job(tmp_path, "b", units=9000), job(tmp_path, "c")
    after = job(tmp_path, "d", start, units=10_000)
    score = job(tmp_path, "e", stage="evaluate")
    jobs = [short, long, start, after, score]
    run(tmp_path, jobs, width=1)
    spans = sorted((times(tmp_path, made.name), made.name) for made in jobs)
    assert "".join(name for _, name in spans) == "ecdba"
    assert all(ended <= begun for ((_, ended), _), ((begun, _), _) in itertools.pairwise(spans))


def test_a_failure_stops_only_what_needs_it(tmp_path: Path) -> None:
    bad = job(tmp_path, "bad", script=FAIL)
    worse = job(tmp_path, "worse", script=TRACEBACK)
    lost = job(tmp_path, "lost", bad)
    lost_too = job(tmp_path, "lost-too", lost)
    good = job(tmp_path, "good", job(tmp_path, "fine"))
    made, said = run(tmp_path, [bad, worse, lost, lost_too, *good.needs, good])
    assert states(made) == {
        "bad": "failed", "worse": "failed", "lost": "held up", "lost-too": "held up", "fine": "made", "good": "made",
    }  # fmt: skip
    assert made.statuses["bad"].reason.endswith("no such thing")
    assert made.statuses["worse"].reason == "RuntimeError: broken"
    assert r"\x1b[31mno such thing" in said
    assert "\x1b" not in said
    assert "so far so good" in (tmp_path / "jobs/bad.log").read_text()


def test_options_that_are_refused_are_the_reason_and_not_an_earlier_failure(tmp_path: Path) -> None:
    made, _ = run(tmp_path, [job(tmp_path, "bad", script=FAIL)])
    assert made.statuses["bad"].reason.endswith("no such thing")
    made, _ = run(tmp_path, [job(tmp_path, "bad", script=BOX)])
    assert made.statuses["bad"].reason == "Unrecognized options: --polcy, a path that goes on"


def test_existing_artefacts_are_up_to_date_and_failures_are_tried_again(tmp_path: Path) -> None:
    first, bad = job(tmp_path, "first"), job(tmp_path, "bad", script=FAIL)
    run(tmp_path, [first, bad])
    before = times(tmp_path, "first")
    mended = job(tmp_path, "bad")
    made, _ = run(tmp_path, [first, mended])
    assert states(made) == {"first": "up to date", "bad": "made"}
    assert times(tmp_path, "first") == before
    log = (tmp_path / "jobs/bad.log").read_text()
    assert log.count("$ OMP_NUM_THREADS=1") == 2  # of both attempts


def test_nothing_is_started_for_a_whole_artefact_of_the_same_inputs(tmp_path: Path) -> None:
    def work(folder: Path) -> dict[str, str]:
        (folder / "payload").write_text("played")
        return {}

    play = job(tmp_path, "play")
    artefacts.build(play.out, kind="log", config=play.config, parents=[], work=work)
    score = job(tmp_path, "score", play, stage="evaluate")
    artefacts.build(score.out, kind="scores", config=score.config, parents=[play.out], work=work)
    other = dataclasses.replace(score, name="other", config=EvaluateConfig(seed=1))
    logs = tmp_path / "jobs"
    made, _ = run(tmp_path, [play, score])
    assert states(made) == {"play": "up to date", "score": "up to date"}
    assert not list(logs.glob("*.log"))
    run(tmp_path, [play, other])
    assert [log.name for log in logs.glob("*.log")] == ["other.log"]
    (play.out / "payload").write_text("forged")
    run(tmp_path, [play, score])
    assert sorted(log.name for log in logs.glob("*.log")) == ["other.log", "play.log", "score.log"]


def test_a_job_that_a_signal_ends_is_a_failure(tmp_path: Path) -> None:
    made, _ = run(tmp_path, [job(tmp_path, "shot", script="import os; os.kill(os.getpid(), 9)")])
    assert made.statuses["shot"].state == "failed"
    assert made.statuses["shot"].reason == "ended by SIGKILL"


def test_children_have_one_thread_and_report_their_progress(tmp_path: Path) -> None:
    script = """
import os, pathlib, sys, time
assert os.environ["OMP_NUM_THREADS"] == "1"
from gym_open.progress import bar
real, now = time.sleep, 0.0
time.monotonic = lambda: now
def wait_until_seen(done):
    while not pathlib.Path(sys.argv[1] + f".{done}").exists():
        real(0.01)
with bar("playing", 400) as shown:
    wait_until_seen(0)
    now = 0.05
    shown.advance(100)
    now = 1.05
    shown.advance(100)
    wait_until_seen(200)
"""
    made = Runner([job(tmp_path, "plays", script=script, units=400)], tmp_path / "jobs", 1)
    seen = set[tuple[int, int]]()

    class Watch(Screen):
        def show(self, statuses: Mapping[str, GridJobStatus], left: float) -> None:  # noqa: ARG002
            if (found := statuses["plays"].progress) is not None:
                seen.add((found.done, found.total))
                (tmp_path / f"plays.{found.done}").touch()
                assert (found.done == 0) == (found.rate == 0)

    made.run(Watch(Console(file=io.StringIO())))
    assert states(made) == {"plays": "up to date"}  # it ended well, and wrote no artefact
    assert seen == {(0, 400), (200, 400)}
    assert not list((tmp_path / "jobs").glob("*.progress*"))


def _number(path: Path) -> int:
    return int(until(lambda: path.is_file() and path.read_text().strip()))


RUNNER = """
import io, signal, sys
from pathlib import Path
from rich.console import Console
sys.path[:0] = sys.argv[1:2]
from tests.grid import test_runner
from tests.children import is_alive
from gym_open.grid import AgentConfig, GridConfig, child, run_grid, runner
child.PROGRAM = (sys.executable,)
signal.signal(signal.SIGINT, signal.default_int_handler)  # ignored where the tests themselves run in the background
root = Path(sys.argv[2])
script = f"import os, time; open({str(root / 'pid')!r}, 'w').write(str(os.getpid())); time.sleep(100_000)"
runner.make_plan = lambda config, out, root: [test_runner.job(out, "long", script=script)]
try:
    runner.run_grid(None, root / "out", root=root, jobs=1, console=Console(file=io.StringIO()))
except KeyboardInterrupt:
    sys.exit(1 if is_alive(int((root / "pid").read_text())) else 130)
"""


@pytest.mark.parametrize("sign", [signal.SIGINT, signal.SIGTERM, signal.SIGHUP, signal.SIGKILL])
def test_no_child_outlives_the_runner(sign: signal.Signals, tmp_path: Path) -> None:
    with started([sys.executable, "-c", RUNNER, ROOT, tmp_path], stderr=subprocess.PIPE, text=True) as process:
        until((tmp_path / "pid").is_file, process)
        pid = _number(tmp_path / "pid")
        assert is_alive(pid)
        process.send_signal(sign)
        _, error = process.communicate()
        assert process.returncode == (-sign if sign == signal.SIGKILL else 130), error
        until(lambda: not is_alive(pid))


def test_a_child_that_will_not_end_is_killed(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(runner, "_GRACE", 0.2)
    script = """
import os, pathlib, signal, sys, time
signal.signal(signal.SIGTERM, signal.SIG_IGN)
pathlib.Path(sys.argv[1] + ".pid").write_text(str(os.getpid()))
parent = os.getppid()
while os.getppid() == parent:  # nor does it outlive the tests
    time.sleep(0.1)
"""
    pid = tmp_path / "stubborn.pid"

    class Stop(Screen):
        def show(self, statuses: Mapping[str, GridJobStatus], left: float) -> None:  # noqa: ARG002  (it is not shown)
            if pid.exists():
                raise KeyboardInterrupt

    made = Runner([job(tmp_path, "stubborn", script=script)], tmp_path / "jobs", 1)
    with pytest.raises(KeyboardInterrupt):
        made.run(Stop(Console(file=io.StringIO())))
    assert not is_alive(_number(pid))


def failing_grid(root: Path, jobs: Sequence[GridJob], monkeypatch: pytest.MonkeyPatch, width: int | None = None) -> str:
    """Everything that is printed until it fails."""
    monkeypatch.setattr(runner, "make_plan", lambda *_, **__: jobs)
    said = io.StringIO()
    config = GridConfig(tasks=("avoidance",), seeds=(0,), agents=(AgentConfig(name="a", policy="p.toml"),))
    with pytest.raises(GymOpenError) as error:
        run_grid(config, root / "out", root=root, jobs=width, console=Console(file=said, width=60))
    return f"{said.getvalue()}{error.value}"


def test_a_failure_is_printed_with_its_log_and_the_command_that_runs_it_alone(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    bad = job(tmp_path, "bad", script=FAIL)
    said = failing_grid(tmp_path, [bad, job(tmp_path, "lost", bad), job(tmp_path, "good")], monkeypatch)
    told = said.splitlines()
    assert r"failed bad: \x1b[31mno such thing" in told
    assert f"  log: {tmp_path / 'out/jobs/bad.log'}" in told
    assert any(line.startswith("  alone: OMP_NUM_THREADS=1 gym-open -c 'import sys;") for line in told)
    assert told[-1].startswith("1 of 3 jobs failed, and 1 that need")
    assert not (tmp_path / "out/report").exists()  # there is no score to report


def test_a_grid_is_run_by_one_process(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    never = [job(tmp_path, "never")]
    with lock(tmp_path / "out"):
        assert "another gym-open process" in failing_grid(tmp_path, never, monkeypatch)
    assert "--jobs: expected 1 or more, got 0" in failing_grid(tmp_path, never, monkeypatch, width=0)
    assert not list(tmp_path.iterdir())


def test_the_time_left_follows_the_speed_that_is_seen(tmp_path: Path) -> None:
    first, second = job(tmp_path, "first", units=1000), job(tmp_path, "second", units=1000)
    made = Runner([first, second, job(tmp_path, "third", second, units=1000)], tmp_path, 2)
    made.statuses["first"].state = "running"
    made.statuses["first"].progress = progress.Progressed(done=500, total=1000, rate=10.0)
    alone = 6.0 + 1000 / 250  # a job of 1,000 steps, before anything is known
    assert made.left() == pytest.approx(max(50.0, 2 * alone))
    made.statuses["first"].state = made.statuses["second"].state = "made"
    assert made.left() == pytest.approx(alone)


def test_a_table_fits_the_terminal_and_shows_work_and_failures_first(tmp_path: Path) -> None:
    jobs = [job(tmp_path, f"job-{i:03d}") for i in range(300)]
    made = Runner(jobs, tmp_path, 2)
    made.statuses["job-200"].state = "running"
    made.statuses["job-200"].progress = progress.Progressed(done=1234, total=5000, rate=56.7)
    made.statuses["job-250"].state, made.statuses["job-250"].reason = "failed", "no \x1b[2J such [bold]thing"
    said = io.StringIO()
    Console(file=said, width=100, color_system=None).print(table(made.statuses, made.left(), height=20))
    lines = [line.rstrip() for line in said.getvalue().splitlines()]
    assert len(lines) < 20
    assert lines[0].startswith("0 of 300 jobs done, 1 running, 1 failed, about")
    assert lines[1].split()[:2] == ["job-200", "running"]
    assert "1,234/5,000  57/s  66 s left" in lines[1]
    assert lines[2].split()[:2] == ["job-250", "failed"]
    assert r"no \x1b[2J such [bold]thing" in lines[2]
    assert lines[-1] == "… and 284 more"


def test_a_terminal_is_drawn_on_and_left_with_the_last_state(tmp_path: Path) -> None:
    said = io.StringIO()
    console = Console(file=said, width=80, height=20, force_terminal=True, color_system=None, legacy_windows=False)
    with Screen(console) as screen:
        Runner([job(tmp_path, "only")], tmp_path / "jobs", 1).run(screen)
    assert "0 of 1 jobs done, 1 running, about" in said.getvalue()
    assert said.getvalue().rstrip().rpartition("1 of 1 jobs done")[2].split()[:2] == ["only", "made"]
