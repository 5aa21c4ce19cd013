"""A stand-in of a Hugging Face hub on 127.0.0.1: as much of its HTTP interface as data sets need, kept in memory.

The real client talks to it. What it answers follows the hub's own: LFS for parquet, pictures and videos, redirects to
another address for those, error codes in `X-Error-Code`, commits as lines of JSON.
"""

import base64
import hashlib
import json
import re
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from typing import Any, ClassVar
from urllib.parse import unquote, urlsplit

TOKEN = "hf_stand_in_token"
LARGE = (".parquet", ".png", ".mp4")
Files = dict[str, bytes]


def git_oid(data: bytes) -> str:
    return hashlib.sha1(b"blob %d\0" % len(data) + data).hexdigest()


def sha256(data: bytes) -> str:
    return hashlib.sha256(data).hexdigest()


@dataclass
class Repo:
    """A data set: commits by number, and the branch and tags that point to them."""

    commits: dict[str, Files] = field(default_factory=dict)
    heads: dict[str, str] = field(default_factory=dict)
    tags: dict[str, str] = field(default_factory=dict)

    def commit(self, files: Files) -> str:
        oid = hashlib.sha1(repr((len(self.commits), sorted(files.items()))).encode()).hexdigest()
        self.commits[oid] = files
        self.heads["main"] = oid
        return oid

    def find(self, revision: str) -> str:
        oid = self.heads.get(revision) or self.tags.get(revision) or revision
        if oid not in self.commits:
            raise AnswerError(404, f"Invalid rev id: {revision}", "RevisionNotFound")
        return oid


@dataclass
class Hub:
    """What the hub holds, and how it misbehaves."""

    endpoint: str = ""
    elsewhere: str = ""
    """Address of the large files: the client follows a redirect to the hub itself before it reads the headers."""
    repos: dict[str, Repo] = field(default_factory=dict)
    objects: dict[str, bytes] = field(default_factory=dict)
    asked: list[str] = field(default_factory=list)
    """Every request, as METHOD and path."""
    garble: Callable[[str, bytes], bytes] = lambda _, data: data
    """What is sent instead of a file's bytes."""
    ignored: frozenset[str] = frozenset()
    """Names that a .gitignore of the repository would hold."""
    broken: Callable[[str, str], bool] = lambda *_: False
    """Of which requests (method, path) the connection is cut."""

    def repo(self, name: str) -> Repo:
        if name not in self.repos:
            raise AnswerError(404, "Repository not found", "RepoNotFound")
        return self.repos[name]


class AnswerError(Exception):
    """An answer of the hub that is not 200."""

    def __init__(self, status: int, message: str, code: str = "", **told: str) -> None:
        super().__init__(message)
        self.status, self.message, self.code, self.told = status, message, code, told


REPO = r"(?P<repo>[^/]+/[^/]+)"
ROUTES: list[tuple[str, str, str]] = [
    ("POST", r"/api/repos/create", "create"),
    ("POST", r"/api/validate-yaml", "validate"),
    ("GET", rf"/api/datasets/{REPO}/refs", "refs"),
    ("GET", rf"/api/datasets/{REPO}/revision/(?P<revision>[^/]+)", "info"),
    ("GET", rf"/api/datasets/{REPO}/tree/(?P<revision>[^/]+)", "tree"),
    ("POST", rf"/api/datasets/{REPO}/preupload/(?P<revision>[^/]+)", "preupload"),
    ("POST", rf"/datasets/{REPO}\.git/info/lfs/objects/batch", "batch"),
    ("PUT", r"/lfs/(?P<oid>[0-9a-f]{64})", "store"),
    ("POST", r"/lfs/verify", "stored"),
    ("POST", rf"/api/datasets/{REPO}/commit/(?P<revision>[^/]+)", "commit"),
    ("POST", rf"/api/datasets/{REPO}/tag/(?P<revision>[^/]+)", "tag"),
    ("DELETE", rf"/api/datasets/{REPO}/tag/(?P<tag>[^/]+)", "untag"),
    ("GET", rf"/datasets/{REPO}/resolve/(?P<revision>[^/]+)/(?P<path>.+)", "resolve"),
    ("GET", r"/cdn/(?P<oid>[0-9a-f]{64})/(?P<path>.+)", "cdn"),
]


