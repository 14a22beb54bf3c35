"""The page in a real browser: a way through all of it by mouse and keyboard, desktop and phone, dark and light."""

import json
import os
import re
from pathlib import Path

import pytest
from playwright.sync_api import expect

from goldfield.page.hub import SILENCE_S, State
from goldfield.page.messages import Progress, Row, progress_message
from hil_sim.clib import ROOT
from tests.host.page.browser import DESKTOP, PHONE, ROOM, STILL, Served, chromium, recorded, times_later
from tests.host.page.walk import BROKEN, WEAK, walk

AXE = ROOT / "build/page/node_modules/axe-core/axe.min.js"
SHOTS = ROOT / "build/screenshots"
IDS = [beacon.id for beacon in ROOM.beacons]
CYCLES, BREAKS = 130, 90
WAIT_MS = 60_000
FOUR_PICTURES = """async () => {
    for (let picture = 0; picture < 4; picture++) await new Promise(requestAnimationFrame);
}"""
"""The first may tell that something is seen, the next draws it."""
SETTLED = "Promise.all(document.getAnimations().map(one => one.finished))"
"""No colour is on its way to another."""
SETTLED_COLOUR = """async element => {
    await Promise.all(element.getAnimations().map(one => one.finished));
    return getComputedStyle(element).color;
}"""
SHIFTS = """new Promise(done => new PerformanceObserver(list => done(list.getEntries()
    .filter(entry => !entry.hadRecentInput)
    .map(entry => [entry.value, entry.sources.map(source => (source.node?.outerHTML ?? "").slice(0, 60)).join(" ")])))
    .observe({type: "layout-shift", buffered: true}))"""
"""What moved by itself: how far, as browsers count it, and which elements."""


@pytest.fixture(scope="module")
def messages(tmp_path_factory):
    log = tmp_path_factory.mktemp("walk") / "walk.log"
    log.write_text(walk(CYCLES))
    return recorded(log)


@pytest.fixture(scope="module")
def calm(messages):
    """Return the messages up to the epoch from which on a coil is open."""
    return messages[: next(n for n, (kind, _) in enumerate(messages) if _epoch(kind, _) >= BREAKS)]


def _epoch(kind, message):
    return int(message.split('"epoch": ')[1].split(",")[0]) if kind == "epoch" else -1


@pytest.fixture(scope="module")
def browser():
    with chromium() as started:
        yield started


@pytest.fixture
def served():
    with Served() as page:
        yield page


@pytest.fixture
def opened(browser, served):
    """Return a function that opens the page; at the end nothing was complained of and nobody else was asked."""
    contexts, complaints, asked, forgiven = [], [], [], ["ERR_CONNECTION", "WebSocket"]

    def open_page(viewport=DESKTOP, scheme="light", first=None, without=()):
        context = browser.new_context(viewport=viewport, color_scheme=scheme, has_touch=viewport is PHONE)
        contexts.append(context)
        page = context.new_page()
        page.add_init_script(STILL)
        page.set_default_timeout(WAIT_MS)
        expect.set_options(timeout=WAIT_MS)
        page.on("pageerror", lambda error: complaints.append(str(error)))
        page.on("console", lambda said: complaints.append(said.text) if said.type == "error" else None)
        page.on("request", lambda request: asked.append(request.url))
        forgiven.extend(without)
        if first is not None:
            first(page)
        page.goto(served.url)
        return page

    yield open_page
    for context in contexts:
        context.close()
    assert [one for one in complaints if not any(word in one for word in forgiven)] == []
    assert [url for url in asked if not url.startswith((served.url, served.url.replace("http", "ws"), "data:"))] == []


def violations(page):
    page.evaluate(SETTLED)
    page.evaluate(AXE.read_text())
    found = page.evaluate("axe.run(document, {resultTypes: ['violations']})")["violations"]
    return [(one["id"], [node["html"] for node in one["nodes"]]) for one in found]


def all_shown(page, messages):
    """Wait until the page has drawn the last of the messages that it was sent since it was opened."""
    expect(page.locator("#counts")).to_have_text(f"{sum(kind == 'epoch' for kind, _ in messages)} epochs")


