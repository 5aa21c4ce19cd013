"""The command `gym-open`: it finds the sub-command, reads its options, and runs it; the sub-commands hold no logic.

A sub-command imports slow libraries (torch, mujoco, lerobot, rerun) when it runs, so that `--help` is fast.
"""

import itertools
import os
import sys
from collections.abc import Sequence
from dataclasses import MISSING, fields
from pathlib import Path
from typing import Any, get_type_hints

import tyro

from gym_open import extras
from gym_open.cli import datasets, exchange, logs, results, stages, viz, world
from gym_open.cli.base import Command, speaking
from gym_open.config import check, load
from gym_open.envs.look.backend import check_backend
from gym_open.errors import ConfigError, GymOpenError
from gym_open.terminal import printable
from gym_open.version import __version__

COMMANDS: dict[str, type[Command]] = {
    "run": stages.RunCommand,
    "init": stages.InitCommand,
    "collect": stages.CollectCommand,
    "log info": logs.LogInfo,
    "log replay": logs.LogReplay,
    "log pack": logs.LogPack,
    "log restore": logs.LogRestore,
    "log repair": logs.LogRepair,
    "dataset build": datasets.DatasetBuild,
    "dataset verify": datasets.DatasetVerify,
    "dataset diff": datasets.DatasetDiff,
    "dataset info": datasets.DatasetInfo,
    "dataset list": datasets.DatasetList,
    "dataset merge": datasets.DatasetMerge,
    "dataset filter": datasets.DatasetFilter,
    "dataset pack": exchange.DatasetPack,
    "dataset restore": exchange.DatasetRestore,
    "dataset export": datasets.DatasetExport,
    "dataset sign": exchange.DatasetSign,
    "dataset push": exchange.DatasetPush,
    "dataset pull": exchange.DatasetPull,
    "train encoder": stages.TrainEncoder,
    "train policy": stages.TrainPolicy,
    "train probe": stages.TrainProbe,
    "encoder push": results.EncoderPush,
    "evaluate": stages.EvaluateCommand,
    "score verify": results.ScoreVerify,
    "benchmark": results.BenchmarkCommand,
    "report": results.ReportCommand,
    "viz": viz.VizCommand,
    "puzzle show": world.PuzzleShow,
    "puzzle verify": world.PuzzleVerify,
    "render sheet": world.RenderSheet,
    "render video": world.RenderVideo,
    "play": world.PlayCommand,
    "serve": world.ServeCommand,
}

_NEEDS: dict[str, tuple[str, ...]] = {
    "run": ("train", "viz"),
    "collect": ("train",),
    "log": ("releases",),
    "dataset": ("releases",),
    "dataset build": ("build",),
    "dataset merge": ("build",),
    "dataset filter": ("build",),
    "train": ("train",),
    "encoder": ("train",),
    "evaluate": ("releases",),
    "score": ("releases",),
    "benchmark": ("train",),
    "report": ("build",),
    "viz": ("build",),
    "render": ("build",),
    "play": ("play",),
    "serve": ("remote",),
}
"""Extras that a command needs to start, by the command or its first word. Some options need more extras."""
_GOES_ON = "; run the same command again to continue from the last checkpoint"
_FLAGS = (tyro.conf.FlagCreatePairsOff,)
"""No additional `--no-…` option for each on-off option."""


_OUT_OF_MEMORY = ("could not allocate", "can't allocate memory", "not enough memory", "out of memory")
"""What MuJoCo (`mujoco.FatalError`), PyTorch and Arrow say when memory runs out."""


def main(argv: Sequence[str] | None = None) -> int:
    """Run one sub-command and return the exit code: 0 success, 1 the run or the check failed, 2 wrong use."""
    words = list(sys.argv[1:] if argv is None else argv)
    if not words or words[0] in ("-h", "--help"):
        _overview()
        return 0
    if words[0] == "--version":
        print(__version__)
        return 0
    name = next((" ".join(words[:n]) for n in (2, 1) if " ".join(words[:n]) in COMMANDS), None)
    if name is None:
        return _unknown(words)
    return _run(name, words[len(name.split()) :])


