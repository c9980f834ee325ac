"""The live page in a real browser: it grows while a real run goes on, and ends as the run does."""

import shutil

import pytest
from playwright.sync_api import Page, sync_playwright

from .conftest import GUARD_S, Start

CHROMIUM = shutil.which("chromium") or shutil.which("chromium-browser") or shutil.which("google-chrome")
_DRAWN = "() => [...document.querySelectorAll('#fig7 path')].map((path) => path.getAttribute('d')).join('').length"


def shown_time(page: Page) -> float:
    """The time that the page shows, s."""
    text = page.locator("#cursor").text_content() or ""
    return float(text.split("=")[1].split("s")[0]) if "=" in text else -1.0


@pytest.mark.skipif(CHROMIUM is None, reason="no Chromium")
def test_the_page_lives(start: Start) -> None:
    wrong: list[str] = []
    with sync_playwright() as playwright:
        browser = playwright.chromium.launch(executable_path=CHROMIUM, args=["--no-sandbox"])
        page = browser.new_page(viewport={"width": 1200, "height": 1400})
        page.set_default_timeout(1e3 * GUARD_S)
        page.on("console", lambda told: wrong.append(told.text) if told.type == "error" else None)
        page.on("pageerror", lambda error: wrong.append(str(error)))
        bench = start("--can", "udp", "--clock", "realtime", duration=8.0)
        page.goto(bench.page)
        page.locator("#status").filter(has_text="live").wait_for()
        times, lengths = [shown_time(page)], [-1]
        while "live" in (page.locator("#status").text_content() or ""):
            times.append(shown_time(page))
            lengths.append(page.evaluate(_DRAWN))
            page.wait_for_timeout(200)
        assert max(times) > 1.0
        assert times == sorted(times)
        assert len(set(lengths)) > 2
        assert page.locator("#status").text_content() == "the run has ended"
        assert float(page.locator("#scrub").get_attribute("max") or 0.0) >= 7.5
        assert "in progress" not in (page.locator("#verdicts").text_content() or "")
        browser.close()
    bench.end()
    assert wrong == []
