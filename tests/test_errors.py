"""Errors that a person reads."""

import pytest

from vemlight.errors import FatalError, UserError


@pytest.mark.parametrize("kind", [UserError, FatalError])
def test_an_error_is_one_line_that_a_terminal_only_shows(kind):
    """Names of files and values in them are other people's text."""
    text = str(kind("a\nb\rc\x1b[2Jd\x85e\u2028f é ü"))
    assert text == "a b c [2Jd e f é ü"
    assert len(text.splitlines()) == 1