def row(page, table, name):
    return page.locator(f"#{table} tbody tr").filter(has=page.get_by_role("rowheader", name=name, exact=True))


def test_a_way_through_everything(opened, served, messages, calm):
    page = opened()
    expect(page.locator("#link-word")).to_have_text("waiting for the sensor")
    served.publish(calm)
    expect(page.locator("#link-word")).to_have_text("live")
    expect(page.locator("#site-name")).to_have_text("prigge8")
    expect(page.locator("#status-word")).to_have_text("ok")
    expect(page.locator("#beacons tbody tr")).to_have_count(8)
    expect(page.locator("#boards tbody tr")).to_have_count(9)
    expect(row(page, "beacons", IDS[0])).to_contain_text("used")
    expect(row(page, "beacons", IDS[WEAK])).to_contain_text("left out")
    expect(page.get_by_label("What is wrong now")).to_contain_text(f"The field of {IDS[WEAK]}")

    # A coil opens: the table, the plan and the alarms say so.
    expect(row(page, "beacons", IDS[BROKEN])).to_contain_text("used")
    served.publish(messages[len(calm) :])
    expect(row(page, "beacons", IDS[BROKEN])).to_contain_text("▲ left out")
    expect(page.get_by_label("What is wrong now")).to_contain_text("reports an open coil")
    expect(row(page, "boards", "13")).to_contain_text("an open coil")
    expect(page.get_by_role("img", name="Plan of the site; the sensor is at")).to_be_visible()

    # What the pictures show.
    for name, part in (("Trail", ".layer-trail"), ("Covariance", ".covariance"), ("Protection", ".protection")):
        expect(page.locator(part)).not_to_have_attribute("visibility", "hidden")
        page.get_by_label(name, exact=True).uncheck()
        expect(page.locator(part)).to_have_attribute("visibility", "hidden")
        page.get_by_label(name, exact=True).check()
        expect(page.locator(part)).not_to_have_attribute("visibility", "hidden")
    page.get_by_label("Expected error").check()
    expect(page.locator(".layer-map image")).to_have_count(1)
    expect(page.locator("#plan-note")).to_contain_text("expected error at z =")
    page.get_by_label("Expected error").uncheck()
    expect(page.locator(".layer-map image")).to_have_count(0)
    all_shown(page, messages)
    assert len(page.locator("polyline.trail").get_attribute("points")) > 100
    page.get_by_role("button", name="Clear trail").click()
    expect(page.locator("polyline.trail")).to_have_attribute("points", "")


@pytest.mark.parametrize(("device", "viewport"), [("desktop", DESKTOP), ("phone", PHONE)])
def test_an_alarm_is_told_once_and_three_are_seen_whole(opened, served, messages, calm, device, viewport):
    """The field of one beacon is told of in two ways, with figures that change, before and after a coil opens."""
    page = opened(viewport)
    alarms, count = page.get_by_label("What is wrong now"), page.locator("#alarm-count")
    expect(count).to_have_text("")
    served.publish(calm[-10:])
    expect(alarms.get_by_role("listitem")).to_have_text(re.compile(f"The field of {IDS[WEAK]} is .* times the site's"))
    expect(count).to_have_text("1 now")
    served.publish([one for one in messages if _epoch(*one) in (91, 100)])
    expect(count).to_have_text("3 now")
    items = alarms.get_by_role("listitem")
    expect(items).to_have_count(3)
    expect(items.filter(has_text=" times the field of the site file")).to_have_count(1)
    SHOTS.mkdir(exist_ok=True)
    page.screenshot(path=SHOTS / f"{device}-alarms.png", full_page=True)
    assert alarms.evaluate("list => list.scrollHeight <= list.clientHeight")


