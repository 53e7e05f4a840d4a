"""A browser that the system has, and servers of the lab for it."""

import functools
import http.server
import json
import secrets
import shutil
import socket
import threading
import time
from contextlib import contextmanager
from pathlib import Path

import pytest

from helpers.thorough import thorough

NAMES = ("chromium", "chromium-browser", "google-chrome", "chrome")
PATIENCE = 120  # seconds until a page shows what is waited for; machines may be busy
LOADED, ARROWS = "globalThis.lab?.ready", "lab.fields.size > 0"
ROOM = "#######\n#....G#\n#.###.#\n#.#...#\n#.#.#.#\n#@....#\n#######"
TOKEN = "a-token-that-nobody-guesses"
# To open a page: with Python, and without, as most of its tests do.
WAYS = ["served", *thorough("static")]
# Plays actions in a level by the rules of a page, and tells its states.
PLAY = """async ([path, level, variant, actions]) => {
  const { rules } = await import(new URL(path, location.href));
  const { advance } = await import(new URL("rules/common.js", location.href));
  const { snapshot } = await import(new URL("engine/episodes.js", location.href));
  const played = [[rules.build(level, variant), 0]];
  for (const action of actions) {
    const s = rules.copy(played.at(-1)[0]); // those before are told last, to see that they stay
    const { reward } = advance(rules, s, action);
    played.push([s, reward]);
    if (s.ended) break;
  }
  const packed = (s) => btoa(String.fromCharCode(...rules.planes(s).data));
  const told = ([s, reward]) => [snapshot(s, rules), packed(s), reward, s.ended];
  return JSON.stringify(played.map(told));
}"""


def chromium():
    """The path of the system's Chromium, or a skip with the reason."""
    pytest.importorskip("playwright", reason="playwright is not installed")
    found = [path for path in map(shutil.which, NAMES) if path]
    if not found:
        pytest.skip(f"there is no browser: none of {', '.join(NAMES)}")
    return found[0]


@contextmanager
def browser():
    from playwright.sync_api import sync_playwright

    path = chromium()
    with sync_playwright() as playwright:
        shown = playwright.chromium.launch(executable_path=path, args=["--no-sandbox"])
        yield shown
        shown.close()


# A page looks itself, for up to a second, as each look from here takes 6 ms of a core.
LOOK = """(async () => {{
  for (let left = 50; left > 0; left--) {{
    if ({}) return true;
    await new Promise((done) => setTimeout(done, 20));
  }}
  return false;
}})()"""


def wait(page, so):
    """Wait until an expression, or a function of the page, is true.

    The page's policy bars `wait_for_function`.
    """
    end = time.monotonic() + PATIENCE
    while not (so(page) if callable(so) else page.evaluate(LOOK.format(so))):
        assert time.monotonic() < end, f"still not so: {so}"
        page.wait_for_timeout(30)


# Windows of each browser that tests have left. In a new one a page takes a second more, as all code
# is compiled again.
LEFT = {}


@contextmanager
def opened(browser, address, ready=ARROWS, **options):
    """A page of the lab, `ready`, and what it writes to the console.

    With `options` it is in a window of its own.
    """
    with window_of(browser, **options) as (page, told):
        page.goto(address)
        wait(page, f"{LOADED} && {ready}")
        yield page, told


@contextmanager
def window_of(browser, **options):
    """A page that has loaded nothing yet, and what it writes to the console, as for `opened`."""
    left = LEFT.setdefault(browser, [])
    page, told = left.pop() if left and not options else new_window(browser, **options)
    yield page, told
    if options:
        page.context.close()
        return
    page.unroute_all()
    page.context.set_offline(False)
    page.evaluate("localStorage.clear()")
    page.set_viewport_size({"width": 1280, "height": 720})
    page.emulate_media(color_scheme="null")
    page.goto("about:blank")
    told.clear()
    left.append((page, told))


def new_window(browser, **options):
    """A page that has loaded nothing, and what it will write to the console."""
    context = browser.new_context(**options)
    context.set_default_timeout(1000 * PATIENCE)
    page, told = context.new_page(), []
    page.on("console", lambda message: told.append(message.text))
    page.on("pageerror", lambda error: told.append(str(error)))
    return page, told


@contextmanager
def modules_of(browser, address):
    """A page that imports the lab's modules when it is asked to, as the files are now."""
    page, _ = new_window(browser)  # others may have kept files
    page.goto(address + "lab.css")
    yield page
    page.context.close()


def load_anew(window, address, ready=ARROWS):
    """Load a page of the lab in a window where one was; in a new one it would be compiled again."""
    page, told = window
    told.clear()
    page.goto("about:blank")
    page.goto(address)
    wait(page, f"{LOADED} && {ready}")
    return page


def violations(page):
    """Return axe-core's violations on a page whose policy is bypassed; skip without axe-core."""
    axe = pytest.importorskip("axe_playwright_python", reason="axe-core is not installed")
    page.evaluate((Path(axe.__path__[0]) / "axe.min.js").read_text())
    page.evaluate("document.querySelectorAll('details').forEach((one) => { one.open = true; })")
    found = page.evaluate("axe.run(document, {resultTypes: ['violations']})")
    return [f"{v['id']}: {one['html']}" for v in found["violations"] for one in v["nodes"]]


@functools.cache
def usual_lab():
    """A lab as most tests need it, made once: the choice of its level takes half a second."""
    from astray.lab.serving import make_lab

    return make_lab("maze-corner", {})


@contextmanager
def folder_served(folder):
    """The address of a folder's files."""
    handler = functools.partial(Quiet, directory=str(folder))
    server = http.server.ThreadingHTTPServer(("127.0.0.1", 0), handler)
    thread = threading.Thread(target=server.serve_forever)
    thread.start()
    try:
        yield f"http://127.0.0.1:{server.server_address[1]}/"
    finally:
        server.shutdown()
        thread.join()
        server.server_close()


class Quiet(http.server.SimpleHTTPRequestHandler):
    def log_message(self, *_):
        pass


def free_port():
    with socket.socket() as found:
        found.bind(("127.0.0.1", 0))
        return found.getsockname()[1]


@contextmanager
def lab_served(lab, port=None):
    """The address of a lab that runs in a thread of this process."""
    import uvicorn

    from astray.lab.server import make_app

    token = TOKEN if port else f"{TOKEN}-{secrets.token_hex(4)}"  # another's files are not cached
    port = port or free_port()
    config = uvicorn.Config(
        make_app(lab, token, port),
        host="127.0.0.1",
        port=port,
        log_level="error",
        lifespan="off",
        ws="websockets-sansio",
        timeout_graceful_shutdown=1,
    )
    server = uvicorn.Server(config)
    thread = threading.Thread(target=server.run)
    thread.start()
    end = time.monotonic() + PATIENCE
    while not server.started:
        assert thread.is_alive() and time.monotonic() < end
        time.sleep(0.02)
    try:
        yield f"http://127.0.0.1:{port}/{token}/"
    finally:
        server.should_exit = True
        thread.join()


def knobs(variant):
    """The knobs of a variant, as a page receives them."""
    return json.loads(json.dumps({k: v for k, v in vars(variant).items() if k != "shifted"}))
