"""The version of code that an artefact depends on: of what its stage can import, and of nothing else."""

import shutil
from pathlib import Path

import grimp
import pytest

import gym_open
from gym_open.artefacts.code import ENTRIES, code_version, source_files

ROOT = Path(gym_open.__file__).parent


@pytest.fixture
def package(tmp_path: Path) -> Path:
    """A copy of the package."""
    return shutil.copytree(ROOT, tmp_path / "gym_open", ignore=shutil.ignore_patterns("__pycache__"))


def changed(package: Path, file: str) -> set[str]:
    """Kinds of artefacts that an edit of a file makes stale."""
    before = {kind: code_version(kind, package) for kind in ENTRIES}
    with (package / file).open("ab") as source:
        source.write(b"\n")
    code_version.cache_clear()
    return {kind for kind in ENTRIES if code_version(kind, package) != before[kind]}


@pytest.mark.parametrize(
    ("file", "stale"),
    [
        ("viz/recording.py", {"recording"}),
        ("evaluate/report/page.md.jinja", {"report"}),
        ("collect/curriculum.py", {"log"}),
        ("train/encoder.py", {"encoder"}),
        ("cli/__init__.py", set()),
        ("artefacts/building.py", set(ENTRIES)),
    ],
)
def test_an_edit_makes_stale_what_can_import_the_file_and_nothing_else(
    package: Path, file: str, stale: set[str]
) -> None:
    assert changed(package, file) == stale


def test_an_edit_in_agents_leaves_no_encoder_up_to_date(package: Path) -> None:
    assert {"log", "encoder", "policy"} <= changed(package, "agents/encoder.py")


def test_an_edit_of_a_world_model_which_is_imported_by_its_name_counts(package: Path) -> None:
    assert {"log", "encoder"} <= changed(package, "agents/icm.py")


def test_a_changed_evaluation_puzzle_leaves_no_scores_up_to_date(package: Path) -> None:
    assert "scores" in changed(package, "envs/puzzles/data/avoidance-test.jsonl")


def test_what_is_of_no_known_kind_depends_on_the_whole_package(package: Path) -> None:
    before = code_version("toy", package)
    (package / "viz" / "still.py").write_text("")
    code_version.cache_clear()
    assert code_version("toy", package) != before


@pytest.fixture(scope="module")
def graph() -> grimp.ImportGraph:
    """Import-linter's graph of the package, which finds imports in a way of its own."""
    return grimp.build_graph("gym_open", exclude_type_checking_imports=True, cache_dir=None)


@pytest.mark.parametrize("kind", ENTRIES)
def test_every_module_that_a_stage_imports_is_covered(graph: grimp.ImportGraph, kind: str) -> None:
    covered = {path.relative_to(ROOT.parent).with_suffix("").as_posix() for path in source_files(kind, ROOT)}
    covered = {name.removesuffix("/__init__").replace("/", ".") for name in covered}
    imported = {name for entry in ENTRIES[kind] for name in (entry, *graph.find_upstream_modules(entry))}
    assert imported - covered == set()