def test_a_chart_without_a_line_has_no_labels(opened, served, calm):
    page = opened()
    pictures = page.locator(".chart-picture")
    expect(pictures).to_have_count(3)
    for number in range(3):
        expect(pictures.nth(number).locator(".uplot")).to_be_hidden()
    SHOTS.mkdir(exist_ok=True)
    page.screenshot(path=SHOTS / "desktop-empty.png", full_page=True)
    assert violations(page) == []
    served.publish([one for one in calm if one[0] == "epoch"])  # whose health tells the rates
    for number, shown in enumerate((True, True, False)):
        expect(pictures.nth(number).locator(".uplot")).to_be_visible(visible=shown)
    served.publish(calm[-10:])
    expect(pictures.nth(2).locator(".uplot")).to_be_visible()


def test_space_is_turned_by_mouse_and_keyboard(opened, served, calm):
    page = opened()
    served.publish(calm)
    all_shown(page, calm)
    canvas = page.locator("#space canvas")
    canvas.scroll_into_view_if_needed()

    def picture():
        page.evaluate(FOUR_PICTURES)
        return canvas.screenshot()

    seen = [picture()]
    for name in ("Top", "Front", "Side", "Oblique"):
        page.get_by_role("button", name=name, exact=True).click()
        seen.append(picture())
    assert len(set(seen)) == 4  # the first is oblique too
    canvas.focus()
    page.keyboard.press("Home")
    home = picture()
    for key in ("ArrowLeft", "ArrowUp", "+"):
        before = picture()
        page.keyboard.press(key)
        assert picture() != before
    page.keyboard.press("Home")
    assert picture() == home


def test_space_is_there_before_the_first_pose(opened, served):
    page = opened()
    expect(page.locator("#space canvas")).to_be_visible()
    expect(page.locator("#status-word")).to_have_text("no pose yet")


NO_WEBGL = """
    const old = HTMLCanvasElement.prototype.getContext;
    HTMLCanvasElement.prototype.getContext = function (kind, ...more) {
        return /webgl/.test(kind) ? null : old.call(this, kind, ...more);
    };
"""
WITHOUT_SPACE = {
    "the script does not come": (
        lambda page: page.route("**/space-*.js", lambda route: route.abort()),
        "did not answer",
        "ERR_FAILED",
    ),
    "no WebGL": (lambda page: page.add_init_script(NO_WEBGL), "WebGL is off", "WebGL context"),
}


@pytest.mark.parametrize("case", WITHOUT_SPACE)
def test_without_three_dimensions_the_rest_goes_on(opened, served, calm, case):
    first, said, complaint = WITHOUT_SPACE[case]
    page = opened(first=first, without=[complaint])
    served.publish(calm)
    expect(page.locator("#status-word")).to_have_text("ok")
    expect(page.locator("#space")).to_contain_text(said)
    expect(page.get_by_role("img", name="Plan of the site; the sensor is at")).to_be_visible()
    page.get_by_role("button", name="Top", exact=True).click()
    assert violations(page) == []


def test_everything_is_reached_by_the_keyboard(opened, served, calm):
    page = opened()
    served.publish(calm)
    expect(page.locator("#status-word")).to_have_text("ok")
    reached = []
    for _ in range(40):
        page.keyboard.press("Tab")
        reached.append(
            page.evaluate("document.activeElement.id || document.activeElement.textContent.trim().slice(0, 20)")
        )
        if reached[-1] == "span":
            break
    wanted = ["hold", "show-trail", "show-covariance", "show-protection", "show-error", "clear-trail", "span", "alarms"]
    assert set(wanted) <= set(reached), reached


def test_a_page_that_is_held_stands_still(opened, served, calm):
    page = opened()
    served.publish(calm[:20])
    all_shown(page, calm[:20])
    expect(page.locator("#link-word")).to_have_text("live")  # which is read out, too
    page.get_by_role("button", name="Hold").click()
    expect(page.get_by_role("button", name="Hold")).to_have_attribute("aria-pressed", "true")
    expect(page.locator("#announce")).to_contain_text("held")
    held = page.locator("#figures").inner_text()
    served.publish(calm[20:])
    served.hub.set_state(State.LOST, "the port is gone")
    expect(page.locator("#link-word")).to_have_text("link lost")  # it has all that came before
    page.evaluate(FOUR_PICTURES)
    assert page.locator("#figures").inner_text() == held
    page.get_by_role("button", name="Hold").click()
    served.publish(calm[-3:])
    expect(page.locator("#figures")).not_to_have_text(held, use_inner_text=True)


