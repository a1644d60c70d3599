"""Services that mark episodes while the server records: start, stop and discard."""

import asyncio
import logging
from collections.abc import Callable
from typing import Any

from protocol.publication import PublishedMessage
from server.datasets.episodes import (
    DISCARD,
    EPISODE_TOPIC,
    EPISODE_TYPE,
    MAX_GAP_S,
    START,
    STOP,
    EpisodeMarks,
    Mark,
    checked_task,
    parse_mark,
)
from server.graph.node import Node
from server.graph.permissions import WORKING
from server.graph.topics import Graph, Subscriber

log = logging.getLogger("armbridge.datasets")

START_SERVICE, START_TYPE = "/dataset/start_episode", "armbridge_msgs/srv/StartEpisode"
STOP_SERVICE = "/dataset/stop_episode"
DISCARD_SERVICE = "/dataset/discard_episode"

# What this server knows of the episodes is for its answers alone; the recording has them all.
MAX_KEPT = 10_000

IMAGE = "sensor_msgs/msg/CompressedImage"

# Published while somebody subscribes, and the arm's states are read at their full rate then.
STATE_TOPIC, COMMANDED_TOPICS = "/joint_states", "_controller/controller_state"

NOT_RECORDED = "this server records nothing (armbridge serve --record FILE.mcap)"


class EpisodeServices:
    """Offers the services, which publish their marks on ``/dataset/episode``; clients may publish there as well.

    While an episode is recorded, it subscribes to states and commands, which nobody else may have asked for.
    """

    def __init__(self, graph: Graph, recording: Callable[[], bool], clock: Callable[[], float] | None = None) -> None:
        self._graph = graph
        self._recording = recording
        self._clock = clock or asyncio.get_running_loop().time
        self._node = Node("dataset")
        self._observer = Node("dataset observer")
        self._marks = EpisodeMarks()
        # Cameras, and the arm's states: time of the last message and the longest silence of the episode [s].
        self._watched: dict[str, tuple[float, float]] = {}
        graph.advertise(self._node, EPISODE_TOPIC, EPISODE_TYPE)
        graph.subscribe(self._node, EPISODE_TOPIC, EPISODE_TYPE, Subscriber(self._take, rule=WORKING))
        graph.services.offer(self._node, START_SERVICE, START_TYPE, self._start, rule=WORKING)
        graph.services.offer(self._node, STOP_SERVICE, "std_srvs/Trigger", self._stop, rule=WORKING)
        graph.services.offer(self._node, DISCARD_SERVICE, "std_srvs/Trigger", self._discard, rule=WORKING)

    def _take(self, published: PublishedMessage) -> None:
        try:
            mark = parse_mark(published.msg["data"])
        except ValueError as error:
            log.warning("%s: %s", EPISODE_TOPIC, error)
            return
        now_s, was_open = self._clock(), self._marks.open is not None
        self._marks.take(mark, now_s)
        self._marks.notes.clear()
        if mark.kind == STOP and was_open and (silences := self._silences()):
            log.warning("episode %d %s", len(self._marks.ended), silences)
        if mark.kind == START:
            # A camera of an earlier episode that is gone is missing in this one.
            self._watched = dict.fromkeys(self._watched, (now_s, 0.0))
        del self._marks.ended[:-MAX_KEPT]
        self._observe(wanted=self._marks.open is not None and self._recording())

    def _observe(self, *, wanted: bool) -> None:
        """Subscribe, or no longer, to topics that are published for subscribers alone: the recording then has them."""
        for topic in self._graph.subscriptions.of(self._observer):
            self._graph.unsubscribe(self._observer, topic)
        if not wanted:
            return
        for topic, type_name in self._graph.topic_names.types().items():
            if type_name == IMAGE or topic == STATE_TOPIC:
                self._watched.setdefault(topic, (self._clock(), 0.0))
            if topic in self._watched or topic.endswith(COMMANDED_TOPICS):
                self._graph.subscribe(self._observer, topic, type_name, Subscriber(self._heard))

    def _heard(self, published: PublishedMessage) -> None:
        if (watched := self._watched.get(published.topic)) is not None:
            now_s = self._clock()
            self._watched[published.topic] = now_s, max(watched[1], now_s - watched[0])

    def _silences(self) -> str:
        """Return the sentence about topics that were silent in the episode that ends now; empty for none."""
        now_s = self._clock()
        longest_s = {topic: max(gap_s, now_s - last_s) for topic, (last_s, gap_s) in self._watched.items()}
        silent = [f"{topic} was silent for {gap_s:.1f} s" for topic, gap_s in longest_s.items() if gap_s > MAX_GAP_S]
        return f"would be left out of a dataset: {', '.join(silent)}" if silent and self._recording() else ""

    def _start(self, request: dict[str, Any]) -> dict[str, Any]:
        try:
            mark = Mark(START, checked_task(request["task"]))
        except ValueError as error:
            return _refused(str(error))
        if self._marks.open is not None:
            return _refused(f"an episode is in progress: end it first ({STOP_SERVICE} or {DISCARD_SERVICE})")
        self._publish(mark)
        return self._answer(f"episode {len(self._marks.ended) + 1} has begun")

    def _stop(self, _request: dict[str, Any]) -> dict[str, Any]:
        if self._marks.open is None:
            return _refused(f"no episode is in progress: {START_SERVICE} begins one")
        begun_s, silences = self._marks.open.start_s, self._silences()
        self._publish(Mark(STOP))
        ended = f"episode {len(self._marks.ended)} has ended after {self._clock() - begun_s:.1f} s"
        return self._answer(f"{ended}. It {silences}" if silences else ended)

    def _discard(self, _request: dict[str, Any]) -> dict[str, Any]:
        if self._marks.open is None and not self._marks.ended:
            return _refused("there is no episode to discard")
        which = "the episode in progress" if self._marks.open is not None else "the last episode"
        self._publish(Mark(DISCARD))
        return self._answer(f"{which} is discarded; {len(self._marks.ended)} are left")

    def _publish(self, mark: Mark) -> None:
        self._graph.publish(self._node, EPISODE_TOPIC, {"data": mark.text})

    def _answer(self, message: str) -> dict[str, Any]:
        if not self._recording():
            message = f"{message}, but {NOT_RECORDED}"
        return {"success": True, "message": message}


def _refused(message: str) -> dict[str, Any]:
    return {"success": False, "message": message}
