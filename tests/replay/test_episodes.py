"""Replay of scores: it gives what was recorded, and it finds forgeries even if their manifest is new."""

import shutil
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

import msgspec
import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest

from gym_open import artefacts
from gym_open.config import Config
from gym_open.envs.puzzles import PuzzleError
from gym_open.envs.puzzles.sets import puzzle_by_id, puzzles_of
from gym_open.envs.puzzles.witnesses import witness_of
from gym_open.errors import ArtefactError
from gym_open.evaluate import play
from gym_open.evaluate.config import CheckpointConfig, EvaluateConfig
from gym_open.evaluate.play import evaluate
from gym_open.evaluate.proof import task_free_proof
from gym_open.evaluate.scores import Episodes, summarise
from gym_open.evaluate.verify import verify_scores
from gym_open.files import sha256_file
from gym_open.formats.scores import EPISODES, RECORD, read_episodes, read_scores
from gym_open.replay.episodes import replay_puzzle

Forge = Callable[[Callable[[Path], None]], Path]


@pytest.fixture(scope="module")
def scores(tmp_path_factory: pytest.TempPathFactory) -> Path:
    config = EvaluateConfig(task="avoidance")
    return evaluate(config, None, tmp_path_factory.mktemp("oracle") / "scores", oracle=True).path


@pytest.fixture
def forge(scores: Path, tmp_path: Path) -> Forge:
    """Copies the scores, changes the copy, and makes a new manifest, so that all bytes agree with it."""

    def forged(change: Callable[[Path], None]) -> Path:
        folder = shutil.copytree(scores, tmp_path / "forged")
        change(folder)
        reseal(folder)
        return folder

    return forged


def reseal(folder: Path) -> None:
    entries = {
        path.name: artefacts.Entry(sha256=sha256_file(path), bytes=path.stat().st_size)
        for path in folder.iterdir()
        if path.name != artefacts.MANIFEST
    }
    (folder / artefacts.MANIFEST).write_bytes(artefacts.canonical_json(entries))


def in_record(**fields: Any) -> Callable[[Path], None]:
    def change(folder: Path) -> None:
        record = msgspec.json.decode((folder / RECORD).read_bytes())
        (folder / RECORD).write_bytes(artefacts.canonical_json({**record, **fields}))

    return change


def in_row(index: int, **fields: Any) -> Callable[[Path], None]:
    def change(folder: Path) -> None:
        table = pq.read_table(folder / EPISODES)
        rows = table.to_pylist()
        rows[index].update(fields)
        pq.write_table(pa.Table.from_pylist(rows, schema=table.schema), folder / EPISODES)

    return change


def rows_of(change: Callable[[list[dict[str, Any]]], list[dict[str, Any]]]) -> Callable[[Path], None]:
    def changed(folder: Path) -> None:
        table = pq.read_table(folder / EPISODES)
        pq.write_table(pa.Table.from_pylist(change(table.to_pylist()), schema=table.schema), folder / EPISODES)

    return changed


def test_a_puzzle_is_replayed_by_its_id(scores: Path) -> None:
    found = replay_puzzle(scores, "avoidance/017")
    assert found.puzzle == puzzle_by_id("avoidance/017")
    assert tuple(found.actions) == witness_of("avoidance/017").actions
    assert sum(found.rewards) == pytest.approx(1.0)
    assert len(found.rewards) == len(found.actions)
    assert found.terminated


def test_all_of_honest_scores_follows_from_their_episodes(scores: Path) -> None:
    assert verify_scores(scores) == (read_scores(scores), "every action is the witness's")


@pytest.mark.parametrize(
    ("name", "error", "message"),
    [
        ("avoidance/100", PuzzleError, "no puzzle 'avoidance/100'; ids are"),
        ("avoidance/17", PuzzleError, "no puzzle"),
        ("avoidance/test/017", PuzzleError, "no puzzle"),
        ("tool-use/017", ArtefactError, "no episode of puzzle tool-use/017; it holds avoidance/000 to avoidance/099"),
        ("avoidance/validation/017", ArtefactError, "no episode of puzzle"),
    ],
)
def test_an_id_that_the_scores_lack_is_named(scores: Path, name: str, error: type[Exception], message: str) -> None:
    with pytest.raises(error, match=message):
        replay_puzzle(scores, name)


def test_another_reward_is_found_at_its_step(forge: Forge) -> None:
    length = len(witness_of("avoidance/017").actions)
    folder = forge(in_row(17, rewards=[1.0] + [0.0] * (length - 1)))
    with pytest.raises(ArtefactError, match=r"avoidance/017: step 1: reward 1\.0 was recorded, the replay gave 0\.0"):
        replay_puzzle(folder, "avoidance/017")
    assert replay_puzzle(folder, "avoidance/018").terminated  # the other episodes are unchanged


