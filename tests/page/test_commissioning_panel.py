"""The panel that calibrates and verifies, with states and answers put into the connection on their way."""

import json
import re
from collections.abc import Iterator
from dataclasses import dataclass, field
from typing import Any

import pytest
from playwright.sync_api import Browser, WebSocketRoute

from harness.page import DESKTOP, OpenPage, opened
from harness.server import RunningServer

TOPIC = "/arm/commissioning/state"
SERVICES = "/arm/commissioning/"

# Height of a window in which the panel of the arm scrolls.
LOW_PX = 420


def state(**fields: object) -> dict[str, Any]:
    """Return an armbridge_msgs/CommissioningState, by default that of no procedure."""
    texts = dict.fromkeys(("procedure", "step", "instruction", "result"), "")
    return {**texts, "answers": [], "progress": 0.0, "joints": [], "findings": [], **fields}


def joint(name: str, lowest: int, present: int, highest: int, **fields: object) -> dict[str, Any]:
    """Return an armbridge_msgs/SweptJoint."""
    ticks = {"lowest": lowest, "present": present, "highest": highest, "expected_width": 2700}
    return {"joint": name, **ticks, "done": False, "note": "", "droop_rad": None, **fields}


@dataclass
class ScriptedProcedures:
    """Procedures that the test scripts: the page's calls are kept, and answered without the server.

    Attributes:
        state: state that a new subscriber gets.
        calls: service, without its prefix, and request of each call.
        refusal: message of the answers; empty for success.
        role: role of the page.
        offered: False for a server that has no procedures.
    """

    page: OpenPage
    state: dict[str, Any] = field(default_factory=state)
    calls: list[tuple[str, dict[str, Any]]] = field(default_factory=list)
    refusal: str = ""
    role: str = "admin"
    offered: bool = True
    _routes: list[WebSocketRoute] = field(default_factory=list)

    def __post_init__(self) -> None:
        self.page.page.route_web_socket(re.compile("^ws://"), self._connected)

    def publish(self, **fields: object) -> None:
        """Publish a state, latched."""
        self.state = state(**fields)
        self._send({"op": "publish", "topic": TOPIC, "msg": self.state})

    def called(self, service: str) -> list[dict[str, Any]]:
        """Return the requests to a service."""
        return [request for name, request in self.calls if name == service]

    def _send(self, operation: dict[str, Any]) -> None:
        self._routes[-1].send(json.dumps(operation))

    def _connected(self, route: WebSocketRoute) -> None:
        self._routes.append(route)
        to_server = route.connect_to_server()
        route.on_message(lambda frame: self._from_page(json.loads(frame), to_server))
        to_server.on_message(lambda frame: self._from_server(json.loads(frame)))

    def _from_page(self, operation: dict[str, Any], to_server: WebSocketRoute) -> None:
        service = str(operation.get("service", ""))
        if operation.get("op") == "subscribe" and operation["topic"] == TOPIC:
            if self.offered:
                self._send({"op": "publish", "topic": TOPIC, "msg": self.state})
        elif operation.get("op") == "call_service" and service.startswith(SERVICES):
            self.calls.append((service.removeprefix(SERVICES), operation["args"]))
            values = {"success": self.refusal == "", "message": self.refusal}
            answer = {"op": "service_response", "service": service, "values": values, "result": True}
            self._send({**answer, "id": operation["id"]})
        else:
            to_server.send(json.dumps(operation))

    def _from_server(self, operation: dict[str, Any]) -> None:
        if operation.get("op") == "service_response" and operation.get("service") == "/arm/who_am_i":
            identity = {**json.loads(operation["values"]["message"]), "role": self.role}
            operation["values"]["message"] = json.dumps(identity)
        self._send(operation)


@pytest.fixture(scope="module")
def scripted(browser: Browser, server: RunningServer) -> Iterator[ScriptedProcedures]:
    with opened(browser, own=True) as page:
        yield opened_on_procedures(page, server)
        assert page.errors == []


@pytest.fixture
def procedures(scripted: ScriptedProcedures) -> ScriptedProcedures:
    """Return scripted procedures, of which none is played, with the page open on them."""
    page = scripted.page
    page.page.set_viewport_size({"width": DESKTOP[0], "height": DESKTOP[1]})
    scripted.publish()
    page.until_state("s.commissioning.procedure === '' && s.commissioning.result === ''")
    page.open_panel("arm", "commissioning")
    scripted.calls.clear()
    scripted.refusal = ""
    return scripted


@pytest.fixture
def page(procedures: ScriptedProcedures) -> OpenPage:
    return procedures.page


def opened_on_procedures(page: OpenPage, server: RunningServer) -> ScriptedProcedures:
    scripted = ScriptedProcedures(page)
    page.open(server.port)
    page.until_state("s.commissioning !== null && s.identity !== null")
    page.open_panel("arm", "commissioning")
    return scripted