def test_a_stream_that_stops_and_a_server_that_goes_are_told_and_so_is_their_return(opened, served, calm):
    page = opened()
    served.publish(calm[:40])
    expect(page.locator("#link-word")).to_have_text("live")
    expect(page.locator("#status-word")).to_have_text("ok")
    expect(page.locator("body")).to_have_attribute("data-old", "false")
    fresh = page.locator("#status").evaluate(SETTLED_COLOUR)
    served.now_s += SILENCE_S + 1.0
    expect(page.locator("#link-word")).to_have_text("stream stopped")
    expect(page.locator("#link-text")).to_contain_text("The latest pose is 3 s old.")
    served.hub.set_state(State.LOST, "the port is gone")
    expect(page.locator("#link-word")).to_have_text("link lost")
    expect(page.locator("#status-word")).to_have_text("ok")
    expect(page.locator("body")).to_have_attribute("data-old", "true")
    page.wait_for_function("colour => getComputedStyle(document.querySelector('#status')).color !== colour", arg=fresh)
    expect(page.locator("#link-text")).to_contain_text("The port is gone. The latest pose is")
    expect(page.locator("#pose-age")).to_contain_text("not of now")
    expect(page.get_by_role("status")).to_contain_text("port is gone")
    page.evaluate("passed(3)")
    expect(page.get_by_label("What is wrong now")).to_contain_text("Nothing is known: no epoch comes in.")
    expect(page.get_by_role("status")).to_contain_text("port is gone")
    served.publish(calm[40:80])
    expect(page.locator("#link-word")).to_have_text("live")
    page.wait_for_function("colour => getComputedStyle(document.querySelector('#status')).color === colour", arg=fresh)
    served.stop()
    expect(page.locator("#link-word")).to_have_text("page cut off")
    served.start()
    served.publish(calm[80:])
    expect(page.locator("#link-word")).to_have_text("live")
    expect(page.locator("#status-word")).to_have_text("ok")


def test_a_clock_that_is_set_back_keeps_no_alarm(opened, served, messages, calm):
    page = opened()
    served.publish(messages)
    alarms = page.get_by_label("What is wrong now")
    expect(alarms).to_contain_text("open coil")
    page.evaluate("Date.now = () => 0")
    page.evaluate("passed(3)")
    served.publish(calm[-3:])
    expect(alarms).not_to_contain_text("open coil")


def test_a_command_that_ends_is_told_and_what_it_said_last_stays(opened, served, calm):
    page = opened()
    served.publish(calm[:40])
    expect(page.locator("#link-word")).to_have_text("live")
    served.hub.end("no survey fits the fields")
    expect(page.locator("#link-word")).to_have_text("ended")
    served.stop()
    expect(page.locator("#pose-age")).to_contain_text("not of now")
    expect(page.locator("#link-text")).to_have_text("No survey fits the fields.")
    expect(page.locator("#link-word")).to_have_text("ended")
    served.hub.set_state(State.WAITING)
    served.start()
    served.publish(calm[40:60])
    expect(page.locator("#link-word")).to_have_text("live")
    epochs = sum(kind == "epoch" for kind, _ in calm[:60])  # those from before came again, and count once
    expect(page.locator("#counts")).to_have_text(f"{epochs} epochs")


@pytest.mark.parametrize(("device", "viewport"), [("desktop", DESKTOP), ("phone", PHONE)])
def test_a_calibration_s_progress_is_shown_to_anybody(opened, served, calm, device, viewport):
    page = opened(viewport)
    expect(page.locator("#link-word")).to_have_text("waiting for the sensor")
    expect(page.locator("#progress")).to_be_hidden()
    served.publish(calm)
    rows = [Row("x up", "3.0 s", 1.0), Row("x down", "0.6 s", 0.2), Row("b1", "4 mm")]
    served.hub.publish_progress(progress_message(Progress("calibration", "Still to come: x down.", 0.4, rows)))
    card = page.get_by_role("region", name="Calibration of the sensor")
    expect(card).to_contain_text("Still to come: x down.")
    expect(card.get_by_role("listitem")).to_have_text(["x up3.0 s", "x down0.6 s", "b14 mm"])
    expect(card.get_by_role("progressbar")).to_have_count(3)  # of the whole, and of the parts that are known
    assert card.get_by_role("progressbar", name="How far x down is").evaluate("bar => bar.value") == pytest.approx(0.2)
    served.hub.set_state(State.BUSY, "the host computes")
    expect(page.locator("#link-word")).to_have_text("computing")
    SHOTS.mkdir(exist_ok=True)
    page.screenshot(path=SHOTS / f"{device}-progress.png")
    assert violations(page) == []
    assert page.evaluate("document.documentElement.scrollWidth <= innerWidth")


