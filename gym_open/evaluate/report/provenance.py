"""Origin of the scores of a report: proofs, configurations, and commands that make the scores again."""

import shlex
from collections.abc import Iterator, Mapping, Sequence
from typing import Any

import msgspec

from gym_open.artefacts import CONFIG, Lineage, Parent, canonical_json
from gym_open.config import to_toml
from gym_open.evaluate.proof import task_free_proof
from gym_open.formats.scores import Proof
from gym_open.results.names import UNTRAINED, one_line
from gym_open.results.runs import ScoredRun
from gym_open.terminal import printable

_VARIES = ("seed", "task", "agent", "at")
"""Keys that the commands give as options, so that all runs can share one file."""
_STAGES = {"log": "collect", "release": "release", "encoder": "encoder", "policy": "policy"}
"""Start of the name of a configuration file, by kind of artefact."""


class ProofGroup(msgspec.Struct, frozen=True):
    """The proof that some runs of an agent share, computed again for the report."""

    agent: str
    scores: int
    verdict: str
    reasons: list[str]
    chains: list["ProofChain"]
    rests_on: str
    recorded: list[str]
    """Verdicts in the scores, if they differ from this verdict."""


class ProofChain(msgspec.Struct, frozen=True):
    """Policies with the same encoder."""

    links: list[str]
    """Links below the policy, down to the logs; empty without an encoder."""
    policies: list[str]
    """Task, seed and digest of each."""


class SharedConfig(msgspec.Struct, frozen=True):
    """A configuration that some runs share, except for seed, task and agent's name."""

    name: str
    """Name of its file in the commands."""
    kind: str
    agents: list[str]
    toml: str | None
    """None if it was not found."""
    sha256: list[str]
    """Digests of the `config.json` files that hold it."""


class Recipe(msgspec.Struct, frozen=True):
    """Commands that make an agent's scores again."""

    agent: str
    tasks: list[str]
    seeds: list[str]
    commands: list[str]


def proofs(runs: Sequence[ScoredRun], agents: Sequence[str]) -> list[ProofGroup]:
    """Compute the task-free proof of every run; group equal proofs of an agent, agents in the given order."""
    groups: dict[tuple[str, str, tuple[str, ...], str], list[tuple[ScoredRun, Proof]]] = {}
    for run in runs:
        proof = _proof(run)
        reasons = tuple(map(printable, proof.reasons))
        rests_on = printable(proof.rests_on).replace(run.record.policy or "\n", "shown below")
        groups.setdefault((run.name, proof.verdict, reasons, rests_on), []).append((run, proof))
    return [
        ProofGroup(
            agent=agent, verdict=verdict, reasons=list(reasons), rests_on=rests_on,
            scores=len(members), chains=_chains(members),
            recorded=sorted({run.record.proof.verdict for run, _ in members} - {verdict}),
        )
        for (agent, verdict, reasons, rests_on), members in sorted(
            groups.items(), key=lambda item: (agents.index(item[0][0]), item[0][1:])
        )
    ]  # fmt: skip


def _chains(members: Sequence[tuple[ScoredRun, Proof]]) -> list[ProofChain]:
    policies: dict[tuple[str, ...], dict[str, None]] = {}
    for run, proof in members:
        if run.lineage.parents:
            own = policies.setdefault(tuple(one_line(link) for link in proof.chain[1:]), {})
            own[f"{run.record.task}, seed {run.seed}: {run.lineage.parents[0].digest}"] = None
    return [ProofChain(list(links), list(own)) for links, own in policies.items()]


def _proof(run: ScoredRun) -> Proof:
    """Compute the proof from the records in the lineage of the scores; `scores.json` is not believed."""
    if run.record.agent in UNTRAINED and run.record.proof.verdict in ("no encoder", "not applicable"):
        return run.record.proof
    if not run.lineage.parents:
        reason = "its lineage names no policy, so the player is unknown"
        return Proof(verdict="missing", reasons=[reason], chain=[])
    return task_free_proof(run.lineage.parents[0])


class _ChainLink(msgspec.Struct, frozen=True):
    """An artefact of a chain, or the scores at its end."""

    run: ScoredRun
    place: str
    """Kinds from the scores down to this link, such as `policy/encoder/release`; unique in a chain."""
    kind: str
    sha256: str
    config: dict[str, Any] | None
    parents: list["_ChainLink"]

    @property
    def shared(self) -> bytes | None:
        """The configuration without what varies: links with equal bytes share a file."""
        if self.config is None:
            return None
        return canonical_json({key: value for key, value in self.config.items() if key not in _VARIES})

    @property
    def file(self) -> tuple[str, bytes | str]:
        """Identity of the link's configuration file; if the file was not found, one per agent and place."""
        return self.kind, self.shared or f"{self.run.name}: {self.place}"

    def walk(self) -> Iterator["_ChainLink"]:
        """Yield this link and all links below it, inputs first."""
        for parent in self.parents:
            yield from parent.walk()
        yield self


