"""The same puzzle and actions give the same states and images, to the bit, on other kinds of processors.

A child process limits its libraries (numba, NumPy, OpenBLAS and the GNU C library) to the features of an older
processor. MuJoCo has no such setting. The process reports the limits that took effect, properties of its compiled code,
and digests of its results, which are compared with golden digests. Decision 0013 has the promise and its reasons.

`python tests/envs/test_processors.py` reports on the process it runs in; with `--write` it writes the golden digests.
"""

import ctypes
import hashlib
import importlib
import json
import math
import os
import platform
import re
import shutil
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Any, NamedTuple

import mujoco
import numpy as np
import pytest
from PIL import Image

from gym_open.envs.constants import N_ACTIONS
from gym_open.envs.env import OpenEnv
from gym_open.envs.options import CameraOptions, LightOptions, ObjectOptions, WorldOptions
from gym_open.envs.puzzles import TASKS, Puzzle, Task
from gym_open.envs.puzzles.generators import SandboxConfig, sample_puzzle
from gym_open.envs.puzzles.sets import test_puzzles as fixed_puzzles
from gym_open.envs.vector import OpenVectorEnv
from gym_open.envs.world import World

NUMPY: Any = importlib.import_module("numpy._core._multiarray_umath")
"""A module that lists NumPy's loops per processor, and those in use."""
GOLDEN = Path(__file__).parent / "golden"
BITS = GOLDEN / "v1-bits.json"
pytestmark = pytest.mark.timeout(1000)  # only against hanging: a child compiles all code

ALL_TASKS: tuple[Task, ...] = ("sandbox", *TASKS)
EVERYTHING = SandboxConfig(push=(1, 2), rectangle=(1, 2), cone=(1, 2), stack=(0, 1))
CHANGED = WorldOptions(
    objects={"light": ObjectOptions(mass=2.0, friction=0.1, bounciness=0.8, size=0.12)},
    camera=CameraOptions(position=(0.1, -1.9, 1.6), direction=(40.0, 3.0, 1.0), field_of_view=87.5),
    light=LightOptions(angle_deg=200.0, elevation_deg=41.0),
    timestep_s=0.002,
    substeps=20,
)
"""On processors with AVX-512, NumPy's tangent of half this field of view is another number."""
STEPS = 150

_EXACT = {"sqrt", "floor", "ceil", "fabs"}
"""Functions that compiled code may call: IEEE 754 defines every bit of their results."""
_FUSED = re.compile(r"vfn?m(add|sub)")
_RUNTIME = re.compile(r"_?Py|NRT_|numba_|_ZN|llvm\.")


class Limit(NamedTuple):
    """A processor to simulate."""

    numba: str
    """Its name in LLVM."""
    numba_features: str
    numpy: str
    """Pattern of the NumPy features that are switched off."""
    blas: str
    """Its name in OpenBLAS."""
    glibc: str
    """Features that the C library must ignore."""
    without: frozenset[str]
    """Features that must be absent."""


_NO_512 = "-AVX512F,-AVX512VL,-AVX512BW,-AVX512DQ,-AVX512CD"
AVX2 = Limit("haswell", "+avx,+avx2,+fma,+bmi,+bmi2,+f16c", "AVX512|X86_V4", "Haswell", _NO_512, frozenset({"AVX512F"}))
SSE = Limit("generic", "", "", "Nehalem", _NO_512, frozenset({"AVX512F"}))
"""Limits all libraries except the C library, whose sine and cosine differ without AVX2 and FMA."""
ALL_SSE = SSE._replace(glibc=f"{_NO_512},-AVX2,-AVX,-FMA,-FMA4", without=frozenset({"AVX512F", "AVX2", "AVX", "FMA"}))


# Results of a process -------------------------------------------------------------------------------------------------


def digest(*parts: Any) -> str:
    found = hashlib.sha256()
    for part in parts:
        found.update(part if isinstance(part, bytes) else np.ascontiguousarray(part).tobytes())
    return found.hexdigest()[:16]