class Handler(BaseHTTPRequestHandler):
    hub: ClassVar[Hub]

    def log_message(self, *_: object) -> None:  # type: ignore[override]
        pass

    def _serve(self) -> None:
        path = unquote(urlsplit(self.path).path)
        self.hub.asked.append(f"{self.command} {path}")
        self.body = self.rfile.read(int(self.headers.get("Content-Length") or 0))
        if self.hub.broken(self.command, path):
            return self.connection.close()
        method = "GET" if self.command == "HEAD" else self.command
        found = ((name, re.fullmatch(pattern, path)) for verb, pattern, name in ROUTES if verb == method)
        try:
            name, match = next(((name, match) for name, match in found if match), (None, None))
            if name is None or match is None:
                raise AnswerError(404, f"no such route: {method} {path}")
            if method != "GET" and name != "store" and self.headers.get("Authorization") != f"Bearer {TOKEN}":
                raise AnswerError(401, "Invalid credentials in Authorization header")
            answer = getattr(self, f"on_{name}")(**match.groupdict())
        except AnswerError as error:
            headers = {"X-Error-Code": error.code, "X-Error-Message": error.message}
            return self._send(error.status, json.dumps({"error": error.message, **error.told}).encode(), headers)
        if answer is not None:
            self._send(200, json.dumps(answer).encode())
        return None

    do_GET = do_HEAD = do_POST = do_PUT = do_DELETE = _serve  # noqa: N815

    def _send(self, status: int, data: bytes, headers: dict[str, str] | None = None) -> None:
        self.send_response(status)
        headers = {"Content-Type": "application/json", "Content-Length": str(len(data))} | (headers or {})
        for name, value in headers.items():
            self.send_header(name, value)
        self.end_headers()
        if self.command != "HEAD":
            self.wfile.write(data)

    @property
    def _json(self) -> Any:
        return json.loads(self.body)

    def on_create(self) -> Any:
        name = f"{self._json['organization']}/{self._json['name']}"
        assert self._json["type"] == "dataset"
        if name in self.hub.repos:
            raise AnswerError(409, "You already created this dataset repo", url=f"{self.hub.endpoint}/datasets/{name}")
        self.hub.repos[name] = Repo()
        self.hub.repos[name].commit({".gitattributes": b"*.parquet filter=lfs\n"})
        return {"url": f"{self.hub.endpoint}/datasets/{name}", "name": name}

    def on_validate(self) -> Any:
        return {"errors": [], "warnings": []}

    def on_refs(self, repo: str) -> Any:
        found = self.hub.repo(repo)
        return {
            "branches": [{"name": k, "ref": f"refs/heads/{k}", "targetCommit": v} for k, v in found.heads.items()],
            "converts": [],
            "tags": [{"name": k, "ref": f"refs/tags/{k}", "targetCommit": v} for k, v in found.tags.items()],
        }

    def on_info(self, repo: str, revision: str) -> Any:
        oid = self.hub.repo(repo).find(revision)
        siblings = [{"rfilename": name} for name in self.hub.repos[repo].commits[oid]]
        return {"id": repo, "sha": oid, "xetEnabled": False, "siblings": siblings}

    def on_tree(self, repo: str, revision: str) -> Any:
        found = self.hub.repo(repo)
        return [self._entry(*item) for item in sorted(found.commits[found.find(revision)].items())]

    @staticmethod
    def _entry(path: str, data: bytes) -> Any:
        entry = {"type": "file", "path": path, "size": len(data), "oid": git_oid(data)}
        if path.endswith(LARGE):
            entry["lfs"] = {"oid": sha256(data), "size": len(data), "pointerSize": 130}
        return entry

    def on_preupload(self, repo: str, revision: str) -> Any:
        found = self.hub.repo(repo)
        there = found.commits[found.find(revision)]
        files = []
        for item in self._json["files"]:
            path, large = item["path"], item["path"].endswith(LARGE)
            oid = (sha256 if large else git_oid)(there[path]) if path in there else None
            files.append(
                {
                    "path": path,
                    "uploadMode": "lfs" if large else "regular",
                    "shouldIgnore": path in self.hub.ignored,
                    "oid": oid,
                }
            )
        return {"files": files}

    def on_batch(self, repo: str) -> Any:
        self.hub.repo(repo)
        objects = []
        for item in self._json["objects"]:
            if item["oid"] not in self.hub.objects:
                upload = {"href": f"{self.hub.endpoint}/lfs/{item['oid']}"}
                item["actions"] = {"upload": upload, "verify": {"href": f"{self.hub.endpoint}/lfs/verify"}}
            objects.append(item)
        return {"transfer": "basic", "objects": objects}

    def on_store(self, oid: str) -> Any:
        self.hub.objects[oid] = self.body
        return {}

    def on_stored(self) -> Any:
        if len(self.hub.objects.get(self._json["oid"], b"")) != self._json["size"]:
            raise AnswerError(422, "not stored whole")
        return {}

    def on_commit(self, repo: str, revision: str) -> Any:
        found = self.hub.repo(repo)
        files = dict(found.commits[found.find(revision)])
        for line in self.body.splitlines():
            item = json.loads(line)
            value = item["value"]
            match item["key"]:
                case "header":
                    if value.get("parentCommit", found.heads["main"]) != found.heads["main"]:
                        raise AnswerError(412, "A commit has happened since")
                case "file":
                    files[value["path"]] = base64.b64decode(value["content"])
                case "lfsFile":
                    files[value["path"]] = self.hub.objects[value["oid"]]
                case "deletedFile":
                    del files[value["path"]]
        oid = found.commit(files)
        return {"commitUrl": f"{self.hub.endpoint}/datasets/{repo}/commit/{oid}", "commitOid": oid}

    def on_tag(self, repo: str, revision: str) -> Any:
        found = self.hub.repo(repo)
        if self._json["tag"] in found.tags:
            raise AnswerError(409, "Tag reference exists already.")
        found.tags[self._json["tag"]] = found.find(revision)
        return {}

    def on_untag(self, repo: str, tag: str) -> Any:
        if self.hub.repo(repo).tags.pop(tag, None) is None:
            raise AnswerError(404, "no such tag", "RevisionNotFound")
        return {}

    def on_resolve(self, repo: str, revision: str, path: str) -> None:
        found = self.hub.repo(repo)
        oid = found.find(revision)
        if path not in found.commits[oid]:
            raise AnswerError(404, "Entry not found", "EntryNotFound")
        data = found.commits[oid][path]
        headers = {"X-Repo-Commit": oid, "ETag": f'"{git_oid(data)}"'}
        if not path.endswith(LARGE):
            return self._file(path, data, headers)
        digest = sha256(data)
        self.hub.objects.setdefault(digest, data)
        headers |= {"X-Linked-Etag": f'"{digest}"', "X-Linked-Size": str(len(data))}
        return self._send(302, b"", headers | {"Location": f"{self.hub.elsewhere}/cdn/{digest}/{path}"})

    def on_cdn(self, oid: str, path: str) -> None:
        self._file(path, self.hub.objects[oid], {"ETag": f'"{oid}"'})

    def _file(self, path: str, data: bytes, headers: dict[str, str]) -> None:
        data = self.hub.garble(path, data)
        if match := re.fullmatch(r"bytes=(\d+)-", self.headers.get("Range") or ""):
            first = int(match[1])
            content = {"Content-Range": f"bytes {first}-{len(data) - 1}/{len(data)}"}
            return self._send(206, data[first:], headers | content)
        return self._send(200, data, headers)


@contextmanager
def serve() -> Iterator[Hub]:
    """A hub without a repository, on a free port."""
    hub = Hub()
    handler = type("Handler", (Handler,), {"hub": hub})
    with ThreadingHTTPServer(("127.0.0.1", 0), handler) as server:
        hub.endpoint = f"http://127.0.0.1:{server.server_address[1]}"
        hub.elsewhere = f"http://localhost:{server.server_address[1]}"
        thread = threading.Thread(target=server.serve_forever, kwargs={"poll_interval": 0.01})
        thread.start()
        try:
            yield hub
        finally:
            server.shutdown()
            thread.join()
