"""Rules of the house that no linter knows: names are unique, tests mirror rooms, files and functions stay short."""

import ast
import graphlib
from collections import defaultdict
from collections.abc import Iterator

import grimp

from gym_open.workspace import template

ROOT = template()
PACKAGE = ROOT / "gym_open"
MODULES = sorted(PACKAGE.rglob("*.py"))
MODULE_LINES, FUNCTION_LINES = 400, 65


def _classes(tree: ast.AST) -> Iterator[str]:
    return (node.name for node in ast.walk(tree) if isinstance(node, ast.ClassDef))


def test_a_class_name_stands_in_one_file_only() -> None:
    files = defaultdict[str, list[str]](list)
    for module in MODULES:
        for name in set(_classes(ast.parse(module.read_text()))):
            files[name].append(module.relative_to(PACKAGE).as_posix())
    assert {name: where for name, where in files.items() if len(where) > 1} == {}


def test_tests_mirror_rooms() -> None:
    """Each folder of tests has a room of the same name, and each room has tests."""
    rooms = {path.name for path in PACKAGE.iterdir() if (path / "__init__.py").is_file()}
    folders = {path.name for path in (ROOT / "tests").iterdir() if path.is_dir() and any(path.glob("**/test_*.py"))}
    assert folders - {"packaging"} <= rooms
    files = {path.stem.removeprefix("test_") for path in (ROOT / "tests").glob("test_*.py")}
    assert rooms - folders - files == set()


def test_modules_and_functions_are_short() -> None:
    long = []
    for module in MODULES:
        where, text = module.relative_to(PACKAGE).as_posix(), module.read_text()
        if (lines := len(text.splitlines())) > MODULE_LINES:
            long.append(f"{where}: {lines}")
        for node in ast.walk(ast.parse(text)):
            if isinstance(node, ast.FunctionDef | ast.AsyncFunctionDef):
                lines = (node.end_lineno or node.lineno) - node.lineno + 1
                long += [f"{where}:{node.name}: {lines}"] if lines > FUNCTION_LINES else []
    assert long == []


def test_no_module_imports_itself_through_others() -> None:
    """For type checkers alone, too: a circle is hard to read whenever it is imported."""
    graph = grimp.build_graph("gym_open", exclude_type_checking_imports=False)
    imports = {module: graph.find_modules_directly_imported_by(module) for module in graph.modules}
    graphlib.TopologicalSorter(imports).prepare()
