"""`rebuild/`: commands and configurations that make the release again from seeds and compare the result.

A release that was made from releases names them by payload digest. Each of them has its own `rebuild/`.
"""

import shlex
from collections.abc import Iterator, Sequence
from pathlib import Path

from gym_open import artefacts
from gym_open.config import to_dict, to_toml
from gym_open.datasets.config import Header
from gym_open.datasets.documents.facts import LogFacts
from gym_open.formats.releases.content import payload_digest
from gym_open.formats.releases.info import read_info
from gym_open.formats.releases.layout import RECORDS, SIGNATURE

_COLLECTED = {"steps", "streams", "seed", "explorer", "curriculum", "sandbox", "log"}
"""Keys in the configuration of a log from `gym-open collect`."""
_HEAD = """\
#!/bin/sh
# Makes {name} {version} again and compares it with the release that this script is in.
# Wants the code and the packages that lineage.json names, on the same type of machine; then all bytes are the same.
#
#     sh rebuild/rebuild.sh            writes to ./rebuilt; WORK=FOLDER for another folder
set -eu
here=$(cd -- "$(dirname -- "$0")" && pwd)
datasets="$here/../../../.."
work="${{WORK:-rebuilt}}"
made="$work/{name}/{version}"

# payload RELEASE: the SHA-256 of all that its manifest lists but the records of code, packages and inputs
payload() {{
    "${{PYTHON:-python3}}" - "$1/manifest.json" <<'END'
import hashlib, json, sys
records = {records}
with open(sys.argv[1], encoding="utf-8") as file:
    entries = {{name: entry for name, entry in json.load(file).items() if name not in records}}
text = json.dumps(entries, indent=1, sort_keys=True, ensure_ascii=False) + "\\n"
print(hashlib.sha256(text.encode()).hexdigest())
END
}}
"""
_PARENT = """
# {what}; by default where it would lie beside this one
{variable}="${{{shell}:-"$datasets/{place}"}}"
if [ ! -f "${variable}/manifest.json" ] || [ "$(payload "${variable}")" != {digest} ]; then
    echo "${variable}: not {place}; make it again with its own rebuild/rebuild.sh, or give {shell}=FOLDER" >&2
    exit 1
fi
"""
_COLLECT = """
# log {number}: {steps} steps of {streams} stream(s)
gym-open collect --config "$here/log-{number}.toml" --out "$work/logs/{number}"
log_{number}="$work/logs/{number}"
"""
_GIVEN = """
# log {number} was not made by `gym-open collect`: it cannot be made again from a seed
log_{number}="${{LOG_{number}:?give the folder of log {number}}}"
"""
_BESIDE = """\
# the version before is looked for beside the new one
beside="$(dirname -- "$made")"
mkdir -p -- "$beside"
[ -e "$beside/{version}" ] || cp -R -- "$previous" "$beside/{version}"
"""
_TAIL = """
expected=$(payload "$here/..")
found=$(payload "$made")
echo "payload of this release  $expected"
echo "payload of the rebuilt   $found"
[ "$expected" = "$found" ] && echo same || {
    echo "different: lineage.json of each names its code and packages, gym-open dataset diff says what differs" >&2
    exit 1
}
"""


def rebuild_files(
    config: Header, command: str, logs: Sequence[LogFacts], releases: Sequence[Path], previous: Path | None
) -> dict[str, bytes]:
    """Files of `rebuild/` by name.

    Args:
        config: configuration of the release.
        command: `build`, `append`, `merge` or `filter`.
        logs: the given logs, in order; empty for `merge` and `filter`.
        releases: the releases from which a merge or filter is made.
        previous: the previous version, if there is one.
    """
    settings = {key: value for key, value in to_dict(config).items() if key != "append"}  # an option of the command
    files = {f"{command}.toml": to_toml(settings).encode()}
    files.update({f"log-{log.number:03d}.toml": to_toml(log.config).encode() for log in logs if _was_collected(log)})
    head = _HEAD.format(name=config.name, version=config.version, records=(*RECORDS, SIGNATURE))
    parts = [head]
    parts += [_parent(f"release_{i}", "a release that this one is made of", path) for i, path in enumerate(releases)]
    if previous is not None:
        parts.append(_parent("previous", "the version before", previous))
    parts += [_log(log) for log in logs]
    parts += [f"\n{_made(config, command, logs, len(releases), previous)}\n", _TAIL]
    return {**files, "rebuild.sh": "".join(parts).encode()}


def _was_collected(log: LogFacts) -> bool:
    return log.config.keys() >= _COLLECTED


def _parent(variable: str, what: str, path: Path) -> str:
    ours, digest = read_info(path)["gym_open"], payload_digest(artefacts.manifest(path))
    place = f"{ours['name']}/{ours['version']}"
    return _PARENT.format(variable=variable, shell=variable.upper(), what=what, place=place, digest=digest)


def _log(log: LogFacts) -> str:
    number = f"{log.number:03d}"
    form = _COLLECT if _was_collected(log) else _GIVEN
    return form.format(number=number, streams=log.streams, steps=log.steps)


def _made(config: Header, command: str, logs: Sequence[LogFacts], releases: int, previous: Path | None) -> str:
    """The command that makes the release."""
    if command in {"build", "append"}:
        given = " ".join(f'"$log_{log.number:03d}"' for log in logs)
        append = " --append" * (command == "append")
        before = ' --previous "$previous"' if previous else ""
        return f'gym-open dataset build --config "$here/{command}.toml"{append} --logs {given}{before} --out "$made"'
    given = " ".join(f'"$release_{i}"' for i in range(releases))
    beside = _BESIDE.format(version=read_info(previous)["gym_open"]["version"]) if previous else ""
    return f'{beside}gym-open dataset {command} {given} {" ".join(_options(config))} --out "$made"'


def _options(config: Header) -> Iterator[str]:
    """Options for the sub-commands without a configuration file, for all values that are not empty."""
    for key, value in to_dict(config).items():
        if value not in ("", [], ()):
            values = value if isinstance(value, list | tuple) else [value]
            yield " ".join([f"--{key.replace('_', '-')}", *(shlex.quote(str(item)) for item in values)])
