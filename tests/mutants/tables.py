"""All mutants, by package."""

from tests.mutants import capture, luminaires, runtime, viewer

TABLES = (runtime.MUTANTS, capture.MUTANTS, luminaires.MUTANTS, viewer.MUTANTS)
