"""When the messages of one client leave its queue, and which are dropped: a course of steps for each rule."""

import pytest

from protocol.errors import MessageError
from protocol.limits import Limits
from protocol.publication import FRAME_OVERHEAD_BYTES, EncodedMessage, Frame
from protocol.send_queue import BULKY_BYTES, SendQueue
from protocol.subscriptions import Subscription
from tests.helpers.cost import count_calls

MESSAGE_BYTES = 10 + FRAME_OVERHEAD_BYTES


def encoded(name: str) -> EncodedMessage:
    """A message of 10 bytes, or a bulky one if its name is in capitals; a plus is between two fragments."""
    size_bytes = BULKY_BYTES - FRAME_OVERHEAD_BYTES if name.isupper() else 10
    return EncodedMessage(*(Frame(part.encode().ljust(size_bytes), text=True) for part in name.split("+")))


class Course:
    """A queue at which steps are taken, in a time of its own.

    A step queues messages on a topic or as replies (``PLACE < NAMES``), the encoding of those with a question mark
    comes later; sets the time, a field of a topic's subscription, or a bound; or expects what follows its colon.
    """

    def __init__(self) -> None:
        self.queue = SendQueue(Limits(max_topic_delay_s=10.0))
        self.now_s = 0.0
        self.topics: dict[str, Subscription] = {}
        self.later: dict[str, EncodedMessage] = {}

    def topic(self, name: str) -> Subscription:
        return self.topics.setdefault(name, Subscription(f"/{name}", last_sent_s=0.0))

    def message(self, name: str) -> EncodedMessage:
        message = encoded(name.removeprefix("?"))
        if name[0] == "?":
            self.later[name[1:]] = EncodedMessage.later(lambda: message, message.size_bytes)
        return self.later.get(name[1:], message)

    def found(self, what: list[str]) -> object:
        """What leaves, for a budget of so many messages; the time of the next; what begins to be encoded."""
        match what:
            case ["leave", *messages]:
                left = self.queue.take_due(self.now_s, int(float(*messages or ["1e9"]) * MESSAGE_BYTES))
                return " ".join("+".join(frame.data.decode().strip() for frame in each.frames) for each in left)
            case ["next"]:
                return "" if (due_s := self.queue.next_due(self.now_s)) is None else f"{due_s:g}"
            case ["encoding"]:
                begun = self.queue.take_unready()
                return " ".join(name for name, each in self.later.items() if each in begun)
        return getattr(self.queue, what[0])

    def take(self, steps: str) -> None:
        for step in steps.split(";"):
            match step.split():
                case ["reply", "<", *names]:
                    for name in names:
                        self.queue.put_reply(self.message(name))
                case [topic, "<", *names]:
                    for name in names:
                        self.queue.put_topic_data(self.topic(topic), self.message(name), self.now_s)
                case ["at", seconds]:
                    self.now_s = float(seconds)
                case ["drop", "late"]:
                    self.queue.drop_late(self.now_s)
                case ["encoded", name]:
                    self.later[name].encode()
                case [bound, value] if bound.startswith("max_"):
                    unit = MESSAGE_BYTES if bound.endswith("bytes") else 1
                    self.queue = SendQueue(Limits.model_construct(**{bound: int(value) * unit}))
                case [topic, field, value] if ":" not in step:
                    setattr(self.topic(topic), field, float(value))
                case _:
                    what, _, expected = step.partition(":")
                    assert str(self.found(what.split())) == expected.strip(), step


