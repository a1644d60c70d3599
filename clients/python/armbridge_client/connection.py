"""Connection to the server: rosbridge's operations (docs/protocol.md) over a WebSocket, which is made again when lost.

Every request has a deadline. Requests during a loss fail at once; streams go on when the connection is back.
"""

from __future__ import annotations

import asyncio
import contextlib
import itertools
import json
import logging
import ssl
from collections import deque
from collections.abc import Awaitable, Callable, Iterator, Mapping
from contextvars import ContextVar
from dataclasses import dataclass
from types import TracebackType
from typing import Any, Generic, Literal, TypeVar
from urllib.parse import urlencode, urlsplit, urlunsplit

from websockets.asyncio.client import ClientConnection, connect
from websockets.exceptions import ConnectionClosed, InvalidHandshake, InvalidStatus, InvalidURI

from armbridge_client.errors import (
    ArmError,
    ConnectError,
    ConnectionLost,
    DeadlineExceeded,
    NotArmbridge,
    NotAuthenticated,
    ServerUnreachable,
    WrongVersion,
    refusal,
)
from armbridge_client.interface import ArmInfo, read_arms
from armbridge_client.messages import TriggerRequest
from armbridge_client.wire import Message, Response, Service, answer_class, from_wire, to_wire

log = logging.getLogger("armbridge_client")

T = TypeVar("T")
M = TypeVar("M", bound=Message)

# A server of this minor version has the message types that this client knows.
SERVER_VERSION = "0.2"

# Large enough for a camera's images and a planning scene with meshes; the server sends up to 10 MB in one message.
MAX_MESSAGE_BYTES = 32_000_000

CALL_TIMEOUT_S = 10.0
CLOSE_TIMEOUT_S = 2.0
# A connection takes milliseconds. A longer wait, as for a busy machine or a wrong host, is logged.
QUIET_S = 1.0
RECONNECT_FIRST_S, RECONNECT_MOST_S = 0.1, 2.0

WHO_SERVICE = "/arm/who_am_i"
UNAUTHENTICATED = (401, 429)
POLICY_VIOLATION = 1008  # RFC 6455, 7.4.1; the server's close code for a missing or wrong token


_AFTER_STOP: ContextVar[int | None] = ContextVar("last stop that a decision knew of", default=None)


@contextlib.contextmanager
def after_stop(stops: int) -> Iterator[None]:
    """Have the server refuse what would move the arm, for requests within, if the arm was stopped since you looked.

    Args:
        stops: ``stops`` of the State that you decided on, or of ``arm.stops()``; within another one, the lower counts.
    """
    outer = _AFTER_STOP.get()
    token = _AFTER_STOP.set(stops if outer is None else min(outer, stops))
    try:
        yield
    finally:
        _AFTER_STOP.reset(token)


def _request(operation: Mapping[str, Any]) -> dict[str, Any]:
    """Return an operation with the last stop that its sender knew of."""
    stops = _AFTER_STOP.get()
    return {**operation} if stops is None else {**operation, "after_stop": stops}


@dataclass(frozen=True)
class Address:
    """Server to connect to.

    Attributes:
        token: authentication token, None for none.
        tls: for ``wss://``: context that checks the server's certificate, None for the system's authorities.
        on_disconnect: ``stop`` ends this client's motions when it is gone, ``finish`` lets them go on.
    """

    url: str
    token: str | None = None
    tls: ssl.SSLContext | None = None
    on_disconnect: Literal["stop", "finish"] = "stop"
    connect_timeout_s: float = CALL_TIMEOUT_S

    def open(self) -> connect:
        """Return the connector of websockets; it follows no redirection, so the token reaches this server alone."""
        parts = urlsplit(self.url)
        query = "&".join(filter(None, (parts.query, urlencode({"on_disconnect": self.on_disconnect}))))
        return connect(
            urlunsplit(parts._replace(query=query)),
            additional_headers={"Authorization": f"Bearer {self.token}"} if self.token else None,
            ssl=(self.tls or True) if parts.scheme == "wss" else None,
            compression=None,
            open_timeout=None,
            close_timeout=CLOSE_TIMEOUT_S,
            max_size=MAX_MESSAGE_BYTES,
            proxy=None,
        )


@dataclass(frozen=True)
class ServerInfo:
    """This client as the server knows it: its name, its role (view, operate or admin), and the server's version."""

    name: str
    role: str
    version: str


