"""Version of the code that makes an artefact: it covers the files that its stage can import, and no others.

An edit in `viz` therefore leaves an encoder up to date, and an edit in `agents` does not.
"""

import ast
import functools
import hashlib
from collections.abc import Iterator
from pathlib import Path

from gym_open.files import sha256_file
from gym_open.version import __version__

ENTRIES = {
    "log": ("gym_open.collect.explore",),
    "release": ("gym_open.datasets.build", "gym_open.datasets.merge", "gym_open.datasets.filter"),
    "packed-log": ("gym_open.replay.compact.logs",),
    "compact": ("gym_open.datasets.compact.pack",),
    "encoder": ("gym_open.train.encoder",),
    "policy": ("gym_open.train.policy",),
    "probe": ("gym_open.train.probe",),
    "scores": ("gym_open.evaluate.play", "gym_open.evaluate.human"),
    "report": ("gym_open.evaluate.report",),
    "recording": ("gym_open.viz.recording",),
    "figure": ("gym_open.viz.figures",),
}
"""Modules that make each kind of artefact. They are only named here: this room imports none of them."""
_DATA = (".jinja", ".json", ".jsonl")
"""Suffixes of the package's data files that decide results: templates of reports and cards, and puzzles."""
_PACKAGE = "gym_open"


@functools.cache
def code_version(kind: str, root: Path = Path(__file__).parent.parent) -> str:
    """Version of gym-open, and a digest of every file of the package that can take part in making an artefact.

    Versions of different kinds differ, because they cover different files: compare only versions of one kind.

    Args:
        kind: of the artefact. A kind that is not in `ENTRIES` depends on the whole package.
        root: folder of the package.
    """
    total = hashlib.sha256()
    for path in source_files(kind, root):
        total.update(f"{path.relative_to(root).as_posix()} {sha256_file(path)}\n".encode())
    return f"{__version__}+{total.hexdigest()[:12]}"


def source_files(kind: str, root: Path) -> list[Path]:
    """Files that the modules of a kind can import, directly or through others, with the data files next to them.

    Imports inside functions count; imports for type checkers alone do not. Where `import_module` gets a name that is
    only complete at run time, all modules of the package that it names count.
    """
    if kind not in ENTRIES:
        modules = set(root.rglob("*.py"))
    else:
        modules, waiting = set[Path](), list(ENTRIES[kind])
        while waiting:
            for path in _files_of(waiting.pop(), root) - modules:
                modules.add(path)
                waiting.extend(_imports(path.read_bytes(), top_level=path == root / "__init__.py"))
    folders = {path.parent for path in modules if path.name == "__init__.py"}
    return sorted(modules.union(*(_data(folder) for folder in folders)))


def _files_of(name: str, root: Path) -> set[Path]:
    """The file of a module and those of the packages that it is in; of a name within a module, the module's."""
    files, place = {root / "__init__.py"}, root
    for part in name.split(".")[1:]:
        if part == "*":
            return files | set(place.glob("*.py"))
        place = place / part
        files |= {path for path in (place / "__init__.py", place.with_suffix(".py")) if path.is_file()}
    return files


@functools.cache
def _imports(source: bytes, *, top_level: bool) -> list[str]:
    """Names that a file imports from the package: modules, and what it takes from them.

    `top_level` leaves out imports inside functions: those of the package's own `__init__` serve its users, not stages.
    """
    found: list[str] = []
    tree = ast.parse(source)
    found += [] if top_level else filter(None, map(_imported_by_name, ast.walk(tree)))
    for node in _statements(tree, top_level):
        if isinstance(node, ast.Import):
            found += [item.name for item in node.names]
        elif isinstance(node, ast.ImportFrom) and node.module:
            found += [f"{node.module}.{item.name}" for item in node.names]
    return [name for name in found if name.split(".")[0] == _PACKAGE]


def _imported_by_name(node: ast.AST) -> str | None:
    """The module that a call of `import_module` names, with `*` for the part of an f-string that is not constant."""
    match node:
        case ast.Call(func=ast.Name("import_module"), args=[ast.Constant(str(name))]):
            return name
        case ast.Call(func=ast.Name("import_module"), args=[ast.JoinedStr([ast.Constant(str(package)), *_])]):
            return f"{package}*"
    return None


def _statements(node: ast.AST, top_level: bool) -> Iterator[ast.AST]:
    """All statements below `node` but those that only type checkers read."""
    for child in ast.iter_child_nodes(node):
        if isinstance(child, ast.If) and isinstance(child.test, ast.Name) and child.test.id == "TYPE_CHECKING":
            continue
        if isinstance(child, ast.stmt | ast.ExceptHandler | ast.match_case):
            yield child
            if not (top_level and isinstance(child, ast.FunctionDef)):
                yield from _statements(child, top_level)


def _data(package: Path) -> set[Path]:
    """Data files in the folder of a package, and in folders below it that are no packages."""
    found = {path for path in package.iterdir() if path.suffix in _DATA}
    below = (path for path in package.iterdir() if path.is_dir() and not (path / "__init__.py").exists())
    return found.union(*({path for path in folder.rglob("*") if path.suffix in _DATA} for folder in below))
