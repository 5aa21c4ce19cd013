"""The configuration of a grid becomes jobs, and its mistakes show before anything starts."""

import tomllib
from collections import Counter
from pathlib import Path
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st

from gym_open.collect.config import CollectConfig
from gym_open.config import decode, load
from gym_open.errors import ConfigError
from gym_open.evaluate.config import EvaluateConfig
from gym_open.grid import GridConfig
from gym_open.grid.plan import GridJob, before_the_end, chains, make_plan
from gym_open.train.config import EncoderTrainConfig, PolicyTrainConfig
from gym_open.workspace import template

ROOT = template()
SHIPPED = sorted(ROOT.glob("evaluate/benchmark-*.toml"))
SCRATCH = {"name": "scratch", "policy": "train/policy-strong.toml"}
ONLINE = {"name": "online", "policy": "train/policy-strong.toml", "collect": "collect/curl-ride.toml", "online": True}
OFFLINE = {
    "name": "offline", "policy": "train/policy-strong.toml", "collect": "collect/curl-ride.toml",
    "encoder": "train/encoder-curl.toml",
}  # fmt: skip


def plan(out: Path = Path("out"), root: Path = ROOT, **changes: Any) -> dict[str, GridJob]:
    raw = {"tasks": ["goal-seeking"], "seeds": [0], "agents": [SCRATCH, ONLINE, OFFLINE], **changes}
    return {job.name: job for job in make_plan(decode(raw, GridConfig, source="test"), out, root=root)}


def test_the_grid_of_the_paper() -> None:
    config = load(ROOT / "evaluate/benchmark-paper.toml", GridConfig)
    jobs = make_plan(config, Path("out"), root=ROOT)
    policies = [job.config for job in jobs if isinstance(job.config, PolicyTrainConfig)]
    grid = {(policy.agent, policy.task, policy.seed) for policy in policies}
    assert len(policies) == len(grid) == 8 * 4 * 3
    assert {policy.steps for policy in policies} == {1_000_000}
    plays = [job.config for job in jobs if isinstance(job.config, CollectConfig)]
    assert {play.explorer.name for play in plays} == {"icm", "icm+ride", "rnd", "rnd+ride", "curl+random", "curl+ride"}
    assert len(plays) == 6 * 3
    assert {play.steps for play in plays} == {2_000_000}
    assert {policy.agent for policy in policies} == {play.explorer.name for play in plays} | {"scratch", "paper"}
    assert {policy.ppo.gamma for policy in policies if policy.task == "tool-use" and policy.agent != "paper"} == {0.99}
    stages = Counter(job.stage for job in jobs)
    assert stages["evaluate"] == 96 * 3 + 2 * 4  # at 200K, 500K and the end; random and oracle once per task
    assert stages["train probe"] == len(plays)
    starts = {job.config.agent: job.needs for job in jobs if isinstance(job.config, PolicyTrainConfig)}
    assert starts.pop("scratch") == starts.pop("paper") == ()
    for agent, needs in starts.items():
        (play,) = needs
        assert isinstance(play.config, CollectConfig)
        assert play.config.explorer.name == agent  # from the explorer's own encoder


@pytest.mark.parametrize("file", SHIPPED, ids=lambda file: file.stem)
def test_every_job_can_be_given_as_a_file(file: Path) -> None:
    jobs = make_plan(load(file, GridConfig), Path("out"), root=ROOT)
    seen = set[str]()
    for job in jobs:
        assert decode(tomllib.loads(job.toml()), type(job.config), source=job.name) == job.config
        assert getattr(job.config, "threads", 1) == 1
        assert {need.name for need in job.needs} <= seen
        assert all(str(need.out) in job.options for need in job.needs)
        seen.add(job.name)
    assert len(seen) == len({job.out for job in jobs}) == len(jobs)


