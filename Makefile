# make demo: the onboard package alone, in an environment of its own, and a plan over real lunar terrain.
# make test: what the tests need, in another, and all tests.
# make bench: our planners beside other libraries' grid search, what a
# region's search costs, and how long the first plan takes.
PYTHON ?= python3
DEMO := .venv-demo
DEV := .venv-dev
SOURCES := nnpp_edge runtime export calibrate tests

.PHONY: demo test bench lint types typing-tree format clean

$(DEMO)/ready: pyproject.toml
	$(PYTHON) -m venv $(DEMO)
	$(DEMO)/bin/pip install --quiet --disable-pip-version-check --editable .
	touch $@

demo: $(DEMO)/ready
	$(DEMO)/bin/nnpp-edge plan nnpp_edge/terrain/samples/moon_highlands.npz --rescale 20 --workload limit20 \
		--start 90,60 --goal 450,470 --method nnpp --compare --hillshade -o demo-out

$(DEV)/ready: pyproject.toml
	$(PYTHON) -m venv $(DEV)
	$(DEV)/bin/pip install --quiet --disable-pip-version-check --editable '.[dev]'
	touch $@

test: $(DEV)/ready
	$(DEV)/bin/ruff check .
	$(DEV)/bin/ruff format --check .
	$(MAKE) --no-print-directory types
	$(DEV)/bin/python -m pytest

$(DEV)/ready-to-bench: $(DEV)/ready
	$(DEV)/bin/pip install --quiet --disable-pip-version-check --editable '.[bench]'
	touch $@

bench: $(DEV)/ready-to-bench
	$(DEV)/bin/nnpp-edge profile --peers --sizes 256,512,1024,2048,4096 -o build/bench
	$(DEV)/bin/python -m nnpp_edge.benchmarks.region_search
	$(DEV)/bin/python -m nnpp_edge.profiling.cold_start

lint: $(DEV)/ready
	$(DEV)/bin/ruff check .
	$(DEV)/bin/ruff format --check .

format: $(DEV)/ready
	$(DEV)/bin/ruff check --fix .
	$(DEV)/bin/ruff format .

# The stage folders are installed inside nnpp_edge; a type checker wants to see them there.
typing-tree:
	rm -rf build/typing && mkdir -p build/typing
	cp -rs $(CURDIR)/nnpp_edge build/typing/nnpp_edge
	for stage in runtime export calibrate profiles; do cp -rs $(CURDIR)/$$stage build/typing/nnpp_edge/$$stage; done

types: $(DEV)/ready typing-tree
	cd build/typing && MYPYPATH=. $(CURDIR)/$(DEV)/bin/mypy --config-file $(CURDIR)/pyproject.toml -p nnpp_edge

clean:
	rm -rf $(DEMO) $(DEV) build demo-out *.egg-info .pytest_cache .mypy_cache .ruff_cache .hypothesis
