"""Names of agents from any artefact, also a hostile one."""

from pathlib import Path
from typing import Any

import pytest

from gym_open import artefacts
from gym_open.config import Config
from gym_open.results.names import distinct_names


class Made(Config, frozen=True):
    """Stands for a policy's configuration."""

    name: str


@pytest.mark.parametrize(
    ("steps", "name"), [(502_000, "a, 502k steps"), ("abc", "a, "), (10**400, "a, "), ([], "a, "), (-1, "a, ")]
)
def test_steps_tell_policies_apart_if_they_are_a_number(tmp_path: Path, steps: Any, name: str) -> None:
    def made(folder: str, steps: Any) -> Path:
        def work(partial: Path) -> dict[str, Any]:
            del partial
            return {"agent": "a", "steps": steps}

        return artefacts.build(tmp_path / folder, kind="policy", config=Made(name=folder), parents=[], work=work).path

    one, other = made("one", steps), made("other", 10)
    assert distinct_names({one: None, other: None}) == {one: name, other: "a, 10 steps"}
