"""A headless Chromium under its DevTools protocol, over pipes: no driver, no network."""

import json
import os
import shutil
import subprocess
import tempfile
import time
from base64 import b64decode
from contextlib import contextmanager

NAMES = ("chromium", "chromium-browser", "google-chrome", "google-chrome-stable", "chrome")
WAIT_S = 60.0


def installed():
    """Path of a browser, None where there is none."""
    given = os.environ.get("CHROMIUM")
    return given or next(filter(None, map(shutil.which, NAMES)), None)


class Page:
    """One open page, and what it complained about."""

    def __init__(self, into, out):
        self._into, self._out, self._session, self._last = into, out, None, 0
        self.complaints = []
        target = self._call("Target.createTarget", url="about:blank")["targetId"]
        attached = self._call("Target.attachToTarget", targetId=target, flatten=True)
        self._session = attached["sessionId"]
        for domain in ("Page", "Runtime", "Log", "Network"):
            self._call(f"{domain}.enable")
        self.requests = []

    def open(self, path):
        """Load a file, until its scripts have run."""
        self._call("Page.navigate", url=path.resolve().as_uri())
        end = time.monotonic() + WAIT_S
        while self.ask("document.readyState") != "complete" and time.monotonic() < end:
            time.sleep(0.05)

    def ask(self, expression):
        """Value of an expression of the page."""
        answer = self._call("Runtime.evaluate", expression=expression, returnByValue=True)
        if "exceptionDetails" in answer:
            self.complaints.append(answer["exceptionDetails"])
        return answer["result"].get("value")

    def picture(self, path, height=900, width=1280):
        """Save what is seen as PNG."""
        size = {"width": width, "height": height, "deviceScaleFactor": 1, "mobile": False}
        self._call("Emulation.setDeviceMetricsOverride", **size)
        path.write_bytes(b64decode(self._call("Page.captureScreenshot", format="png")["data"]))

    def _call(self, method, **parameters):
        self._last += 1
        message = {"id": self._last, "method": method, "params": parameters}
        if self._session:
            message["sessionId"] = self._session
        os.write(self._into, json.dumps(message).encode() + b"\0")
        while True:
            told = json.loads(self._read())
            if told.get("id") == self._last:
                assert "error" not in told, told
                return told["result"]
            self._event(told)

    def _event(self, told):
        name, content = told.get("method"), told.get("params", {})
        if name == "Runtime.exceptionThrown" or (
            name == "Runtime.consoleAPICalled" and content["type"] in ("error", "assert")
        ):
            self.complaints.append(content)
        elif name == "Log.entryAdded" and content["entry"]["level"] == "error":
            self.complaints.append(content["entry"])
        elif name == "Network.requestWillBeSent":
            self.requests.append(content["request"]["url"])

    def _read(self):
        content = b""
        while not content.endswith(b"\0"):
            byte = self._out.read(1)
            assert byte, "the browser has ended"
            content += byte
        return content[:-1]


@contextmanager
def page():
    """A page of a browser that ends with the block."""
    to_read, into = os.pipe()
    out, to_write = os.pipe()

    def hand_over():
        os.dup2(to_read, 13)
        os.dup2(to_write, 14)
        os.dup2(13, 3)
        os.dup2(14, 4)

    with tempfile.TemporaryDirectory(ignore_cleanup_errors=True) as profile:
        command = [
            installed(), "--headless=new", "--no-sandbox", "--disable-gpu",
            "--disable-dev-shm-usage", "--no-first-run", "--disable-background-networking",
            "--remote-debugging-pipe", f"--user-data-dir={profile}",
        ]  # fmt: skip
        process = subprocess.Popen(
            command, preexec_fn=hand_over, close_fds=False, stderr=subprocess.DEVNULL
        )
        os.close(to_read)
        os.close(to_write)
        try:
            with os.fdopen(out, "rb") as stream:
                yield Page(into, stream)
        finally:
            os.close(into)
            process.terminate()
            process.wait(WAIT_S)
