from __future__ import annotations

from server.gateway.connection import Traffic, TrafficCounts
from server.operations.metrics.clients import client_metrics, refusal_metrics, zenoh_metrics
from tests.helpers.metric_samples import samples
from tests.helpers.watched_parts import WatchedRecorder


class Talk:
    """A connection."""

    queued_bytes = 70

    def counts(self) -> TrafficCounts:
        return TrafficCounts(1, 2, 3, 4, 5, 6)


def test_who_was_not_let_in_is_counted_by_why() -> None:
    found = samples(refusal_metrics(lambda: {"origin": 3, "limit": 0}))
    told = {("armbridge_refused_connections_total", "origin"): 3, ("armbridge_refused_connections_total", "limit"): 0}
    assert found == told


def test_what_was_lost_between_machines_is_told() -> None:
    assert samples(zenoh_metrics(WatchedRecorder(dropped=7))) == {("armbridge_zenoh_dropped_messages_total",): 7}


def test_each_count_is_told_under_its_own_name() -> None:
    traffic = Traffic()
    for _ in range(2):
        traffic.add(Talk())
    assert samples(client_metrics(traffic)) == {
        ("armbridge_clients",): 2,
        ("armbridge_clients_queued_bytes",): 140,
        ("armbridge_clients_queued_greatest_bytes",): 70,
        ("armbridge_connections_total",): 2,
        ("armbridge_received_messages_total",): 2,
        ("armbridge_received_bytes_total",): 4,
        ("armbridge_sent_messages_total",): 6,
        ("armbridge_sent_bytes_total",): 8,
        ("armbridge_dropped_messages_total",): 10,
        ("armbridge_refused_operations_total",): 12,
    }
