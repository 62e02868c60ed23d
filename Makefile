PYTHON ?= python3
BIN := .venv/bin
LOWEST := .venv-lowest/bin
PYTEST := python -m pytest -n 2 --dist worksteal

# Another processor's rounding, in software: MKL's and ATen's plainest instructions, and sums split over two threads.
OTHER_ROUNDING := MKL_CBWR=COMPATIBLE ATEN_CPU_CAPABILITY=default OMP_NUM_THREADS=2 OMP_WAIT_POLICY=PASSIVE

# A process that finds no compiled modules takes a second longer to import torchbeam, whatever the environment says.
export PYTHONDONTWRITEBYTECODE =

.PHONY: demo test quick test-long test-first test-second test-rounding test-lowest bench docs docs-serve gallery dist lint clean

demo: .venv/demo.done
	$(BIN)/python -m torchbeam demo --out out/demo

test: lint test-first test-second

# A minute: the style, a row or two of the nets, and the tests of the modules that differ from main (or from BASE=...).
BASE ?= main
SAMPLE := tests/unit/test_layers.py tests/unit/math tests/unit/equations/test_midpoint.py tests/properties/test_batch_sizes.py \
	"tests/properties/test_parity.py::test_native_code_gives_the_eager_answer[bodies-steps]" \
	"tests/properties/test_zero.py::test_gradient_at_zero[TipLoad.force-equilibrium]"
quick: .venv/dev.done
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .
	$(BIN)/$(PYTEST) $(SAMPLE) $$(git diff --name-only $(BASE) -- torchbeam tests | sed -n \
		-e 's|^torchbeam/\(.*/\)\([^/]*\)\.py$$|tests/unit/\1test_\2.py|p' -e '/^tests\/.*\/test_[^/]*\.py$$/p' \
		| sort -u | xargs -r ls 2> /dev/null | head -12)

# Of the dear tests, most of which make one claim over many scenes (tests/in_turn.json), a fifth, by the number of commits:
# five turns run all rows. `make test TURN=1/1` runs them at once, `make test TURN=2/5` what the second turn runs.
TURN ?= $(shell echo $$(( $$(git rev-list --count HEAD 2> /dev/null || echo 0) % 5 + 1 )))/5

# What `make test` leaves out: the tests marked "long".
test-long: .venv/dev.done
	$(BIN)/$(PYTEST) -m long

# Each test once. Of the units those of linear algebra, local functions, statics and linear models, which rest on rounding
# most, run as another processor rounds: `test-second`; all others, and what is compiled, as this one does: `test-first`.
# The same relations between answers hold by eager steps too.
UNITS := $(addprefix tests/unit/,math nodal state linear solvers statics) tests/unit/equations/test_load_steps.py
PROPERTIES := $(addsuffix .py,$(addprefix tests/properties/test_,batch_sizes metamorphic))
test-first: .venv/dev.done
	$(BIN)/$(PYTEST) --turn $(TURN) $(addprefix --ignore=,$(UNITS))

test-second: .venv/dev.done
	$(OTHER_ROUNDING) $(BIN)/$(PYTEST) --turn $(TURN) --eager tests/properties $(UNITS) $(PROPERTIES)

# The same of all units that compute.
test-rounding: .venv/dev.done
	$(OTHER_ROUNDING) $(BIN)/$(PYTEST) tests/unit $(addprefix --ignore=tests/unit/,plot uncertainty analysis mixed engine/chain)

# Operation counts, and errors of fixed settings, against the stored ones; `python -m studies bench` measures times. After a
# change that is meant: python -m studies bench --operations tests/studies/operations.json --update
bench: .venv/dev.done
	$(BIN)/python -m studies bench --operations tests/studies/operations.json --errors tests/studies/errors.json

# The site, into out/site: every link and every name in the reference is looked up, and one that is missing is an error.
docs: .venv/docs.done
	$(BIN)/python docs/site.py
	$(BIN)/zensical build --strict --config-file out/site.toml

# Each example once more, its picture and its time, for the gallery of the site.
gallery: .venv/dev.done
	$(BIN)/python docs/gallery.py

docs-serve: docs
	$(BIN)/zensical serve --config-file out/site.toml

# Every dependency at the lowest version that pyproject.toml states, all at once.
test-lowest: .venv-lowest/done
	$(LOWEST)/$(PYTEST)

# What is released: the source and a wheel, into dist/, installed in an empty environment and tried there.
dist: .venv/dev.done
	rm -rf dist
	$(BIN)/python -m build --outdir dist
	TORCHBEAM_DIST=$(CURDIR)/dist $(BIN)/$(PYTEST) -n 0 -m "long or not long" tests/unit/test_release.py

lint: .venv/dev.done
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .
	$(BIN)/mypy

# One stamp per extra: made again only when pyproject.toml changes, so a second call starts in seconds.
.venv/%.done: pyproject.toml
	test -x $(BIN)/python || $(PYTHON) -m venv .venv
	$(BIN)/python -m pip install --quiet torch==2.13.0
	$(BIN)/python -m pip install --quiet --editable '.[$*]'
	touch $@

.venv-lowest/done: pyproject.toml
	test -x $(LOWEST)/python || $(PYTHON) -m venv .venv-lowest
	$(LOWEST)/python -m pip install --quiet uv
	$(LOWEST)/uv pip install --quiet --upgrade --python $(LOWEST)/python --resolution lowest-direct \
		"$$(sed -n 's/^requires = \["\(setuptools.*\)"\]/\1/p' pyproject.toml)"
	$(LOWEST)/uv pip install --quiet --upgrade --python $(LOWEST)/python --resolution lowest-direct --no-build-isolation \
		--editable '.[test]'
	touch $@

clean:
	rm -rf .venv .venv-lowest build dist *.egg-info out