def test_what_two_agents_share_is_one_job() -> None:
    jobs = plan(probe="train/probe.toml")
    assert set(jobs) == {
        "collect-curl-ride-seed0", "release-curl-ride-seed0", "encoder-curl-of-curl-ride-seed0",
        "probe-curl-ride-seed0", "probe-encoder-curl-of-curl-ride-seed0",
        *(f"policy-{name}-goal-seeking-seed0" for name in ("offline", "online", "scratch")),
        *(f"score-{name}-goal-seeking-seed0" for name in ("offline", "online", "scratch")),
        *(f"score-{name}-goal-seeking-seed0-at200000" for name in ("offline", "online", "scratch")),
        *(f"score-{name}-goal-seeking-seed0-at500000" for name in ("offline", "online", "scratch")),
        "score-oracle-goal-seeking", "score-random-goal-seeking",
    }  # fmt: skip
    assert jobs["score-online-goal-seeking-seed0-at200000"].needs == (jobs["policy-online-goal-seeking-seed0"],)


def test_no_path_of_a_command_is_taken_for_an_option() -> None:
    jobs = plan(Path("-x"), probe="train/probe.toml")
    words = {word for job in jobs.values() for word in job.words(Path("/jobs"))}
    assert {word for word in words if "-x" in word and not word.startswith(str(Path.cwd()))} == set()
    assert str(Path("-x").absolute() / "collect/logs/curl-ride-seed0") in words


def test_one_exploration_run_for_all_seeds_or_one_for_each() -> None:
    own = plan(seeds=[3, 4], agents=[OFFLINE])
    shared = plan(seeds=[3, 4], agents=[{**OFFLINE, "play_seed": 7}])
    for jobs, seeds in ((own, [3, 4]), (shared, [7])):
        assert [job.config.seed for job in jobs.values() if isinstance(job.config, CollectConfig)] == seeds
        assert [job.config.seed for job in jobs.values() if isinstance(job.config, EncoderTrainConfig)] == seeds
        assert [job.config.seed for job in jobs.values() if isinstance(job.config, PolicyTrainConfig)] == [3, 4]


def test_a_task_may_have_a_configuration_of_its_own() -> None:
    agent = {**SCRATCH, "policies": {"tool-use": "train/policy-strong-tool-use.toml"}}
    jobs = plan(tasks=["goal-seeking", "tool-use"], agents=[agent])
    found = [job.config for job in jobs.values() if isinstance(job.config, PolicyTrainConfig)]
    assert [(config.task, config.ppo.gamma) for config in found] == [("goal-seeking", 0.95), ("tool-use", 0.99)]


def test_only_policies_take_greedy_actions(tmp_path: Path) -> None:
    (tmp_path / "train").symlink_to(ROOT / "train")
    (tmp_path / "evaluate").mkdir()
    (tmp_path / "evaluate/goal-seeking.toml").write_text('actions = "greedy"')
    jobs = plan(root=tmp_path, agents=[SCRATCH]).values()
    scored = {job.name: job.config.actions for job in jobs if isinstance(job.config, EvaluateConfig)}
    assert scored.pop("score-random-goal-seeking") == "sampled"
    scored.pop("score-oracle-goal-seeking")
    assert set(scored.values()) == {"greedy"}


def test_lengths_are_replaced() -> None:
    long = {**ONLINE, "name": "long", "collect_steps": 999}
    jobs = plan(
        agents=[OFFLINE, long], collect_steps=11, collect_pool=7, encoder_updates=22, policy_steps=9000,
        checkpoints=[4096, 5000],
    )  # fmt: skip
    plays = [job.config for job in jobs.values() if isinstance(job.config, CollectConfig)]
    assert {(play.steps, play.pool) for play in plays} == {(11, 7), (999, 7)}
    assert {job.units for job in jobs.values() if job.stage == "train encoder"} == {22}
    policies = [job.config for job in jobs.values() if isinstance(job.config, PolicyTrainConfig)]
    assert {(policy.steps, policy.checkpoints) for policy in policies} == {(9000, (4096, 5000))}
    assert "score-long-goal-seeking-seed0-at5000" in jobs


def test_every_task_is_scored_on_its_own_puzzles() -> None:
    jobs = plan(tasks=["tool-use", "avoidance"])
    for name, job in jobs.items():
        if isinstance(job.config, EvaluateConfig):
            assert job.config.task in name
            assert all(isinstance(need.config, PolicyTrainConfig) for need in job.needs)
            assert {need.config.task for need in job.needs} <= {job.config.task}  # pyright: ignore


