"""A Hub on the loopback: the part of the protocol that pushing and pulling an agent speaks."""

from __future__ import annotations

import base64
import contextlib
import functools
import hashlib
import json
import ssl
import threading
from dataclasses import dataclass, field
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from unittest import mock
from urllib.parse import parse_qs, unquote, urlsplit

WRITER, READER = "hf_writer", "hf_reader"  # tokens
CERTIFICATES = functools.cache(ssl.create_default_context)  # each client would read all of them


@dataclass
class Repository:
    private: bool
    branches: dict[str, str] = field(default_factory=dict)  # name -> commit
    commits: dict[str, dict[str, bytes]] = field(default_factory=dict)  # commit -> path -> content

    def commit(self, branch, files):
        text = json.dumps({path: hashlib.sha256(x).hexdigest() for path, x in files.items()})
        sha = hashlib.sha1(f"{branch}{len(self.commits)}{text}".encode()).hexdigest()
        self.branches[branch], self.commits[sha] = sha, dict(files)
        return sha

    def at(self, revision):
        """The commit that a branch or a commit is; None where there is none."""
        found = self.branches.get(revision, revision)
        return found if found in self.commits else None


@dataclass
class Hub:
    """What the server holds, and what goes wrong with it."""

    repositories: dict[str, Repository] = field(default_factory=dict)
    uploads: dict[str, bytes] = field(default_factory=dict)  # of large files, by SHA-256
    requests: list[str] = field(default_factory=list)
    cut: dict[str, list[int]] = field(default_factory=dict)  # path -> bytes of each next answer
    changed: dict[str, bytes] = field(default_factory=dict)  # path -> what is sent in its place
    said: list[dict[str, str]] = field(default_factory=list)  # headers of each next file, of HEAD
    sent: dict[str, str] = field(default_factory=dict)  # headers of what is sent of files
    missing: dict[str, str] = field(default_factory=dict)  # headers where there is no such file
    drips: tuple[int, float] | None = None  # bytes of files at once, and seconds after them
    dripping: str = "/resolve/"  # part of the paths whose answers drip
    no_room: bool = False
    address: str = ""


