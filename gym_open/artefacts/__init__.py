"""Artefacts: folders that are whole or absent, and that record their bytes and their origin.

An artefact is a folder of payload files and three records:

    config.json     the whole configuration that made it, defaults included
    lineage.json    kind, key of its inputs, parents (digest and lineage of each), code and package versions, facts
    manifest.json   SHA-256 and size of every other file

The *digest* of an artefact is the SHA-256 of manifest.json. The records hold no path, host, user name or time of day,
so the same inputs give the same digest in any folder. An artefact is written in a hidden sibling folder, which is
renamed when it is whole.

A release may also have a signature.json. It signs the manifest, so the manifest cannot list it.
"""

from gym_open.artefacts.building import RECORDED_PACKAGES, SCRATCH, Outcome, build, is_up_to_date, remake
from gym_open.artefacts.checks import MAX_SIGNATURE_BYTES, Problem, problems, verify
from gym_open.artefacts.code import code_version
from gym_open.artefacts.records import (
    CONFIG,
    LINEAGE,
    MANIFEST,
    SIGNATURE,
    Entry,
    Lineage,
    Parent,
    canonical_json,
    config_of,
    digest,
    lineage,
    manifest,
)

__all__ = [
    "CONFIG",
    "LINEAGE",
    "MANIFEST",
    "MAX_SIGNATURE_BYTES",
    "RECORDED_PACKAGES",
    "SCRATCH",
    "SIGNATURE",
    "Entry",
    "Lineage",
    "Outcome",
    "Parent",
    "Problem",
    "build",
    "canonical_json",
    "code_version",
    "config_of",
    "digest",
    "is_up_to_date",
    "lineage",
    "manifest",
    "problems",
    "remake",
    "verify",
]
