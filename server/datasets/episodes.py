"""Episodes of a recording: marks on the topic ``/dataset/episode``, and the spans of time between them."""

from collections.abc import Iterable
from dataclasses import dataclass, field, replace
from typing import Literal, TypeAlias

from server.errors import ServiceError

EPISODE_TOPIC, EPISODE_TYPE = "/dataset/episode", "std_msgs/String"
COMPRESSED_IMAGE, RAW_IMAGE = "sensor_msgs/msg/CompressedImage", "sensor_msgs/msg/Image"
IMAGES = COMPRESSED_IMAGE, RAW_IMAGE

Kind: TypeAlias = Literal["start", "stop", "discard"]
START: Kind = "start"
STOP: Kind = "stop"
DISCARD: Kind = "discard"

# 25 periods of the states: a longer gap is no jitter of a network, and nobody knows what happened in it.
MAX_GAP_S = 0.5

# A task is one sentence for a model that reads language; lerobot's own are some 50 characters long.
MAX_TASK_CHARACTERS = 300


@dataclass(frozen=True)
class Mark:
    """Mark of an episode; the task of a start may be empty."""

    kind: Kind
    task: str = ""

    @property
    def text(self) -> str:
        return f"{self.kind} {self.task}".rstrip()


@dataclass(frozen=True)
class Episode:
    """Span of a recording."""

    start_s: float
    end_s: float
    task: str


def parse_mark(text: str) -> Mark:
    """Read a mark, or raise ServiceError."""
    kind, _, rest = text.strip().partition(" ")
    task = " ".join(rest.split())
    if kind == START:
        return Mark(START, checked_task(task))
    if task or kind not in (STOP, DISCARD):
        raise ServiceError(f"data: must be 'start', 'start TASK', 'stop' or 'discard', not {text[:40]!r}")
    return Mark(STOP if kind == STOP else DISCARD)


def checked_task(task: str) -> str:
    """Return a task in one line, or raise ServiceError if it is too long."""
    task = " ".join(task.split())
    if len(task) > MAX_TASK_CHARACTERS:
        raise ServiceError(f"task: must have at most {MAX_TASK_CHARACTERS} characters, not {len(task)}")
    return task


@dataclass
class EpisodeMarks:
    """State between marks: the ``open`` episode, None between episodes, and the kept ``ended`` episodes."""

    open: Episode | None = None
    ended: list[Episode] = field(default_factory=list)
    notes: list[str] = field(default_factory=list)

    def take(self, mark: Mark, at_s: float) -> None:
        """Take the next mark.

        A start within an episode ends that one. A discard drops the episode in progress; between episodes it drops the
        last one, because people see that an attempt has failed when it is over.
        """
        if mark.kind == START:
            if self.open is not None:
                self.notes.append(f"an episode was started at {at_s:.1f} s within another, which ends there")
                self._end(at_s)
            self.open = Episode(at_s, at_s, mark.task)
        elif mark.kind == STOP:
            if self.open is None:
                self.notes.append(f"the stop at {at_s:.1f} s has no start and counts for nothing")
            self._end(at_s)
        elif self.open is not None:
            self.open = None
        elif self.ended:
            self.ended.pop()
        else:
            self.notes.append(f"the discard at {at_s:.1f} s has no episode and counts for nothing")

    def finish(self, at_s: float) -> None:
        """End an episode that is in progress when the recording ends."""
        if self.open is not None:
            self.notes.append(
                f"the episode started at {self.open.start_s:.1f} s was not stopped, and ends with the file"
            )
            self._end(at_s)

    def _end(self, at_s: float) -> None:
        if self.open is not None:
            self.ended.append(replace(self.open, end_s=at_s))
            self.open = None


def episodes_of(marks: Iterable[tuple[float, str]], start_s: float, end_s: float) -> tuple[list[Episode], list[str]]:
    """Return the episodes of a recording, one without marks, and sentences about marks that do not fit."""
    state, marked = EpisodeMarks(), False
    for at_s, text in marks:
        marked = True
        try:
            state.take(parse_mark(text), at_s)
        except ServiceError as error:
            state.notes.append(f"the mark at {at_s:.1f} s counts for nothing: {error}")
    state.finish(end_s)
    return (state.ended if marked else [Episode(start_s, end_s, "")]), state.notes