def compiled_numbers(world: World) -> str:
    """Digest of the compiled model, for which MuJoCo computes sines and arc tangents."""
    names = "geom_pos geom_quat geom_size body_ipos body_iquat body_inertia mesh_vert mesh_normal cam_quat light_dir"
    return digest(*(getattr(world.model, name) for name in names.split()), *world.drawing.camera)


def golden_play(task: Task) -> tuple[list[list[list[float]]], np.ndarray]:
    """Digests of the steps in `test_frozen`: positions to a nanometre, and the images before and after."""
    world = World()
    world.load(fixed_puzzles(task)[17], recolour_hits=True)
    before, positions = world.observe(), []
    for action in np.random.default_rng(17).integers(1, N_ACTIONS, 12).tolist():
        world.step(action)
        positions.append(world.object_state()[world.present, :3].round(9).tolist())
    return positions, np.hstack([before, world.observe()])


def long_play(world: World, puzzles: list[Puzzle]) -> Iterator[tuple[str, Any]]:
    """Digests of random steps: states and outcomes ("motion"), and images ("look")."""
    for seed, puzzle in enumerate(puzzles):
        world.load(puzzle, recolour_hits=True)
        for step, action in enumerate(np.random.default_rng(seed).integers(1, N_ACTIONS, STEPS).tolist()):
            yield "motion", repr(world.step(action)).encode()
            yield "motion", world.save_state()
            yield "motion", world.object_state()
            if step % 10 == 0:
                yield "look", world.observe()
        for picture in (world.depth(), world.segmentation(), world.normals()):
            yield "look", picture


def vector_play() -> str:
    worlds = OpenVectorEnv(3, "tool-use")
    parts = [worlds.reset(seed=5)[0]]
    for action in np.random.default_rng(5).integers(0, N_ACTIONS, (40, 3)):
        images, rewards, terminated, truncated, infos = worlds.step(action)
        parts += [images.copy(), rewards, terminated, truncated, infos["object_state"]]
    worlds.close()
    return digest(*parts)


def played() -> dict[str, str]:
    """Digests of everything that is promised, by name."""
    found = {}
    drawn: dict[str, list[Puzzle]] = {}
    for task in ALL_TASKS:
        rng = np.random.default_rng(3)
        drawn[task] = [sample_puzzle(task, rng, EVERYTHING) for _ in range(30)]
        env = OpenEnv(task)
        seeded = [env.reset(seed=seed)[1]["puzzle_digest"] for seed in range(5)]
        found[f"puzzles {task}"] = digest(*(puzzle.to_json() for puzzle in drawn[task]), *(s.encode() for s in seeded))
    for task in TASKS:
        positions, pictures = golden_play(task)
        found[f"golden motion {task}"] = digest(json.dumps(positions).encode())
        found[f"golden look {task}"] = digest(pictures)
    for name, world, tasks in (("v1", World(), ALL_TASKS), ("changed", World(CHANGED), ALL_TASKS[:1])):
        found[f"model {name}"] = compiled_numbers(world)
        for task in tasks:
            parts: dict[str, list[Any]] = {"motion": [], "look": []}
            for what, part in long_play(world, drawn[task][:3]):
                parts[what].append(part)
            found |= {f"long {what} {task} {name}": digest(*values) for what, values in parts.items()}
    return found | {"vector": vector_play()}


# Properties of a process ----------------------------------------------------------------------------------------------


class _Leaf(ctypes.Structure):
    _fields_ = (("cpuid", ctypes.c_uint32 * 4), ("active", ctypes.c_uint32 * 4))


def glibc_features() -> set[str]:
    """Those of AVX, FMA, AVX2 and AVX512F that the GNU C library uses; none for another C library."""
    try:
        leaf = ctypes.CDLL(None).__x86_get_cpuid_feature_leaf
    except AttributeError:
        return set()
    leaf.restype = ctypes.POINTER(_Leaf)
    bits = {"FMA": (0, 2, 12), "AVX": (0, 2, 28), "AVX2": (1, 1, 5), "AVX512F": (1, 1, 16)}
    return {name for name, (i, word, bit) in bits.items() if leaf(i).contents.active[word] >> bit & 1}