def recipes(
    runs: Sequence[ScoredRun], agents: Sequence[str], configs: Mapping[str, dict[str, Any]]
) -> tuple[list[SharedConfig], list[Recipe]]:
    """Return the distinct configurations of some runs, and the commands for every agent.

    Args:
        runs: the runs.
        agents: their names, in the order of the recipes.
        configs: configurations by SHA-256 of their file.
    """
    chains = [
        _chain(run, configs)
        for run in sorted(runs, key=lambda run: agents.index(run.name))
        if run.record.agent not in ("human", "oracle")
    ]
    named = _settings([link for chain in chains for link in chain.walk()])
    recipes = []
    for agent in agents:
        own = [run for run in runs if run.name == agent]
        heads = sorted((one for one in chains if one.run.name == agent), key=lambda one: -one.run.trained)
        recipes.append(
            Recipe(
                agent=agent,
                tasks=list(dict.fromkeys(run.record.task for run in own)),
                seeds=list(dict.fromkeys(str(run.seed) for run in own if run.record.agent != "oracle")),
                commands=_commands(own[0], heads, named),
            )
        )
    return list(named.values()), recipes


def _settings(links: Sequence[_ChainLink]) -> dict[tuple[str, bytes | str], SharedConfig]:
    """Name the configuration files, with a number per kind."""
    named: dict[tuple[str, bytes | str], SharedConfig] = {}
    for link in links:
        if link.file not in named:
            number = sum(kind == link.kind for kind, _ in named) + 1
            named[link.file] = SharedConfig(
                name=f"{_STAGES.get(link.kind, 'evaluate')}-{number}.toml", kind=link.kind, agents=[],
                toml=None if link.config is None else _toml(link.config), sha256=[],
            )  # fmt: skip
        setting = named[link.file]
        for values, value in ((setting.agents, link.run.name), (setting.sha256, link.sha256)):
            if value not in values:
                values.append(value)
    return named


def _chain(run: ScoredRun, configs: Mapping[str, dict[str, Any]]) -> _ChainLink:
    def link(parent: Parent | Lineage, sha256: str, place: str) -> _ChainLink:
        lineage = parent.lineage if isinstance(parent, Parent) else parent
        place = f"{place}/{lineage.kind}"
        below = [
            link(one, one.manifest[CONFIG].sha256 if CONFIG in one.manifest else "", f"{place}{i or ''}")
            for i, one in enumerate(lineage.parents)
        ]
        return _ChainLink(run, place, lineage.kind, sha256, configs.get(sha256), below)

    return link(run.lineage, run.config_sha256, "")


def _commands(
    run: ScoredRun, heads: Sequence[_ChainLink], named: Mapping[tuple[str, bytes | str], SharedConfig]
) -> list[str]:
    """Return the commands for all runs, with `$TASK` and `$SEED`. A comment names the runs if a line is not for all."""
    if run.record.agent == "oracle":
        return [f"gym-open evaluate --task $TASK --split {run.record.split} --oracle --out scores"]
    if run.record.agent == "human":
        return [f"gym-open play --task $TASK --split {run.record.split} --player $SEED --out scores"]
    links = [link for head in heads for link in head.walk()]
    follows: dict[str, bool] = {}
    names: dict[str, str] = {}
    for link in links:
        same = link.config is None or link.config.get("seed", link.run.seed) == link.run.seed
        follows[link.place] = follows.get(link.place, True) and same
        if link.place not in names:
            names[link.place] = f"{link.kind}{'' if link.kind not in names.values() else f'-{len(names)}'}"
    serves: dict[tuple[str, str], dict[str, None]] = {}
    for link in links:
        line = _command(link, named[link.file].name, names, follows=follows[link.place])
        serves.setdefault((link.place, line), {})[f"{link.run.record.task}, seed {link.run.seed}"] = None
    everyone = {run for served in serves.values() for run in served}
    return [
        line if served.keys() == everyone else f"{line}  # {'; '.join(served)}"
        for place in names
        for (where, line), served in serves.items()
        if where == place
    ]


def _command(link: _ChainLink, file: str, names: Mapping[str, str], *, follows: bool) -> str:
    inputs = {one.kind: names[one.place] for one in link.parents}
    every = " ".join(names[one.place] for one in link.parents)
    match link.kind:
        case "log":
            words = "collect"
        case "release" if inputs.keys() == {"log"}:
            words = f"dataset build --logs {every}"
        case "release":
            return f"# {names[link.place]}: merged, filtered or appended from {every}; see its rebuild/ folder"
        case "compact":
            return f"gym-open dataset pack {every} --out {names[link.place]}"
        case "encoder":
            words = f"train encoder --release {every}"
        case "policy":
            words = f"train policy --encoder {every}" if every else "train policy"
        case _:
            words = f"evaluate --policy {every}" if every else "evaluate"
    # without a policy's configuration, the lineage still says which keys it must have
    own = {"task": None, "seed": None, "agent": link.run.record.agent} if link.kind == "policy" else {}
    config = own if link.config is None else link.config
    task = " --task $TASK" if "task" in config else ""
    agent = f" --agent {shlex.quote(one_line(str(config['agent'])))}" if config.get("agent") else ""
    seed = "" if "seed" not in config else " --seed $SEED" if follows else f" --seed {config['seed']}"
    at = f" --at {config['at']}" if "at" in config else ""
    name = f"{names[link.place]}-at{config['at']}" if at else names[link.place]
    return f"gym-open {words} --config {file}{task}{agent}{seed}{at} --out {name}"


def _toml(config: Mapping[str, Any]) -> str:
    """Return TOML for `--config`; TOML has no null, and a missing key has its default."""
    kept = {key: value for key, value in config.items() if key not in _VARIES}
    return printable(to_toml(kept).strip())
