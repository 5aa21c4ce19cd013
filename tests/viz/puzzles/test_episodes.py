"""Episodes of a replay, a policy and the witness, compared with the simulator, torch and the evaluation."""

import shutil
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest
import torch

from gym_open import artefacts
from gym_open.envs.constants import N_ACTIONS
from gym_open.envs.env import OpenEnv
from gym_open.envs.puzzles import PuzzleError
from gym_open.envs.puzzles.sets import puzzle_by_id, puzzles_of
from gym_open.envs.puzzles.witnesses import witness_of
from gym_open.errors import ArtefactError, UsageError
from gym_open.evaluate.config import EvaluateConfig
from gym_open.evaluate.play import load_actor, play
from gym_open.formats.models import load_policy
from gym_open.formats.scores import EPISODES
from gym_open.viz.config import Choice, VizConfig
from gym_open.viz.puzzles import episodes, view
from gym_open.viz.puzzles.episodes import PuzzleEpisode, play_all

SOLVED, GIVEN_UP, FAILED = (f"avoidance/{i:03d}" for i in range(3))


def check_simulated(episode: PuzzleEpisode, puzzle: str) -> None:
    """Compare an episode with a new environment."""
    env = OpenEnv("avoidance")
    image, info = env.reset(options={"puzzle": puzzle_by_id(puzzle)})
    for step, action in enumerate(episode.actions):
        np.testing.assert_array_equal(episode.images[step], image)
        np.testing.assert_array_equal(episode.states[step], info["object_state"])
        image, reward, _, _, info = env.step(action)
        assert (episode.rewards[step], episode.contacts[step], episode.touched[step]) == (
            reward, info["contacts"], info["hits"],
        )  # fmt: skip
    np.testing.assert_array_equal(episode.states[-1], info["object_state"])
    assert env.ended


def test_scores_are_replayed_beside_the_witness(scores: Any) -> None:
    played = play_all(SOLVED, [scores.path])
    own, witness = played.episodes
    assert (own.name, witness.name) == ("small", "witness")
    assert own.actions == scores.actions[0] == list(witness_of(SOLVED).actions) == witness.actions
    assert own.outcome == f"solved in {len(own.actions)} actions"
    assert own.returns.tolist() == [0.0, *np.cumsum(scores.rewards[0]).tolist()]
    assert own.policy is None
    check_simulated(own, SOLVED)
    check_simulated(witness, SOLVED)


def test_how_it_ended_is_said(scores: Any) -> None:
    assert play_all(GIVEN_UP, [scores.path]).episodes[0].outcome == "not solved in 100 actions"
    failed = play_all(FAILED, [scores.path]).episodes[0]
    assert failed.outcome == f"in the danger patch at action {len(scores.actions[2])}"


def test_a_policy_plays_as_it_is_evaluated(policy: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(episodes, "THREADS", 1)
    config = EvaluateConfig(task="avoidance", threads=1)
    actor, states = load_actor(policy, config)
    evaluated = play(actor, "avoidance", puzzles_of("avoidance", "test")[:1], config, states=states)
    own = play_all(SOLVED, [policy]).episodes[0]
    assert own.actions == evaluated.actions[0, : evaluated.steps[0]].tolist()
    assert own.rewards == evaluated.rewards[0, : evaluated.steps[0]].tolist()
    assert len(set(own.actions)) > 3
    check_simulated(own, SOLVED)


def test_the_policy_behind_scores_says_what_it_made_of_their_episode(scores: Any, policy: Path) -> None:
    played = play_all(SOLVED, [scores.path, policy])
    assert [episode.name for episode in played.episodes] == ["small", "witness"]
    own = played.episodes[0]
    assert own.policy is not None
    network = load_policy(policy).eval()
    with torch.no_grad():
        logits, values = network(network.prepare(torch.from_numpy(own.images[:-1])))
    expected = torch.distributions.Categorical(logits=logits.double())
    np.testing.assert_allclose(own.policy.probabilities, expected.probs.numpy(), atol=1e-5)
    np.testing.assert_allclose(own.policy.entropy, expected.entropy().numpy(), atol=1e-5)
    np.testing.assert_allclose(own.policy.values, values.numpy(), atol=1e-5)
    assert own.policy.probabilities.shape == (own.steps, N_ACTIONS)
    assert float(np.ptp(own.policy.probabilities, axis=1).min()) > 0.01


@pytest.mark.parametrize(("at", "paid"), [(0, 0.0), (-1, 1.0)])
def test_scores_that_do_not_come_out_again_are_refused(
    scores: Any, tmp_path: Path, seal: Callable[[Path], None], at: int, paid: float
) -> None:
    """With a higher and with a lower reward than the replay gives."""
    forged = shutil.copytree(scores.path, tmp_path / "forged")
    table = pq.read_table(forged / EPISODES)
    rows = table.to_pylist()
    rows[0]["rewards"][at] = 0.5
    step = 1 if at == 0 else rows[0]["steps"]
    pq.write_table(pa.Table.from_pylist(rows, schema=table.schema), forged / EPISODES)
    seal(forged)
    with pytest.raises(
        ArtefactError, match=rf"puzzle avoidance/000: step {step}: reward 0\.5 was recorded, the replay gave {paid}"
    ):
        play_all(SOLVED, [forged])


def test_what_cannot_be_shown_is_refused(scores: Any, others: Any, policy: Path, make_log: Callable[..., Path]) -> None:
    with pytest.raises(ArtefactError, match="no episode of puzzle avoidance/002; it holds avoidance/000 to"):
        play_all(FAILED, [scores.path, others.path])
    with pytest.raises(ArtefactError, match="trained for task 'avoidance', but tool-use/017 is one of tool-use"):
        play_all("tool-use/017", [policy])
    with pytest.raises(PuzzleError, match="no puzzle 'avoidance/17'"):
        play_all("avoidance/17", [policy])
    with pytest.raises(UsageError, match="no source plays it"):
        play_all(SOLVED, [])
    with pytest.raises(ArtefactError, match="a log, which plays no puzzle of the evaluation"):
        play_all(SOLVED, [make_log()])
    with pytest.raises(UsageError, match="--segment does not apply to a puzzle"):
        view(VizConfig(), [scores.path], Choice(puzzle=SOLVED, segment=1))
    with pytest.raises(ArtefactError, match="expected an artefact of kind 'scores', got 'policy'"):
        view(VizConfig(), [policy], Choice())
    assert artefacts.verify(scores.path, "scores")
