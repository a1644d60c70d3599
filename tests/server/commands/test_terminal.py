import os
import pty

import pytest

from server.commands.terminal import AnswerMissing, Terminal, chosen, table


@pytest.fixture
def typed():
    """A terminal, and a function that types into it."""
    read_end, write_end = os.pipe()
    yield Terminal(read_end), lambda text: os.write(write_end, text.encode())
    for descriptor in (read_end, write_end):
        os.close(descriptor)


@pytest.mark.parametrize(("answer", "agreed"), [("y\n", True), ("YES\n", True), ("\n", False), ("yellow\n", False)])
def test_only_yes_is_yes(typed, capsys, answer, agreed):
    terminal, write = typed
    write(answer)
    assert terminal.confirm("Go on?") is agreed
    assert capsys.readouterr().err == "Go on? [y/N]\n"


def test_each_question_takes_one_line_of_many(typed):
    terminal, write = typed
    write("y\nn\n\n")
    assert terminal.confirm("one")
    assert not terminal.confirm("two")
    assert terminal.line_typed() == ""
    assert terminal.line_typed() is None


class Answered(Terminal):
    """A terminal at which somebody has pressed keys too early, and types ``n`` once a question is printed."""

    def __init__(self, keyboard: int, descriptor: int) -> None:
        super().__init__(descriptor)
        self._keyboard = keyboard

    def say(self, text: str) -> None:
        super().say(text)
        os.write(self._keyboard, b"n\n")


def test_keys_pressed_before_a_question_do_not_answer_it(capsys):
    keyboard, descriptor = pty.openpty()
    terminal = Answered(keyboard, descriptor)
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
    read_end, write_end = os.pipe()
    os.close(write_end)
    with pytest.raises(AnswerMissing):
        Terminal(read_end).await_enter("Hold the arm")
    os.close(read_end)


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
