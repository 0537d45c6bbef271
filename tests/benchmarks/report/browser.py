"""A headless Chromium, driven through chromedriver's HTTP interface (W3C WebDriver) with the standard library."""

from __future__ import annotations

import base64
import json
import shutil
import socket
import subprocess
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any
from urllib.error import URLError
from urllib.request import Request, urlopen

CHROMIUM = next(
    (found for name in ("chromium", "chromium-browser", "google-chrome") if (found := shutil.which(name))), ""
)
DRIVER = shutil.which("chromedriver") or ""
START_S = 60.0
FLAGS = (
    "--headless=new", "--no-sandbox", "--disable-dev-shm-usage", "--hide-scrollbars", "--no-first-run",
    "--use-angle=swiftshader", "--enable-unsafe-swiftshader", "--host-resolver-rules=MAP * ~NOTFOUND",
)  # fmt: skip


class Browser:
    """One session. No name resolves in it: whatever a page would fetch from elsewhere fails, and is an error."""

    def __init__(self, port: int, wide: int, tall: int) -> None:
        self._root = f"http://127.0.0.1:{port}/session"
        options = {"binary": CHROMIUM, "args": [*FLAGS, f"--window-size={wide},{tall}"]}
        asked = {"browserName": "chrome", "goog:chromeOptions": options, "goog:loggingPrefs": {"browser": "ALL"}}
        self._root += "/" + self._call("", {"capabilities": {"alwaysMatch": asked}})["sessionId"]
        self.resize(wide, tall)

    def resize(self, wide: int, tall: int) -> None:
        """Change the size of the page in pixels. A headless window has a least width, an emulated device has none."""
        size = {"width": wide, "height": tall, "deviceScaleFactor": 1, "mobile": wide < 600}
        self._call("/goog/cdp/execute", {"cmd": "Emulation.setDeviceMetricsOverride", "params": size})

    def open(self, path: Path) -> None:
        """Load a file."""
        self._call("/url", {"url": path.absolute().as_uri()})

    def run(self, script: str, *arguments: Any) -> Any:
        """Return what a script returns."""
        return self._call("/execute/sync", {"script": script, "args": list(arguments)})

    def wait(self, script: str, limit_s: float = 60.0) -> Any:
        """Return what a script returns once that is true."""
        end = time.monotonic() + limit_s
        while not (found := self.run(script)):
            if time.monotonic() > end:
                raise TimeoutError(f"never true: {script}; said: {self.messages()}")
            time.sleep(0.1)
        return found

    def messages(self) -> list[str]:
        """Return the warnings and errors on the console since the last call."""
        entries = self._call("/se/log", {"type": "browser"})
        return [entry["message"] for entry in entries if entry["level"] in ("WARNING", "SEVERE")]

    def picture(self, path: Path) -> None:
        """Write what the window shows as PNG."""
        path.write_bytes(base64.b64decode(self._call("/screenshot")))

    def close(self) -> None:
        """End the session."""
        self._call("", method="DELETE")

    def _call(self, path: str, body: Any = None, method: str | None = None) -> Any:
        content = None if body is None else json.dumps(body).encode()
        method = method or ("GET" if body is None else "POST")
        request = Request(self._root + path, content, {"Content-Type": "application/json"}, method=method)
        with urlopen(request, timeout=120) as answer:
            return json.load(answer)["value"]


@contextmanager
def browser(wide: int = 1280, tall: int = 900) -> Iterator[Browser]:
    """Start a browser for as long as the context lasts."""
    with socket.socket() as free:
        free.bind(("127.0.0.1", 0))
        port = free.getsockname()[1]
    quiet = subprocess.DEVNULL
    driver = subprocess.Popen([DRIVER, f"--port={port}"], stdout=quiet, stderr=quiet)
    try:
        _wait_for(f"http://127.0.0.1:{port}/status")
        one = Browser(port, wide, tall)
        try:
            yield one
        finally:
            one.close()
    finally:
        driver.terminate()
        driver.wait()


def _wait_for(address: str) -> None:
    end = time.monotonic() + START_S
    while True:
        try:
            with urlopen(address, timeout=5):
                return
        except (URLError, ConnectionError):
            if time.monotonic() > end:
                raise
            time.sleep(0.05)
