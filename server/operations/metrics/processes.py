"""The server's processes, its event loop, and which version it is."""

from __future__ import annotations

import functools
import os
import platform
from collections.abc import Iterator, Mapping
from importlib import metadata

from prometheus_client.core import CounterMetricFamily, GaugeMetricFamily, InfoMetricFamily, Metric

from server.operations.distribution import Distribution
from server.operations.metrics.distributions import histogram
from server.operations.process_figures import process_figures


def process_metrics(children: Mapping[str, int]) -> Iterator[Metric]:
    """What each process uses.

    Args:
        children: process id by what the process is.
    """
    labels = ("process",)
    memory = GaugeMetricFamily("armbridge_process_resident_memory_bytes", "Memory that is held.", labels=labels)
    threads = GaugeMetricFamily("armbridge_process_threads", "Threads.", labels=labels)
    files = GaugeMetricFamily("armbridge_process_open_fds", "Open file descriptors.", labels=labels)
    cpu = CounterMetricFamily("armbridge_process_cpu_seconds", "Processor time used.", labels=labels)
    for name, pid in {"server": os.getpid(), **children}.items():
        figures = process_figures(pid)
        if figures is not None:
            memory.add_metric((name,), figures.resident_bytes)
            threads.add_metric((name,), figures.threads)
            files.add_metric((name,), figures.open_files)
            cpu.add_metric((name,), figures.cpu_s)
    yield from (memory, threads, files, cpu)


def loop_metrics(lag_s: Distribution) -> Iterator[Metric]:
    """How late the event loop is."""
    yield histogram("armbridge_event_loop_lag_seconds", "Time by which the event loop woke up too late.", lag_s)


def build_metrics() -> Iterator[Metric]:
    """Which version this is."""
    about = {"version": _version(), "python": platform.python_version()}
    yield InfoMetricFamily("armbridge_build", "Version of armbridge and of Python.", about)


@functools.cache
def _version() -> str:
    return metadata.version("armbridge")