def until_called(page: OpenPage, procedures: ScriptedProcedures, service: str) -> dict[str, Any]:
    """Wait for a call, and return its request."""
    page.wait(lambda: procedures.called(service))
    return procedures.called(service)[-1]


SWEEP = {"procedure": "calibrate", "step": "sweep", "instruction": "Move every joint.", "answers": ["done", "again"]}


def test_the_step_is_shown_with_its_ranges_and_answered_by_the_keyboard(
    page: OpenPage, procedures: ScriptedProcedures
) -> None:
    joints = [
        joint("shoulder_pan", 1000, 1800, 2024, done=True),
        joint("elbow_flex", 2000, 2000, 2000, note="not moved yet"),
    ]
    procedures.publish(**SWEEP, progress=0.25, joints=joints)
    page.until_text("instruction", "Move every joint.")
    page.until_text("swept-shoulder_pan-text", "90° of about 237°")
    page.until_text("swept-shoulder_pan-done", "done")
    assert page.part("swept-elbow_flex-done").text_content() == ""
    page.until_text("swept-elbow_flex-note", "not moved yet")
    meter = page.page.get_by_role("meter", name="shoulder_pan: range")
    assert meter.get_attribute("aria-valuenow") == "1024"
    assert float(page.part("procedure-progress").evaluate("bar => bar.value")) == 0.25
    answer = page.page.get_by_role("button", name="again")
    page.until("!document.querySelector('[data-testid=answer-1]').disabled")
    answer.focus()
    page.page.keyboard.press("Enter")
    assert until_called(page, procedures, "answer") == {"step": "sweep", "answer": "again"}
    assert page.errors == []


def test_the_keyboard_is_led_to_the_next_instruction(page: OpenPage, procedures: ScriptedProcedures) -> None:
    procedures.publish(**SWEEP)
    page.until("document.querySelector('[data-testid=answer-0]')?.disabled === false")
    page.part("answer-0").focus()
    page.page.keyboard.press("Enter")
    until_called(page, procedures, "answer")
    procedures.publish(**{**SWEEP, "step": "next", "instruction": "Now the gripper."})
    page.until_text("instruction", "Now the gripper.")
    page.until("document.activeElement?.dataset.testid === 'instruction'")


def assert_in_sight(page: OpenPage, test_id: str) -> None:
    box = page.box(test_id)
    assert 0 <= box["y"] <= box["y"] + box["height"] <= DESKTOP[1]


def test_what_is_asked_is_scrolled_into_sight(page: OpenPage, procedures: ScriptedProcedures) -> None:
    page.open_panel("arm", "servos")
    page.page.set_viewport_size({"width": DESKTOP[0], "height": LOW_PX})
    page.page.evaluate("document.querySelector('#panel-arm').scrollTo(0, 0)")
    page.until(f"document.querySelector('[data-testid=calibrate]').getBoundingClientRect().top > {LOW_PX}")
    procedures.publish(**SWEEP)
    page.until(f"document.querySelector('[data-testid=answer-0]')?.getBoundingClientRect().bottom < {LOW_PX}")


def test_the_panel_of_a_procedure_comes_before_the_one_that_is_shown(
    page: OpenPage, procedures: ScriptedProcedures
) -> None:
    page.open_panel("plots")
    procedures.publish(**SWEEP)
    page.part("answer-0").wait_for()
    assert page.part("panel-plots").is_hidden()


CLICKS_WHEN_THE_ANSWERS_CHANGE = """() => {
    window.clicked = [];
    const before = document.querySelector('[data-testid=answer-0]');
    const observer = new MutationObserver(() => {
        const answer = document.querySelector('[data-testid=answer-0]');
        if (window.clicked.length === 0 && answer !== null && (answer !== before || answer.disabled)) {
            window.clicked.push(answer.disabled);
            answer.click();
        }
    });
    observer.observe(document.body, { subtree: true, childList: true, attributeFilter: ["disabled"] });
}"""


def test_the_second_click_of_a_double_click_does_not_answer_the_next_step(
    page: OpenPage, procedures: ScriptedProcedures
) -> None:
    procedures.publish(**SWEEP)
    page.until("document.querySelector('[data-testid=answer-0]')?.disabled === false")
    # The second click comes with the next step, however busy the machine is.
    page.page.evaluate(CLICKS_WHEN_THE_ANSWERS_CHANGE)
    procedures.publish(**{**SWEEP, "step": "next"})
    page.until("window.clicked.includes(true)")
    page.until("document.querySelector('[data-testid=answer-0]').disabled === false")
    page.part("answer-0").click()
    until_called(page, procedures, "answer")
    assert procedures.called("answer") == [{"step": "next", "answer": "done"}]


