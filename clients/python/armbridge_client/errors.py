"""Errors of the client, one class for each fact that a program may react to.

ArmError
├── ConnectError            no connection
│   ├── ServerUnreachable   nothing listens at the address
│   ├── NotArmbridge        the server is another program
│   ├── WrongVersion        the server's message types differ from the client's
│   └── NotAuthenticated    the token is missing or wrong
├── ConnectionLost          the connection broke during a request
├── DeadlineExceeded        no answer in time; also a TimeoutError
└── RequestRefused          the server answered no, with a sentence
    ├── NotPermitted        the token's role is too low
    ├── ControlledByOther   another client controls the arm
    └── GoalRefused         a motion failed, with MoveIt's code and a suggestion
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from armbridge_client.messages import GoalTarget

# Sentences of the server's role check and of its control lease.
_ROLE_REFUSAL = "needs the role "
_LEASE_REFUSALS = ("has controlled ", "has taken control from another", " controls the arm, not ")


class ArmError(Exception):
    """Base of all errors of this package."""


class ConnectError(ArmError, ConnectionError):
    """No connection to an armbridge server could be made."""


class ServerUnreachable(ConnectError):
    """Nothing listens at the address: start the server, or correct host and port."""


class NotArmbridge(ConnectError):
    """Another program listens at the address: correct host and port."""


class WrongVersion(ConnectError):
    """The server's message types differ from the client's: install the client of the server's version."""


class NotAuthenticated(ConnectError):
    """The server requires a token, or does not know the token: pass ``token=`` to ``connect``."""


class ConnectionLost(ArmError, ConnectionError):
    """The connection broke before the answer came; the client connects again by itself.

    The server ends the motions of a lost client by a stop along their path. Read the state before you move again.
    """


class DeadlineExceeded(ArmError, TimeoutError):
    """No answer came within the deadline; the goal in progress, if any, was cancelled."""


class RequestRefused(ArmError):
    """The server refused a request; the text is its sentence."""

    def __init__(self, sentence: str) -> None:
        super().__init__(sentence)
        self.sentence = sentence


class NotPermitted(RequestRefused):
    """The token's role does not allow the request: use a token of the role that the sentence names."""


class ControlledByOther(RequestRefused):
    """Another client controls the arm: wait until it is free, or take control with an admin's token."""


class GoalRefused(RequestRefused):
    """A motion was refused, or ended before its goal.

    Attributes:
        code: value of moveit_msgs/MoveItErrorCodes, such as -31 for NO_IK_SOLUTION; -7 after a stop.
        code_name: its name.
        details: diagnostic details by name, such as ``pairs`` that would touch or ``nearest_m``.
        suggestion: a goal that would work instead, for ``move``; None if the server knows none.
    """

    def __init__(
        self,
        code: int,
        code_name: str,
        sentence: str,
        details: Mapping[str, Any],
        suggestion: GoalTarget | None,
    ) -> None:
        super().__init__(sentence)
        self.code = code
        self.code_name = code_name
        self.details = details
        self.suggestion = suggestion

    def __str__(self) -> str:
        return f"{self.code_name} ({self.code}): {self.sentence}"


def refusal(sentence: str) -> RequestRefused:
    """Return the error of a request that the server refused with a sentence."""
    if _ROLE_REFUSAL in sentence:
        return NotPermitted(sentence)
    if any(part in sentence for part in _LEASE_REFUSALS):
        return ControlledByOther(sentence)
    return RequestRefused(sentence)
