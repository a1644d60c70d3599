"""A zenoh network on this machine: servers' graphs with their bridges, and a machine that speaks as rmw_zenoh does.

What that machine sends and expects is written down here anew, by rosbags' CDR and hashes, not by the server's code.
"""

from __future__ import annotations

import asyncio
import json
import struct
import threading
import time
from collections.abc import AsyncIterator
from contextlib import asynccontextmanager
from typing import Any

import zenoh
from rosbags.typesys import Stores, get_typestore

from harness.server import free_port
from harness.waiting import TIMEOUT_S, until
from protocol.publication import PublishedMessage
from server.access.authorization import Access
from server.access.settings import AccessSettings
from server.graph.permissions import Node
from server.graph.services import Call
from server.graph.topics import Graph, Subscriber
from server.zenoh.bridge import Bridge
from server.zenoh.settings import ZenohSettings
from tests.helpers.messages import REGISTRY
from tests.helpers.rules import with_server_rules

STORE = get_typestore(Stores.ROS2_JAZZY)

TRIGGER_KEY = "std_srvs::srv::dds_::Trigger_/RIHS01_eeff2cd6fa5ad9d27cdf4dec64818317839b62f212a91e6b5304b634b2062c5f"


class Site:
    """One server as far as the bridge sees it: a graph with a part of the server and a client in it.

    Args:
        port: where the session listens; None to connect.
        to: ports that it connects to.
        access: the section of that name.
        arms: names of several arms; empty for one.
        max_message_bytes: of what comes in [bytes].
        settings: further ones of the section ``zenoh``.
    """

    def __init__(
        self,
        port: int | None = None,
        to: tuple[int, ...] = (),
        access: AccessSettings | None = None,
        arms: tuple[str, ...] = (),
        max_message_bytes: int = 10_000_000,
        **settings: Any,
    ) -> None:
        ends = {"listen": [port] if port else [], "connect": to}
        endpoints: dict[str, Any] = {
            name: tuple(f"tcp/127.0.0.1:{each}" for each in ports) for name, ports in ends.items()
        }
        self.namespace = settings.get("namespace", "")
        self.graph = with_server_rules(Graph(REGISTRY), *arms)
        self.part, self.client = Node("part"), Node("client", remote=True)
        self.access = Access(access or AccessSettings(control="shared"), arms=dict.fromkeys(arms, lambda: None))
        chosen = {"mode": "peer", "publish": (), **endpoints, **settings}
        self.bridge = Bridge(self.graph, ZenohSettings(**chosen), self.access, max_message_bytes)
        self._tasks: list[asyncio.Task[None]] = []

    async def __aenter__(self) -> Site:
        self._tasks.append(asyncio.create_task(self.bridge.run()))
        await until(lambda: self.bridge._sharing is not None)
        return self

    async def __aexit__(self, *_: object) -> None:
        await self.leave()

    async def leave(self) -> None:
        """Leave the network, and wait until that is done."""
        for task in self._tasks:
            task.cancel()
            await asyncio.wait([task])

    def hear(self, topic: str, type_name: str | None = None, node: Node | None = None) -> list[PublishedMessage]:
        """Subscribe, as the client if nobody else; what comes is appended to the list."""
        heard: list[PublishedMessage] = []
        heard += self.graph.subscribe(node or self.client, topic, type_name, Subscriber(heard.append))
        return heard

    async def held_network(self) -> threading.Event:
        """Let the network stand still, until the event is set."""
        held, go_on = threading.Event(), threading.Event()

        def hold(_session: object) -> None:
            held.set()
            go_on.wait(TIMEOUT_S)

        self.bridge._thread.submit(hold)
        await until(held.is_set)
        return go_on

    async def until_seen(self, part: str) -> None:
        """Wait until this server sees a token with this text, and with it all that its machine declared before."""
        seen = threading.Event()

        def look(sample: zenoh.Sample) -> None:
            if part in str(sample.key_expr):
                seen.set()

        self.bridge._thread.submit(
            lambda session: session.liveliness().declare_subscriber("@ros2_lv/**", look, history=True)
        )
        await until(seen.is_set)

    def calls_of(self, service: str) -> list[Call]:
        """Calls of a service that are on their way."""
        offer = self.graph.services._offers.get(service)
        return [] if offer is None else list(offer.requests.values())

    async def called(self, service: str, arguments: dict[str, Any] | None = None) -> Any:
        """Call a service as the client, and wait for the response."""
        answer: asyncio.Future[Any] = asyncio.get_running_loop().create_future()
        self.graph.services.call(self.client, service, arguments or {}, answer.set_result, TIMEOUT_S)
        return await answer