def test_cancel_is_in_sight_wherever_the_panel_is_scrolled_and_with_its_section_closed(
    page: OpenPage, procedures: ScriptedProcedures
) -> None:
    assert page.part("procedure-cancel").is_hidden()
    procedures.publish(**SWEEP)
    page.until_text("procedure", "Calibration in progress")
    page.part("section-commissioning").locator("summary").click()
    page.page.evaluate("document.querySelector('#panel-arm').scrollTo(0, 1e6)")
    assert_in_sight(page, "procedure-cancel")
    page.open_panel("plots")
    assert_in_sight(page, "procedure-cancel")
    page.part("procedure-cancel").click()
    assert until_called(page, procedures, "cancel") == {}


def test_findings_and_the_result_are_told_when_the_procedure_is_over(
    page: OpenPage, procedures: ScriptedProcedures
) -> None:
    procedures.publish(result="Calibrated: written to left.json.", findings=["wrist_roll turns against the model."])
    page.until_text("procedure-result", "Calibrated: written to left.json.")
    page.until_text("findings", "wrist_roll turns against the model.")
    assert page.part("calibrate").is_enabled()
    assert page.part("procedure").is_hidden()


def test_the_reason_of_a_refusal_is_told(page: OpenPage, procedures: ScriptedProcedures) -> None:
    procedures.refusal = "the arm is being moved by alice"
    page.part("verify").click()
    page.until_text("notices", "the arm is being moved by alice")
    assert until_called(page, procedures, "begin") == {"procedure": "verify", "name": ""}
    page.until("!document.querySelector('[data-testid=verify]').disabled")


def test_the_range_of_the_joint_in_hand_is_drawn_on_the_arm(browser: Browser, server: RunningServer) -> None:
    with opened(browser, draws=True, own=True) as page:
        procedures = opened_on_procedures(page, server)
        procedures.publish(**SWEEP, joints=[joint("shoulder_pan", 1000, 2047, 3000)])
        page.until_state("s.commissioning.step === 'sweep'")
        procedures.publish(**SWEEP, joints=[joint("shoulder_pan", 1000, 2147, 3000)])
        page.until_state("s.joint_in_hand?.joint === 'shoulder_pan'")
        # Beside the joint, in the plane in which it turns.
        beside_m = (0.12, 0.07, 0.06)
        page.shot("swept_range")
        page.until_colour(beside_m, lambda red, green, blue: min(green, blue) > red + 15)
        procedures.publish()
        page.until_colour(beside_m, lambda red, green, blue: min(green, blue) <= red + 15)


def test_a_verification_shows_droop_and_brings_the_whole_arm_into_the_picture(
    page: OpenPage, procedures: ScriptedProcedures
) -> None:
    drooping = joint("elbow_flex", 2000, 2000, 2000, expected_width=0, droop_rad=0.0349)
    asked = {"instruction": "Does the arm stand as the model does?", "answers": ["yes", "no"], "joints": [drooping]}
    procedures.publish(procedure="verify", step="pose 1", **asked)
    # From here on the bar has its height with the procedure in it, and the picture what is left.
    page.until_text("instruction", "Does the arm stand")
    page.part("view").dblclick(position={"x": 300, "y": 500})
    framed = page.screen_of((0.0, 0.0, 0.0))
    page.page.mouse.move(*framed)
    page.page.mouse.wheel(0, -2000)
    page.until(f"Math.abs(window.armbridge.screen_of(0, 0, 0)[1] - {framed[1]}) > 5")
    procedures.publish(procedure="verify", step="pose 2", **asked)
    page.until_text("swept-elbow_flex-droop", "droop 2.0°")
    page.until(f"Math.abs(window.armbridge.screen_of(0, 0, 0)[1] - {framed[1]}) < 1")
    assert page.page.get_by_role("meter").count() == 0


def test_whoever_may_not_configure_sees_the_procedure_and_why_it_is_grey(
    routed: OpenPage, server: RunningServer
) -> None:
    page = routed
    procedures = ScriptedProcedures(page, role="operate")
    page.open(server.port)
    page.until_state("s.identity?.role === 'operate'")
    page.open_panel("arm", "commissioning")
    page.until_text("commissioning-reason", "needs a token with the role admin")
    assert page.part("calibrate").is_disabled()
    procedures.publish(**SWEEP)
    page.until_text("instruction", "Move every joint.")
    page.pause(500)
    assert page.part("answer-0").is_disabled()
    assert page.part("procedure-cancel").is_disabled()


def test_a_server_without_procedures_has_no_such_section(routed: OpenPage, server: RunningServer) -> None:
    page = routed
    ScriptedProcedures(page, offered=False)
    page.open(server.port)
    page.until_state("s.identity !== null && s.servos.length > 0")
    page.open_panel("arm")
    assert page.part("section-servos").is_visible()
    assert page.part("section-commissioning").is_hidden()
