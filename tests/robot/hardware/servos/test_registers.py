from __future__ import annotations

from itertools import pairwise

import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from robot.hardware.servos.registers import RegisterTable
from tests.helpers.servo_families import Family

Several = settings(suppress_health_check=[HealthCheck.function_scoped_fixture])


@pytest.fixture
def table(family: Family) -> RegisterTable:
    return family.driver.registers


@Several
@given(data=st.data())
def test_every_value_of_a_register_is_read_as_it_was_written(table: RegisterTable, data: st.DataObject) -> None:
    register = data.draw(st.sampled_from(list(table.layout)))
    value = data.draw(st.integers(*table.value_range(register)))
    written = table.encode(register, value)
    assert len(written) == table.layout[register].size
    assert table.decode(register, written) == value


@Several
@given(data=st.data())
def test_a_value_that_does_not_fit_is_refused_by_name(table: RegisterTable, data: st.DataObject) -> None:
    register = data.draw(st.sampled_from(list(table.layout)))
    lowest, highest = table.value_range(register)
    value = data.draw(st.one_of(st.integers(min_value=highest + 1), st.integers(max_value=lowest - 1)))
    with pytest.raises(ValueError, match=f"{register.name} .* not {value}"):
        table.encode(register, value)


def test_no_two_registers_overlap(family: Family, table: RegisterTable) -> None:
    ordered = sorted(family.registers.Register)
    assert ordered == list(table.layout)
    assert all(first + table.layout[first].size <= second for first, second in pairwise(ordered))


def test_data_of_the_wrong_length_is_refused(table: RegisterTable) -> None:
    size = table.layout[table.goal_position].size
    with pytest.raises(ValueError, match=f"GOAL_POSITION has {size} bytes, not 1"):
        table.decode(table.goal_position, b"\x01")
    with pytest.raises(ValueError, match=f"GOAL_POSITION has {size} bytes, not 9"):
        table.parse(table.block(table.goal_position), bytes(9))


@Several
@given(data=st.data())
def test_a_block_has_the_registers_from_the_first_to_the_last(table: RegisterTable, data: st.DataObject) -> None:
    ordered = list(table.layout)
    first, last = sorted(data.draw(st.tuples(st.sampled_from(ordered), st.sampled_from(ordered))))
    block = table.block(first, last)
    values = {register: data.draw(st.integers(*table.value_range(register))) for register in block.registers}
    memory = bytearray(block.length)
    for register, value in values.items():
        at = register - block.address
        memory[at : at + table.layout[register].size] = table.encode(register, value)
    assert (block.registers[0], block.registers[-1]) == (first, last)
    assert table.parse(block, bytes(memory)) == values
