# Everything runs from the environment in .venv, which these targets make with nothing but Python and make.
PYTHON ?= python3
BIN := .venv/bin
PIP := $(BIN)/pip install --disable-pip-version-check --progress-bar on
# more than two at a time take no less on two cores
TESTS := $(BIN)/pytest --numprocesses 2 --dist loadfile --no-loadscope-reorder --durations 15 --quiet

.PHONY: install setup demo test test-ci test-all readers planners lint check docs proto package bench soak weights clean

# what running needs: PyTorch, SUMO and the libraries around them
install: .venv/.installed

# that, and what developing needs: tests, type checker, browser driver, site generator, Ray
setup: .venv/.ready

.venv/.installed: pyproject.toml constraints.txt
	@echo "[1/3] an environment in .venv"
	$(PYTHON) -m venv .venv
	@echo "[2/3] PyTorch: 200 MB to fetch without a GPU's libraries, else some GB"
	$(PIP) "$$(grep -m 1 '^torch==' constraints.txt)"
	@echo "[3/3] SUMO (150 MB) and the libraries that running needs"
	$(PIP) --constraint constraints.txt --editable .
	@touch $@
	@echo "installed; '. .venv/bin/activate' lets you type advdiff-sumo, without it type .venv/bin/advdiff-sumo"

.venv/.ready: .venv/.installed
	@echo "what developing needs: about a GB, Ray, mypy, Playwright and MkDocs among it"
	$(PIP) --constraint constraints.txt --editable '.[dev]'
	@touch $@

# a sound planner and the same one with 12 m of sight, in the same lawful traffic
demo: install
	@folder=runs/demo-$$(date +%Y%m%d-%H%M%S) && set -e && \
	echo "the sound planner:" && \
	$(BIN)/advdiff-sumo run --config scenarios/demo.toml --out $$folder/sound && \
	echo "the same planner, which sees 12 m far:" && \
	$(BIN)/advdiff-sumo run --config scenarios/demo.toml --defect range:strong --out $$folder/short-sighted && \
	echo "what only the second one fails at, with a careful driver beside it: $$folder/short-sighted/report.html"
	@echo "next: . .venv/bin/activate    then advdiff-sumo run --help (or type .venv/bin/advdiff-sumo without activating)"

# values worked by hand, contracts, and one of everything end to end
test: setup
	$(TESTS) -m "not slow and not nightly"

# those and the slow ones, as continuous integration runs them: all but further maps, seeds and policies
test-ci: setup
	$(TESTS) -m "not nightly"

# all there is; before a release, or every night
test-all: setup
	$(TESTS)

# other people's programs that read what we export, in environments of their own; tests/export uses them where they are
readers: build/readers/commonroad/.ready build/readers/asam/.ready build/readers/av2/.ready build/readers/lanelet2/.ready build/readers/nuplan/.ready build/readers/opendrive/.ready

build/readers/av2/.ready: PIP_FLAGS = --no-deps

build/readers/%/.ready: tests/export/readers/%.txt | build/pip/bin/pip
	$(PYTHON) -m venv --without-pip build/readers/$*
	build/pip/bin/pip --python build/readers/$*/bin/python install --quiet --disable-pip-version-check $(PIP_FLAGS) --requirement $<
	touch $@

# one pip for all of them: to bring its own into an environment takes seconds
build/pip/bin/pip:
	$(PYTHON) -m venv build/pip

# other people's planners that examples/ serves, in environments of their own; tests/examples drives them where they are
planners: build/tum_planners/reactive/.ready build/tum_planners/frenetix/.ready

build/tum_planners/%/.ready: examples/tum_planners/setup.sh .venv/.installed
	PATH="$(CURDIR)/$(BIN):$$PATH" examples/tum_planners/setup.sh $* build/tum_planners/$*
	touch $@

# style, types, import layers, links in the pages
lint: setup
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .
	$(BIN)/mypy
	$(BIN)/lint-imports
	$(BIN)/python tools/check_links.py

# that, and whether the pages make a site; tests/docs/test_site.py, which is slow, builds it, too
check: lint
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
	$(BIN)/python tools/bench_engine.py
	$(BIN)/python tools/bench_sweep.py
	$(BIN)/python tools/bench_report.py

# an hour of every background, target and attack on many nets; ADVDIFF_DATA adds real nets and logs; resumes
soak: setup
	$(BIN)/python tools/soak.py build/soak $${ADVDIFF_DATA:+--data $$ADVDIFF_DATA} --minutes 60

# the weights "closed-loop" from nothing, in some hours; goes on where it was stopped
weights: install
	tools/make_weights.sh build/weights

clean:
	rm -rf .venv build dist *.egg-info .mypy_cache .ruff_cache .pytest_cache .hypothesis
