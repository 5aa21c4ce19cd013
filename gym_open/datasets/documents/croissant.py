"""croissant.json: description of the release and of its records, in the format MLCommons Croissant 1.1.

<https://docs.mlcommons.org/croissant/docs/croissant-spec-1.1.html>
"""

from collections.abc import Iterable, Iterator
from typing import Any

import pyarrow as pa

from gym_open.datasets.compare import payload
from gym_open.datasets.config import Header
from gym_open.datasets.documents.licences import URLS
from gym_open.formats.releases import IMAGE, Release
from gym_open.formats.releases.schemas import STATS, episodes_schema, table_schema

CONFORMS_TO = "http://mlcommons.org/croissant/1.1"
_PARQUET, _MP4 = "application/x-parquet", "video/mp4"
_TYPES = {
    "int64": "cr:Int64", "float32": "cr:Float32", "double": "cr:Float64", "bool": "sc:Boolean", "string": "sc:Text",
}  # fmt: skip
_SETS = {"frames": "data/*/*.parquet", "episodes": "meta/episodes/*/*.parquet", "worlds": "meta/worlds/*.parquet"}
"""Patterns of the files of each record set."""
_JSON_TERMS = ("data", "examples")
_TERMS = (
    "arrayShape", "citeAs", "column", "containedIn", "equivalentProperty", "extract", "field", "fileObject",
    "fileProperty", "fileSet", "format", "includes", "isArray", "isLiveDataset", "jsonPath", "key", "md5",
    "parentField", "path", "recordSet", "references", "regex", "repeated", "replace", "samplingRate", "separator",
    "source", "subField", "transform",
)  # fmt: skip


def _context() -> dict[str, Any]:
    """The JSON-LD context of the specification."""
    return {
        "@language": "en",
        "@vocab": "https://schema.org/",
        "sc": "https://schema.org/",
        "cr": "http://mlcommons.org/croissant/",
        "rai": "http://mlcommons.org/croissant/RAI/",
        "dct": "http://purl.org/dc/terms/",
        "conformsTo": "dct:conformsTo",
        "dataType": {"@id": "cr:dataType", "@type": "@vocab"},
        **{name: {"@id": f"cr:{name}", "@type": "@json"} for name in _JSON_TERMS},
        **{name: f"cr:{name}" for name in _TERMS},
    }


def croissant(header: Header, release: Release, description: str) -> dict[str, Any]:
    """The document as plain data. It has all recommended fields, except the date if the release has none."""
    return {
        "@context": _context(),
        "@type": "sc:Dataset",
        "conformsTo": CONFORMS_TO,
        "name": header.name.replace("/", "-"),
        "description": description,
        "license": URLS[header.license],
        "url": f"urn:gym-open:release:{header.name}:{header.version}",
        "version": header.version,
        "citeAs": _citation(header),
        "creator": {"@type": "sc:Organization", "name": f"the authors of {header.name}"},
        "keywords": ["exploration", "reinforcement learning", "robotics", "world models", "MuJoCo"],
        **({"datePublished": header.published} if header.published else {}),
        "distribution": [*_file_objects(release), *_file_sets(release)],
        "recordSet": [_frames(release), *_tables(release)],
    }


def _citation(header: Header) -> str:
    key = header.name.replace("/", "-")
    year = f", year={{{header.published[:4]}}}" if header.published else ""
    who = f"the authors of {header.name}"
    return f"@misc{{{key}, author={{{{{who}}}}}, title={{{header.name} {header.version}}}{year}}}"


def _file_objects(release: Release) -> Iterator[dict[str, Any]]:
    for path, entry in payload.entries(release.root).items():
        if path.endswith((".parquet", ".mp4")):
            yield {
                "@type": "cr:FileObject",
                "@id": path,
                "name": path,
                "contentUrl": path,
                "contentSize": f"{entry.bytes} B",
                "encodingFormat": _PARQUET if path.endswith(".parquet") else _MP4,
                "sha256": entry.sha256,
            }


def _file_sets(release: Release) -> Iterator[dict[str, Any]]:
    sets = {f"{name}-files": (_PARQUET, files) for name, files in _SETS.items()}
    if release.info["features"][IMAGE]["dtype"] == "video":
        sets["video-files"] = (_MP4, f"videos/{IMAGE}/*/*.mp4")
    for name, (form, files) in sets.items():
        yield {"@type": "cr:FileSet", "@id": name, "name": name, "encodingFormat": form, "includes": files}


def _record_set(name: str, key: Iterable[str], fields: list[dict[str, Any]], description: str) -> dict[str, Any]:
    return {
        "@type": "cr:RecordSet",
        "@id": name,
        "name": name,
        "description": description,
        "key": [{"@id": f"{name}/{column}"} for column in key],
        "field": fields,
    }


def _field(records: str, column: str, kind: str, length: int = 1, *, transform: str = "") -> dict[str, Any]:
    """A field for a column. `length` is that of a vector; `transform` selects a part of a structure."""
    source = {"fileSet": {"@id": f"{records}-files"}, "extract": {"column": column}}
    if transform:
        source["transform"] = {"jsonPath": transform}
    vector = {"isArray": True, "arrayShape": str(length)} if length > 1 else {}
    return {
        "@type": "cr:Field", "@id": f"{records}/{column}", "name": column, "dataType": kind, **vector, "source": source,
    }  # fmt: skip


def _frames(release: Release) -> dict[str, Any]:
    fields = []
    for name, feature in release.info["features"].items():
        if feature["dtype"] == "image":
            fields.append(_field("frames", name, "sc:ImageObject", transform="bytes"))
        elif feature["dtype"] != "video":  # the images of a video are in separate files
            fields.append(_field("frames", name, _TYPES[feature["dtype"]], feature["shape"][0]))
    return _record_set("frames", ["index"], fields, "One record per frame. The last frame of an episode has no action.")


def _tables(release: Release) -> Iterator[dict[str, Any]]:
    episodes = episodes_schema(release.info["features"])
    for name, schema, key, about in (
        ("episodes", episodes, ["episode_index"], "One record per episode: uninterrupted steps in one world."),
        ("worlds", table_schema("worlds", {}), ["stream", "world"], "One record per world in the pool of a stream."),
    ):
        columns = [
            column for column in schema if not column.name.startswith(STATS) and not pa.types.is_list(column.type)
        ]
        fields = [_field(name, column.name, _TYPES[str(column.type)]) for column in columns]
        yield _record_set(name, key, fields, about)
