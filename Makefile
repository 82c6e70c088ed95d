# make demo: the package with what draws, in an environment of its own, a plan over real lunar terrain, and a rover's among rocks.
# make check: lint, spelling, types, import contract and the fast tests; about a minute, once the kernels are compiled.
# make test: the same with all tests.
# make bench: our planners beside other libraries' grid search, the stages from elevations to a first path, and how long
# the first plan takes.
# make results TERRAIN=dem.tif: the tables of README and docs/results.md, a quarter of an hour on a machine that does nothing else.
# make coverage: what the fast tests reach, in the terminal and as build/coverage.xml; compiled kernels are not seen.
# make wheel, make try-wheel, make try-oldest: the wheel; it alone in a bare environment, which plans and measures there,
# with the newest and with the oldest packages that it takes (.ci/oldest.txt). PYTHON=python3.12 tries another Python.
# make kernel-wheels: wheels of compiled kernels (nnpp-edge-kernels), for x86-64-v3 and -v4 and for 64-bit ARM, all made on
# this x86-64 machine, one for each of PYTHONS that is to be had; some minutes for each.
# make release: all of that, a source distribution, what the onboard install consists of, notes and checksums, into
# build/release; the same commit gives the same bytes. make try-release: each of these tried as a user will.
# make bundle PLATFORM=aarch64 TARGET_PYTHON=3.11: of the release, a folder with every wheel for a robot without internet.
# make try-bundle: a bundle, bare and without a network; one for aarch64 and 3.11, as root, on an emulated processor.
# make try-aarch64: as root, both wheels on an emulated 64-bit ARM processor: the same plans as here, and fast tests. PYTHON is
# to be 3.11.
# make ros: the ROS 2 node beside plain rclpy, on the wheels of ROS 2 Kilted (x86-64), in an environment of its own.
# make docs: the site, into build/site; nothing is fetched but the packages.
# make fuzz MINUTES=30: damaged files, odd options, odd weights and the rest (docs/fuzzing.md).
PYTHON ?= python3
PYTHONS ?= python3.11 python3.12 python3.13
MINUTES ?= 30
PLATFORM ?= $(shell uname -m)
TARGET_PYTHON ?= $(shell $(PYTHON) -c 'import sys; print("%d.%d" % sys.version_info[:2])')
DEMO := .venv-demo
DEV := .venv-dev
TRY = .ci/try-wheel $(PYTHON) build/wheel/nnpp_edge-*.whl
PYTEST := $(DEV)/bin/python -m pytest --numprocesses 2

DOCS := .venv-docs
ROS := .venv-ros

.PHONY: demo check test coverage bench results docs ros fuzz kernels lint spelling types contract format wheel kernel-wheels try-aarch64 \
	try-wheel try-oldest release try-release bundle try-bundle clean

$(DEMO)/ready: pyproject.toml
	$(PYTHON) -m venv $(DEMO)
	$(DEMO)/bin/pip install --quiet --disable-pip-version-check --editable '.[viz]'
	touch $@

demo: $(DEMO)/ready
	$(DEMO)/bin/nnpp-edge plan sample:moon_highlands --rescale 20 --workload limit20 \
		--start 90,60 --goal 450,470 --method nnpp --compare -o demo-out
	$(DEMO)/bin/nnpp-edge plan sample:moon_rocks --vehicle large-rover --set clearance_m=0.4 --set max_step_m=0.3 \
		--start 60,9 --goal 60,113 --method astar --compare -o demo-out/vehicle

$(DEV)/ready: pyproject.toml
	$(PYTHON) -m venv $(DEV)
	$(DEV)/bin/pip install --quiet --disable-pip-version-check --no-compile --editable '.[dev]'
	touch $@

check: $(DEV)/ready
	$(MAKE) --no-print-directory --jobs 2 lint spelling types contract
	$(PYTEST) --dist worksteal -m 'not slow'

test: $(DEV)/ready
	$(MAKE) --no-print-directory --jobs 2 lint spelling types contract kernels
	$(PYTEST)

