"""Forged scores: the player, the actions and all numbers are checked again."""

import shutil
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

import msgspec
import pyarrow as pa
import pyarrow.parquet as pq
import pytest

from gym_open import artefacts
from gym_open.agents.config import EncoderConfig, PPOConfig
from gym_open.cli import main
from gym_open.envs.puzzles import Puzzle, Task
from gym_open.envs.puzzles.sets import Split, puzzles_of
from gym_open.errors import ArtefactError
from gym_open.evaluate import play, verify
from gym_open.evaluate.config import EvaluateConfig
from gym_open.evaluate.human import HumanConfig, HumanEpisode, write_scores
from gym_open.evaluate.play import evaluate
from gym_open.evaluate.verify import verify_scores
from gym_open.files import sha256_file
from gym_open.formats.scores import EPISODES, RECORD
from gym_open.train.config import PolicyTrainConfig
from gym_open.train.policy import train_policy

NUMBERS = ("a_success", "a_success_half_width_95", "mean_return", "mean_return_within", "mean_steps", "puzzles")
CONFIG = EvaluateConfig(task="avoidance", seed=3, threads=1)
N = 3
"""Puzzles, in place of a hundred."""
Change = Callable[[dict[str, Any]], Any]


@pytest.fixture(scope="module", autouse=True)
def few_puzzles() -> Any:
    def few(task: Task, split: Split) -> tuple[Puzzle, ...]:
        return puzzles_of(task, split)[:N]

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(play, "puzzles_of", few)
        patch.setattr(play, "witnesses_of", lambda task, split: verify.witnesses_of(task, split)[:N])
        patch.setattr(verify, "PER_SET", N)
        yield


@pytest.fixture(scope="module")
def made(tmp_path_factory: pytest.TempPathFactory) -> Mapping[str, Path]:
    """Scores of a policy after one update and at its end, of the random agent, the oracle and a person."""
    root = tmp_path_factory.mktemp("scores")
    config = PolicyTrainConfig(
        task="avoidance", steps=32, num_envs=2, num_steps=8, checkpoints=(16,), threads=1,
        encoder=EncoderConfig(architecture="state"), trunk=(8,), ppo=PPOConfig(learning_rate=0.1),
    )  # fmt: skip
    policy = train_policy(config, None, root / "policy").path
    other = train_policy(msgspec.structs.replace(config, seed=1), None, root / "other").path
    oracle = evaluate(CONFIG, None, root / "oracle", oracle=True).path
    person = HumanConfig(task="avoidance", puzzles=(0, N))
    rows = pq.read_table(oracle / EPISODES).to_pylist()
    rounds = [HumanEpisode(row["actions"], row["rewards"], row["terminated"], ended=True) for row in rows]

    def played(folder: Path) -> Mapping[str, Any]:
        write_scores(folder, person, [row["puzzle"] for row in rows], puzzles_of("avoidance", "test")[:N], rounds)
        return {}

    return {
        "weights": policy, "other": other, "oracle": oracle,
        "policy": evaluate(CONFIG, policy, root / "p").path,
        "checkpoint": evaluate(CONFIG, policy, root / "c", at=16).path,
        "random": evaluate(CONFIG, None, root / "random").path,
        "human": artefacts.build(root / "human", kind="scores", config=person, parents=[], work=played).path,
    }  # fmt: skip


def forged(scores: Path, out: Path, record: Mapping[str, Any] | None = None, episodes: Path | None = None) -> Path:
    """Copy scores with other fields or other episodes and their numbers, and a new manifest."""
    shutil.copytree(scores, out)
    fields = {**msgspec.json.decode((scores / RECORD).read_bytes()), **(record or {})}
    if episodes is not None:
        shutil.copy(episodes / EPISODES, out / EPISODES)
        theirs = msgspec.json.decode((episodes / RECORD).read_bytes())
        fields |= {name: theirs[name] for name in NUMBERS}
    (out / RECORD).write_bytes(artefacts.canonical_json(fields))
    return reseal(out)


def reseal(folder: Path) -> Path:
    entries = {
        path.name: artefacts.Entry(sha256=sha256_file(path), bytes=path.stat().st_size)
        for path in folder.iterdir()
        if path.name != artefacts.MANIFEST
    }
    (folder / artefacts.MANIFEST).write_bytes(artefacts.canonical_json(entries))
    return folder


@pytest.mark.parametrize(
    ("name", "policy", "chosen"),
    [
        ("random", None, "every action was drawn again from seed 3"),
        ("oracle", None, "every action is the witness's"),
        ("human", None, "nothing proves that a person chose the actions"),
        ("policy", None, "not checked that the policy chose these actions; give --policy"),
        ("policy", "weights", "the policy chose every action again"),
        ("checkpoint", "weights", "the policy chose every action again"),
    ],
)
def test_honest_scores_say_what_was_shown_of_who_chose(
    made: Mapping[str, Path], name: str, policy: str | None, chosen: str
) -> None:
    assert verify_scores(made[name], made[policy] if policy else None).chosen.startswith(chosen)


