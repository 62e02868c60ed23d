PYTHON ?= python3
BIN := .venv/bin

.PHONY: demo test lint clean

demo: .venv/demo.done
	$(BIN)/python -m torchbeam demo --out out/demo

test: .venv/dev.done
	$(BIN)/ruff check .
	$(BIN)/python -m pytest -n 2 --dist worksteal

lint: .venv/dev.done
	$(BIN)/ruff check .

# One stamp per extra: made again only when pyproject.toml changes, so a second call starts in seconds.
.venv/%.done: pyproject.toml
	test -x $(BIN)/python || $(PYTHON) -m venv .venv
	$(BIN)/python -m pip install --quiet torch==2.13.0
	$(BIN)/python -m pip install --quiet --editable '.[$*]'
	touch $@

clean:
	rm -rf .venv build dist *.egg-info out
