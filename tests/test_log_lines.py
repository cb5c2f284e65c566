"""Lines about what others do, and how often somebody may do something."""

from vemlight.runtime import allowance, log_lines
from vemlight.runtime.allowance import Allowance
from vemlight.runtime.log_lines import LogLines


def test_one_line_of_each_kind_a_minute_and_the_next_tells_how_many_were_left_out(monkeypatch, capsys):
    now = [0.0]
    monkeypatch.setattr(log_lines.time, "monotonic", lambda: now[0])
    lines = LogLines()
    for _ in range(100):
        lines.say("a", "first\nkind")
        now[0] += 0.9
    lines.say("b", "second kind")
    said = capsys.readouterr().err.splitlines()
    assert said == ["vemlight: first\\nkind", "vemlight: first\\nkind (and 66 like it since the last line)", "vemlight: second kind"]


def test_a_line_is_short(capsys):
    LogLines().say("a", "x" * 100_000)
    assert len(capsys.readouterr().err) < 500


def test_an_allowance_gives_its_burst_and_then_its_rate(monkeypatch):
    now = [0.0]
    monkeypatch.setattr(allowance.time, "monotonic", lambda: now[0])
    some = Allowance(burst=10, per_s=2)
    assert some.is_full
    assert sum(some.take() for _ in range(100)) == 10
    now[0] += 3.0
    assert sum(some.take() for _ in range(100)) == 6
    now[0] += 1000.0
    assert some.is_full
    assert not some.take(11)
    assert some.take(10)
    assert not some.has()