def test_another_action_is_found(forge: Forge) -> None:
    actions = list(witness_of("avoidance/017").actions)
    actions[-1] = 0  # standing still before the goal gives no reward
    with pytest.raises(
        ArtefactError, match=f"avoidance/017: step {len(actions)}: reward 1.0 was recorded, the replay gave 0.0"
    ):
        replay_puzzle(forge(in_row(17, actions=actions)), "avoidance/017")


@pytest.mark.parametrize(
    ("fields", "message"),
    [
        ({"terminated": False}, "`terminated` is False"),
        ({"digest": "0" * 64}, "layout 0000"),
        ({"steps": 1}, "1 steps with"),
        ({"actions": [9], "rewards": [1.0], "steps": 1}, "an action outside 0 to 8"),
        ({"actions": [-1], "rewards": [1.0], "steps": 1}, "an action outside 0 to 8"),
        ({"actions": [0], "rewards": [0.0], "steps": 1}, "step 1: the episode does not end here"),
        ({"actions": [0] * 101, "rewards": [0.0] * 101, "steps": 101}, "101 steps"),
        ({"actions": [], "rewards": [], "steps": 0}, "0 steps"),
        ({"rewards": [float("nan")] * 2, "actions": [0] * 2, "steps": 2}, "a reward that is not finite"),
    ],
)
def test_a_row_that_cannot_have_been_played_is_refused(forge: Forge, fields: Mapping[str, Any], message: str) -> None:
    with pytest.raises(ArtefactError, match=message):
        replay_puzzle(forge(in_row(17, **fields)), "avoidance/017")


@pytest.mark.parametrize("index", [0, 99])
def test_an_episode_ends_where_its_task_ends_it(forge: Forge, index: int) -> None:
    name = f"avoidance/{index:03d}"
    actions = list(witness_of(name).actions)
    longer = {"actions": [*actions, 0], "rewards": [0.0] * (len(actions) - 1) + [1.0, 0.0], "steps": len(actions) + 1}
    with pytest.raises(ArtefactError, match=f"{name}: step {len(actions)}: the episode ends here"):
        replay_puzzle(forge(in_row(index, **longer)), name)


@pytest.mark.parametrize(
    ("fields", "field"),
    [
        ({"a_success": 0.99}, "a_success"),
        ({"a_success_half_width_95": 0.0}, "a_success_half_width_95"),
        ({"mean_return": 0.5}, "mean_return"),
        ({"mean_return_within": [1.0] * 100}, "mean_return_within"),
        ({"mean_return_within": [1.0]}, "mean_return_within"),
        ({"mean_steps": 1.0}, "mean_steps"),
        ({"puzzles": 1000}, "puzzles"),
        ({"policy": "0" * 64}, "policy"),
        ({"trained": 1_000_000}, "trained"),
        ({"code": "9.9.9"}, "code"),
    ],
)
def test_a_number_that_does_not_follow_is_named(forge: Forge, fields: Mapping[str, Any], field: str) -> None:
    with pytest.raises(ArtefactError, match=rf"scores\.json: `{field}` is .* follows from the rest"):
        verify_scores(forge(in_record(**fields)))


def test_consistent_rewards_are_still_replayed(forge: Forge) -> None:
    """Rewards and all numbers computed from them are higher by the same amount; the actions are unchanged."""
    length = len(witness_of("avoidance/000").actions)

    def change(folder: Path) -> None:
        in_row(0, rewards=[1.0] + [0.0] * (length - 1), a_success=1.0)(folder)
        rows = read_episodes(folder)
        rewards, steps = np.zeros((100, 100)), np.array([row["steps"] for row in rows])
        for out, row in zip(rewards, rows, strict=True):
            out[: row["steps"]] = row["rewards"]
        in_record(**summarise(Episodes(rewards, rewards, steps, steps > 0)))(folder)

    with pytest.raises(ArtefactError, match="avoidance/000: step 1: reward"):
        verify_scores(forge(change))


def test_scores_of_chosen_puzzles_are_refused(forge: Forge) -> None:
    easy = rows_of(lambda rows: sorted(rows, key=lambda row: -row["a_success"])[:50])
    with pytest.raises(ArtefactError, match="expected the test puzzles of avoidance, each once and in order, got 50"):
        verify_scores(forge(easy))


def test_scores_of_one_puzzle_a_hundred_times_are_refused(forge: Forge) -> None:
    with pytest.raises(ArtefactError, match="each once and in order"):
        verify_scores(forge(rows_of(lambda rows: [rows[3]] * 100)))


def test_scores_of_a_policy_that_name_none_are_cut(forge: Forge) -> None:
    with pytest.raises(ArtefactError, match="scores of 'curl' that name no policy, so the chain is broken"):
        verify_scores(forge(in_record(agent="curl")))


