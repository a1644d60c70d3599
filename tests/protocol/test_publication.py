import json

from protocol.publication import Publication


def publication(msg=None):
    return Publication("/chatter", "std_msgs/msg/String", {"data": "hello"} if msg is None else msg)


def test_a_frame_has_three_keys_in_order_and_the_topic_as_the_subscriber_spells_it():
    assert publication().frame("chatter") == b'{"op":"publish","topic":"chatter","msg":{"data":"hello"}}'


def test_subscribers_of_one_spelling_share_the_same_bytes():
    message = publication()
    assert message.frame("/chatter") is message.frame("/chatter")


def test_each_spelling_has_a_frame_of_its_own():
    message = publication()
    assert json.loads(message.frame("/chatter"))["topic"] == "/chatter"
    assert json.loads(message.frame("chatter"))["topic"] == "chatter"


def test_the_message_is_encoded_once_for_all_spellings():
    message = publication({"data": "before"})
    message.frame("/chatter")
    message.msg["data"] = "after"
    assert json.loads(message.frame("chatter"))["msg"] == {"data": "before"}


def test_topics_and_messages_beyond_ascii_are_escaped():
    frame = publication({"data": "größer 😀"}).frame('/a"ü')
    assert frame.isascii()
    assert json.loads(frame) == {"op": "publish", "topic": '/a"ü', "msg": {"data": "größer 😀"}}


def test_nan_and_infinity_go_out_as_null():
    frame = publication({"data": [float("nan"), float("inf"), 1.0]}).frame("/a")
    assert json.loads(frame)["msg"]["data"] == [None, None, 1.0]
