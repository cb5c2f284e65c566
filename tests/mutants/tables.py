"""All mutants, by package."""

from tests.mutants import capture, commands, luminaires, renderer, runtime, sampler, viewer

TABLES = (runtime.MUTANTS, capture.MUTANTS, sampler.MUTANTS, renderer.MUTANTS, luminaires.MUTANTS, viewer.MUTANTS, commands.MUTANTS)
