# Sets up everything in .venv, then runs. Needs python3, its venv module and make.
#
# What is installed is stamped by a hash of what describes it, so that a second start installs
# nothing; so are the compiled kernels, by the sources they are made from. The package itself is
# installed in editable mode: the sources of this folder run. What that leaves out, which is
# what `ros2 run` and the ament index need, setup.py's own install_data puts into .venv.

SHELL := /bin/bash
.SHELLFLAGS := -e -o pipefail -c
.DEFAULT_GOAL := help

VENV := .venv
RUN_ARGS ?=
TEST_ARGS ?=
CAMPAIGN_ARGS ?=
SOAK_ARGS ?=
BENCH_ARGS ?=

# Three workers for two cores: graphs that start and end leave them idle half of the time.
# test/conftest.py divides the tests among them.
PYTEST = $(BIN)/python -m pytest -n 3
READY = $(TEST_STAMP) $(DATA_STAMP) $(COMPILED_STAMP)

# A native ROS 2 Jazzy is used where there is one; the wheels must not shadow it.
ROS_PREFIX ?= /opt/ros/jazzy
ifneq ($(wildcard $(ROS_PREFIX)/setup.bash),)
  ROS := native
  WITH_ROS := source $(ROS_PREFIX)/setup.bash &&
else ifeq ($(ROS_DISTRO),jazzy)
  # Sourced already, from elsewhere, unless the variable is all there is.
  ROS := $(shell python3 -c 'import rclpy' 2>/dev/null && echo native || echo wheels)
else
  ROS := wheels
endif

ifeq ($(ROS),native)
  PYTHON ?= $(if $(WITH_ROS),/usr/bin/python3,python3)
  VENV_FLAGS := --system-site-packages
  # What else is installed must leave its numpy, which its messages and pinocchio are built for.
  KEPT := 'numpy<2'
  RUN_PACKAGE := .
  VIEW_PACKAGE := .[view]
  TEST_PACKAGE := .[pybullet,robots,mujoco,dask,learning,view,certify,docs,test]
  DOCS_PACKAGE := .[docs]
else
  PYTHON ?= python3
  VENV_FLAGS :=
  KEPT :=
  RUN_PACKAGE := .[ros]
  VIEW_PACKAGE := .[ros,view]
  TEST_PACKAGE := .[ros,rostest,pybullet,robots,mujoco,dask,learning,view,certify,docs,test]
  DOCS_PACKAGE := .[ros,docs]
endif

BIN := $(VENV)/bin
comma := ,
PIP := $(WITH_ROS) $(BIN)/python -m pip install -qq --disable-pip-version-check
# By uv, in a quarter of the time; by pip where uv is missing, or the registry known to pip alone.
# uv does not see the packages of a native ROS 2. The certificates are those of this machine.
UV := UV_NATIVE_TLS=1 $(BIN)/uv pip install --quiet --python $(BIN)/python
ifeq ($(ROS),native)
  install = $(PIP) $(KEPT) $(1)
else
  install = { [ -x $(BIN)/uv ] && $(UV) $(1) 2>/dev/null; } || $(PIP) $(1)
endif
DESCRIPTION := setup.py setup.cfg pyproject.toml multicontact_control/__init__.py
KEY := $(ROS)-$(shell (pwd; cat $(DESCRIPTION)) | sha256sum | cut -c1-12)
VENV_STAMP := $(VENV)/.made-$(ROS)-$(shell pwd | sha256sum | cut -c1-12)
RUN_STAMP := $(VENV)/.run-$(KEY)
TEST_STAMP := $(VENV)/.test-$(KEY)
VIEW_STAMP := $(VENV)/.view-$(KEY)
DOCS_STAMP := $(VENV)/.docs-$(KEY)
DATA_STAMP := $(VENV)/.data
COMPILED_STAMP := $(VENV)/.compiled
# Of all sources `multicontact compile` itself finds those that kernels are compiled from.
SOURCES := $(shell find multicontact_control sim_bridge -name '*.py')

define CHECK_PYTHON
import sys
if not (3, 10) <= sys.version_info < (3, 14):
    sys.exit(f'error: {sys.executable} is Python {sys.version.split()[0]}; 3.10 to 3.13 is '
             'needed (make PYTHON=...)')
endef
export CHECK_PYTHON

.PHONY: help setup demo run simulate lint check test nightly browser campaign velocities soak bench \
    reference docs dist clean

help:  ## Show this list
	@awk -F ':.*## ' '/^[a-z]+:.*## /{printf "make %-10s %s\n", $$1, $$2}' Makefile
	@echo 'Pass arguments on with RUN_ARGS="--scenario quick" and TEST_ARGS="-k force".'

setup: $(RUN_STAMP) $(DATA_STAMP) $(COMPILED_STAMP)  ## Set up .venv and compile the kernels

demo: setup $(VIEW_STAMP)  ## See and steer the simulated arm in the browser
	@$(WITH_ROS) exec $(BIN)/multicontact demo $(RUN_ARGS)

run: setup  ## Run the experiment over ROS 2: RUN_ARGS="--scenario quick --out DIR"
	@$(WITH_ROS) exec $(BIN)/multicontact run --preset paper $(RUN_ARGS)

