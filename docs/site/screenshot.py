"""Take a picture of a page of the viewer: python docs/site/screenshot.py PAGE.html FRAGMENT OUT.png

FRAGMENT is what stands behind the # of a link, as trial=3&t=120. Needs Chromium and chromedriver.
"""

from __future__ import annotations

import sys
import time
from importlib import util
from pathlib import Path
from typing import Any

BROWSER = Path(__file__).parents[2] / "tests/benchmarks/report/browser.py"
DRAWN = "return players.some((one) => one.go) && document.querySelector('article .plots .main-svg') !== null"
SETTLES_S = 3.0


def main(page: str, fragment: str, out: str) -> None:
    """Open a page at a moment, wait until it is drawn, and write the picture."""
    with _module().browser(1280, 900) as browser:
        browser.open(Path(page))
        browser.wait("return typeof players !== 'undefined' && players.length > 0")
        browser.run("location.hash = arguments[0]", fragment)
        browser.wait(DRAWN)
        time.sleep(SETTLES_S)
        browser.picture(Path(out))


def _module() -> Any:
    spec = util.spec_from_file_location("browser", BROWSER)
    assert spec is not None and spec.loader is not None
    module = util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


if __name__ == "__main__":
    main(*sys.argv[1:])