def facts() -> dict[str, Any]:
    """The processor features that this process's libraries use."""
    from numba.core.registry import cpu_target

    blas: Any = ctypes.CDLL(NUMPY.__file__).scipy_openblas_get_corename64_
    blas.restype = ctypes.c_char_p
    target: Any = cpu_target.target_context
    _, numba_name, numba_features = target.codegen().magic_tuple()
    sines = [function(0.2 * i / 200_000) for i in range(200_000) for function in (math.sin, math.cos)]
    return {
        "numba": numba_name,
        "numba_features": numba_features,
        "numpy": [name for name in NUMPY.__cpu_dispatch__ if NUMPY.__cpu_features__[name]],
        "blas": blas().decode(),
        "glibc": sorted(glibc_features()),
        "sines": digest(np.array(sines)),
    }


def machine_code() -> dict[str, dict[str, list[str]]]:
    """For each compiled function: fused operations, wide registers, and foreign functions that it calls."""
    found = {}
    modules = [module for name, module in sys.modules.items() if name.startswith("gym_open.envs.")]
    functions = {id(f): f for module in modules for f in vars(module).values() if hasattr(f, "inspect_asm")}
    for function in functions.values():
        for signature, assembly in function.inspect_asm().items():
            declared = re.findall(r'^declare [^@]*@"?([\w.$]+)', function.inspect_llvm(signature), re.MULTILINE)
            intrinsics = [match[1] for name in declared if (match := re.match(r"llvm\.(\w+)\.(?:v\d+)?f\d+", name))]
            foreign = [name for name in declared if not _RUNTIME.match(name)]
            found[f"{function.py_func.__name__}{signature}"] = {
                "instructions": sorted(set(re.findall(r"^\s+(v?\w+)\s", assembly, re.MULTILINE))),
                "registers": sorted(set(re.findall(r"%([xyz]mm)\d", assembly))),
                "calls": sorted({*foreign, *intrinsics}),
            }
    return found


# The tests ------------------------------------------------------------------------------------------------------------

promised = pytest.mark.skipif(
    platform.machine() != "x86_64" or not {"AVX2", "FMA"} <= glibc_features(),
    reason="promised for x86-64 processors with AVX2 and FMA, and the GNU C library: docs/decisions/0013",
)


def environment(limit: Limit, cache: Path) -> dict[str, str]:
    off = [name for name in NUMPY.__cpu_dispatch__ if NUMPY.__cpu_features__[name] and re.match(limit.numpy, name)]
    return {
        **os.environ,
        "NUMBA_CPU_NAME": limit.numba,
        "NUMBA_CPU_FEATURES": limit.numba_features,
        "NUMBA_CACHE_DIR": str(cache),
        "NPY_DISABLE_CPU_FEATURES": " ".join(off),
        "OPENBLAS_CORETYPE": limit.blas,
        "GLIBC_TUNABLES": f"glibc.cpu.hwcaps={limit.glibc}",
    }


def child(limit: Limit, cache: Path) -> dict[str, Any]:
    """The report of a limited process, after a check that its limits took effect."""
    command = [sys.executable, __file__]
    done = subprocess.run(
        command, env=environment(limit, cache), capture_output=True, text=True, timeout=900, check=False
    )
    assert done.returncode == 0, done.stderr
    report = json.loads(done.stdout)
    found = report["facts"]
    assert (found["numba"], found["numba_features"]) == (limit.numba, limit.numba_features)
    assert not [name for name in found["numpy"] if re.match(limit.numpy, name)]
    assert found["blas"] == limit.blas
    assert not limit.without & set(found["glibc"])
    return report


