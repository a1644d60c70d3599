"""Services that mark episodes while the server records, and the state of the recording: episodes and their cameras."""

import asyncio
import itertools
import logging
from collections import deque
from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any

from protocol.publication import PublishedMessage
from server.datasets.episodes import (
    DISCARD,
    EPISODE_TOPIC,
    EPISODE_TYPE,
    IMAGES,
    MAX_GAP_S,
    START,
    STOP,
    EpisodeMarks,
    Mark,
    checked_task,
    parse_mark,
)
from server.diagnostic_values import LEVEL_OK, LEVEL_WARN, diagnostic_status
from server.errors import ServiceError
from server.graph.permissions import WORKING, Node
from server.graph.topics import Graph, Subscriber

log = logging.getLogger("armbridge.datasets")

START_SERVICE, START_TYPE = "/dataset/start_episode", "armbridge_msgs/srv/StartEpisode"
STOP_SERVICE = "/dataset/stop_episode"
DISCARD_SERVICE = "/dataset/discard_episode"
STATE, STATE_TYPE = "/dataset/state", "diagnostic_msgs/DiagnosticStatus"

# Episodes that the server remembers for its answers; the recording has all.
MAX_KEPT = 10_000

# Topics that are published while somebody subscribes; the arm's states are read at their full rate then.
STATE_TOPIC, COMMANDED_TOPICS = "/joint_states", "_controller/controller_state"

NOT_RECORDED = "nothing is recorded: no --record FILE.mcap, or the file has its limit_mb, or the disk is full"

# Cameras that are watched: an arm has a few, and clients can make up any number of topics.
MAX_WATCHED = 100

# Period in which an episode in progress is looked at [s].
LOOK_PERIOD_S = 0.5

# A camera is late when its images come later after their stamps [s]: the arm moves 0.2 rad meanwhile at 1 rad/s.
LATE_S = 0.2

# A camera is uneven when two of its latest images are this multiple of their mean interval apart.
UNEVEN, LATEST = 3.0, 30
MIN_LATEST = 8


@dataclass
class Timing:
    """Timing of a topic in an episode: time of its last message, longest silence, and delay behind its stamp [s]."""

    last_s: float
    longest_s: float = 0.0
    delay_s: float = 0.0
    latest_s: deque[float] = field(default_factory=lambda: deque(maxlen=LATEST))

    def take(self, now_s: float, delay_s: float) -> None:
        self.longest_s = max(self.longest_s, now_s - self.last_s)
        self.last_s, self.delay_s = now_s, delay_s
        self.latest_s.append(now_s)

    @property
    def rate_hz(self) -> float:
        """Rate of the latest messages; 0 before there are two."""
        span_s = self.latest_s[-1] - self.latest_s[0] if len(self.latest_s) > 1 else 0.0
        return (len(self.latest_s) - 1) / span_s if span_s > 0.0 else 0.0

    def problem(self, now_s: float) -> str:
        """Return the problem with a camera's images now, empty for none."""
        if now_s - self.last_s > MAX_GAP_S:
            return f"is silent for {now_s - self.last_s:.1f} s"
        if self.delay_s > LATE_S:
            return f"is late: its images come {self.delay_s:.1f} s after their stamps"
        times_s = list(self.latest_s)
        gap_s = max((after - before for before, after in itertools.pairwise(times_s)), default=0.0)
        if len(times_s) >= MIN_LATEST and gap_s * self.rate_hz > UNEVEN:
            return f"is uneven: {self.rate_hz:.0f} images a second, but up to {gap_s:.2f} s apart"
        return ""


