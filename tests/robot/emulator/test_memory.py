from __future__ import annotations

import pytest
from hypothesis import given
from hypothesis import strategies as st

from robot.emulator.memory import FACTORY_EPROM, MEMORY_BYTES, Memory
from robot.hardware.feetech.registers import LAYOUT, Area, Register, decode, encode


def memory():
    return Memory({**FACTORY_EPROM, Register.ID: 4})


def put(memory, register, value):
    memory.write(register, encode(register, value))


def test_memory_beyond_the_end_reads_as_zero():
    assert memory().read(MEMORY_BYTES - 1, 10) == bytes(10)
    assert len(memory().read(0, 255)) == 255


@given(st.lists(st.tuples(st.integers(0, 90), st.binary(min_size=1, max_size=20)), max_size=10))
def test_a_value_is_always_that_of_the_bytes(writes):
    written = memory()
    for address, data in writes:
        written.write(address, data)
        for register in Register:
            assert written.value(register) == decode(register, written.read(register, LAYOUT[register].size))


@given(st.integers(0, 255), st.binary(max_size=100))
def test_no_write_changes_what_is_read_only(address, data):
    written = memory()
    read_only = [register for register in Register if LAYOUT[register].area is Area.READ_ONLY]
    before = {register: written.value(register) for register in read_only}
    written.write(address, data)
    assert {register: written.value(register) for register in read_only} == before


@pytest.mark.parametrize(("lock", "kept"), [(1, 32), (0, 16)])
def test_eprom_outlives_a_power_cut_only_when_written_unlocked(lock, kept):
    written = memory()
    put(written, Register.LOCK, lock)
    put(written, Register.P_GAIN, 16)
    assert written.value(Register.P_GAIN) == 16
    written.power_up()
    assert written.value(Register.P_GAIN) == kept


def test_the_torque_limit_comes_up_as_the_eprom_says():
    written = memory()
    put(written, Register.LOCK, 0)
    put(written, Register.MAX_TORQUE, 500)
    put(written, Register.TORQUE_LIMIT, 100)
    written.power_up()
    assert written.value(Register.TORQUE_LIMIT) == 500


def test_a_measured_value_too_large_shows_as_the_largest():
    shown = memory()
    shown.show(Register.PRESENT_LOAD, -5000)
    assert shown.value(Register.PRESENT_LOAD) == -1023
    shown.show(Register.PRESENT_TEMPERATURE, 300)
    assert shown.value(Register.PRESENT_TEMPERATURE) == 255


def test_without_a_backup_a_restore_brings_back_what_was_there_at_first_but_for_the_id():
    written = memory()
    put(written, Register.LOCK, 0)
    put(written, Register.P_GAIN, 16)
    put(written, Register.ID, 9)
    written.restore()
    assert (written.value(Register.P_GAIN), written.value(Register.ID)) == (32, 9)
