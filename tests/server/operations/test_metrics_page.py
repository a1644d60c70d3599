from __future__ import annotations

from prometheus_client.parser import text_string_to_metric_families
from websockets.datastructures import Headers
from websockets.http11 import Request

from server.operations.distribution import Distribution
from server.operations.metrics_page import MetricsPage
from server.operations.parts import Parts


async def test_who_scrapes_gets_the_metrics_in_the_format_that_is_wanted() -> None:
    page = MetricsPage(Parts(), Distribution((1.0,)))
    plain = await page.answer(Request("/metrics", Headers()))
    assert plain.headers["Content-Type"].startswith("text/plain; version=")
    assert any(family.name == "armbridge_live" for family in text_string_to_metric_families(plain.body.decode()))
    accepting = Headers({"Accept": "application/openmetrics-text; version=1.0.0"})
    modern = await page.answer(Request("/metrics", accepting))
    assert modern.headers["Content-Type"].startswith("application/openmetrics-text")
    assert modern.body.endswith(b"# EOF\n")
