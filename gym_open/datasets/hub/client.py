"""Shared parts of push and pull: the connection to a hub, its tags and files, and the identity of a release."""

import re
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Any

import msgspec

from gym_open.datasets.compare.versions import parse
from gym_open.errors import ArtefactError, GymOpenError, UsageError
from gym_open.formats.compact import layout as compact
from gym_open.formats.releases.layout import INFO_PATH

if TYPE_CHECKING:
    from huggingface_hub import HfApi
    from huggingface_hub.hf_api import RepoFile

_REPO = re.compile(r"[A-Za-z0-9][\w.-]*/[A-Za-z0-9][\w.-]*", re.ASCII)
_AGAIN = "run the same command again, it continues from there"


@contextmanager
def talking(repo: str, endpoint: str | None) -> "Iterator[HfApi]":
    """Provide a client of the hub. Every failure becomes an error that says what to do.

    Args:
        repo: OWNER/NAME, named in errors.
        endpoint: address of the hub; by default HF_ENDPOINT or huggingface.co.

    Raises:
        GymOpenError: if the hub cannot be reached, refuses, or sends an invalid answer.
    """
    from huggingface_hub import HfApi

    api = HfApi(endpoint=endpoint, library_name="gym-open")
    try:
        yield api
    except (network_error(), OSError, RuntimeError, ValueError, LookupError, TypeError, AttributeError) as error:
        # the client raises the last three for an invalid answer
        raise GymOpenError(f"{repo} at {api.endpoint}: {_explained(error)}") from error


def network_error() -> type[Exception]:
    """The exception of the client's HTTP library: requests, httpx or httpx2, depending on the client's version."""
    from huggingface_hub.errors import HfHubHTTPError

    library = HfHubHTTPError.__bases__[0].__module__.partition(".")[0]
    return [base for base in HfHubHTTPError.__mro__ if base.__module__.partition(".")[0] == library][-1]


def _explained(error: Exception) -> str:
    from huggingface_hub.errors import HfHubHTTPError, LocalEntryNotFoundError, RepositoryNotFoundError
    from huggingface_hub.errors import OfflineModeIsEnabled as OfflineError

    if isinstance(error, RuntimeError) and isinstance(error.__cause__, Exception):
        error = error.__cause__  # raised in the thread of an upload
    if isinstance(error, OfflineError):
        return "HF_HUB_OFFLINE is set: unset it for this command"
    if isinstance(error, RepositoryNotFoundError):
        return "no such data set, or your token may not see it; check the name, or log in with `hf auth login`"
    if isinstance(error, HfHubHTTPError) and error.response is not None:
        status, said = error.response.status_code, (error.server_message or "").strip()[:300]
        if status in {401, 403}:
            return f"refused ({status}): log in with `hf auth login`, or set HF_TOKEN, with the right to write there"
        return f"answered {status} {said}; {_AGAIN}, later if it is busy"
    if isinstance(error, network_error() | LocalEntryNotFoundError):
        return f"cannot be reached ({type(error).__name__}); check the network and --endpoint, then {_AGAIN}"
    return f"{type(error).__name__}: {str(error)[:300]}; {_AGAIN}"


def tags(api: "HfApi", repo: str) -> dict[str, str]:
    """The commit of each tag of a data set."""
    return {tag.name: tag.target_commit for tag in api.list_repo_refs(repo, repo_type="dataset").tags}


def versions(known: Mapping[str, str]) -> list[tuple[int, int, int]]:
    """The versions `X.Y.Z` that tags `vX.Y.Z` name, ascending."""
    return sorted(version for tag in known if tag[:1] == "v" and (version := parse(tag[1:])))


def tree(api: "HfApi", repo: str, revision: str) -> "dict[str, RepoFile]":
    """The hub's record of every file of a revision, by name."""
    from huggingface_hub.hf_api import RepoFile

    items = api.list_repo_tree(repo, recursive=True, revision=revision, repo_type="dataset")
    return {item.path: item for item in items if isinstance(item, RepoFile)}


def check_repo(repo: str, name: str | None = None) -> None:
    """Check that `repo` is OWNER/NAME, and that NAME is that of the release `name`, if given.

    Raises:
        UsageError: if the check fails.
    """
    if not _REPO.fullmatch(repo):
        raise UsageError(f"a repository must be OWNER/NAME, got {repo!r}")
    if name is not None and repo.partition("/")[2] != (own := name.partition("/")[2]):
        raise UsageError(f"{repo}: the release is called {name}, so its repository must be OWNER/{own}")


def verified(root: Path) -> tuple[str, str]:
    """Verify the release at `root`, without the replay, and return its name and version.

    Raises:
        ArtefactError: naming the first faulty file.
    """
    from gym_open.datasets.verify import verify_release

    report = verify_release(root, replay=False)
    for problem in report.problems:
        raise ArtefactError(f"{root / problem.file}: {problem.what} (list all problems with gym-open dataset verify)")
    return identity(root)


def info_path(root: Path) -> str:
    """Name of the file with the name and version of the release at `root`, compact or not."""
    return compact.INFO if (root / compact.INFO).is_file() else INFO_PATH


def identity(root: Path) -> tuple[str, str]:
    """Read name and version of a release from its `meta/info.json`, or from the `compact.json` of a compact one.

    Raises:
        ArtefactError: if it holds none.
    """
    info = root / info_path(root)
    try:
        said = msgspec.json.decode(info.read_bytes(), type=dict[str, Any])
        ours = said if info.name == compact.INFO else said["gym_open"]
        name, version = ours["name"], ours["version"]
    except (OSError, msgspec.DecodeError, UnicodeDecodeError, RecursionError, KeyError, TypeError) as error:
        raise ArtefactError(f"{info}: not from a release of gym-open: {error}") from None
    if not (isinstance(name, str) and _REPO.fullmatch(name) and isinstance(version, str) and parse(version)):
        raise ArtefactError(f"{info}: expected NAMESPACE/NAME and X.Y.Z as name and version, got {name!r}, {version!r}")
    return name, version
