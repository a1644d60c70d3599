"""Every panel for everybody: axe-core's rules, the keyboard, and fingers on a phone.

The panels are looked at in every pair of a colour scheme, a size and a language.
"""

import json
from collections.abc import Iterator
from typing import Any

import pytest
from playwright.sync_api import Browser

from harness.page import DESKTOP, PANELS, PHONE, OpenPage, opened
from harness.server import RunningServer

# Apple's guidelines and WCAG 2.2's level AAA (2.5.5) want as much; a finger covers it.
FINGER_PX = 44

# More stops of the Tab key than any panel has.
MANY_STOPS = 300

# A checkbox is pressed by its label too.
FIND_SMALL_CONTROLS = """least_px => {
    const wanted = "button, select, summary, textarea, input, a[href], [role=button]";
    const seen = [...document.querySelectorAll(wanted)].filter(each => each.checkVisibility());
    return seen.map(each => {
        const pressed = each.matches("[type=checkbox], [type=radio]") ? each.closest("label") ?? each : each;
        const { width, height } = pressed.getBoundingClientRect();
        return { name: each.dataset.testid || each.id || each.textContent, width, height };
    }).filter(({ width, height }) => Math.min(width, height) < least_px - 0.5)
      .map(({ name, width, height }) => `${name}: ${Math.round(width)} x ${Math.round(height)}`);
}"""

# Of the tabs one is reached by Tab and the others by arrow keys, as with radio buttons.
NAME_CONTROLS = """() => {
    const wanted = "button, select, summary, textarea, input, a[href], [tabindex='0']";
    const found = [...document.querySelectorAll(wanted)].filter(each => {
        const by_arrows = each.matches("[role=tab]:not([aria-selected=true]), [type=radio]:not(:checked)");
        return each.checkVisibility() && !each.matches(":disabled") && !by_arrows;
    });
    found.forEach((each, index) => each.dataset.stop = String(index));
    return Object.fromEntries(found.map(each => [each.dataset.stop, each.outerHTML.slice(0, 120)]));
}"""

FOCUSED = """() => {
    const { dataset, tagName } = document.activeElement;
    const style = getComputedStyle(document.activeElement);
    const outlined = style.outlineStyle !== "none" && parseFloat(style.outlineWidth) >= 2;
    return { stop: dataset.stop ?? tagName, visible: outlined || style.boxShadow !== "none" };
}"""


@pytest.fixture(scope="module", params=[{}, {"locale": "de"}], ids=["en", "de"])
def page(browser: Browser, server: RunningServer, request: pytest.FixtureRequest) -> Iterator[OpenPage]:
    """A page of each language, with a pose chosen and a plan shown, so that nothing is grey for want of one."""
    with opened(browser, **request.param) as open_page:
        open_page.open(server.port)
        assert open_page.page.evaluate("document.documentElement.lang") == request.param.get("locale", "en")
        open_page.part("named-home").click()
        open_page.press("plan")
        open_page.until_state("s.plan.trajectory !== null && s.identity !== null && s.servos.length > 0")
        yield open_page


# Each colour scheme with each size, and each of both with each language.
LOOKS: dict[str, list[tuple[Any, tuple[int, int]]]] = {
    "en": [("light", DESKTOP), ("dark", PHONE)],
    "de": [("dark", DESKTOP), ("light", PHONE)],
}


@pytest.mark.parametrize("number", [0, 1])
def test_axe_finds_nothing_in_any_panel(page: OpenPage, number: int) -> None:
    scheme, (width, height) = LOOKS[page.page.evaluate("document.documentElement.lang")][number]
    page.page.set_viewport_size({"width": width, "height": height})
    page.page.emulate_media(color_scheme=scheme)
    # What stands above all panels is looked at beside the first.
    within = {panel: f"#panel-{panel}, #tab-{panel}" for panel in PANELS[1:]}
    violations = [each for panel in page.open_panels() for each in page.violations(within.get(panel, "html"))]
    assert not violations, "\n".join(violations)
    assert page.errors == []


# Translated texts are as high, and longer.
@pytest.mark.parametrize("page", [{}], ids=["en"], indirect=True)
def test_no_control_is_too_small_for_a_finger(page: OpenPage) -> None:
    page.page.set_viewport_size({"width": PHONE[0], "height": PHONE[1]})
    found = [
        f"{panel}: {each}"
        for panel in page.open_panels()
        for each in page.page.evaluate(FIND_SMALL_CONTROLS, FINGER_PX)
    ]
    assert not found, "\n".join(found)


@pytest.mark.parametrize("page", [{}], ids=["en"], indirect=True)
def test_every_control_is_reached_by_the_keyboard_and_shows_its_focus(page: OpenPage) -> None:
    page.page.set_viewport_size({"width": DESKTOP[0], "height": DESKTOP[1]})
    for panel in page.open_panels():
        missed: dict[str, str] = page.page.evaluate(NAME_CONTROLS)
        names = dict(missed)
        page.page.evaluate("document.activeElement.blur()")
        for _ in range(MANY_STOPS):
            page.page.keyboard.press("Tab")
            focused = page.page.evaluate(FOCUSED)
            if missed.pop(focused["stop"], None) is None and focused["stop"] in names:
                break
            assert focused["visible"] or focused["stop"] == "BODY", (panel, names.get(focused["stop"]))
        assert missed == {}, panel


def test_names_and_sentences_of_the_page_are_in_its_language(page: OpenPage) -> None:
    language = page.page.evaluate("document.documentElement.lang")
    title, planned = {"en": ("Move", "is planned"), "de": ("Bewegen", "ist geplant")}[language]
    assert page.part("tab-move").text_content() == title, json.dumps(page.state("layout"))
    assert planned in page.state("goal")["message"]
