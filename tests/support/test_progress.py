"""What a command prints for who waits."""

import re
import time

import pytest

from ndob_fmu import cli
from ndob_fmu.support.progress import begin, go_on, shown_after

SLOW = """
import time
time.sleep(0.4)
from ndob_fmu.model.built_in.flexible_joint import model
"""


@pytest.mark.parametrize(
    ("command", "at"),
    [
        ("check", "largest slope of f of FlexibleJoint"),
        ("design", "largest slope of f of FlexibleJoint"),
        ("build", "modes, ranks and zeros of FlexibleJoint"),
    ],
)
def test_a_command_that_takes_long_says_what_it_is_at_in_a_line(command, at, tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(cli, "PATIENCE", 0.1)
    (tmp_path / "slow.py").write_text(SLOW)
    assert cli.main([command, "slow.py"]) == 0
    lines = capsys.readouterr().err.splitlines()
    assert lines[0] == "ndob-fmu: still running slow.py"
    assert [line for line in lines if not re.match(r"ndob-fmu: still \w+ing ", line)] == []
    assert any(at in line for line in lines)


def test_what_ends_in_time_is_not_mentioned_and_what_follows_a_long_wait_is(capsys):
    with shown_after(0.2):
        begin("reading one")
        begin("reading two")
        time.sleep(0.5)
        begin("reading three")
    begin("reading four")
    assert capsys.readouterr().err == "ndob-fmu: still reading two\nndob-fmu: still reading three\n"


def test_how_far_a_long_activity_is_is_said_where_nothing_else_was_for_a_while(capsys):
    with shown_after(0.2):
        begin("fitting")
        go_on("round 1")
        time.sleep(0.5)
        go_on("round 2")
        go_on("round 3")
    assert capsys.readouterr().err == "ndob-fmu: still fitting\nndob-fmu: still fitting, round 2\n"


def test_a_quick_command_prints_nothing_more_later(capsys):
    with shown_after(0.1):
        begin("reading")
    time.sleep(0.3)
    assert capsys.readouterr().err == ""