def _run(name: str, words: list[str]) -> int:
    try:
        check_backend()
        command = _parse(name, words)
        extras.check(*(_NEEDS.get(name) or _NEEDS.get(name.split(maxsplit=1)[0], ())))
        with extras.Named(), speaking(command, name):
            command.run()
    except GymOpenError as error:
        print(f"error: {printable(str(error))}", file=sys.stderr)
        return error.exit_code
    except BrokenPipeError:  # the reader of the output, such as `head`, has ended
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        return 1
    except OSError as error:
        print(printable(f"error: {error.filename or 'a file'}: {error.strerror or error}"), file=sys.stderr)
        return 1
    except Exception as error:
        if not _is_out_of_memory(error):
            raise
        print(f"error: {name}: there is not enough memory: {printable(str(error)[:200])}{_GOES_ON}", file=sys.stderr)
        return 1
    except KeyboardInterrupt:
        goes_on = "" if name in ("viz", "render sheet", "render video") else _GOES_ON
        print(f"stopped{goes_on}", file=sys.stderr)
        return 130
    return 0


def _is_out_of_memory(error: Exception) -> bool:
    """Whether memory ran out: Python's own error, or that of MuJoCo or PyTorch, which have no class for it alone."""
    text = str(error).lower()
    return isinstance(error, MemoryError) or any(word in text for word in _OUT_OF_MEMORY)


def _parse(name: str, words: list[str]) -> Command:
    kind = COMMANDS[name]
    program = f"gym-open {name}"
    if not issubclass(kind, stages.StageCommand):
        return tyro.cli(kind, args=words, prog=program, config=_FLAGS)
    root = Path(_value(words, "--workspace") or ".")
    file = Path(_value(words, "--config") or root / kind.default)
    settings_type = get_type_hints(kind)["settings"]
    optional = any(word in ("-h", "--help") for word in words) or not (
        kind.needs_workspace or _value(words, "--config")
    )
    settings = settings_type() if optional and not file.is_file() else load(file, settings_type)
    given: dict[str, Any] = {"settings": settings, "workspace": root, "config": file}
    required = {f.name: tyro.MISSING for f in fields(kind) if f.default is MISSING and f.name not in given}
    try:
        command = tyro.cli(kind, args=words, prog=program, config=_FLAGS, default=kind(**given, **required))
    except ValueError as error:  # a check of the configuration: options that contradict each other
        raise ConfigError(f"options: {error}") from None
    check(command.settings, source="options")
    return command


def _value(words: Sequence[str], option: str) -> str | None:
    """The last value of an option, as the parser would use it."""
    found = None
    for word, following in itertools.pairwise([*words, ""]):
        if word == option:
            found = following
        elif word.startswith(f"{option}="):
            found = word.split("=", 1)[1]
    return found


def _overview() -> None:
    print(f"gym-open {__version__}: explore without a task, publish the data, learn from it, score the result\n")
    print("usage: gym-open COMMAND [options]      gym-open COMMAND --help shows its options and an example\n")
    for name, kind in COMMANDS.items():
        print(f"  {name:<15} {kind.about}")
    print("\nexample: gym-open run")


def _unknown(words: Sequence[str]) -> int:
    near = [name for name in COMMANDS if words[0] in name.split()]
    if near and len(words) > 1 and words[1] in ("-h", "--help"):
        print("\n".join(f"  gym-open {name:<15} {COMMANDS[name].about}" for name in near))
        return 0
    hint = f"did you mean {' or '.join(f'`gym-open {name}`' for name in near)}?" if near else "see gym-open --help"
    print(f"error: no command {' '.join(words[:2])!r}; {hint}", file=sys.stderr)
    return 2
