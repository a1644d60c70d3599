import os
import pty
from pathlib import Path

import pytest

from server.commands.terminal import AnswerMissing, Terminal, chosen, table


@pytest.fixture
def typed():
    """A terminal, and a function that types into it."""
    read_end, write_end = os.pipe()
    yield Terminal(read_end), lambda text: os.write(write_end, text.encode())
    for descriptor in (read_end, write_end):
        os.close(descriptor)


def test_only_yes_is_yes_and_each_question_takes_one_line_of_many(typed, capsys):
    terminal, write = typed
    write("y\nYES\n\nyellow\n\n")
    assert [terminal.confirm("Go on?") for _ in range(4)] == [True, True, False, False]
    assert capsys.readouterr().err == "Go on? [y/N]\n" * 4
    assert terminal.line_typed() == ""
    assert terminal.line_typed() is None


def test_keys_pressed_before_a_question_do_not_answer_it():
    keyboard, descriptor = pty.openpty()

    class Answered(Terminal):
        """A terminal at which somebody types ``n`` once a question is printed."""

        def say(self, text):
            super().say(text)
            os.write(keyboard, b"n\n")

    terminal = Answered(descriptor)
    os.write(keyboard, b"y\ny\n")
    assert not terminal.confirm("Write this?")
    os.write(keyboard, b"\n\n")
    terminal.ask("Hold the arm. Enter: done.")
    assert terminal.line_typed() == "n"
    for each in (keyboard, descriptor):
        os.close(each)


def test_looking_for_a_line_does_not_wait_for_its_enter(typed):
    terminal, write = typed
    assert terminal.line_typed() is None
    write("half a line")
    assert terminal.line_typed() is None
    write("\n")
    assert terminal.line_typed() == "half a line"


def test_an_input_that_ends_answers_nothing():
    with Path("/dev/null").open() as empty, pytest.raises(AnswerMissing):
        Terminal(empty.fileno()).await_enter("Hold the arm")


def test_a_live_table_replaces_the_last_one_and_is_for_terminals_only(capsys, monkeypatch):
    terminal = Terminal()
    terminal.show_live("1\n2")
    assert capsys.readouterr().err == ""
    monkeypatch.setattr("sys.stderr.isatty", lambda: True)
    terminal.show_live("1\n2")
    terminal.show_live("3\n4")
    assert capsys.readouterr().err == "1\n2\n\x1b[2A\x1b[J3\n4\n"


def test_columns_are_as_wide_as_their_widest_entry():
    assert table(("id", "joint"), [(1, "pan"), (100, "x")]) == "id   joint\n1    pan\n100  x"


@pytest.mark.parametrize(
    ("typed", "answers", "answer"),
    [
        ("", ("done", "skip", "skip all"), "done"),
        (" Skip ", ("done", "skip", "skip all"), "skip"),
        ("y", ("yes", "no"), "yes"),
        ("", ("yes", "no"), ""),
        ("s", ("done", "skip", "skip all"), "s"),
    ],
)
def test_enter_is_the_first_answer_but_answers_no_question_about_yes_or_no(typed, answers, answer):
    assert chosen(typed, answers) == answer