class Stream(Generic[M]):
    """Messages of one topic, oldest first; a reader that is slow loses the oldest.

    Iterate over it. A wait for the next message that exceeds ``timeout_s`` raises DeadlineExceeded.
    """

    def __init__(self, topic: str, decode: Callable[[Mapping[str, Any]], M], length: int, timeout_s: float) -> None:
        self.topic = topic
        self._decode = decode
        self._messages: deque[Mapping[str, Any]] = deque(maxlen=length)
        self._came = asyncio.Event()
        self._timeout_s = timeout_s
        self._failure: Exception | None = None

    def put(self, message: Mapping[str, Any]) -> None:
        """Add a message as it came."""
        self._messages.append(message)
        self._came.set()

    def fail(self, error: Exception) -> None:
        """End the stream with an error, behind the messages that are there."""
        self._failure = error
        self._came.set()

    def newest(self) -> M | None:
        """Return the newest message that waits, and drop the others; None if none waits."""
        newest = self._messages.pop() if self._messages else None
        self._messages.clear()
        return None if newest is None else self._decode(newest)

    def __aiter__(self) -> Stream[M]:
        return self

    async def __anext__(self) -> M:
        while not self._messages:
            if self._failure is not None:
                raise self._failure
            self._came.clear()
            await within(self._timeout_s, self._came.wait(), f"no message on {self.topic}")
        return self._decode(self._messages.popleft())


