"""The mutants of tests/mutants are of the code as it is, so that a run of hours does not find out at its end."""

from pathlib import Path

import pytest

from tests.mutants.tables import TABLES

ROOT = Path(__file__).parents[1]
MUTANTS = [mutant for table in TABLES for mutant in table]


@pytest.mark.parametrize("file", sorted({mutant.file for mutant in MUTANTS}))
def test_each_mutant_changes_one_place_of_its_file(file):
    source = (ROOT / file).read_text()
    for mutant in MUTANTS:
        if mutant.file == file:
            assert mutant.applied(source) != source  # raises ValueError where its text is not there, or twice


def test_the_tests_that_mutants_name_exist():
    named = {name.partition("::") for mutant in MUTANTS for name in mutant.tests}
    assert [file for file, _, test in named if not (ROOT / file).exists() or f"def {test}" not in (ROOT / file).read_text()] == []


def test_no_two_mutants_have_one_name():
    assert len({mutant.name for mutant in MUTANTS}) == len(MUTANTS)
