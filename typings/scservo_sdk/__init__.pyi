from collections.abc import Sequence
from typing import Protocol

from serial import Serial

BROADCAST_ID: int
INST_PING: int
INST_READ: int
INST_WRITE: int
INST_REG_WRITE: int
INST_ACTION: int
INST_SYNC_WRITE: int
INST_SYNC_READ: int
COMM_SUCCESS: int

class PortHandler:
    is_open: bool
    is_using: bool
    baudrate: int
    port_name: str
    ser: Serial | None
    def __init__(self, port_name: str) -> None: ...
    def setBaudRate(self, baudrate: int) -> bool: ...
    def setupPort(self, cflag_baud: int) -> bool: ...
    def clearPort(self) -> None: ...
    def writePort(self, packet: Sequence[int]) -> int: ...
    def closePort(self) -> None: ...

class _Port(Protocol):
    is_using: bool
    def clearPort(self) -> None: ...
    def writePort(self, packet: Sequence[int], /) -> int: ...

class protocol_packet_handler:
    def txPacket(self, port: _Port, txpacket: list[int]) -> int: ...
    def getTxRxResult(self, result: int) -> str: ...

def PacketHandler(protocol_end: int) -> protocol_packet_handler: ...