class Connection:
    """Open connection; made by :meth:`open`, ended by :meth:`close`."""

    def __init__(self, address: Address) -> None:
        self._address = address
        self._socket: ClientConnection | None = None
        self._answers: dict[str, asyncio.Future[Mapping[str, Any]]] = {}
        self._feedback: dict[str, Callable[[Mapping[str, Any]], None]] = {}
        # Sentences of the server about requests that have no answer, by the request's id; one a topic at most.
        self._complaints: dict[str, str] = {}
        # Subscriptions by number and advertised topics by name, sent again on each connection.
        self._registrations: dict[str, dict[str, Any]] = {}
        self._streams: dict[str, Stream[Any]] = {}
        self._ids = itertools.count(1)
        self._connected = asyncio.Event()
        self._keeper: asyncio.Task[None] | None = None
        self._sending: set[asyncio.Task[None]] = set()
        self.server = ServerInfo("", "", "")
        self.arms: dict[str, ArmInfo] = {}

    async def open(self) -> None:
        """Connect, and check that the server is an armbridge of this client's version.

        Raises:
            ConnectError: ServerUnreachable, NotArmbridge, WrongVersion or NotAuthenticated.
            DeadlineExceeded: the server does not answer in time.
        """
        address = self._address
        url, timeout_s = address.url, address.connect_timeout_s
        waiting = asyncio.get_running_loop().call_later(
            QUIET_S, log.warning, "%s: no answer yet; waiting up to %g s", url, timeout_s
        )
        try:
            await within(timeout_s, self._connect(), f"{url}: no answer to the connection")
            reading = asyncio.to_thread(read_arms, url, address.token, address.tls, timeout_s)
            self.arms = await within(timeout_s, reading, f"{url}: no description of the server")
        except BaseException:
            await self.close()
            raise
        finally:
            waiting.cancel()
        self._keeper = asyncio.create_task(self._keep(), name=f"connection to {self._address.url}")

    async def close(self) -> None:
        """Disconnect; unanswered requests fail and streams end with ConnectionLost."""
        with contextlib.suppress(asyncio.TimeoutError):
            if self._sending:
                await asyncio.wait(self._sending, timeout=CLOSE_TIMEOUT_S)
        if self._keeper is not None:
            self._keeper.cancel()
            await asyncio.wait([self._keeper], timeout=CLOSE_TIMEOUT_S)
        if self._socket is not None:
            with contextlib.suppress(asyncio.TimeoutError):
                await asyncio.wait_for(self._socket.close(), CLOSE_TIMEOUT_S + 1.0)
        self._lose(ConnectionLost("this client has closed the connection"), for_good=True)

    async def wait_connected(self, timeout_s: float = CALL_TIMEOUT_S) -> None:
        """Wait until a lost connection is back."""
        await within(timeout_s, self._connected.wait(), f"{self._address.url}: no connection")

    # Requests.

    async def call(self, service: str, request: Service[Response], timeout_s: float = CALL_TIMEOUT_S) -> Response:
        """Call a service, and return its response.

        Raises:
            RequestRefused: the server refused the call.
            DeadlineExceeded: no response in time.
            ConnectionLost: the connection broke.
        """
        operation = {"op": "call_service", "service": service, "type": request.TYPE, "args": to_wire(request)}
        number = str(next(self._ids))
        answer = await self._ask(number, {**operation, "timeout": timeout_s}, timeout_s, f"service {service}")
        if not answer["result"]:
            raise refusal(str(answer["values"]))
        response: Response = from_wire(answer_class(type(request)), answer["values"])
        # A scene that cannot be applied is answered without a sentence; the sentence comes as a status before it.
        if answer["complaint"] and not getattr(response, "success", True):
            raise refusal(answer["complaint"])
        return response

    async def carry_out(self, service: str, request: Service[Response], timeout_s: float = CALL_TIMEOUT_S) -> Response:
        """Call a service whose response has ``success``. As :meth:`call`.

        Raises:
            RequestRefused: the server refused the call, or the response has no success.
        """
        response = await self.call(service, request, timeout_s)
        if not getattr(response, "success", True):
            raise refusal(getattr(response, "message", "") or f"{service}: refused; the server's log has the reason")
        return response

    async def perform(
        self,
        action: str,
        goal: Message,
        timeout_s: float,
        on_feedback: Callable[[Mapping[str, Any]], None] | None = None,
    ) -> Mapping[str, Any]:
        """Send a goal to an action, and return the values of its result; a deadline or cancellation cancels the goal.

        Raises:
            RequestRefused: the goal was not accepted, or ended with a sentence.
        """
        number = str(next(self._ids))
        cancel = {"op": "cancel_action_goal", "id": number, "action": action}
        operation: dict[str, Any] = {"op": "send_action_goal", "action": action, "action_type": goal.TYPE}
        operation["args"] = to_wire(goal)
        if on_feedback is not None:
            self._feedback[number] = on_feedback
            operation["feedback"] = True
        answering = asyncio.ensure_future(self._ask(number, operation, None, f"action {action}"))
        try:
            if not (await asyncio.wait([answering], timeout=timeout_s))[0]:
                self.send_soon(cancel)
                raise DeadlineExceeded(f"{action}: not done within {timeout_s:g} s; the goal is cancelled")
            answer = answering.result()
        except asyncio.CancelledError:
            self.send_soon(cancel)
            raise
        finally:
            answering.cancel()
            self._feedback.pop(number, None)
        values: Any = answer["values"]
        if isinstance(values, str):
            raise refusal(values)
        result: Mapping[str, Any] = values
        return result

    def complaint(self, topic: str) -> str:
        """Return the server's sentence about an earlier message on a topic, once; empty for none."""
        return self._complaints.pop(topic, "")

    async def publish(self, topic: str, message: Message) -> None:
        """Publish a message.

        Raises:
            RequestRefused: the server has refused an earlier message on this topic, which has no answer.
        """
        if complaint := self.complaint(topic):
            raise refusal(complaint)
        if topic not in self._registrations:
            # Kept with the subscriptions, so that it is sent again on the next connection.
            self._registrations[topic] = {"op": "advertise", "id": topic, "topic": topic, "type": message.TYPE}
            await within(CALL_TIMEOUT_S, self._send(self._registrations[topic]), f"topic {topic}")
        operation = _request({"op": "publish", "id": topic, "topic": topic, "msg": to_wire(message)})
        await within(CALL_TIMEOUT_S, self._send(operation), f"topic {topic}")

    def subscribe(
        self,
        topic: str,
        message_class: type[M],
        rate_hz: float = 0.0,
        length: int = 1,
        timeout_s: float = 5.0,
    ) -> Subscription[M]:
        """Return a subscription to a topic, to be entered with ``async with``.

        Args:
            rate_hz: most messages a second; 0 for all.
            length: most messages that wait for their reader; older ones are dropped.
            timeout_s: longest wait for a message.
        """
        if not rate_hz >= 0.0:
            raise ValueError(f"rate_hz must be 0 or more, not {rate_hz}")
        number = str(next(self._ids))
        operation: dict[str, Any] = {"op": "subscribe", "id": number, "topic": topic, "type": message_class.TYPE}
        operation["queue_length"] = length
        operation["throttle_rate"] = 1000.0 / rate_hz if rate_hz else 0
        stream = Stream(topic, lambda values: from_wire(message_class, values), length, timeout_s)
        return Subscription(self, operation, stream)

    async def begin(self, operation: dict[str, Any], stream: Stream[Any]) -> None:
        """Subscribe; the subscription survives a loss of the connection."""
        self._registrations[operation["id"]], self._streams[operation["id"]] = operation, stream
        await within(CALL_TIMEOUT_S, self._send(operation), f"topic {stream.topic}")

    def end(self, operation: Mapping[str, Any]) -> None:
        """End a subscription."""
        if self._registrations.pop(operation["id"], None) is not None:
            del self._streams[operation["id"]]
            self.send_soon({"op": "unsubscribe", "id": operation["id"], "topic": operation["topic"]})

    def topics(self) -> list[str]:
        """Return the subscribed topics, one for each subscription."""
        return [stream.topic for stream in self._streams.values()]

    def send_soon(self, operation: Mapping[str, Any]) -> None:
        """Send an operation without waiting for it; without a connection it is dropped."""

        async def send() -> None:
            with contextlib.suppress(ConnectionLost):
                await self._send(operation)

        task = asyncio.create_task(send())
        self._sending.add(task)
        task.add_done_callback(self._sending.discard)

    # The socket.

    async def _ask(
        self, number: str, operation: Mapping[str, Any], timeout_s: float | None, name: str
    ) -> Mapping[str, Any]:
        answer: asyncio.Future[Mapping[str, Any]] = asyncio.get_running_loop().create_future()
        self._answers[number] = answer
        try:
            await self._send(_request({**operation, "id": number}))
            operation = await within(timeout_s, answer, f"{name}: no answer")
            return {**operation, "complaint": self._complaints.get(number, "")}
        finally:
            del self._answers[number]
            self._complaints.pop(number, None)

    async def _send(self, operation: Mapping[str, Any]) -> None:
        if self._socket is None:
            raise ConnectionLost(f"{self._address.url}: not connected; the client connects again by itself")
        try:
            await self._socket.send(json.dumps(operation, separators=(",", ":")))
        except ConnectionClosed as error:
            raise self._lost(error) from error

    def _lost(self, error: ConnectionClosed) -> Exception:
        if error.rcvd is not None and error.rcvd.code == POLICY_VIOLATION:
            return NotAuthenticated(f"{self._address.url}: {error.rcvd.reason}")
        effect = "stops this client's motions" if self._address.on_disconnect == "stop" else "continues them"
        return ConnectionLost(f"{self._address.url}: connection lost ({error}); a server that still runs {effect}")

    async def _connect(self) -> None:
        url = self._address.url
        try:
            socket = await self._address.open()
        except InvalidStatus as error:
            sentence = error.response.body.decode(errors="replace").strip() if error.response.body else str(error)
            if error.response.status_code in UNAUTHENTICATED:
                raise NotAuthenticated(f"{url}: {sentence}") from error
            raise NotArmbridge(f"{url}: {sentence}") from error
        except ssl.SSLError as error:
            remedy = "pass tls= for a certificate of your own"
            if error.reason == "WRONG_VERSION_NUMBER":
                remedy = "the server has no certificate: use ws://"
            raise ConnectError(f"{url}: TLS: {error}; {remedy}") from error
        except (InvalidURI, ValueError) as error:
            raise ConnectError(
                f"{url}: must be ws://HOST:PORT or wss://HOST:PORT, as in ws://127.0.0.1:9090"
            ) from error
        except (InvalidHandshake, EOFError) as error:
            raise NotArmbridge(
                f"{url}: the server does not speak WebSocket, or with TLS alone (wss://): {error}"
            ) from error
        except OSError as error:
            raise ServerUnreachable(f"no server answers at {url}: start one with armbridge serve ({error})") from error
        try:
            self.server = await self._identify(socket)
            await socket.send(json.dumps({"op": "set_level", "level": "warning"}))
            for operation in self._registrations.values():
                await socket.send(json.dumps(operation))
        except ConnectionClosed as error:
            raise self._lost(error) from error
        except BaseException:
            await socket.close()
            raise
        self._socket = socket
        self._connected.set()

    async def _identify(self, socket: ClientConnection) -> ServerInfo:
        """Ask the server for its version; another rosbridge server has no such service."""
        request = {"op": "call_service", "id": "who", "service": WHO_SERVICE, "type": TriggerRequest.TYPE}
        await socket.send(json.dumps(request))
        url = self._address.url
        try:
            while (answer := json.loads(await socket.recv())).get("op") != "service_response":
                pass
            values = json.loads(answer["values"]["message"])
            info = ServerInfo(str(values["name"]), str(values["role"]), str(values["version"]))
        except (ValueError, TypeError, KeyError, AttributeError) as error:
            raise NotArmbridge(f"{url}: the server has no {WHO_SERVICE}, so it is not armbridge") from error
        if info.version.split(".")[:2] != SERVER_VERSION.split("."):
            wanted = ".".join(info.version.split(".")[:2])
            raise WrongVersion(
                f"{url}: the server's version is {info.version}, this client is for {SERVER_VERSION}: "
                f"install armbridge-client {wanted}, from clients/python of that version's source"
            )
        return info

    async def _keep(self) -> None:
        """Read until the connection is lost, then connect again, until closed or no longer authenticated."""
        while (socket := self._socket) is not None:
            try:
                async for text in socket:
                    self._read(text)
                error: Exception = ConnectionLost(f"{self._address.url}: the server has closed the connection")
            except ConnectionClosed as closed:
                error = self._lost(closed)
            self._socket = None
            self._connected.clear()
            self._lose(error, for_good=False)
            log.warning("%s; connecting again", error)
            pause_s = RECONNECT_FIRST_S
            while self._socket is None:
                await asyncio.sleep(pause_s)
                pause_s = min(2.0 * pause_s, RECONNECT_MOST_S)
                try:
                    await asyncio.wait_for(self._connect(), self._address.connect_timeout_s)
                except (NotAuthenticated, NotArmbridge, WrongVersion) as error:
                    log.error("%s", error)  # noqa: TRY400 - the sentence says all
                    self._lose(error, for_good=True)
                    return
                except (ArmError, asyncio.TimeoutError):
                    continue

    def _lose(self, error: Exception, *, for_good: bool) -> None:
        for answer in self._answers.values():
            if not answer.done():
                answer.set_exception(error)
        if for_good:
            for stream in self._streams.values():
                stream.fail(error)

    def _read(self, text: str | bytes) -> None:
        try:
            self._take(json.loads(text))
        except (ValueError, KeyError, TypeError):
            log.warning("the server sent a message that is not rosbridge's: %.200s", text)

    def _take(self, operation: Mapping[str, Any]) -> None:
        number = operation.get("id")
        match operation.get("op"):
            case "publish":
                for stream in self._streams.values():
                    if stream.topic == operation["topic"]:
                        stream.put(operation["msg"])
            case "service_response" | "action_result":
                answer = self._answers.get(str(number))
                if answer is not None and not answer.done():
                    answer.set_result(operation)
            case "action_feedback":
                if (on_feedback := self._feedback.get(str(number))) is not None:
                    try:
                        on_feedback(operation["values"])
                    except Exception:  # the program's own function: its error must not end the connection
                        log.exception("the function that takes the progress failed")
            case "status":
                self._take_status(str(number), str(operation["msg"]), str(operation["level"]))
            case _:
                pass

    def _take_status(self, number: str, sentence: str, level: str) -> None:
        log.info("the server: %s", sentence)
        if number in self._streams and level == "error":
            self._streams[number].fail(refusal(sentence))
        # A warning refuses no message: a topic's name may only look like another topic's.
        elif number in self._answers or (number in self._registrations and level == "error"):
            self._complaints[number] = sentence


class Subscription(Generic[M]):
    """A subscription for the length of an ``async with``; entering returns its stream."""

    def __init__(self, connection: Connection, operation: dict[str, Any], stream: Stream[M]) -> None:
        self._connection = connection
        self._operation = operation
        self._stream = stream

    async def __aenter__(self) -> Stream[M]:
        await self._connection.begin(self._operation, self._stream)
        return self._stream

    async def __aexit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._connection.end(self._operation)


async def within(timeout_s: float | None, awaited: Awaitable[T], name: str) -> T:
    """Await with a deadline; None for none.

    Raises:
        DeadlineExceeded: the deadline has passed.
    """
    try:
        return await asyncio.wait_for(awaited, timeout_s)
    except asyncio.TimeoutError as error:
        raise DeadlineExceeded(f"{name} within {timeout_s:g} s") from error
