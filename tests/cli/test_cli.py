"""The command line: every help text has an example, wrong use is refused by name, and exit codes are right."""

import os
import shlex
import sys
from pathlib import Path

import pytest

from gym_open import artefacts, workspace
from gym_open.cli import COMMANDS, _parse, base, main
from gym_open.cli.stages import StageCommand
from gym_open.collect.config import CollectConfig
from gym_open.config import Config
from gym_open.errors import UsageError
from gym_open.summary import word
from gym_open.terminal import printable
from tests.children import python, run


@pytest.fixture
def root(tmp_path: Path) -> Path:
    workspace.init(tmp_path / "w")
    return tmp_path / "w"


def test_the_overview_names_every_command(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["--help"]) == 0
    shown = capsys.readouterr().out
    assert all(name in shown for name in COMMANDS)
    assert "example: gym-open run" in shown


@pytest.mark.parametrize("name", COMMANDS)
def test_help_shows_an_example_of_the_command(name: str, capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(SystemExit) as caught:
        main([*name.split(), "--help"])
    assert caught.value.code == 0
    assert f"Example: gym-open {name}" in " ".join(capsys.readouterr().out.replace("│", " ").split())


def test_help_imports_no_slow_library() -> None:
    code = (
        "import sys; from gym_open.cli import main; main(['--help']);"
        "print([m for m in ('torch', 'mujoco', 'lerobot', 'rerun', 'numba', 'pandas') if m in sys.modules])"
    )
    shown = python(code).stdout
    assert shown.splitlines()[-1] == "[]"


@pytest.mark.parametrize(
    ("words", "said"),
    [
        (["fly"], "no command 'fly'; see gym-open --help"),
        (["build"], "did you mean `gym-open dataset build`?"),
        (["train"], "did you mean `gym-open train encoder`"),
        (["collect", "--workspace", "WORKSPACE", "--steps", "-5"], "key `steps`"),
        (["collect", "--workspace", "nowhere"], "no such configuration file"),
        (["run", "--workspace", "nowhere"], "not a workspace"),
        (["run", "--workspace", "WORKSPACE", "--seed", "-1"], "key `seed`"),
        (
            ["train", "encoder", "--workspace", "WORKSPACE", "--release", "r", "--encoder.architecture", "state"],
            "error: options: `encoder.architecture` 'state' takes no images",
        ),
        (["benchmark", "WORKSPACE/nope.toml", "--out", "o"], "nope.toml: no such configuration file"),
        (["evaluate", "--workspace", "WORKSPACE", "--actions", "greedy"], "`actions` greedy takes a policy's"),
        (["evaluate", "--workspace", "WORKSPACE", "--oracle", "--out", "/proc/x"], "/proc/x: cannot be made"),
    ],
)
def test_wrong_use_ends_with_2_and_the_reason(
    words: list[str], said: str, root: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main([word.replace("WORKSPACE", str(root)) for word in words]) == 2
    assert said in " ".join(capsys.readouterr().err.split())


@pytest.mark.parametrize(
    ("name", "said"),
    [("collect", "no such configuration file"), ("viz", "no source given"), ("run", "not a workspace")],
)
def test_a_command_without_options_outside_of_a_workspace_says_what_is_missing(
    name: str, said: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(tmp_path)
    assert main([name]) == 2
    assert said in capsys.readouterr().err


def test_a_reader_that_ends_early_sees_no_error() -> None:
    read, write = os.pipe()
    os.close(read)
    words = [sys.executable, "-m", "gym_open.cli", "puzzle", "show", "tool-use/000"]
    done = run(words, stdout=write)
    os.close(write)
    assert (done.returncode, done.stderr) == (1, "")


def test_contradicting_options_are_named(root: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """The options are two levels down, where the parser itself finds the contradiction."""
    with pytest.raises(SystemExit) as caught:
        main(["collect", "--workspace", str(root), "--explorer.world-model", "none"])
    assert caught.value.code == 2
    assert "`reward` 'ride' needs a world model" in " ".join(capsys.readouterr().err.replace("│", " ").split())


@pytest.mark.parametrize("form", ["{} {}", "{}={}"])
def test_the_last_of_two_equal_options_counts(form: str, root: Path, tmp_path: Path) -> None:
    (tmp_path / "first.toml").write_text("seed = 1\nthreads = 3\n")
    (tmp_path / "last.toml").write_text("seed = 2\n")
    pairs = (("--workspace", "nowhere"), ("--config", "nowhere"), ("--config", tmp_path / "first.toml"),
             ("--workspace", root), ("--config", tmp_path / "last.toml"))  # fmt: skip
    command = _parse("collect", [word for pair in pairs for word in form.format(*pair).split()])
    assert isinstance(command, StageCommand)
    assert (command.config, command.workspace) == (tmp_path / "last.toml", root)
    assert command.settings == CollectConfig(seed=2)


@pytest.mark.parametrize(
    ("words", "name"),
    [
        ([], "goal-seeking-random"),
        (["--oracle", "--actions", "greedy"], "goal-seeking-oracle"),
        (["--split", "validation"], "goal-seeking-random-validation"),
        (["--policy", "some/p"], "p"),
        (["--policy", "some/p", "--actions", "greedy"], "p-greedy"),
        (
            ["--policy", "some/p", "--at", "20", "--actions", "greedy", "--split", "validation"],
            "p-at20-greedy-validation",
        ),
    ],
)
def test_scores_with_other_settings_get_another_folder(
    words: list[str], name: str, root: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    folders: list[Path] = []

    def evaluate(_config: Config, _policy: Path | None, out: Path, **_: object) -> None:
        folders.append(out)
        raise UsageError("enough for the test")

    monkeypatch.setattr("gym_open.evaluate.play.evaluate", evaluate)
    assert main(["evaluate", "--workspace", str(root), *words]) == 2
    assert folders == [root / "evaluate/scores" / name]


def test_the_record_of_a_shown_puzzle_can_be_copied(capsys: pytest.CaptureFixture[str]) -> None:
    from gym_open.envs.puzzles import Puzzle
    from gym_open.envs.puzzles.sets import puzzle_by_id

    assert main(["puzzle", "show", "tool-use/017"]) == 0
    (record,) = (line for line in capsys.readouterr().out.splitlines() if line.startswith("{"))
    assert Puzzle.from_json(record) == puzzle_by_id("tool-use/017")


def test_an_error_of_the_file_system_names_the_file(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    (tmp_path / "file").write_text("")
    assert main(["init", str(tmp_path / "file" / "workspace")]) == 1
    assert "Not a directory" in capsys.readouterr().err


def test_paths_are_printed_as_they_are_and_next_commands_can_be_typed(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    """Brackets are no markup and colons no emoji; a shell splits the next command into the right words."""
    names = ["a[/b]", "[bold]d", "it's :x: here", "back\\", "\x1b[31mred"]
    for name in names:
        root = tmp_path / name
        assert main(["init", str(root)]) == 0
        shown = capsys.readouterr().out
        assert f"made the workspace {printable(str(root))}\n" in shown
        assert shlex.split(shown.splitlines()[-1].replace("\\x1b", "\x1b")) == [
            "next:", "gym-open", "run", "--workspace", str(root),
        ]  # fmt: skip
        made = artefacts.build(root / "out", kind="toy", config=Config(), parents=(), work=lambda _: {})
        base.report(made, f"gym-open viz {word(made.path)}")
        shown = capsys.readouterr().out.splitlines()
        assert shown[0].startswith(f"made {printable(str(root / 'out'))}  (digest ")
        assert shlex.split(shown[1].replace("\\x1b", "\x1b"))[1:] == ["gym-open", "viz", str(root / "out")]
        assert "\x1b" not in "".join(shown)
        monkeypatch.chdir(root)
        assert word(made.path) == "out"


def test_an_unknown_option_ends_with_2_and_a_suggestion(root: Path, capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(SystemExit) as caught:
        main(["collect", "--workspace", str(root), "--stepz", "5"])
    assert caught.value.code == 2
    assert "--steps" in capsys.readouterr().err


@pytest.mark.parametrize("file", ["encoder-objects.toml", "probe.toml", "policy-goal-seeking.toml"])
def test_a_misspelt_key_in_a_file_ends_the_run_before_it_starts(
    file: str, root: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    path = root / "train" / file
    path.write_text("sead = 3\n" + path.read_text())
    assert main(["run", "--workspace", str(root)]) == 2
    assert f"{path}: unknown key `sead`" in capsys.readouterr().err
    assert not list(root.glob("*/*/"))


@pytest.mark.parametrize(
    ("words", "said"),
    [
        (["dataset", "build", "--logs", "nowhere"], "nowhere: not an artefact"),
        (["train", "encoder", "--release", "nowhere"], "nowhere: not an artefact"),
        (["train", "policy", "--encoder", "nowhere"], "nowhere: not an artefact"),
        (["evaluate", "--policy", "nowhere"], "nowhere: not an artefact"),
    ],
)
def test_a_missing_input_ends_with_1_and_leaves_no_file(
    words: list[str], said: str, root: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main([*words, "--workspace", str(root)]) == 1
    assert said in " ".join(capsys.readouterr().err.split())
    assert not list(root.glob("*/*/*"))


def test_an_interrupted_viz_does_not_mention_a_checkpoint(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    def stop(_: object) -> None:
        raise KeyboardInterrupt

    monkeypatch.setattr(COMMANDS["viz"], "run", stop)
    assert main(["viz", "log"]) == 130
    assert capsys.readouterr().err == "stopped\n"


NO_MEMORY = (
    MemoryError(),
    RuntimeError("could not allocate mjData arena"),
    RuntimeError("DefaultCPUAllocator: can't allocate memory"),
)


@pytest.mark.parametrize("error", NO_MEMORY)
def test_too_little_memory_is_said(
    error: Exception, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str], tmp_path: Path
) -> None:
    def fail(_: object) -> None:
        raise error

    monkeypatch.setattr(COMMANDS["dataset list"], "run", fail)
    assert main(["dataset", "list", str(tmp_path)]) == 1
    assert "there is not enough memory" in capsys.readouterr().err


def test_other_errors_are_not_hidden(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    def fail(_: object) -> None:
        raise RuntimeError("a mistake in the program")

    monkeypatch.setattr(COMMANDS["dataset list"], "run", fail)
    with pytest.raises(RuntimeError, match="a mistake"):
        main(["dataset", "list", str(tmp_path)])
