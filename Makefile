# `make demo` and `make test` set everything up by themselves; both are quick the second time.

PYTHON ?= python3
BIN := .venv/bin
INSTALLED := .venv/installed
# One thread a process: the test workers share the cores.
PYTEST := OMP_NUM_THREADS=1 $(BIN)/pytest -n auto

.PHONY: demo test test-slow fuzz tables lint types check clean
.DEFAULT_GOAL := demo

demo: $(INSTALLED)  ## the embedded room through the embedded weights, into out/demo
	$(BIN)/mvsam demo --out out/demo

test: $(INSTALLED)  ## everything that needs minutes, not more
	$(PYTEST)

test-slow: $(INSTALLED)  ## full-size models
	OMP_NUM_THREADS= $(BIN)/pytest -m slow

fuzz: $(INSTALLED)  ## made-up files for 5 minutes a reader; TARGETS="sens split" SECONDS=60
	$(BIN)/python -c 'import atheris' 2>/dev/null || $(BIN)/python -m pip install --quiet \
		--disable-pip-version-check --constraint constraints.txt --editable '.[fuzz]'
	OMP_NUM_THREADS=1 $(BIN)/python -m tests.fuzz $(TARGETS) --seconds $(or $(SECONDS),300)

# One thread: two of these side by side outrun one of two threads, and share the rows.
# Table 6 is made of pictures, which need weights.
tables: $(INSTALLED)  ## every row of Tables 1-5 on rooms, trained where missing; TABLE_OPTIONS="--steps 2000"
	for table in 1 4 5 2 3; do \
		OMP_NUM_THREADS=1 $(BIN)/mvsam table $$table --data rooms --train $(TABLE_OPTIONS) \
			--figure results/table$$table.png || exit 1; \
	done
	if test -e runs/base_rooms-0/model.safetensors; then \
		$(BIN)/mvsam table 6 --data rooms --figure results/table6.png; fi
	$(BIN)/python benchmarks/claims.py --data rooms --out docs/tables.md

lint: $(INSTALLED)
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .

types: $(INSTALLED)
	$(BIN)/pyright

check: lint types test

$(INSTALLED): pyproject.toml constraints.txt
	@$(PYTHON) -c 'import sys; sys.exit(sys.version_info < (3, 11))' || \
		{ echo "mvsam needs Python 3.11 or later: make PYTHON=python3.12 $(MAKECMDGOALS)"; exit 1; }
	test -x $(BIN)/python || $(PYTHON) -m venv .venv
	$(BIN)/python -m pip install --quiet --disable-pip-version-check \
		--constraint constraints.txt --editable '.[dev]'
	touch $@

clean:
	rm -rf .venv out