class Handler(BaseHTTPRequestHandler):
    protocol_version = "HTTP/1.1"
    disable_nagle_algorithm = True  # which holds what follows the headers for 40 ms
    hub: Hub

    def log_message(self, *_):
        pass

    def answer(self, status, data=b"", **headers):
        body = data if isinstance(data, bytes) else json.dumps(data).encode()
        self.send_response(status)
        for name, value in ({"Content-Length": str(len(body))} | headers).items():
            self.send_header(name.replace("_", "-"), value)
        self.end_headers()
        if self.command in ("GET", "POST") and self.hub.drips and self.hub.dripping in self.path:
            many, seconds = self.hub.drips
            with contextlib.suppress(OSError):  # nobody waits for the rest
                for begin in range(0, len(body), many):
                    self.wfile.write(body[begin : begin + many])
                    threading.Event().wait(seconds)
        elif self.command != "HEAD":
            self.wfile.write(body)

    def refuse(self, status, code, message):
        self.answer(status, {"error": message}, X_Error_Code=code, X_Error_Message=message)

    def body(self):
        return self.rfile.read(int(self.headers.get("Content-Length", 0)))

    def token(self):
        return (self.headers.get("Authorization") or "").removeprefix("Bearer ")

    def repository(self, name, writes=False):
        """The repository, if whoever asks may do that; else it is refused, and None."""
        found = self.hub.repositories.get(name)
        if found is None or (found.private and self.token() not in (WRITER, READER)):
            self.refuse(401, "RepoNotFound", "Repository not found")
            return None
        if writes and self.token() != WRITER:
            self.refuse(403, "", "You have no write permission")
            return None
        return found

    def parts(self):
        url = urlsplit(self.path)
        self.hub.requests.append(f"{self.command} {url.path}")
        return [unquote(part) for part in url.path.strip("/").split("/")], parse_qs(url.query)

    def do_POST(self):
        body, (parts, _) = self.body(), self.parts()
        match parts:
            case ["api", "repos", "create"]:
                self.create(json.loads(body))
            case ["api", "validate-yaml"]:
                self.answer(200, {"errors": [], "warnings": []})
            case ["api", "models", user, name, "branch", branch]:
                if repository := self.repository(f"{user}/{name}", writes=True):
                    head = repository.branches.get("main", "")
                    repository.branches.setdefault(branch, head)
                    self.answer(200, {})
            case ["api", "models", user, name, "preupload", _]:
                if self.repository(f"{user}/{name}", writes=True):
                    self.answer(
                        200, {"files": [self.mode(one) for one in json.loads(body)["files"]]}
                    )
            case ["api", "models", user, name, "commit", branch]:
                if repository := self.repository(f"{user}/{name}", writes=True):
                    self.commit(repository, f"{user}/{name}", branch, body)
            case [user, name, "info", "lfs", "objects", "batch"]:
                if self.repository(f"{user}/{name.removesuffix('.git')}", writes=True):
                    self.answer(
                        200,
                        {
                            "transfer": "basic",
                            "objects": [
                                {
                                    "oid": one["oid"],
                                    "size": one["size"],
                                    "actions": {
                                        "upload": {"href": f"{self.hub.address}/put/{one['oid']}"}
                                    },
                                }
                                for one in json.loads(body)["objects"]
                            ],
                        },
                    )
            case _:
                self.answer(404)

    def create(self, wanted):
        if self.token() != WRITER:
            return self.refuse(403, "", "You don't have the rights to create a model")
        user = wanted.get("organization") or "ada"
        name = f"{user}/{wanted['name']}"
        if name in self.hub.repositories:
            return self.answer(409, {"url": f"{self.hub.address}/{name}"})
        made = self.hub.repositories[name] = Repository(
            "private" in (wanted.get("visibility"), wanted.get("private") and "private")
        )
        made.commit("main", {})
        return self.answer(200, {"url": f"{self.hub.address}/{name}"})

    @staticmethod
    def mode(file):
        large = file["path"].endswith((".safetensors", ".gif", ".png"))
        return {
            "path": file["path"],
            "uploadMode": "lfs" if large else "regular",
            "shouldIgnore": False,
        }

    def commit(self, repository, name, branch, body):
        files = dict(repository.commits.get(repository.branches.get(branch, ""), {}))
        for line in map(json.loads, body.splitlines()):
            value = line["value"]
            if line["key"] == "file":
                files[value["path"]] = base64.b64decode(value["content"])
            elif line["key"] == "lfsFile":
                files[value["path"]] = self.hub.uploads[value["oid"]]
            elif line["key"] == "deletedFile":
                files.pop(value["path"])
        sha = repository.commit(branch, files)
        self.answer(200, {"commitUrl": f"{self.hub.address}/{name}/commit/{sha}", "commitOid": sha})

    def do_PUT(self):
        body, (parts, _) = self.body(), self.parts()
        if self.hub.no_room:
            return self.answer(507, {"error": "Insufficient Storage"})
        self.hub.uploads[parts[-1]] = body
        return self.answer(200)

    def do_GET(self):
        parts, _ = self.parts()
        match parts:
            case ["api", "models", user, name, *rest]:
                self.info(f"{user}/{name}", rest)
            case [user, name, "resolve", revision, *path]:
                self.file(f"{user}/{name}", revision, "/".join(path))
            case _:
                self.answer(404)

    do_HEAD = do_GET

    def info(self, name, rest):
        if not (repository := self.repository(name)):
            return None
        sha = repository.at(rest[1] if len(rest) > 1 else "main")
        if sha is None:
            return self.refuse(404, "RevisionNotFound", "Invalid rev id")
        files = repository.commits[sha]
        if rest[:1] == ["tree"]:
            return self.answer(
                200,
                [
                    {
                        "type": "file",
                        "path": path,
                        "size": len(x),
                        "oid": hashlib.sha1(x).hexdigest(),
                    }
                    for path, x in files.items()
                ],
            )
        return self.answer(
            200,
            {
                "id": name,
                "sha": sha,
                "siblings": [{"rfilename": path} for path in files],
                "private": repository.private,
                "tags": [],
            },
        )

    def file(self, name, revision, path):
        if not (repository := self.repository(name)):
            return None
        sha = repository.at(revision)
        if sha is None:
            return self.refuse(404, "RevisionNotFound", "Invalid rev id")
        if path not in repository.commits[sha]:
            return self.answer(404, X_Error_Code="EntryNotFound", **self.hub.missing)
        whole = repository.commits[sha][path]
        etag = f'"{hashlib.sha256(whole).hexdigest()}"'
        data = self.hub.changed.get(path, whole)
        begin = int((self.headers.get("Range") or "bytes=0-")[6:].split("-")[0])
        told = {"ETag": etag, "X-Repo-Commit": sha, "Accept-Ranges": "bytes"}
        if self.command == "HEAD" and self.hub.said:
            told |= self.hub.said.pop(0)
        elif self.command == "GET":
            told |= self.hub.sent
        if begin:
            told["Content-Range"] = f"bytes {begin}-{len(data) - 1}/{len(data)}"
        cuts = self.hub.cut.get(path)
        if self.command == "HEAD" or not cuts:
            moved = 302 if "Location" in told else 206 if begin else 200
            return self.answer(moved, data[begin:], **told)
        self.answer(
            206 if begin else 200,
            data[begin : begin + cuts.pop(0)],
            **told | {"Content-Length": str(len(data) - begin)},
        )
        self.close_connection = True
        return None


@contextlib.contextmanager
def running():
    """A server of a new hub, on the loopback."""
    hub = Hub()
    server = ThreadingHTTPServer(("127.0.0.1", 0), type("Ours", (Handler,), {"hub": hub}))
    server.daemon_threads = True
    hub.address = f"http://127.0.0.1:{server.server_port}"
    thread = threading.Thread(target=server.serve_forever, args=(0.05,), daemon=True)
    thread.start()
    try:
        with mock.patch("ssl.create_default_context", CERTIFICATES):
            yield hub
    finally:
        server.shutdown()
        server.server_close()
        thread.join()
