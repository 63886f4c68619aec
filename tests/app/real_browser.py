"""A real browser for tests: what its pages may load, what its console may say, and what axe finds.

Where there is no Chromium these tests are skipped, unless ``JOINTPLAY_REQUIRE_BROWSER`` is set (as ``.ci/run`` does).
"""

from __future__ import annotations

import os
import shutil
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any
from urllib.parse import urlsplit

import pytest
from playwright.sync_api import Browser, BrowserContext, Locator, Page, Response, sync_playwright

AXE = Path(__file__).parent / "vendor" / "axe-4.14.1.min.js"
PROGRAMS = ("chromium", "chromium-browser", "google-chrome")
ARGUMENTS = [
    "--no-sandbox",
    "--disable-gpu",
    "--no-first-run",
    "--disable-background-networking",
    "--disable-component-update",
    "--disable-sync",
]
SECONDS = 120_000
SCREENS = [(1280, 900, "light"), (360, 740, "dark")]


@contextmanager
def running() -> Iterator[Browser]:
    """A browser without a window."""
    program = next(filter(None, map(shutil.which, PROGRAMS)), None)
    if program is None:
        say = pytest.fail if os.environ.get("JOINTPLAY_REQUIRE_BROWSER") else pytest.skip
        say(f"no browser: none of {', '.join(PROGRAMS)} is installed")
    with sync_playwright() as playwright:
        browser = playwright.chromium.launch(executable_path=program, args=ARGUMENTS, timeout=SECONDS)
        yield browser
        browser.close()


class Visit:
    """A page under watch: whatever its console complains of, and whatever it loads from elsewhere, fails the test."""

    def __init__(self, context: BrowserContext, server: str) -> None:
        self.complaints: list[str] = []
        self.hosts: set[str] = set()
        self.page: Page = context.new_page()
        self.page.on("pageerror", lambda error: self.complaints.append(str(error)))
        self.page.on("console", lambda message: self._heard(message.type, message.text))
        self.page.on("response", self._loaded)
        self.page.goto(server)

    def _heard(self, kind: str, text: str) -> None:
        # The browser itself notes every answer with an error status; the tests ask about those on purpose.
        if kind in ("error", "warning") and "responded with a status of" not in text:
            self.complaints.append(text)

    def _loaded(self, response: Response) -> None:
        self.hosts.add(urlsplit(response.url).netloc)


@contextmanager
def visiting(browser: Browser, server: str, screen: tuple[int, int, Any], **more: Any) -> Iterator[Visit]:
    """A visit on a screen of some width, height and scheme of colours, which is in order to its end."""
    width, height, scheme = screen
    context = browser.new_context(viewport={"width": width, "height": height}, color_scheme=scheme, **more)
    context.set_default_timeout(SECONDS)
    visit = Visit(context, server)
    yield visit
    assert visit.complaints == []
    assert visit.hosts == {urlsplit(server).netloc}
    context.close()


def serious(page: Page) -> list[str]:
    """What axe finds that is serious or worse; it is evaluated, as the policy lets no page load it."""
    page.wait_for_load_state()
    page.evaluate(AXE.read_text(encoding="utf-8"))
    found = page.evaluate("axe.run()")
    assert len(found["passes"]) > 10
    return [
        f"{fault['id']}: {node['html']}"
        for fault in found["violations"]
        if fault["impact"] in ("serious", "critical")
        for node in fault["nodes"]
    ]


def has_drawn(canvas: Locator) -> bool:
    """Whether there is anything on a canvas."""
    drawn = "canvas => canvas.getContext('2d').getImageData(0, 0, canvas.width, canvas.height).data.some(v => v > 0)"
    return bool(canvas.evaluate(drawn))


def is_within_screen(page: Page) -> bool:
    page.wait_for_load_state()  # a page that just came has no content yet
    wide: bool = page.evaluate("document.documentElement.scrollWidth <= window.innerWidth")
    return wide