class RosMachine:
    """A machine with ROS 2 and rmw_zenoh of a domain, as far as it can be told from the outside."""

    def __init__(self, port: int, domain_id: int = 0) -> None:
        config = zenoh.Config()
        settings = {
            "connect/endpoints": [f"tcp/127.0.0.1:{port}"],
            "listen/endpoints": [],
            "scouting/multicast/enabled": False,
            "timestamping/enabled": True,
            # Else it waits half a second for machines that there are none of.
            "open/return_conditions/connect_scouted": False,
        }
        for path, value in settings.items():
            config.insert_json5(path, json.dumps(value))
        self.session = zenoh.open(config)
        self.tokens: set[str] = set()
        self._declared: list[Any] = []
        self.session.liveliness().declare_subscriber(f"@ros2_lv/{domain_id}/**", self._on_token, history=True)

    def __enter__(self) -> RosMachine:
        return self

    def __exit__(self, *_: object) -> None:
        self.session.close()

    def key(self, topic: str, type_name: str) -> str:
        package, _, name = type_name.split("/")
        return f"0{topic}/{package}::msg::dds_::{name}_/{STORE.hash_rihs01(type_name)}"

    def announce(self, kind: str, topic: str, type_and_hash: str, qos: str = "::,7:,:,:,,") -> Any:
        """Declare a token, for a topic or service of this machine."""
        mangled = topic.replace("/", "%")
        token = f"@ros2_lv/0/{self.session.zid()}/0/10/{kind}/%/%/talker/{mangled}/{type_and_hash}/{qos}"
        declared = self.session.liveliness().declare_token(token)
        # It ends with the object.
        self._declared.append(declared)
        return declared

    def announce_topic(self, topic: str, type_name: str, qos: str = "::,7:,:,:,,") -> Any:
        return self.announce("MP", topic, "/".join(self.key(topic, type_name).split("/")[-2:]), qos)

    def message(self, type_name: str, **fields: Any) -> bytes:
        return bytes(STORE.serialize_cdr(STORE.types[type_name](**fields), type_name))

    def publish(self, topic: str, type_name: str, **fields: Any) -> None:
        self.session.put(self.key(topic, type_name), self.message(type_name, **fields), attachment=attached(1))

    def hear(self, topic: str, type_name: str) -> list[tuple[Any, bytes]]:
        """Messages of a topic with what is attached to them; what comes is appended to the list."""
        heard: list[tuple[Any, bytes]] = []

        def take(sample: zenoh.Sample) -> None:
            assert sample.attachment is not None
            heard.append((STORE.deserialize_cdr(bytes(sample.payload), type_name), bytes(sample.attachment)))

        self.session.declare_subscriber(self.key(topic, type_name), take)
        return heard

    def call(self, service: str, payload: bytes = b"\0\1\0\0\0", key: str = "", number: int = 7) -> list[zenoh.Reply]:
        """Call a std_srvs/Trigger, and wait for all replies."""
        return list(
            self.session.get(
                key or f"0{service}/{TRIGGER_KEY}",
                target=zenoh.QueryTarget.ALL_COMPLETE,
                consolidation=zenoh.ConsolidationMode.NONE,
                payload=payload,
                attachment=attached(number),
                timeout=TIMEOUT_S,
            )
        )

    def has_token(self, part: str) -> bool:
        """Return true if a token with this text has been announced."""
        return any(part in token for token in list(self.tokens))

    def _on_token(self, sample: zenoh.Sample) -> None:
        (self.tokens.add if sample.kind == zenoh.SampleKind.PUT else self.tokens.discard)(str(sample.key_expr))


@asynccontextmanager
async def networked(**settings: Any) -> AsyncIterator[tuple[Site, RosMachine]]:
    """One server's bridge, with the settings of a :class:`Site`, and a ROS 2 machine that is connected to it."""
    port = free_port()
    async with Site(port, **settings) as site:
        with RosMachine(port) as machine:
            yield site, machine


def attached(number: int) -> bytes:
    """Return the attachment of rmw_zenoh."""
    return struct.pack("<qqB16s", number, time.time_ns(), 16, b"a-ros-2-machine.")