@pytest.mark.parametrize(
    ("changes", "words"),
    [
        ({"agents": [{**SCRATCH, "online": True}]}, "`collect`"),
        ({"agents": [{**OFFLINE, "online": True}]}, "both `online` and `encoder`"),
        ({"agents": [{**SCRATCH, "collect": "collect/icm.toml"}]}, "its exploration is not used"),
        ({"agents": [{**SCRATCH, "frozen": True}]}, "`frozen`"),
        ({"agents": [{**SCRATCH, "play_seed": 1}]}, "`play_seed`"),
        ({"agents": [SCRATCH, SCRATCH]}, "'scratch' is given twice"),
        ({"seeds": [1, 0, 0]}, "0 is given twice"),
        ({"agents": [{**SCRATCH, "name": "human"}]}, "none of random, oracle and human"),
        ({"agents": [{**SCRATCH, "name": "../up"}]}, "agents.0.name"),
        ({"agents": [{**SCRATCH, "polcy": "x"}]}, "did you mean `policy`?"),
        ({"tasks": []}, "tasks"),
        ({"agents": [{**SCRATCH, "policy": "train/none.toml"}]}, "train/none.toml: no such configuration file"),
        ({"evaluate": "evaluate/none.toml"}, "evaluate/none.toml: no such configuration file"),
        ({"agents": [{**ONLINE, "collect": "collect/random.toml"}]}, "no world model"),
        ({"agents": [{**ONLINE, "policy": "train/policy-paper.toml"}]}, "`encoder.pixel_scale` is 1.0"),
        ({"agents": [{**SCRATCH, "policy": "collect/icm.toml"}]}, "collect/icm.toml: unknown key"),
    ],
)  # fmt: skip
def test_mistakes_are_named_before_anything_starts(changes: dict[str, Any], words: str, tmp_path: Path) -> None:
    with pytest.raises(ConfigError) as error:
        plan(tmp_path / "out", **changes)
    assert words in str(error.value)
    assert not (tmp_path / "out").exists()


def test_two_exploration_runs_of_one_name_are_refused(tmp_path: Path) -> None:
    for folder, steps in (("a", 64), ("b", 128)):
        (tmp_path / folder).mkdir()
        (tmp_path / folder / "curl.toml").write_text(f"steps = {steps}\n")
    (tmp_path / "policy.toml").write_text("")
    (tmp_path / "evaluate.toml").write_text("")
    agents = [
        {"name": name, "collect": f"{name}/curl.toml", "online": True, "policy": "policy.toml"} for name in ("a", "b")
    ]
    with pytest.raises(ConfigError, match="'collect-curl-seed0'"):
        plan(root=tmp_path, agents=agents, evaluate="evaluate.toml")


@given(
    st.integers(1, 200), st.lists(st.integers(1, 300), max_size=8), st.integers(1, 5), st.integers(1, 9),
)  # fmt: skip
def test_no_weights_are_scored_twice(steps: int, checkpoints: list[int], num_envs: int, num_steps: int) -> None:
    """Compared with training step by step: which checkpoints it writes, and at which step."""
    config = PolicyTrainConfig(steps=steps, checkpoints=tuple(checkpoints), num_envs=num_envs, num_steps=num_steps)
    step, reached = 0, dict[int, int]()
    while step < steps:
        step += num_envs * num_steps
        reached |= {asked: step for asked in checkpoints if asked <= step and asked not in reached}
    scored = list(before_the_end(config))
    assert set(scored) <= reached.keys()
    at = [reached[asked] for asked in scored]
    assert len(at) == len(set(at))
    assert set(at) | {step} == set(reached.values()) | {step}
    assert step not in at


@given(st.data())
def test_the_longest_chain_is_that_of_all_paths(data: st.DataObject) -> None:
    jobs: list[GridJob] = []
    for i in range(data.draw(st.integers(1, 7))):
        needs = tuple(data.draw(st.lists(st.sampled_from(jobs), unique_by=lambda job: job.name))) if jobs else ()
        jobs.append(GridJob(str(i), "collect", Path(str(i)), CollectConfig(), 1, (), needs))
    left = {job.name: float(data.draw(st.integers(0, 50))) for job in jobs}

    def longest(job: GridJob) -> float:
        return left[job.name] + max((longest(other) for other in jobs if job in other.needs), default=0.0)

    assert chains(jobs, left) == {job.name: longest(job) for job in jobs}