@pytest.mark.parametrize(
    ("fields", "message"),
    [
        ({"agent": "mine"}, "`agent` is 'mine', but 'theirs' follows"),
        ({"seed": 2}, "`seed` is 2, but 1 follows"),
        ({"trained": 1_000_000}, "`trained` is 1000000, but 224 follows"),
        ({"actions": "greedy"}, "`actions` is 'greedy', but 'sampled' follows"),
        ({"evaluation_seed": 9}, "`evaluation_seed` is 9, but 0 follows"),
        ({"policy": "0" * 64}, "`policy` is '0000"),
        ({"split": "validation"}, "expected the validation puzzles"),
        ({"proof": {"verdict": "proven", "reasons": [], "chain": []}}, "is 'proven', but 'missing' follows"),
    ],
)
def test_who_played_must_follow_from_the_lineage(
    scores: Path, tmp_path: Path, fields: Mapping[str, Any], message: str
) -> None:
    """The policy was scored at a checkpoint and claims that it had no encoder; without weights nothing is proven."""
    facts = {
        "task": "avoidance", "steps": 640, "agent": "theirs", "seed": 1, "encoder": "none", "from_encoder": False,
        "checkpoints": [{"asked": 200, "step": 224}],
    }  # fmt: skip
    policy = artefacts.build(tmp_path / "policy", kind="policy", config=Config(), parents=[], work=lambda _: facts).path

    def work(folder: Path) -> Mapping[str, Any]:
        for name in (RECORD, EPISODES):
            shutil.copy(scores / name, folder / name)
        link = artefacts.Parent(artefacts.digest(policy), artefacts.manifest(policy), artefacts.lineage(policy))
        missing = msgspec.to_builtins(task_free_proof(link))
        honest = {
            "agent": "theirs", "seed": 1, "evaluation_seed": 0, "trained": 224, "actions": "sampled",
            "policy": link.digest, "proof": missing,
        }  # fmt: skip
        in_record(**{**honest, **fields})(folder)
        return {}

    config = CheckpointConfig(task="avoidance", at=200)
    made = artefacts.build(tmp_path / "scores", kind="scores", config=config, parents=[policy], work=work).path
    with pytest.raises(ArtefactError, match=message):
        verify_scores(made)


def test_a_proof_that_was_written_in_is_not_believed(forge: Forge) -> None:
    proof = {"verdict": "proven", "reasons": [], "chain": ["policy 0123"], "rests_on": ""}
    with pytest.raises(ArtefactError, match=r"`proof\.verdict` is 'proven', but 'not applicable' follows"):
        verify_scores(forge(in_record(proof=proof)))


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (lambda folder: (folder / RECORD).write_text("{}"), "not scores as this version writes them"),
        (lambda folder: (folder / RECORD).write_bytes(b"\xff"), "not scores as this version writes them"),
        (lambda folder: (folder / RECORD).unlink(), "missing, so there are no scores"),
        (lambda folder: (folder / EPISODES).write_bytes(b"PAR1"), "not readable"),
        (lambda folder: (folder / EPISODES).unlink(), "missing, so nothing can be replayed"),
        (lambda folder: pq.write_table(pa.table({"puzzle": ["a"]}), folder / EPISODES), "its columns are not those"),
        (in_row(17, actions=None), "its columns are not those"),
        (in_row(17, actions=[None]), "its columns are not those"),
        (in_row(17, digest=None), "its columns are not those"),
    ],
)
def test_damaged_scores_are_named(forge: Forge, change: Callable[[Path], None], message: str) -> None:
    with pytest.raises(ArtefactError, match=message):
        replay_puzzle(forge(change), "avoidance/017")


def test_changed_bytes_are_named_before_anything_is_read(scores: Path, tmp_path: Path) -> None:
    folder = shutil.copytree(scores, tmp_path / "copy")
    in_record(a_success=1.0)(folder)
    with pytest.raises(ArtefactError, match=r"scores\.json: .*manifest\.json"):
        replay_puzzle(folder, "avoidance/017")


def test_no_scores_are_no_scores(tmp_path: Path) -> None:
    made = artefacts.build(tmp_path / "log", kind="log", config=Config(), parents=[], work=lambda _: {})
    with pytest.raises(ArtefactError, match="expected an artefact of kind 'scores', got 'log'"):
        replay_puzzle(made.path, "avoidance/017")


def test_a_random_agent_is_replayed(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(play, "puzzles_of", lambda task, split: puzzles_of(task, split)[:2])
    made = evaluate(EvaluateConfig(task="preferences", split="validation", threads=1), None, tmp_path / "scores").path
    record = read_scores(made)
    assert (record.agent, record.seed, record.evaluation_seed, record.trained) == ("random", 0, 0, 0)
    again = [replay_puzzle(made, f"preferences/validation/{i:03d}") for i in range(2)]
    assert sum(sum(one.rewards) for one in again) / 2 == pytest.approx(record.mean_return)
    assert sum(len(one.actions) for one in again) / 2 == record.mean_steps
