"""The page in a real browser: no complaint, no request, and the slider moves the scene."""

import pytest

from diffstack_mmv.reporting.html import read_page, write_page
from tests.reporting.html import browser, runs

pytestmark = [
    pytest.mark.slow,
    pytest.mark.skipif(
        browser.installed() is None,
        reason="needs Chromium or Chrome on the PATH, or its path in CHROMIUM",
    ),
]
SEEN = "document.querySelectorAll('.scenes')[{box}].querySelector('.moving').innerHTML"
MOVE = """(() => {{
  const slider = document.querySelectorAll('.scenes')[{box}].querySelector('input[type=range]');
  slider.value = {step};
  slider.dispatchEvent(new Event('input'));
  return document.querySelectorAll('.scenes')[{box}].querySelector('output').textContent;
}})()"""
PLAY = "document.querySelectorAll('.scenes')[0].querySelector('button').click()"
CHOOSE = """(() => {
  const select = document.querySelector('.scenes select');
  select.value = 1;
  select.dispatchEvent(new Event('change'));
})()"""
HIDE = "document.querySelectorAll('.layers input').forEach((tick) => tick.click())"
HOVER = """document.querySelectorAll('.chart.lines svg').forEach((chart) =>
  chart.dispatchEvent(new MouseEvent('mousemove', {clientX: 100, clientY: 50})))"""


@pytest.fixture(scope="module")
def page(tmp_path_factory):
    place = tmp_path_factory.mktemp("page")
    made = [read_page(kind(place / kind.__name__), runs.TITLES) for kind in runs.KINDS]
    write_page(place / "page.html", made)
    with browser.page() as opened:
        opened.open(place / "page.html")
        yield opened


@pytest.mark.parametrize(("box", "last"), [(0, 9), (1, 3)])
def test_the_slider_moves_the_scene(page, box, last):
    first = page.ask(MOVE.format(box=box, step=0)), page.ask(SEEN.format(box=box))
    then = page.ask(MOVE.format(box=box, step=last)), page.ask(SEEN.format(box=box))
    assert first[0] != then[0]
    assert first[1] != then[1]
    assert "<ellipse" in page.ask(SEEN.format(box=0))
    assert page.complaints == []


def test_everything_is_drawn_and_nothing_fetched(page):
    for kind in ("lines", "bars"):
        drawn = f"document.querySelectorAll('.chart.{kind} svg').length"
        assert page.ask(drawn) == page.ask(f"document.querySelectorAll('.chart.{kind}').length") > 0
    assert page.ask("[...document.images].every((image) => image.naturalWidth > 0)")
    assert [each for each in page.requests if not each.startswith(("file:", "data:"))] == []


def test_playing_choosing_hiding_and_pointing_raise_no_error(page):
    for action in (PLAY, PLAY, CHOOSE, HIDE, HIDE, HOVER):
        page.ask(action)
    assert page.ask("document.querySelector('.readout').textContent") != ""
    assert page.complaints == []