PACED = "t queue_length 10; t throttle_s 1; "
COURSES = {
    "what is queued leaves once, in that order": (
        "a < 1; reply < 2; b < 3; a < 4; reply < 5; at 1; next: 1; leave: 1 2 3 4 5; leave: ; next: "
    ),
    "beyond the bound of bytes the oldest topic data is dropped whatever its topic, and no reply": (
        "max_queued_bytes 4; reply < r; b < 0 1; a < 2 3 4; leave: r 2 3 4; dropped: 2"
    ),
    "beyond the bound of messages the oldest are dropped": "max_queued_messages 3; a < 0 1 2 3 4; leave: 2 3 4",
    "a queue length keeps the newest of its topic only": (
        "a < 0 1 2; b queue_length 2; b < 3 4 5 6 7; leave: 0 1 2 6 7; dropped: 3"
    ),
    "a queue length that is shortened gives up the oldest": (
        f"{PACED} t < 0 1 2 3 4; t queue_length 2; t < 5; at 1; leave: 4; at 2; leave: 5; at 3; leave: "
    ),
    "messages leave one per throttle interval": (
        f"{PACED} t < 0 1 2; at 5; leave: 0; next: 6; at 5.9; leave: ; at 6.1; leave: 1; at 9; leave: 2; next: "
    ),
    "a throttled topic holds nothing else back": (
        f"{PACED} t last_sent_s 4.5; t < later; a < now; reply < r; at 5; leave: now r; next: 5.5; at 5.5; leave: later"
    ),
    "messages of a closed subscription are not sent": (
        f"{PACED} t last_sent_s 4.5; t < 0 1 2; t closed 1; at 5; next: 5; leave: ; next: "
    ),
    "replies up to their bound are kept, and one more overflows": (
        "max_queued_reply_bytes 3; reply < 0 1 2; leave: 0 1 2; reply < 0 1 2; overflowed: False; reply < 3; "
        "overflowed: True; leave: 0 1 2"
    ),
    "a budget is kept to within one message, and the rest leaves later in order": (
        "a < 0; b < 1; reply < 2; a < 3; b < 4; reply < 5; leave 2: 0 1; next: 0; leave 2.002: 2 3 4; "
        "leave 0: 5; next: "
    ),
    "the fragments of a message leave together, whatever the budget, and are dropped together": (
        "b queue_length 1; b < 1+2 3+4; reply < 5; leave 0: 3+4; dropped: 1"
    ),
    "messages dropped by a client's own throttle are counted apart": (
        "max_queued_bytes 2; t throttle_s 1; t queue_length 1; t < 0 1 2; dropped: 2; throttled: 2; a < 3 4 5; "
        "dropped: 4; throttled: 3"
    ),
    "what is behind a reply that is still to be encoded waits for it": (
        "reply < ?1 2; encoding: 1; encoding: ; leave: ; next: ; encoded 1; next: 0; leave: 1 2; empty: True; "
        "size_bytes: 0"
    ),
    "topic data that waits alone leaves once it is encoded": "a < ?1; leave: ; next: ; encoded 1; leave: 1; next: ",
    "topic data that nobody wants any more does not leave once it is encoded": (
        "a < ?1; a closed 1; encoded 1; leave: ; next: "
    ),
    "a message may wait from the end of its encoding, and no longer": (
        "a < ?1; at 11; drop late; encoded 1; at 11.1; drop late; leave: 1; at 20; a < ?2; at 31; drop late; "
        "encoded 2; at 41.1; drop late; leave: ; dropped: 1"
    ),
    "a subscription that is too far behind gets the newest": (
        "a < 0; at 4; a < 1; at 8; a < 2; at 14; a < 3; dropped: 1; at 14.1; a < 4; dropped: 2; leave: 2 3 4"
    ),
    "one burst waits as long as the client reads of it": (
        "a < 0 1 2; b < 3; leave 0: 0; at 6; b < 4; leave 0: 1; at 12; b < 5; dropped: 1; leave: 2 4 5"
    ),
    "topic data is dropped of a client that stands still, and replies stay": (
        "a < 0 1 2; reply < r; at 1; b < new; at 10.5; drop late; dropped: 3; leave: r new"
    ),
    "messages that wait for the client's own throttle are not late": (
        f"{PACED} t throttle_s 60; t < 0 1 2; at 10; drop late; t < 3; at 70; drop late; t < 4; dropped: 0; "
        "at 70.1; drop late; dropped: 4; leave: 4"
    ),
    "messages of a topic keep their order when its throttle comes and goes": (
        "t queue_length 10; t < 0; t throttle_s 0.3; t < 1; t throttle_s 0; t < 2; t throttle_s 0.3; t < 3; at 1; "
        "leave: 0; at 2; leave: 1; at 3; leave: 2; t throttle_s 0; t < 4; leave: 3 4; empty: True"
    ),
    "small messages go ahead of large ones of other topics when the client is behind": (
        "b < BIG HUGE; at 0.3; a < small; reply < r; leave: small r BIG; leave: HUGE"
    ),
    "all leave in order of queuing while the client keeps up": (
        "b < BIG; a < small; reply < r; at 0.25; leave: BIG small r"
    ),
    "large messages come through to a client that is behind with small ones too": (
        "b < BIG HUGE; a < 0 1 2; at 1; leave 0: 0; leave 0: BIG; leave 0: 1; leave 0: HUGE; leave: 2"
    ),
    "small messages do not wait for a large one whose encoding takes long": (
        "b < ?BIG; a < small; at 0.25; leave: ; next: ; at 1; next: 1; leave: small; next: ; encoded BIG; next: 1; "
        "leave: BIG"
    ),
}


@pytest.mark.parametrize("steps", COURSES.values(), ids=COURSES)
def test_a_queue_takes_its_course(steps: str) -> None:
    Course().take(steps)


def test_requests_up_to_their_bound_are_kept_and_one_more_is_refused() -> None:
    queue = SendQueue(Limits.model_construct(max_queued_request_bytes=2 * MESSAGE_BYTES))
    assert [queue.put_request(encoded(name)) for name in "123"] == [True, True, False]
    assert len(queue.take_due(1.0, 10**9)) == 2
    assert queue.put_request(encoded("4"))


def test_one_request_and_one_reply_may_have_any_size_and_take_no_room_from_each_other() -> None:
    queue = SendQueue(Limits.model_construct(max_queued_request_bytes=1, max_queued_reply_bytes=1))
    assert queue.put_request(encoded("1"))
    for overflowed in (False, True):
        queue.put_reply(encoded("2"))
        assert queue.overflowed is overflowed


def test_a_message_that_could_not_be_encoded_holds_nobody_up() -> None:
    def fail() -> EncodedMessage:
        raise MessageError("a number", "nothing")

    course, broken = Course(), EncodedMessage.later(fail, 100)
    course.queue.put_reply(broken)
    course.take("reply < next")
    with pytest.raises(MessageError):
        broken.encode()
    course.take("leave: next")


def test_messages_that_wait_for_a_throttle_are_not_looked_at_when_others_leave() -> None:
    course = Course()
    course.take(f"t throttle_s 1; t queue_length 1000; t < {' '.join(map(str, range(1000)))}")
    assert count_calls(lambda: course.queue.take_due(0.9, 10**9)) < 100
