# All targets run in .venv and the built workspace; setup.bash activates both.
SHELL := bash
.SHELLFLAGS := -euo pipefail -c
.DEFAULT_GOAL := help
.PHONY: help build demo test test-ci test-nightly docs bench clean

# Use ROS 2 Jazzy if it is installed and sourced. Otherwise install it as wheels for the first Python found: 3.11, for
# which PyBullet has a wheel as well, then 3.13 and 3.12. PYTHON=... chooses another one.
ifeq ($(ROS_DISTRO)$(if $(AMENT_PREFIX_PATH),+sourced),jazzy+sourced)
NATIVE := $(shell python3 -c 'import rclpy' 2>/dev/null && echo yes)
endif
ifdef NATIVE
VERSIONS := 3.11 3.12
FOUND := python3
REQUIREMENTS := $(shell command -v colcon >/dev/null || echo colcon-common-extensions==0.3.0)
else
VERSIONS := 3.11 3.13 3.12
FOUND = $(firstword $(foreach version,$(VERSIONS),$(call python,$(version))) python3)
REQUIREMENTS := -r requirements/ros.txt $(shell printf '3.16\n%s\n' \
  "$$(cmake --version 2>/dev/null | grep -om1 '[0-9][0-9.]*')" | sort -VC || echo cmake==3.31.10)
endif
# The interpreter of a version: one on the path that runs (a shim of pyenv may not), or one of pyenv.
python = $(shell for python in python$(1) $(or $(PYENV_ROOT),$(HOME)/.pyenv)/versions/$(1).*/bin/python; do \
  "$$python" -c 'import ensurepip' 2>/dev/null && echo "$$python" && break; done)
PYTHON ?= $(FOUND)
VENV := .venv/.installed
BUILT := install/.built
ENTER := . ./setup.bash &&

help: ## print this list
	@awk -F ':.*## ' '/^[a-z0-9-]+:.*## / {printf "make %-12s %s\n", $$1, $$2}' $(MAKEFILE_LIST)

build: $(BUILT) ## install the dependencies into .venv and build the workspace

$(VENV): requirements/core.txt requirements/dev.txt requirements/ros.txt
	@version=$$($(PYTHON) -c 'import sys; print("%d.%d" % sys.version_info[:2])' 2>/dev/null) && \
	[[ " $(VERSIONS) " == *" $$version "* ]] || \
	{ echo "PYTHON: expected a Python $(VERSIONS), got $(PYTHON) $${version:-(not found)}. Run make build PYTHON=..." >&2; exit 1; }
	@echo "Installing $(if $(NATIVE),the dependencies,ROS 2 Jazzy and the dependencies) into .venv ..."
	@$(PYTHON) -m venv --prompt rkhs_ros $(if $(NATIVE),--system-site-packages) .venv
	@.venv/bin/python -m pip install -qq --no-compile --disable-pip-version-check \
	  -r requirements/core.txt -r requirements/dev.txt $(REQUIREMENTS)
	@.venv/bin/python -m compileall -qq -j 0 .venv/lib || true # on all cores; pip uses one
	@touch $@

# Python code, configurations and launch files are linked, not copied, so only new files require a build.
$(BUILT): $(VENV) package.xml setup.py setup.cfg colcon_defaults.yaml \
  $(wildcard rkhs_interfaces/* rkhs_interfaces/*/* config config/experiments config/tuning launch)
	@echo "Building the workspace ..."
	@set +u; . .venv/bin/activate; unset _ROS_WHEELS_BOOTSTRAP_COMPLETE; \
	$(if $(NATIVE),,export AMENT_PREFIX_PATH=$$VIRTUAL_ENV COLCON_LOG_LEVEL=error;) \
	python "$$(command -v colcon)" build # with this Python, since installed scripts contain its path
	@touch $@

demo: build ## learn to swing up a pendulum from three episodes with model-based training, in seconds
	@$(ENTER) python docs/demo.py

# The tests start hundreds of processes; without stored bytecode each of them would compile the packages.
PYTEST := PYTHONDONTWRITEBYTECODE= python -m pytest
WORKERS ?= $(shell expr $$(nproc) + 1) # tests of nodes wait more than they compute
test: build ## lint, types and tests in minutes
	@$(ENTER) ruff format --check . && ruff check . && mypy
	@$(ENTER) $(PYTEST) -n $(WORKERS) --dist worksteal -m "not ci and not nightly and not clock and not browser"

test-ci: build ## kill a node of each kind, and run the code blocks of the pages that a first user follows
	@$(ENTER) $(PYTEST) -n $(WORKERS) --dist worksteal -m ci

# Robots by the wall clock, which a busy machine disturbs, run alone. The last lines repeat the unit tests with the
# library versions of Ubuntu 24.04, without ROS, and the tests of extras that are too large for every run.
KILLS ?= 40
test-nightly: test test-ci .venv-noble/.installed .venv-extras/.installed ## all tests, for hours; before a release
	@$(ENTER) $(PYTEST) -n auto -rP -m nightly --kills $(KILLS) test
	@$(ENTER) $(PYTEST) -m clock test/ros
	@$(ENTER) $(PYTEST) -rs -m browser test/view
	@PYTHONPATH=$(CURDIR) .venv-noble/bin/python -m pytest -n auto -m "not slow and not nightly" test/unit
	@$(ENTER) PYTHONPATH=$(CURDIR)/.venv-extras:$$PYTHONPATH python -m pytest -rsP \
	  test/faults/test_other_learners.py test/unit/runs/test_resume.py

.venv-noble/.installed: requirements/noble.txt
	@$(or $(shell command -v python3.12),python3.11) -m venv --prompt noble .venv-noble
	@.venv-noble/bin/python -m pip install -qq --disable-pip-version-check -r $<
	@touch $@

.venv-extras/.installed: requirements/extras.txt requirements/core.txt | $(VENV)
	@.venv/bin/python -m pip install -qq --disable-pip-version-check --target .venv-extras \
	  -c requirements/core.txt -r $<
	@touch $@

BENCH_OPTIONS ?=
bench: build ## run all benchmarks but those of hours, even if some fail; BENCH_OPTIONS=--quick: seconds each
	@$(ENTER) failed=; for script in $(filter-out benchmarks/tasks.py benchmarks/ablation.py benchmarks/descriptions.py,$(shell grep -l __main__ benchmarks/*.py)); do \
	  echo "$$script ..."; python "$$script" $(BENCH_OPTIONS) || failed+=" $$script"; done; \
	[ -z "$$failed" ] || { echo "failed:$$failed" >&2; exit 1; }

docs: build .venv/.docs ## build the documentation site in docs/_build/html
	@$(ENTER) python -m sphinx -q -E -W --keep-going -b html docs docs/_build/html
	@echo docs/_build/html/index.html

.venv/.docs: requirements/docs.txt | $(VENV)
	@.venv/bin/python -m pip install -qq --disable-pip-version-check -r $<
	@touch $@

clean: ## remove everything built or installed
	@rm -rf .venv .venv-extras .venv-noble build install log docs/_build .hypothesis .mypy_cache .pytest_cache .ruff_cache
