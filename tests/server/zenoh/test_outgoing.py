from __future__ import annotations

import struct

import zenoh
import zenoh.ext

from server.zenoh import outgoing
from tests.helpers.zenoh_network import RosMachine, Site, free_port, until

STRING = "std_msgs/msg/String"


async def test_a_message_goes_out_as_a_ros_2_machine_expects_it() -> None:
    port = free_port()
    async with Site(port, publish=("/news",)) as site:
        site.graph.advertise(site.part, "/news", STRING)
        with RosMachine(port) as machine:
            heard = machine.hear("/news", STRING)
            await until(lambda: machine.has_token("/MP/%/%/armbridge/%news/std_msgs::msg::dds_::String_/RIHS01_df66"))
            for text in ("one", "two"):
                site.graph.publish(site.part, "/news", {"data": text})
            await until(lambda: len(heard) == 2)
    assert [message.data for message, _ in heard] == ["one", "two"]
    first, second = (struct.unpack("<qqB16s", attached) for _, attached in heard)
    assert (first[0], second[0]) == (1, 2)
    assert 0 <= second[1] - first[1] < 1_000_000_000
    assert first[2:] == second[2:]


async def test_a_namespace_stands_before_the_names_at_the_others() -> None:
    port = free_port()
    async with Site(port, publish=("/news",), namespace="/arm1") as site:
        site.graph.advertise(site.part, "/news", STRING)
        with RosMachine(port) as machine:
            heard = machine.hear("/arm1/news", STRING)
            await until(lambda: machine.has_token("/MP/%/%arm1/armbridge/%arm1%news/"))
            site.graph.publish(site.part, "/news", {"data": "one"})
            await until(lambda: heard)


async def test_who_comes_later_gets_what_is_latched() -> None:
    port = free_port()
    async with Site(port, publish=("/description",)) as site:
        site.graph.advertise(site.part, "/description", STRING, latch=True)
        site.graph.publish(site.part, "/description", {"data": "an arm"})
        with RosMachine(port) as machine:
            await until(lambda: machine.has_token("%description/std_msgs"))
            assert machine.has_token("/:1:,1:,:,:,,")
            heard: list[bytes] = []
            history = zenoh.ext.HistoryConfig(detect_late_publishers=True, max_samples=1)
            zenoh.ext.declare_advanced_subscriber(
                machine.session,
                machine.key("/description", STRING),
                lambda sample: heard.append(bytes(sample.payload)),
                history=history,
            )
            await until(lambda: heard)
            assert heard == [machine.message(STRING, data="an arm")]


async def test_what_fits_no_pattern_and_what_has_no_name_of_ros_stays_here() -> None:
    port = free_port()
    async with Site(port, publish=("/news*", "/*\\*")) as site:
        for name in ("/other", "/news/**", "/news"):
            site.graph.advertise(site.part, name, STRING)
        with RosMachine(port) as machine:
            await until(lambda: machine.has_token("%news"))
            assert len([token for token in machine.tokens if "/MP/" in token]) == 1


async def test_a_topic_that_nobody_publishes_any_more_is_taken_back() -> None:
    port = free_port()
    async with Site(port, publish=("/news",)) as site:
        site.graph.advertise(site.client, "/news", STRING)
        with RosMachine(port) as machine:
            await until(lambda: machine.has_token("%news"))
            site.graph.unadvertise(site.client, "/news")
            await until(lambda: not machine.has_token("%news"))
        assert site.graph.subscribers("/news") == []


async def test_what_a_client_publishes_on_a_new_topic_is_not_lost() -> None:
    port = free_port()
    async with Site(port, publish=("/news",)) as site:
        with RosMachine(port) as machine:
            heard = machine.hear("/news", STRING)
            await until(lambda: machine.has_token("/NN/"))
            site.graph.advertise(site.client, "/news", STRING)
            site.graph.publish(site.client, "/news", {"data": "one"}, lifespan_s=1.0)
            await until(lambda: heard)


async def test_of_messages_that_come_faster_than_the_network_takes_them_the_newest_go_out() -> None:
    port = free_port()
    count = 3 * outgoing.MAX_WAITING
    async with Site(port, publish=("/news",)) as site:
        site.graph.advertise(site.part, "/news", STRING)
        with RosMachine(port) as machine:
            heard = machine.hear("/news", STRING)
            await until(lambda: machine.has_token("%news"))
            go_on = await site.held_network()
            for number in range(count):
                site.graph.publish(site.part, "/news", {"data": str(number)})
            go_on.set()
            await until(lambda: heard and heard[-1][0].data == str(count - 1))
        assert [message.data for message, _ in heard] == [
            str(each) for each in range(count - outgoing.MAX_WAITING, count)
        ]
        assert site.bridge.dropped == count - outgoing.MAX_WAITING