@pytest.fixture(scope="module")
def cache(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """An empty folder for machine code, because cached code cannot be inspected."""
    return tmp_path_factory.mktemp("numba")


@pytest.fixture(scope="module")
def avx2(cache: Path) -> dict[str, Any]:
    return child(AVX2, cache)


@pytest.fixture(scope="module")
def sse(cache: Path) -> dict[str, Any]:
    return child(SSE, cache)


def golden() -> dict[str, str]:
    return json.loads(BITS.read_text())


def test_the_digests_are_of_the_golden_files() -> None:
    """`test_frozen` and this module take the same steps."""
    record = json.loads((GOLDEN / "v1.json").read_text())
    for task in TASKS:
        assert golden()[f"golden motion {task}"] == digest(json.dumps(record["positions"][task]).encode())
        picture = np.asarray(Image.open(GOLDEN / f"v1-{task}.png"))
        assert golden()[f"golden look {task}"] == digest(picture)


@promised
def test_this_processor_plays_to_the_bit() -> None:
    assert played() == golden()


@promised
def test_one_with_avx2_plays_the_same(avx2: dict[str, Any]) -> None:
    assert avx2["played"] == golden()


@promised
def test_one_with_sse_plays_the_same(sse: dict[str, Any]) -> None:
    assert sse["played"] == golden()


@promised
@pytest.mark.usefixtures("sse")  # so that the code is compiled
def test_the_promise_ends_at_the_c_librarys_sine(cache: Path) -> None:
    """Without FMA, the last bit of sine sometimes differs, and MuJoCo rotates with sine; all else is equal."""
    report = child(ALL_SSE, cache)
    assert report["facts"]["sines"] != facts()["sines"]
    assert {name: value for name, value in report["played"].items() if "long" not in name} == {
        name: value for name, value in golden().items() if "long" not in name
    }


@promised
def test_compiled_code_fuses_nothing(avx2: dict[str, Any], sse: dict[str, Any]) -> None:
    """It was compiled for a processor with FMA: a fused multiply-add rounds once, separate operations round twice."""
    for report, widest in ((avx2, "ymm"), (sse, "xmm")):
        code = report["code"]
        assert {"simulate", "read_states", "draw", "step_and_draw"} <= {name.split("(")[0] for name in code}
        for name, what in code.items():
            assert not [word for word in what["instructions"] if _FUSED.match(word)], name
            assert all(register <= widest for register in what["registers"]), name
    vector = {word for what in avx2["code"].values() for word in what["instructions"]}
    assert {"vmulsd", "vaddsd"} <= vector  # otherwise there was no code to inspect
    assert "mulsd" in {word for what in sse["code"].values() for word in what["instructions"]}


@promised
def test_compiled_code_calls_only_exact_functions(avx2: dict[str, Any], sse: dict[str, Any]) -> None:
    called = {name for report in (avx2, sse) for what in report["code"].values() for name in what["calls"]}
    assert "sqrt" in called
    assert called <= _EXACT


def test_mujoco_fuses_nothing_and_does_not_check_the_processor() -> None:
    if platform.machine() != "x86_64" or shutil.which("objdump") is None:
        pytest.skip("needs objdump (package binutils) and x86-64")
    (library,) = Path(mujoco.__file__).parent.glob("libmujoco.so.*")
    command = ["objdump", "-d", "--no-show-raw-insn", str(library)]
    listing = subprocess.run(command, capture_output=True, text=True, check=True).stdout
    instructions = set(re.findall(r"^\s+[0-9a-f]+:\t(\w+)", listing, re.MULTILINE))
    assert {"vmulsd", "vaddsd"} <= instructions
    assert not {word for word in instructions if _FUSED.match(word) or word in {"cpuid", "xgetbv"}}


def _main() -> None:
    if sys.argv[1:] == ["--write"]:
        BITS.write_text(json.dumps(played(), indent=1) + "\n")
        return
    found = played()
    sys.stdout.write(json.dumps({"played": found, "facts": facts(), "code": machine_code()}))


if __name__ == "__main__":
    _main()