class EpisodeServices:
    """Offers the services, which publish their marks on ``/dataset/episode``; clients may publish there as well.

    While an episode is recorded, it subscribes to states, commands and cameras, which nobody else may have asked for,
    and reports problems of their timing on ``/dataset/state`` and in the log.
    """

    def __init__(self, graph: Graph, recording: Callable[[], bool], clock: Callable[[], float] | None) -> None:
        self._graph = graph
        self._recording = recording
        self._clock = clock or asyncio.get_running_loop().time
        self._node = graph.node("dataset")
        self._observer = Node("dataset observer")
        self._marks = EpisodeMarks()
        # Cameras, and the arm's states.
        self._watched: dict[str, Timing] = {}
        self._logged: set[tuple[str, str]] = set()
        self._node.advertise(EPISODE_TOPIC, EPISODE_TYPE)
        self._node.advertise(STATE, STATE_TYPE, latch=True)
        self._node.subscribe(EPISODE_TOPIC, EPISODE_TYPE, self._take, rule=WORKING)
        self._node.offer(START_SERVICE, START_TYPE, self._start, rule=WORKING)
        self._node.offer(STOP_SERVICE, "std_srvs/Trigger", self._stop, rule=WORKING)
        self._node.offer(DISCARD_SERVICE, "std_srvs/Trigger", self._discard, rule=WORKING)
        self._show()

    async def run(self) -> None:
        while True:
            await asyncio.sleep(LOOK_PERIOD_S)
            if self._marks.open is not None:
                self.look()

    def look(self) -> None:
        """Report the timing of the episode in progress, each new problem also in the log."""
        # A camera that began after the episode is watched from now on.
        self._observe(wanted=self._recording())
        for topic, problem in self._problems().items():
            kind = topic, problem.split()[1]
            if kind not in self._logged:
                self._logged.add(kind)
                log.warning("episode %d: %s %s", len(self._marks.ended) + 1, topic, problem)
        self._show()

    def _take(self, published: PublishedMessage) -> None:
        try:
            mark = parse_mark(published.msg["data"])
        except ServiceError as error:
            log.warning("%s: %s", EPISODE_TOPIC, error)
            return
        now_s, was_open = self._clock(), self._marks.open is not None
        self._marks.take(mark, now_s)
        self._marks.notes.clear()
        if mark.kind == STOP and was_open and (silences := self._silences()):
            log.warning("episode %d %s", len(self._marks.ended), silences)
        if mark.kind == START:
            # A camera of an earlier episode that is gone is missing in this one.
            self._watched = {topic: Timing(now_s) for topic in self._watched}
            self._logged.clear()
        del self._marks.ended[:-MAX_KEPT]
        self._observe(wanted=self._marks.open is not None and self._recording())
        self._show()

    def _observe(self, *, wanted: bool) -> None:
        """Subscribe, or no longer, to topics that are published for subscribers alone: the recording then has them."""
        subscribed = set(self._graph.subscriptions.of(self._observer))
        if not wanted:
            for topic in subscribed:
                self._graph.unsubscribe(self._observer, topic)
            return
        if len(self._watched) >= MAX_WATCHED:
            # Cameras that are gone make room for others.
            for topic in [topic for topic in self._watched if not self._graph.publishers(topic)]:
                del self._watched[topic]
                self._graph.unsubscribe(self._observer, topic)
        for topic, type_name in self._graph.topic_names.types().items():
            publishers = self._graph.publishers(topic)
            if len(self._watched) < MAX_WATCHED and publishers and (type_name in IMAGES or topic == STATE_TOPIC):
                self._watched.setdefault(topic, Timing(self._clock()))
            commanded = topic.endswith(COMMANDED_TOPICS) and any(not node.remote for node in publishers)
            if topic not in subscribed and (topic in self._watched or commanded):
                self._graph.subscribe(self._observer, topic, type_name, Subscriber(self._take_timed))

    def _take_timed(self, published: PublishedMessage) -> None:
        if (watched := self._watched.get(published.topic)) is not None:
            stamp, received = published.msg["header"]["stamp"], published.received
            delay_s = received.sec - stamp["sec"] + 1e-9 * (received.nanosec - stamp["nanosec"])
            watched.take(self._clock(), delay_s if stamp["sec"] else 0.0)

    def _problems(self) -> dict[str, str]:
        """Return the problems of cameras in the episode in progress by topic; states come at a rate of their own."""
        now_s = self._clock()
        found = {topic: timing.problem(now_s) for topic, timing in self._watched.items() if topic != STATE_TOPIC}
        return {topic: problem for topic, problem in found.items() if problem}

    def _silences(self) -> str:
        """Return the sentence about topics that were silent in the episode that ends now; empty for none."""
        now_s = self._clock()
        longest_s = {topic: max(each.longest_s, now_s - each.last_s) for topic, each in self._watched.items()}
        silent = [f"{topic} was silent for {gap_s:.1f} s" for topic, gap_s in longest_s.items() if gap_s > MAX_GAP_S]
        return f"would be left out of a dataset: {', '.join(silent)}" if silent and self._recording() else ""

    def _show(self) -> None:
        now_s, opened, ended = self._clock(), self._marks.open, self._marks.ended
        problems = self._problems() if opened is not None and self._recording() else {}
        values = {
            "recording": str(self._recording()).lower(),
            "task": "" if opened is None else opened.task,
            "episode_s": "" if opened is None else f"{now_s - opened.start_s:.1f}",
            "episodes": str(len(ended)),
            "lengths_s": " ".join(f"{each.end_s - each.start_s:.1f}" for each in ended[-LATEST:]),
            **{f"rate_hz.{topic}": f"{timing.rate_hz:.1f}" for topic, timing in self._watched.items()},
        }
        message = "; ".join(f"{topic} {problem}" for topic, problem in problems.items())
        level = LEVEL_WARN if problems else LEVEL_OK
        self._node.publish(STATE, diagnostic_status(level, "episodes", message, values))

    def _start(self, request: dict[str, Any]) -> str:
        mark = Mark(START, checked_task(request["task"]))
        if self._marks.open is not None:
            raise ServiceError(f"an episode is in progress: end it first ({STOP_SERVICE} or {DISCARD_SERVICE})")
        self._publish(mark)
        return self._answer(f"episode {len(self._marks.ended) + 1} has begun")

    def _stop(self, _request: dict[str, Any]) -> str:
        if self._marks.open is None:
            raise ServiceError(f"no episode is in progress: {START_SERVICE} begins one")
        begun_s, silences = self._marks.open.start_s, self._silences()
        self._publish(Mark(STOP))
        ended = f"episode {len(self._marks.ended)} has ended after {self._clock() - begun_s:.1f} s"
        return self._answer(f"{ended}. It {silences}" if silences else ended)

    def _discard(self, _request: dict[str, Any]) -> str:
        if self._marks.open is None and not self._marks.ended:
            raise ServiceError("there is no episode to discard")
        which = "the episode in progress" if self._marks.open is not None else "the last episode"
        self._publish(Mark(DISCARD))
        return self._answer(f"{which} is discarded; {len(self._marks.ended)} are left")

    def _publish(self, mark: Mark) -> None:
        self._node.publish(EPISODE_TOPIC, {"data": mark.text})

    def _answer(self, message: str) -> str:
        return message if self._recording() else f"{message}, but {NOT_RECORDED}"
