"""All mutants, by package."""

from tests.mutants import capture, commands, exchange, fixtures, luminaires, renderer, runtime, sampler, viewer

PACKAGES = (runtime, capture, sampler, renderer, luminaires, viewer, commands, exchange, fixtures)
TABLES = tuple(package.MUTANTS for package in PACKAGES)
