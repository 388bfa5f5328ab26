"""A browser without a screen, for the tests of pages; they are skipped where there is none."""

import shutil

import pytest

NAMES = ("chromium", "chromium-browser", "google-chrome")
OPTIONS = ("--no-sandbox", "--use-angle=swiftshader", "--enable-unsafe-swiftshader", "--ignore-gpu-blocklist")


def start_browser():
    """Yields a function that opens a file offline and returns its page, which fails the test for any message in the console."""
    playwright = pytest.importorskip("playwright.sync_api", reason="playwright is not installed")
    program = next((path for name in NAMES if (path := shutil.which(name))), None)
    if program is None:
        pytest.skip(f"no browser: none of {', '.join(NAMES)} is installed")
    said = []
    with playwright.sync_playwright() as driver:
        browser = driver.chromium.launch(executable_path=program, args=OPTIONS)
        context = browser.new_context(viewport={"width": 1200, "height": 800}, offline=True)

        def open_page(path):
            page = context.new_page()
            page.on("console", lambda message: said.append(f"{message.type}: {message.text}"))
            page.on("pageerror", lambda error: said.append(str(error)))
            page.on("request", lambda request: None if request.url.startswith(("file:", "data:")) else said.append(request.url))
            page.goto(path.resolve().as_uri())
            page.wait_for_selector("body[data-ready]")
            return page

        open_page.said = said
        yield open_page
        browser.close()
