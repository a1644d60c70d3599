from hypothesis import given
from hypothesis import strategies as st

from protocol.names import qualify


def test_a_topic_has_one_name_with_and_without_its_leading_slash():
    assert qualify("joint_states") == qualify("/joint_states") == "/joint_states"


@given(st.text(min_size=1))
def test_a_qualified_name_stays_as_it_is(name):
    assert qualify(qualify(name)) == qualify(name)