def test_the_command_tells_it(made: Mapping[str, Path], capsys: pytest.CaptureFixture[str]) -> None:
    scores, policy = str(made["policy"]), str(made["weights"])
    assert main(["score", "verify", scores]) == 0
    assert "not checked that the policy chose these actions" in capsys.readouterr().out
    assert main(["score", "verify", scores, "--policy", policy]) == 0
    assert "the policy chose every action again" in capsys.readouterr().out
    assert main(["score", "verify", scores, "--policy", policy, "--puzzle", "avoidance/000"]) == 2
    assert "leave out --puzzle or --policy" in capsys.readouterr().err


def test_better_episodes_under_the_random_agents_name(made: Mapping[str, Path], tmp_path: Path) -> None:
    with pytest.raises(
        ArtefactError, match=r"avoidance/000: step 1: action \d was recorded, the random agent of seed 3"
    ):
        verify_scores(forged(made["random"], tmp_path / "f", episodes=made["oracle"]))


def test_worse_episodes_under_the_oracles_name(made: Mapping[str, Path], tmp_path: Path) -> None:
    with pytest.raises(ArtefactError, match=r"avoidance/000: step 1: action \d was recorded, the witness takes"):
        verify_scores(forged(made["oracle"], tmp_path / "f", episodes=made["random"]))


@pytest.mark.parametrize(("name", "better"), [("policy", "oracle"), ("policy", "checkpoint"), ("checkpoint", "policy")])
def test_others_episodes_under_a_policys_name(made: Mapping[str, Path], tmp_path: Path, name: str, better: str) -> None:
    scores = forged(made[name], tmp_path / "f", episodes=made[better])
    assert "not checked" in verify_scores(scores).chosen
    with pytest.raises(ArtefactError, match=r"step \d+: action \d was recorded, the policy takes \d"):
        verify_scores(scores, made["weights"])


def test_another_policy_is_not_asked(made: Mapping[str, Path]) -> None:
    with pytest.raises(ArtefactError, match=r"but the scores are of the policy .*; give that policy"):
        verify_scores(made["policy"], made["other"])
    with pytest.raises(ArtefactError, match="scores of random, which is no policy; omit --policy"):
        verify_scores(made["random"], made["weights"])


@pytest.mark.parametrize("name", ["random", "oracle", "human", "policy"])
@pytest.mark.parametrize("field", ["reasons", "chain", "rests_on"])
def test_a_proof_in_other_words_is_refused(made: Mapping[str, Path], tmp_path: Path, name: str, field: str) -> None:
    proof = msgspec.json.decode((made[name] / RECORD).read_bytes())["proof"]
    proof[field] = "certified" if field == "rests_on" else ["certified"]
    with pytest.raises(ArtefactError, match=rf"scores\.json: `proof\.{field}` is .*certified.* follows from the rest"):
        verify_scores(forged(made[name], tmp_path / "f", {"proof": proof}))


@pytest.mark.parametrize(
    ("name", "field", "value"),
    [
        ("random", "actions", "greedy"), ("random", "seed", 77), ("random", "evaluation_seed", 77),
        ("random", "agent", "oracle"), ("random", "agent", "human"), ("random", "trained", 5),
        ("oracle", "agent", "random"), ("oracle", "actions", "sampled"), ("oracle", "seed", 0),
        ("oracle", "evaluation_seed", 0), ("human", "agent", "oracle"), ("human", "actions", "witnesses"),
    ],
)  # fmt: skip
def test_who_played_without_a_policy_is_what_the_configuration_says(
    made: Mapping[str, Path], tmp_path: Path, name: str, field: str, value: Any
) -> None:
    with pytest.raises(ArtefactError, match=rf"scores\.json: `{field}` is {value!r}, but .* follows from the rest"):
        verify_scores(forged(made[name], tmp_path / "f", {field: value}))


def test_puzzles_that_went_badly_for_a_person_are_not_left_out(made: Mapping[str, Path], tmp_path: Path) -> None:
    scores = shutil.copytree(made["human"], tmp_path / "f")
    table = pq.read_table(scores / EPISODES)
    pq.write_table(table.slice(1), scores / EPISODES)
    with pytest.raises(ArtefactError, match="each once and in order, got 2 others"):
        verify_scores(reseal(scores))


@pytest.mark.parametrize("column", ["a_success", "return"])
def test_a_column_that_does_not_follow_from_the_rewards(made: Mapping[str, Path], tmp_path: Path, column: str) -> None:
    scores = shutil.copytree(made["random"], tmp_path / "f")
    table = pq.read_table(scores / EPISODES)
    rows = table.to_pylist()
    rows[1][column] = 9.0
    pq.write_table(pa.Table.from_pylist(rows, schema=table.schema), scores / EPISODES)
    with pytest.raises(ArtefactError, match=rf"avoidance/001: `{column}` is 9\.0, but .* follows from its rewards"):
        verify_scores(reseal(scores))


def test_a_configuration_that_is_none_is_named(made: Mapping[str, Path], tmp_path: Path) -> None:
    def changed(name: str, **fields: Any) -> Path:
        scores = shutil.copytree(made[name], tmp_path / name)
        config = {**artefacts.config_of(scores), **fields}
        (scores / artefacts.CONFIG).write_bytes(artefacts.canonical_json(config))
        return reseal(scores)

    with pytest.raises(ArtefactError, match=r"config\.json: `witnesses` is '0"):
        verify_scores(changed("oracle", witnesses="0" * 64))
    with pytest.raises(ArtefactError, match=r"config\.json.*`level`.*evaluate again"):
        verify_scores(changed("random", level=3))
