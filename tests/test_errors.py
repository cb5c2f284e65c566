"""Errors that a person reads."""

import ast
from pathlib import Path

import pytest

from vemlight.errors import FatalError, UserError


@pytest.mark.parametrize("kind", [UserError, FatalError])
def test_an_error_is_one_line_that_a_terminal_only_shows(kind):
    """Names of files and values in them are other people's text."""
    text = str(kind("a\nb\rc\x1b[2Jd\x85e\u2028f é ü"))
    assert text == "a b c [2Jd e f é ü"
    assert len(text.splitlines()) == 1


def test_what_the_user_can_correct_ends_with_how():
    """A UserError made of text names the way out behind a semicolon, or asks whether something else was meant; others pass one on."""
    without = []
    for path in sorted((Path(__file__).parents[1] / "services").rglob("*.py")):
        for call in ast.walk(ast.parse(path.read_text())):
            if isinstance(call, ast.Call) and isinstance(call.func, ast.Name) and call.func.id == "UserError":
                parts = [part for part in ast.walk(call.args[0]) if isinstance(part, ast.Constant) and isinstance(part.value, str)]
                text = "".join(str(part.value) for part in parts)
                if len(text.split()) > 4 and not any(sign in text for sign in (";", "?", "run `", "play it with")):
                    without.append(f"{path.name}:{call.lineno}: {text}")
    assert without == []