simulate: setup  ## Run the experiment in one process, without ROS
	@$(WITH_ROS) exec $(BIN)/multicontact simulate $(RUN_ARGS)

lint: $(TEST_STAMP)  ## Check style and types
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .
	$(BIN)/mypy

check: $(READY) lint  ## For every commit, a minute: style, types, unit tests
	@$(WITH_ROS) exec $(PYTEST) -m 'not (ros or slow or nightly)' $(TEST_ARGS)

test: $(READY) lint  ## Check style and types, then run the tests: twenty minutes
	@$(WITH_ROS) exec $(PYTEST) -m 'not nightly' $(TEST_ARGS)

nightly: $(READY)  ## What takes long: packaging, documents, browser, clusters, all robots, studies
	@$(WITH_ROS) exec $(BIN)/python -m pytest -m nightly $(TEST_ARGS)

browser: $(READY)  ## Drive the pages in Chromium (Debian: chromium)
	@$(WITH_ROS) MULTICONTACT_BROWSER=required exec $(BIN)/python -m pytest -m browser $(TEST_ARGS)

campaign: $(READY)  ## Faults over running graphs: CAMPAIGN_ARGS="--count 20"
	@$(WITH_ROS) PYTHONPATH=test:$$PYTHONPATH exec $(BIN)/python -m campaign.faults $(CAMPAIGN_ARGS)

velocities: $(READY)  ## Wrong joint speeds and sensors, in process: CAMPAIGN_ARGS="--every 20"
	@$(WITH_ROS) PYTHONPATH=test:$$PYTHONPATH exec $(BIN)/python -m campaign.velocities $(CAMPAIGN_ARGS)

soak: $(READY)  ## Hours of random commands and faults: SOAK_ARGS="--hours 0.1"
	@$(WITH_ROS) PYTHONPATH=test:$$PYTHONPATH exec $(BIN)/python -m campaign.soak $(SOAK_ARGS)

bench: setup  ## How fast everything is: BENCH_ARGS="--ticks 2000"
	@$(WITH_ROS) exec $(BIN)/python benchmarks/bench.py $(BENCH_ARGS)

reference: $(RUN_STAMP)  ## Write docs/reference anew, from what the code declares
	@$(WITH_ROS) exec $(BIN)/python docs/make_reference.py

docs: $(DOCS_STAMP)  ## Make HTML of the documents, in build/docs; a broken link is an error
	@$(WITH_ROS) exec $(BIN)/python -m sphinx --fail-on-warning --keep-going --quiet docs build/docs

dist: $(TEST_STAMP)  ## Build wheel and sdist in dist/, check both, try the wheel in an empty venv
	@rm -rf dist
	$(BIN)/python -m build --quiet
	$(BIN)/twine check --strict dist/*
	@$(WITH_ROS) MULTICONTACT_WHEEL=$$(ls dist/*.whl) exec $(BIN)/python -m pytest -s \
	    test/test_distribution.py $(TEST_ARGS)

clean:  ## Remove .venv and everything built, but no runs
	rm -rf $(VENV) build install log dist *.egg-info .hypothesis .mypy_cache .pytest_cache \
	    .ruff_cache
	find . -name __pycache__ -type d -prune -exec rm -rf {} +

$(VENV_STAMP):
	@echo 'Setting up $(VENV) with $(PYTHON) and ROS 2 Jazzy ($(ROS)): once, two minutes.'
	@$(PYTHON) -c "$$CHECK_PYTHON"
	@$(PYTHON) -m venv --clear $(VENV_FLAGS) $(VENV)
	@[ $(ROS) = native ] || $(PIP) uv 2>/dev/null || true
	@touch $@

$(RUN_STAMP): | $(VENV_STAMP)
	@echo 'Installing the dependencies: half a minute.'
	@$(call install,'setuptools>=70.1$(comma)<80' --editable '$(RUN_PACKAGE)')
	@rm -f $(VENV)/.run-* $(VENV)/.test-* $(VENV)/.view-* $(VENV)/.docs-* $(DATA_STAMP) $(COMPILED_STAMP)
	@touch $@

$(TEST_STAMP): $(RUN_STAMP)
	@echo 'Installing what the tests need.'
	@$(call install,--editable '$(TEST_PACKAGE)')
	@touch $@

$(VIEW_STAMP): $(RUN_STAMP)
	@echo 'Installing what the page needs.'
	@$(call install,--editable '$(VIEW_PACKAGE)')
	@touch $@

$(DOCS_STAMP): $(RUN_STAMP)
	@echo 'Installing what the documents need.'
	@$(call install,--editable '$(DOCS_PACKAGE)')
	@touch $@

$(COMPILED_STAMP): $(RUN_STAMP) $(SOURCES)
	@$(WITH_ROS) $(BIN)/multicontact compile
	@touch $@

$(DATA_STAMP): $(RUN_STAMP) package.xml $(wildcard resource/*) $(shell find config)
	@rm -rf $(VENV)/share/multicontact_control $(VENV)/lib/multicontact_control
	@$(BIN)/python -W ignore setup.py --quiet install_data --install-dir $(VENV)
	@touch $@
