# Everything runs from the environment in .venv, which `make setup` makes with nothing but Python and make.
PYTHON ?= python3
BIN := .venv/bin

.PHONY: setup demo test readers check docs proto package bench clean

setup: .venv/.ready

.venv/.ready: pyproject.toml constraints.txt
	$(PYTHON) -m venv .venv
	$(BIN)/pip install --quiet --disable-pip-version-check "$$(grep -m 1 '^torch==' constraints.txt)"
	$(BIN)/pip install --quiet --disable-pip-version-check --constraint constraints.txt --editable '.[dev]'
	touch .venv/.ready

demo: setup
	$(BIN)/advdiff-sumo run --target lane_graph --background diffusion --episodes 5 --out runs/demo-$$(date +%Y%m%d-%H%M%S)

test: setup
	$(BIN)/pytest --numprocesses 2 --dist loadfile --no-loadscope-reorder --quiet

# other people's programs that read what we export, in environments of their own; tests/export uses them where they are
readers: build/readers/commonroad/.ready build/readers/asam/.ready build/readers/av2/.ready build/readers/lanelet2/.ready

build/readers/av2/.ready: PIP_FLAGS = --no-deps

build/readers/%/.ready: tests/export/readers/%.txt
	$(PYTHON) -m venv build/readers/$*
	build/readers/$*/bin/pip install --quiet --disable-pip-version-check $(PIP_FLAGS) --requirement $<
	touch $@

check: setup
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .
	$(BIN)/mypy
	$(BIN)/lint-imports
	$(BIN)/python tools/check_links.py
	site=$$(mktemp -d) && trap 'rm -rf "$$site"' EXIT && NO_MKDOCS_2_WARNING=1 $(BIN)/mkdocs build --strict --site-dir "$$site"

docs: setup
	NO_MKDOCS_2_WARNING=1 $(BIN)/mkdocs build --strict
	@echo build/site/index.html

# wheel and sdist, and the wheel in an empty environment with no repository around
package: setup
	tools/check_package.sh build/package

# the compiled description of the planners' protocol; a test holds it to planner.proto
proto: setup
	cd advdiff_sumo/planner_kit && ../../$(BIN)/python -m grpc_tools.protoc -I . --descriptor_set_out=planner.binpb planner.proto

bench: setup
	$(BIN)/python tools/bench.py
	$(BIN)/python tools/bench_plans.py
	$(BIN)/python tools/bench_sweep.py
	$(BIN)/python tools/bench_report.py

clean:
	rm -rf .venv build dist *.egg-info .mypy_cache .ruff_cache .pytest_cache .hypothesis
