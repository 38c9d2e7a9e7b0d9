"""A small material, its page on a real port, and a browser to open it with."""

import shutil
import threading
import time
from contextlib import contextmanager

import pytest
from materials import SMALL, a_material

from matcap.field.material import Material
from matcap.view.subject import Materials, Pages

# A software renderer, so that every machine draws the same.
# Small, because software draws it: a desktop's layout, few texels held.
WINDOW = {"viewport": {"width": 800, "height": 500}, "screen": {"width": 800, "height": 500}}
FLAGS = ["--no-sandbox", "--use-gl=angle", "--use-angle=swiftshader", "--enable-unsafe-swiftshader"]


@pytest.fixture(scope="session")
def material() -> Material:
    return a_material("test", config=SMALL)


@pytest.fixture(scope="session")
def subject(material) -> Materials:
    return Materials(material, a_material("other", 4, SMALL))


@pytest.fixture(scope="session")
def served():
    """`with served(subject) as address`: see serving."""
    pytest.importorskip("uvicorn", reason="the extra 'view' is not installed")
    return serving


@contextmanager
def serving(subject, beside=None):
    """The page of a subject, on a free port of this machine; gives its address."""
    import uvicorn

    from matcap.view.server import listen, make_app, new_address

    listening = listen(0)
    address = new_address(listening.getsockname()[1])
    pages = Pages(subject, workers=2)
    app = make_app(pages, address, beside)
    server = uvicorn.Server(uvicorn.Config(app, log_level="error", lifespan="off"))
    thread = threading.Thread(target=server.run, kwargs={"sockets": [listening]}, daemon=True)
    thread.start()
    try:
        yield address
    finally:
        server.should_exit = True
        thread.join(10)
        pages.close()
        listening.close()


@pytest.fixture(scope="session")
def chromium():
    """Chromium without a window; the tests are skipped where there is none."""
    api = pytest.importorskip("playwright.sync_api", reason="playwright is not installed")
    program = shutil.which("chromium") or shutil.which("chromium-browser")
    with api.sync_playwright() as play:
        try:
            browser = play.chromium.launch(executable_path=program, args=FLAGS)
        except api.Error as error:
            pytest.skip(f"no Chromium ({str(error).splitlines()[0]})")
        yield browser
        browser.close()


class Tab:
    """A page that must not complain, and must not fetch from anywhere but its own address."""

    def __init__(self, browser, url: str, **options) -> None:
        self.page = browser.new_page(**WINDOW | options)
        self.complaints: list[str] = []
        self.requests: list[str] = []
        self.page.on("console", lambda message: self.complaints.append(message.text))
        self.page.on("pageerror", lambda error: self.complaints.append(str(error)))
        self.page.on("request", lambda request: self.requests.append(request.url))
        self.start = time.perf_counter()
        self.page.goto(url)

    def shown(self) -> list[str]:
        """Addresses fetched over a network: data and blobs are the page's own."""
        return [url for url in self.requests if not url.startswith(("data:", "blob:", "file:"))]

    def ask(self, script: str, argument=None):
        return self.page.evaluate(script, argument)

    def until(self, script: str, limit: float = 60.0) -> float:
        """Wait for a condition; gives the seconds since the page was opened."""
        end = time.perf_counter() + limit
        while not self.ask(script):
            assert time.perf_counter() < end, (script, self.complaints)
            time.sleep(0.02)
        return time.perf_counter() - self.start

    def loaded(self) -> float:
        """Wait until all that is seen is there."""
        return self.until("!!window.matcap && matcap.view.complete && !matcap.view.pending")


@contextmanager
def opened(browser):
    """Opens pages; at the end nothing may have been complained about."""
    tabs: list[Tab] = []

    def open_tab(url: str, **options) -> Tab:
        tabs.append(Tab(browser, url, **options))
        return tabs[-1]

    yield open_tab
    for one in tabs:
        one.page.close()
        # A server may end before the page that it served; what is said then is tested on its own.
        assert [said for said in one.complaints if "CONNECTION_REFUSED" not in said] == []


@pytest.fixture
def tab(chromium):
    """Open a page of one's own."""
    with opened(chromium) as open_tab:
        yield open_tab


@pytest.fixture(scope="module")
def shared_tab(chromium):
    """Open a page that several tests put into states of their own."""
    with opened(chromium) as open_tab:
        yield open_tab
