# The whole vocabulary: install, demo, test, slow, fuzz, browser, lint, format, docs, dist, clean (see CONTRIBUTING.md).
# PYTHON=/path/to/python3.12 chooses the interpreter that .venv is made from.

# The first Python from 3.11 to 3.13, for which all wheels exist.
PYTHON ?= $(shell for p in python3 python3.13 python3.12 python3.11 python; do \
	if $$p -c 'import sys; sys.exit(not (3, 11) <= sys.version_info < (3, 14))' 2>/dev/null; then \
	echo $$p; exit; fi; done; echo python3)
VENV := .venv
BIN := $(VENV)/bin
OUT ?= out/demo
ARGS ?=
# Interpreters in which `make dist` tries the wheel.
PYTHONS ?= $(PYTHON)

.PHONY: install demo test slow fuzz browser lint format docs dist clean
.DEFAULT_GOAL := install

install: $(VENV)/.installed

# Stamps make every target cheap to repeat: a changed pyproject.toml installs again, nothing else does.
$(VENV)/.created:
	@$(PYTHON) -c 'import sys; sys.exit(sys.version_info < (3, 11))' 2>/dev/null || { \
		echo "error: mi_simplify needs Python 3.11 or newer, but '$(PYTHON)' is $$($(PYTHON) --version 2>/dev/null || echo not there);" \
			"name another one: make PYTHON=/path/to/python3.11" >&2; exit 1; }
	@$(PYTHON) -m venv $(VENV) || { \
		echo "error: '$(PYTHON) -m venv' failed; this Python lacks venv or ensurepip (see above)," \
			"name another one: make PYTHON=/path/to/python3.11" >&2; rm -rf $(VENV); exit 1; }
	@touch $@

$(VENV)/.installed: $(VENV)/.created pyproject.toml
	$(BIN)/python -m pip install --quiet --disable-pip-version-check --editable '.[dev]'
	@touch $@

$(VENV)/.docs: $(VENV)/.installed
	$(BIN)/python -m pip install --quiet --disable-pip-version-check --editable '.[docs]'
	@touch $@

# What the tests in a real browser need, and what they need of npm; without it they are skipped, so nothing here has to
# succeed.
$(VENV)/.browser: $(VENV)/.installed
	@$(BIN)/python -m pip install --quiet --disable-pip-version-check --editable '.[browser]' || \
		echo "no playwright could be installed: the browser tests will be skipped" >&2
	@for c in chromium chromium-browser google-chrome; do command -v $$c >/dev/null && exit; done; \
		test "$$(id -u)" = 0 && apt-get update -qq && apt-get install -qq --no-install-recommends chromium >/dev/null || \
		echo "no chromium could be installed: the browser tests will be skipped" >&2
	@npm install --silent --no-save --no-package-lock three gltf-validator mikktspace >/dev/null 2>&1 || \
		echo "npm could not install three and gltf-validator: tests with them will be skipped" >&2
	@touch $@

browser: $(VENV)/.browser

demo: install
	$(BIN)/mi-simplify run scenes/demo.yaml -o $(OUT) --overwrite $(ARGS)

# Two at a time: a test keeps little more than one core busy.
test: browser
	$(BIN)/python -m pytest -m "not slow" -n 2 --dist worksteal $(ARGS)

slow: browser
	$(BIN)/python -m pytest -m slow -n 2 --dist worksteal $(ARGS)

fuzz: install
	$(BIN)/python tests/fuzz/fuzz.py $(ARGS)

lint: install
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .
	$(BIN)/mypy

format: install
	$(BIN)/ruff check --fix .
	$(BIN)/ruff format .

docs: $(VENV)/.docs
	$(BIN)/mi-simplify config-schema > $(VENV)/config.md && mv $(VENV)/config.md docs/config.md
	$(BIN)/python docs/draw_architecture.py
	$(BIN)/mkdocs build --quiet --strict

dist: install
	rm -rf dist
	$(BIN)/python -m build --outdir dist . > $(VENV)/build.log || { cat $(VENV)/build.log; exit 1; }
	@for python in $(PYTHONS); do .ci/smoke dist/*.whl $$python || exit; done

clean:
	rm -rf $(VENV) build dist site out
