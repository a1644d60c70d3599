from protocol.registry import Registry
from server.graph import Graph, Subscriber
from server.moveit.scene.interface import TOPIC, MonitoredScene
from server.node import Node
from tests.helpers.clock import FakeClock
from tests.helpers.planning_scene import BENT, ROBOT, box, collision_object, current_state, scene_state

# Not the default.
PERIOD_S = 0.5


class Watched:
    """A scene that is monitored, and who has subscribed."""

    def __init__(self):
        self.clock, self.state = FakeClock(), scene_state(box("table"))
        self.graph = Graph(Registry.load(), self.clock, call_later=self.clock.call_later)
        self.monitored = MonitoredScene(
            self.graph, Node("scene"), ROBOT, self.state, 2.0, self.clock, self.clock.call_later
        )
        self.monitored.open(current_state())
        self.heard = []
        self.first = self.subscribe(self.heard)

    def subscribe(self, heard):
        subscriber = Subscriber(lambda publication: heard.append(publication.msg))
        return [publication.msg for publication in self.graph.subscribe(Node("client"), TOPIC, None, subscriber)]

    def add(self, name):
        assert self.state.apply_object(collision_object(**box(name)), BENT) is None


def ids(message):
    return [each["id"] for each in message["world"]["collision_objects"]]


def test_a_subscriber_gets_the_whole_scene_first():
    (whole,) = Watched().first
    assert (whole["is_diff"], ids(whole)) == (False, ["table"])
    assert len(whole["robot_state"]["joint_state"]["name"]) == 6


def test_a_change_is_told_as_a_difference():
    watched = Watched()
    watched.add("cup")
    watched.clock.advance(0.0)
    (change,) = watched.heard
    assert (change["is_diff"], ids(change)) == (True, ["cup"])


def test_changes_that_come_fast_are_told_together():
    watched = Watched()
    for number in range(10):
        watched.add(str(number))
        watched.clock.advance(0.1 * PERIOD_S)
    watched.clock.advance(PERIOD_S)
    assert [len(ids(change)) for change in watched.heard] == [1, 9]


def test_who_comes_later_gets_the_whole_scene_as_it_is_then():
    watched = Watched()
    watched.add("cup")
    watched.clock.advance(PERIOD_S)
    (whole,) = watched.subscribe([])
    assert (whole["is_diff"], ids(whole)) == (False, ["table", "cup"])


def test_a_change_that_is_taken_back_in_time_is_not_told():
    watched = Watched()
    watched.add("cup")
    watched.clock.advance(0.0)
    watched.add("pen")
    assert watched.state.apply_object(collision_object(id="pen", operation=1), BENT) is None
    watched.clock.advance(PERIOD_S)
    assert len(watched.heard) == 1


def test_after_the_end_nothing_is_told():
    watched = Watched()
    watched.add("cup")
    watched.monitored.close()
    watched.clock.advance(PERIOD_S)
    assert watched.heard == []