@pytest.mark.parametrize(("device", "viewport"), [("desktop", DESKTOP), ("phone", PHONE)])
@pytest.mark.parametrize("scheme", ["light", "dark"])
def test_anybody_can_use_it_and_nothing_jumps(opened, served, messages, device, viewport, scheme):
    page = opened(viewport, scheme)
    expect(page.locator("#link-word")).to_have_text("waiting for the sensor")
    served.publish(messages)
    expect(page.get_by_label("What is wrong now")).to_contain_text("open coil")
    page.get_by_text("Earlier alarms").click()
    SHOTS.mkdir(exist_ok=True)
    page.locator("#space").scroll_into_view_if_needed()
    page.wait_for_timeout(500)  # for who looks at the pictures; nothing is judged by them
    page.screenshot(path=SHOTS / f"{device}-{scheme}-space.png")
    page.screenshot(path=SHOTS / f"{device}-{scheme}.png", full_page=True)
    assert violations(page) == []
    assert page.evaluate("document.documentElement.scrollWidth <= innerWidth")
    moved = page.evaluate(f"Promise.race([{SHIFTS}, new Promise(done => setTimeout(() => done([]), 300))])")
    assert sum(value for value, _ in moved) < 0.02, moved


def own_memory():
    """Return the memory that this process holds, in which the server runs, bytes."""
    return int(Path("/proc/self/statm").read_text().split()[1]) * os.sysconf("SC_PAGE_SIZE")


def at_rate(messages, fixes):
    """Return the messages with so many poses at times of their own behind each epoch."""
    spread = []
    for kind, message in messages:
        record = json.loads(message)
        spread.append((kind, json.dumps(record | {"at_rate": True} if kind == "epoch" and fixes else record)))
        if kind == "epoch":
            step_s = ROOM.cycle_s / max(fixes, 1)
            spread += [
                ("fix", json.dumps(record | {"type": "fix", "t_s": record["t_s"] + n * step_s})) for n in range(fixes)
            ]
    return spread


@pytest.mark.slow
@pytest.mark.parametrize(("rate_hz", "fixes", "batch"), [(10, 0, 90), (100, 10, 30)])
def test_an_hour_of_virtual_time_takes_no_more_memory(opened, served, calm, rate_hz, fixes, batch):
    page = opened()
    client = page.context.new_cdp_session(page)
    client.send("HeapProfiler.enable")
    first = next((n for n, (kind, message) in enumerate(calm) if _epoch(kind, message) >= batch), len(calm))
    messages = at_rate(calm[:first], fixes)  # fewer than the messages that wait for a browser
    browser, server, played = [], [], 0
    while played < 36_000:  # of a tenth of a second each
        served.publish(times_later(messages, played * ROOM.cycle_s))
        played += batch
        page.evaluate("seconds => passed(seconds)", batch * ROOM.cycle_s)
        expect(page.locator("#counts")).to_have_text(f"{played} epochs")  # and none was skipped
        if played // 9_000 > len(browser):
            client.send("HeapProfiler.collectGarbage")
            browser.append(client.send("Runtime.getHeapUsage")["usedSize"])
            server.append(own_memory())
    for name, used in (("browser", browser), ("server", server)):
        print(f"{rate_hz} Hz, {name}: {[f'{one / 1e6:.1f} MB' for one in used]}")
        assert len(used) == 4
        assert used[3] < 1.1 * used[1] + 1e6
