"""Clients: who is there, what they say and hear, and what they miss."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping

from prometheus_client.core import CounterMetricFamily, GaugeMetricFamily, Metric

from server.gateway.connection import Traffic
from server.operations.parts import ZenohPart


def refusal_metrics(refused_connections: Callable[[], Mapping[str, int]]) -> Iterator[Metric]:
    """Who was not let in."""
    family = CounterMetricFamily(
        "armbridge_refused_connections", "Connections and requests that were not let in, by why.", labels=("reason",)
    )
    for reason, count in refused_connections().items():
        family.add_metric((reason,), count)
    yield family


def zenoh_metrics(zenoh: ZenohPart) -> Iterator[Metric]:
    """The network of other machines."""
    yield CounterMetricFamily(
        "armbridge_zenoh_dropped_messages", "Messages lost because network or server were too slow.", zenoh.dropped
    )


def client_metrics(traffic: Traffic) -> Iterator[Metric]:
    """The metrics of the gateway."""
    counts = traffic.counts()
    queued_bytes, most_queued_bytes = traffic.queued_bytes()
    yield GaugeMetricFamily("armbridge_clients", "Clients that are connected.", traffic.clients)
    yield GaugeMetricFamily("armbridge_clients_queued_bytes", "What waits for all clients to read.", queued_bytes)
    yield GaugeMetricFamily(
        "armbridge_clients_queued_greatest_bytes", "What waits for the slowest client to read.", most_queued_bytes
    )
    for name, meaning, value in (
        ("armbridge_connections", "Clients that have connected since the start.", traffic.connections),
        ("armbridge_received_messages", "WebSocket messages that came from clients.", counts.received_messages),
        ("armbridge_received_bytes", "Bytes that came from clients, handshakes included.", counts.received_bytes),
        ("armbridge_sent_messages", "WebSocket messages that went to clients.", counts.sent_messages),
        ("armbridge_sent_bytes", "Bytes of messages that went to clients.", counts.sent_bytes),
        (
            "armbridge_dropped_messages",
            "Messages on topics that clients did not get because they read too slowly.",
            counts.dropped_messages,
        ),
        ("armbridge_refused_operations", "Operations that were not carried out.", counts.refused_operations),
    ):
        yield CounterMetricFamily(name, meaning, value)
