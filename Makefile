# vemlight. `make` lists the targets.
PYTHON ?= python3
VENV := .venv
BIN := $(VENV)/bin
SETTINGS ?=
GL_PACKAGES := libegl1 libgl1 libgl1-mesa-dri

.DEFAULT_GOAL := help
.PHONY: help env gl run test mutants check charts golden settings-doc wheel extension sbom clean

help:  ## list the targets
	@awk -F ':.*## ' '/^[a-z-]+:.*## /{printf "  make %-12s %s\n", $$1, $$2}' $(MAKEFILE_LIST)
	@echo "  options of run: FRAMES=24 (stop after so many), OUT=out (write lights and pictures there), SETTINGS=vemlight.toml"

env: $(VENV)/.ready  ## make the Python environment in .venv from the hashed lock

$(VENV)/.ready: requirements.lock requirements-dev.lock pyproject.toml
	@$(PYTHON) -c 'import sys; sys.exit(sys.version_info < (3, 11))' \
	  || { echo "vemlight needs Python 3.11 or later and $(PYTHON) is older: make $(MAKECMDGOALS) PYTHON=python3.12" >&2; exit 2; }
	@$(PYTHON) -c 'import ensurepip, venv' 2>/dev/null || $(call apt,python3-venv,The module venv)
	test -x $(BIN)/pip || $(PYTHON) -m venv $(VENV)
	@echo "installing the Python packages of the lock in $(VENV): a minute or two"
	$(BIN)/pip install --quiet --disable-pip-version-check --require-hashes -r requirements.lock -r requirements-dev.lock
	$(BIN)/pip install --quiet --disable-pip-version-check --no-deps --no-build-isolation --editable .
	@find services -name '*.nb[ic]' -delete  # numba sees no change of a kernel that others in other files call
	$(BIN)/python -m vemlight.commands.precompile
	@touch $@

# Root installs the system's packages; anybody else gets the command to run.
apt = { if [ "$$(id -u)" = 0 ] && command -v apt-get >/dev/null; then \
	    echo "installing $(1)"; apt-get update -qq && DEBIAN_FRONTEND=noninteractive apt-get install -y -qq --no-install-recommends $(1) >/dev/null; \
	  else echo "$(2) is missing: run  sudo apt-get install $(1)  and make again" >&2; exit 2; fi; }
HAS_GL := $(BIN)/python -c 'from vemlight.renderer.gl.programs import open_context; open_context()' 2>/dev/null

gl: env
	@$(HAS_GL) || $(call apt,$(GL_PACKAGES),OpenGL)
	@$(HAS_GL) || { echo "OpenGL 4.3 does not start here: run $(BIN)/vemlight doctor" >&2; exit 2; }

run: gl  ## play the bundled sequence through all services and print the viewer's address
	$(BIN)/vemlight run $(SETTINGS) $(if $(FRAMES),--frames $(FRAMES)) $(if $(OUT),--out $(OUT))

test: gl  ## run the tests
	$(BIN)/python -m pytest $(PYTEST)

mutants: gl  ## change the source in small ways and count the changes that tests notice (hours; ONLY="text ..." for some of them)
	$(BIN)/python -m tests.mutants --workers $$(nproc) $(if $(ONLY),--only $(ONLY))

check: env  ## lint and check the types
	$(BIN)/ruff check .
	$(BIN)/pyright

charts: gl  ## remake the charts in docs/charts (needs VEMLIGHT_DATA for real maps; under 30 minutes on 2 cores)
	$(BIN)/pip install --quiet --disable-pip-version-check --require-hashes -r requirements.lock -r requirements-dev.lock -r requirements-bench.lock
	$(BIN)/python -m bench.charts

# The same bytes from the same commit: from a copy without old build files, whose times are the commit's and whose modes are the same anywhere.
wheel: env  ## build the wheel in dist/, the same bytes each time
	@rm -rf build/source dist/*.whl && mkdir -p build/source
	@cp -R services replay_data vemlight vemlight_client.py pyproject.toml README.md LICENSE build/source && chmod -R u=rwX,go=rX build/source
	umask 022 && SOURCE_DATE_EPOCH=$${SOURCE_DATE_EPOCH:-$$(git log -1 --format=%ct)} \
	  $(BIN)/python -m pip wheel --quiet --disable-pip-version-check --no-deps --no-build-isolation --wheel-dir dist build/source

extension:  ## pack the Blender extension as dist/vemlight_lights.zip, the same bytes for a commit
	@mkdir -p dist
	git archive --format=zip -o dist/vemlight_lights.zip HEAD:blender/vemlight_lights

sbom: env  ## write dist/sbom.json: what an installation brings with it, with versions and hashes (CycloneDX)
	@mkdir -p dist
	$(BIN)/python -m cyclonedx_py requirements requirements.lock --pyproject pyproject.toml --output-reproducible --of JSON -o dist/sbom.json

settings-doc: env  ## rewrite docs/settings.md from services/settings.py
	$(BIN)/vemlight settings > docs/settings.md

golden: gl  ## rewrite the golden messages and the references of the replay tests
	$(BIN)/python -m tests.golden
	$(BIN)/python -m tests.references

clean:  ## remove the environment and all caches
	rm -rf $(VENV) .pytest_cache .ruff_cache .hypothesis build *.egg-info
	find . -name __pycache__ -type d -prune -exec rm -rf {} +
