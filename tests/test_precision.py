"""Networks compute in bf16 only if the processor multiplies it natively, and a run keeps its precision."""

import os
import platform
from collections.abc import Callable
from pathlib import Path

import pytest

from gym_open import artefacts, precision
from gym_open.agents.config import EncoderConfig, ExplorerConfig, PPOConfig
from gym_open.collect.config import CollectConfig, CurriculumConfig
from gym_open.collect.explore import collect
from gym_open.errors import ArtefactError
from gym_open.formats.logs import open_logs
from gym_open.precision import Precision, native_precision, resolve, settle
from gym_open.train import policy
from gym_open.train.config import PolicyTrainConfig
from tests.children import python

LIMITED = {"ATEN_CPU_CAPABILITY": "avx2", "ONEDNN_MAX_CPU_ISA": "AVX2"}
"""With these, PyTorch treats an AVX-512 processor as one that has AVX2 alone."""
OTHER: dict[Precision, Precision] = {"fp32": "bf16", "bf16": "fp32"}
TINY = PolicyTrainConfig(
    steps=48, num_envs=2, num_steps=8, mean_images=3, encoder=EncoderConfig(features=16), threads=1,
    ppo=PPOConfig(minibatch_size=8, update_epochs=1),
)  # fmt: skip


@pytest.fixture
def processor(monkeypatch: pytest.MonkeyPatch) -> Callable[[Precision], None]:
    """`processor("fp32")`: from now on, the native precision of this machine is fp32."""
    return lambda native: monkeypatch.setattr(precision, "native_precision", lambda _device="cpu": native)


@pytest.mark.skipif(platform.machine() != "x86_64" or not Path("/proc/cpuinfo").is_file(), reason="needs Linux on x86")
def test_bf16_is_chosen_where_the_processors_own_flags_have_it() -> None:
    flags = set(Path("/proc/cpuinfo").read_text().split("flags", 1)[1].splitlines()[0].split())
    limited = LIMITED.keys() & os.environ.keys()
    assert native_precision() == ("bf16" if flags & {"avx512_bf16", "amx_bf16"} and not limited else "fp32")
    assert resolve("auto") == native_precision()
    assert (resolve("fp32"), resolve("bf16")) == ("fp32", "bf16")


def test_a_processor_limited_to_avx2_computes_in_fp32() -> None:
    code = "from gym_open.precision import native_precision; print(native_precision())"
    found = python(code, env=os.environ | LIMITED)
    assert found.stdout == "fp32\n", found.stderr


def test_a_run_keeps_the_precision_in_which_it_began(
    tmp_path: Path, processor: Callable[[Precision], None], capsys: pytest.CaptureFixture[str]
) -> None:
    processor("bf16")
    assert settle("auto", "cpu", tmp_path / "run") == "bf16"
    assert capsys.readouterr().err == ""
    processor("fp32")
    assert settle("auto", "cpu", tmp_path / "run") == "bf16"
    assert "this run began in bf16; bf16 is emulated here" in capsys.readouterr().err
    assert settle("auto", "cpu", tmp_path / "other") == "fp32"
    assert capsys.readouterr().err == ""
    processor("bf16")
    assert settle("auto", "cpu", tmp_path / "other") == "fp32"
    assert "this run began in fp32; bf16 is faster here" in capsys.readouterr().err


def test_a_request_for_emulated_bf16_prints_a_warning(
    tmp_path: Path, processor: Callable[[Precision], None], capsys: pytest.CaptureFixture[str]
) -> None:
    processor("fp32")
    assert settle("bf16", "cpu", tmp_path) == "bf16"
    assert "the configuration asks for bf16; bf16 is emulated here, about ten times" in capsys.readouterr().err


def test_a_damaged_record_is_refused(tmp_path: Path) -> None:
    (tmp_path / precision.FILE).write_bytes(b"fp16")
    with pytest.raises(ArtefactError, match=r"precision: expected fp32 or bf16, got b'fp16'; restore the file"):
        settle("auto", "cpu", tmp_path)


@pytest.mark.parametrize("began", ["fp32", "bf16"])
def test_a_resumed_policy_goes_on_in_the_precision_in_which_it_began(
    began: Precision, tmp_path: Path, processor: Callable[[Precision], None], monkeypatch: pytest.MonkeyPatch
) -> None:
    """The second half runs with the other native precision, and the bytes equal those of an uninterrupted run."""
    processor(began)
    whole = policy.train_policy(TINY, None, tmp_path / "whole").path
    assert artefacts.lineage(whole).facts["precision"] == began
    real = policy._PolicyTrainer.collect

    def stop_in_the_second_update(self: policy._PolicyTrainer, *rest: object) -> object:
        if self.rows:
            raise KeyboardInterrupt
        return real(self, *rest)  # pyright: ignore[reportArgumentType]

    with monkeypatch.context() as patch:
        patch.setattr(policy._PolicyTrainer, "collect", stop_in_the_second_update)
        with pytest.raises(KeyboardInterrupt):
            policy.train_policy(TINY, None, tmp_path / "resumed")
    processor(OTHER[began])
    resumed = policy.train_policy(TINY, None, tmp_path / "resumed").path
    assert artefacts.digest(resumed) == artefacts.digest(whole)
    fresh = policy.train_policy(TINY, None, tmp_path / "fresh").path
    assert artefacts.lineage(fresh).facts["precision"] == OTHER[began]
    assert (fresh / "model.safetensors").read_bytes() != (whole / "model.safetensors").read_bytes()


def test_a_log_says_in_which_precision_its_explorer_learned_and_random_play_has_none(
    tmp_path: Path, processor: Callable[[Precision], None]
) -> None:
    alone = ExplorerConfig(world_model="none", reward="none")
    config = CollectConfig(
        steps=32, streams=1, rollout=16, pool=2, probe=16, explorer=alone, curriculum=CurriculumConfig(rule="never")
    )
    curious = ExplorerConfig(world_model="icm", reward="error", encoder=EncoderConfig(features=16))
    digests = []
    for native in ("fp32", "bf16"):
        processor(native)
        log = collect(config, tmp_path / f"random-{native}").path
        digests.append(artefacts.digest(log))
        assert artefacts.lineage(log).facts["precision"] is None
        learned = collect(
            CollectConfig(steps=32, streams=1, rollout=16, pool=2, probe=16, explorer=curious),
            tmp_path / f"icm-{native}",
        ).path
        assert artefacts.lineage(learned).facts["precision"] == native
        assert artefacts.config_of(learned)["explorer"]["ppo"]["precision"] == "auto"
        assert [log.config["explorer"]["ppo"]["precision"] for log in open_logs(learned)] == [native]
    assert digests[0] == digests[1]