coverage: $(DEV)/ready
	$(PYTEST) --dist worksteal -m 'not slow' --cov --cov-report=term --cov-report=xml:build/coverage.xml

kernels: $(DEV)/ready
	$(DEV)/bin/nnpp-edge warmup

lint: $(DEV)/ready
	$(DEV)/bin/ruff check .
	$(DEV)/bin/ruff format --check .
	$(DEV)/bin/flake8 nnpp_edge runtime export calibrate

spelling: $(DEV)/ready
	$(DEV)/bin/typos

types: $(DEV)/ready
	$(DEV)/bin/mypy -p nnpp_edge

contract: $(DEV)/ready
	$(DEV)/bin/lint-imports

format: $(DEV)/ready
	$(DEV)/bin/ruff check --fix .
	$(DEV)/bin/ruff format .

$(DEV)/ready-to-bench: $(DEV)/ready
	$(DEV)/bin/pip install --quiet --disable-pip-version-check --editable '.[bench]'
	touch $@

bench: $(DEV)/ready-to-bench
	$(DEV)/bin/nnpp-edge profile --peers --sizes 256,512,1024,2048 -o build/bench
	$(DEV)/bin/nnpp-edge profile

results: $(DEV)/ready
	$(DEV)/bin/python -m nnpp_edge.benchmarks.results $(TERRAIN)

wheel:
	rm -rf build/lib build/wheel
	$(PYTHON) -m pip wheel --quiet --disable-pip-version-check --no-deps --wheel-dir build/wheel .

kernel-wheels: wheel
	rm -rf build/kernel-wheels
	for python in $(PYTHONS); do \
		if ! $$python --version; then echo "left out: no $$python here"; continue; fi; \
		$$python -m venv --clear build/kernels && \
		build/kernels/bin/pip install --quiet --disable-pip-version-check build/wheel/nnpp_edge-*.whl && \
		build/kernels/bin/python .ci/kernel_wheel.py build/kernel-wheels || exit 1; \
	done

try-aarch64:
	$(MAKE) --no-print-directory kernel-wheels PYTHONS=$(PYTHON)
	.ci/try-aarch64 $(PYTHON)

release: kernel-wheels
	.ci/release $(PYTHON) $(TAG)

build/release/SHA256SUMS:
	$(MAKE) --no-print-directory release

try-release: build/release/SHA256SUMS
	.ci/try-release $(PYTHON)
	$(MAKE) --no-print-directory try-bundle

bundle: build/release/SHA256SUMS
	.ci/bundle $(PYTHON) $(PLATFORM) $(TARGET_PYTHON)

try-bundle: bundle
	.ci/try-$(if $(filter $(PLATFORM),$(shell uname -m)),bundle,$(PLATFORM)) $(PYTHON) \
		build/bundle/nnpp-edge-*-cp$(subst .,,$(TARGET_PYTHON))-$(PLATFORM)

try-wheel: wheel
	$(TRY)

try-oldest: wheel
	$(TRY) --constraint .ci/oldest.txt

$(DOCS)/ready: pyproject.toml
	$(PYTHON) -m venv $(DOCS)
	$(DOCS)/bin/pip install --quiet --disable-pip-version-check --editable '.[docs]'
	touch $@

docs: $(DOCS)/ready
	NO_MKDOCS_2_WARNING=1 $(DOCS)/bin/mkdocs build --quiet --strict

$(ROS)/ready: pyproject.toml
	$(PYTHON) -m venv $(ROS)
	$(ROS)/bin/pip install --quiet --disable-pip-version-check --editable '.[ros,test]'
	touch $@

ros: $(ROS)/ready
	$(ROS)/bin/nnpp-edge warmup
	$(ROS)/bin/python -m pytest tests/robot/test_ros2*.py

fuzz: $(DEV)/ready
	$(DEV)/bin/python -m tests.fuzz --minutes $(MINUTES)

clean:
	rm -rf $(DEMO) $(DEV) $(DOCS) $(ROS) build demo-out *.egg-info .pytest_cache .mypy_cache .ruff_cache .import_linter_cache .hypothesis
