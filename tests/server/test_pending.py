from __future__ import annotations

from server.pending import Pending


def test_the_first_end_is_told_once_to_all_in_order_of_asking() -> None:
    heard: list[str] = []
    pending: Pending[str] = Pending()
    pending.when_ended(lambda end: heard.append(f"a {end}"))
    pending.when_ended(lambda end: heard.append(f"b {end}"))
    pending._end("first")
    pending._end("second")
    assert heard == ["a first", "b first"]
    assert pending.ended
