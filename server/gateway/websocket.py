"""A WebSocket that hands messages over as they come, for as long as that takes no others' time."""

from __future__ import annotations

import math
import time
from collections.abc import Callable
from typing import Any

from websockets.asyncio.server import ServerConnection
from websockets.frames import Frame, Opcode
from websockets.protocol import State

from protocol.parcel import Parcel

# Looking a member of an enumeration up takes as long as calling a function.
_OPEN, _TEXT, _BINARY = State.OPEN, Opcode.TEXT, Opcode.BINARY

# Messages that follow one another more quickly than this leave together: less than a round trip between two clients,
# which is not to be delayed, and more than a message of a flood takes.
BURST_S = 0.0001

# While more than this waits for the socket to take it, the rest waits where it can be dropped. It is where websockets'
# writer has itself paused (its default write_limit), so `drain` waits exactly then.
WRITE_LIMIT_BYTES = 32_768

# Messages of one client are carried out for no longer than this before others have their turn.
TURN_S = 0.001


class WebSocket(ServerConnection):
    """An open connection.

    Waking a task for each message costs as much as all else that is done for a short one. So a message that comes when
    none waits is handed over at once; what comes after the client's turn is over waits for whoever iterates over the
    connection, as it does with websockets' own class.

    Attributes:
        on_message: called with a message, text or bytes, None while nobody is there to be called; must not raise.
    """

    def __init__(self, *args: Any, **kwargs: Any) -> None:
        super().__init__(*args, **kwargs)
        self.on_message: Callable[[str | bytes], None] | None = None
        self._turn_ends_s = 0.0
        self._last_sent_s = -math.inf
        self._unsent: list[bytes] = []
        self._unsent_bytes = 0

    @property
    def takes_more(self) -> bool:
        """Whether the socket takes a message without waiting."""
        # The order counts: the transport of a connection that is lost can be asked nothing.
        if self.protocol.state is not _OPEN:
            return False
        return bool(self.transport.get_write_buffer_size() + self._unsent_bytes <= WRITE_LIMIT_BYTES)

    def send_at_once(self, parcel: Parcel) -> bool:
        """Send a message, in order of calling, if the socket takes it without waiting; says whether it does.

        A task and an event for each message would cost more than the message, and so would making its frame anew for
        each client. Messages that follow closely upon another leave together, at the end of the event loop's turn: in a
        flood, one call of the kernel a message is a tenth of all that is spent.
        """
        if not self.takes_more:
            return False
        if not self._unsent:
            now_s = time.monotonic()
            if now_s - self._last_sent_s > BURST_S:
                self._last_sent_s = now_s
                self.transport.write(parcel.on_wire)
                return True
            self.loop.call_soon(self._write_unsent)
        self._unsent.append(parcel.on_wire)
        self._unsent_bytes += len(parcel.on_wire)
        return True

    def _write_unsent(self) -> None:
        if self.protocol.state is _OPEN:
            self.transport.writelines(self._unsent)
        self._unsent.clear()
        self._unsent_bytes = 0

    def data_received(self, data: bytes) -> None:
        """Begin a turn with what the socket has received."""
        self._turn_ends_s = time.monotonic() + TURN_S
        super().data_received(data)

    def process_event(self, event: Any) -> None:
        """Hand a message over, or have it wait."""
        if self.on_message is None or not _is_message(event) or not self._may_go_first():
            super().process_event(event)
            return
        try:
            message = event.data.decode() if event.opcode is _TEXT else bytes(event.data)
        except UnicodeDecodeError:
            # Refused where it is read.
            super().process_event(event)
            return
        self.on_message(message)

    def _may_go_first(self) -> bool:
        return not len(self.recv_messages.frames) and time.monotonic() < self._turn_ends_s


def _is_message(event: Any) -> bool:
    """Whether this is a whole message, not a piece of one, a control frame or the handshake."""
    return isinstance(event, Frame) and event.fin and (event.opcode is _TEXT or event.opcode is _BINARY)
