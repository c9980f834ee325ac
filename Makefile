# make run: complete set-up, then the paper's formation. make check before a commit, make test before a push; make nightly,
# make lint, make coverage, make mutation, make docs, make dist, make bench [AGAINST=REV], make references, make clean.
# PYTEST_ARGS is passed to pytest: make test PYTEST_ARGS='-x -k outbox'.
PYTHON      ?= python3
SCENARIO    ?= formation
ARGS        ?=
PYTEST_ARGS ?=
# One per logical core.
WORKERS     ?= logical

VENV      := .venv
BIN       := $(VENV)/bin
INSTALLED := $(VENV)/.installed
LINTERS   := $(VENV)/.installed-lint
DEVELOP   := $(VENV)/.installed-dev
INSTALL   := $(BIN)/python -m pip install --quiet --disable-pip-version-check --no-build-isolation -c constraints.txt -e
FMU       := build/Vehicle.fmu
PYTEST    := $(BIN)/pytest -n $(WORKERS) --dist worksteal
# Tests of the controllers and of their communication, and one run of real processes on two kinds of bus.
CHECK     := $(addprefix tests/,bus faults conductor control ecu plant integration/test_identity.py)
# The tests of the files listed in pyproject.toml under [tool.coverage.run].
SAFETY    := $(addprefix tests/,bus/test_e2e.py bus/test_inbox.py bus/test_outbox.py faults control/test_certificate.py \
	ecu/test_plausibility.py plant/test_actuators.py)
ON_VCAN   := -p no:cacheprovider $(addprefix tests/,vcan bus/link ecu/test_c_tracker.py integration/test_own_ecu.py \
	integration/test_any_frame.py)

.PHONY: setup run check test coverage mutation nightly lint lint-c lint-js docs dist bench references clean
.DELETE_ON_ERROR:

# Both are quick where nothing has changed; Python does not keep bytecode itself if PYTHONDONTWRITEBYTECODE is set.
setup: $(FMU)
	@$(BIN)/python -m bench.compiled.build
	@$(BIN)/python -m compileall -q bench platoon_fmu

run: setup
	$(BIN)/platoon run $(SCENARIO) $(ARGS)

# Takes two minutes on two cores.
check: setup $(DEVELOP) lint
	$(PYTEST) $(PYTEST_ARGS) $(CHECK)

# Tests that use the kernel's CAN links run a second time if there are any, if necessary in a separate kernel.
test: setup $(DEVELOP) coverage
	$(PYTEST) $(PYTEST_ARGS)
	@if $(BIN)/platoon vcan -- true; then \
		$(BIN)/platoon vcan -- $(BIN)/pytest $(ON_VCAN) -m 'kernel_can and not nightly'; \
	elif [ -n "$$CI" ]; then echo "make test: the tests on vcan must run in CI" >&2; exit 1; \
	else echo "make test: NOT TESTED ON VCAN, see the message above" >&2; fi

# Compiled code cannot be traced, so it is interpreted here.
coverage: setup $(DEVELOP)
	PLATOON_INTERPRETED=1 $(BIN)/coverage run -m pytest $(SAFETY)
	$(BIN)/coverage report

# Some 1,800 mutants, one per core at a time.
mutation: setup $(DEVELOP)
	$(BIN)/python -m tests.mutation $(SAFETY)

nightly: setup $(DEVELOP) mutation
	$(PYTEST) -m nightly $(PYTEST_ARGS)
	$(BIN)/platoon vcan -- $(BIN)/pytest $(ON_VCAN) -m 'kernel_can and nightly'

lint: $(LINTERS) lint-c lint-js
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .
	$(BIN)/mypy
	$(BIN)/lint-imports

# Each folder is checked with its own compiler options; cantools generates the tracker's headers.
lint-c: TIDY = $(BIN)/clang-tidy --quiet
lint-c: WARNINGS = -Wall -Wextra -Wpedantic -Wconversion -Wshadow
lint-c: HEADERS = $$(echo $(VENV)/lib/python3*/site-packages/fmpy/c-code)
lint-c: HOSTS = tests/platoon_fmu
lint-c: $(LINTERS)
	$(BIN)/clang-format --dry-run --Werror $$(find bench platoon_fmu tests -name '*.[ch]' -not -path '*/build/*')
	@$(MAKE) -s -C bench/examples/tracker BUILD=$(CURDIR)/build/lint PYTHON=$(CURDIR)/$(BIN)/python \
		$(CURDIR)/build/lint/messages.h
	$(TIDY) platoon_fmu/fmi/*.c -- -std=c99 $(WARNINGS) -isystem $(HEADERS)
	$(TIDY) bench/examples/tracker/*.c -- -std=c11 -D_DEFAULT_SOURCE $(WARNINGS) -isystem build/lint
	$(TIDY) bench/benchmarks/*.c -- -std=c11 $(WARNINGS) -isystem $(HEADERS) -Iplatoon_fmu/fmi
	$(TIDY) $(HOSTS)/host/*.c -- -std=c11 -D_POSIX_C_SOURCE=200809L $(WARNINGS) -isystem $(HEADERS)
	$(TIDY) $(HOSTS)/faulty/*.c -- -std=c11 $(WARNINGS) -isystem $(HEADERS)
	$(TIDY) $(HOSTS)/platform_host.c -- -std=c99 $(WARNINGS) -isystem $(HEADERS)
	$(TIDY) $(HOSTS)/platform_host.c -- -std=c99 -DFMI3 $(WARNINGS) -isystem $(HEADERS)

# The scripts of a page share one scope, so they are checked as one. The campaign's page has scripts of the report's, and
# does not use all that is in them.
lint-js: SHARED = dom data marks cursor axes save plot rows print
lint-js: $(LINTERS)
	@mkdir -p build/lint
	cat bench/analysis/page/*.js > build/lint/page.js
	$(BIN)/oxlint --deny-warnings build/lint/page.js
	cat $(SHARED:%=bench/analysis/page/%.js) bench/campaign/page/*.js > build/lint/campaign.js
	$(BIN)/oxlint --deny-warnings -A no-unused-vars -A prefer-const build/lint/campaign.js

# A page for each module, with a search, readable offline. The modules are listed because pdoc omits those that are not in
# a package's __all__.
docs: setup $(DEVELOP)
	rm -rf build/docs
	PYTHONWARNINGS='ignore:The module specification' $(BIN)/pdoc --docformat google --no-show-source \
		--footer-text "$$($(BIN)/platoon --version)" -o build/docs \
		bench platoon_fmu $$(find bench platoon_fmu -name '[!_]*.py' -not -path 'bench/examples/tracker/*' | \
		sort | sed 's/\.py$$//; s,/,.,g')
	@! grep -rE '<(script|link|img)[^>]*(src|href)="?https?:' build/docs || { \
		echo "make docs: these pages have external references" >&2; exit 1; }
	@echo build/docs/index.html

# The sdist, and the wheel built from it.
dist: $(INSTALLED)
	rm -rf build/dist
	$(BIN)/python -m hatchling build -t sdist -d build/dist
	$(BIN)/python -m pip wheel --quiet --no-deps --no-build-isolation --wheel-dir build/dist build/dist/platoon-*.tar.gz

# With AGAINST, ratios to another revision: make bench AGAINST=HEAD~1 ARGS='--pairs 3 --realtime 60'.
bench: setup $(DEVELOP)
	$(BIN)/python -m bench.benchmarks $(if $(AGAINST),against $(AGAINST) $(ARGS))

# The logs on which `platoon resim` is tested; regenerate them after an intended change of the frames that ECUs send.
references: setup
	$(BIN)/python -m tests.reference

clean:
	rm -rf $(VENV) build *.egg-info .pytest_cache .mypy_cache .ruff_cache .hypothesis .import_linter_cache
	find bench platoon_fmu tests -name __pycache__ -type d -prune -exec rm -rf {} +

# The install is editable, so only changed requirements need another.
$(INSTALLED): pyproject.toml constraints.txt
	@$(PYTHON) -c 'import sys; sys.exit(sys.version_info < (3, 11))' 2>/dev/null || { \
		echo "platoon needs Python 3.11 or newer as $(PYTHON). On Debian or Ubuntu: apt install python3" \
			"(or name another: make PYTHON=python3.12)" >&2; exit 1; }
	@$(PYTHON) -c 'import venv, ensurepip' 2>/dev/null || { \
		echo "$(PYTHON) cannot create virtual environments. On Debian or Ubuntu: apt install python3-venv" >&2; exit 1; }
	$(PYTHON) -m venv $(VENV)
	$(BIN)/python -m pip install --quiet --disable-pip-version-check -c constraints.txt editables hatchling
	$(INSTALL) '.[campaign,live,mf4,pandas]'
	@touch $@

$(LINTERS): $(INSTALLED)
	$(INSTALL) '.[lint]'
	@touch $@

# For tests and benchmarks only; mostly zig's compilers for all platforms.
$(DEVELOP): $(LINTERS)
	$(INSTALL) '.[dev]'
	@touch $@

$(FMU): $(INSTALLED) $(wildcard platoon_fmu/*.* platoon_fmu/fmi/*)
	@for cc in cc gcc clang; do \
		echo '#include <math.h>' | $$cc -fsyntax-only -x c - 2>/dev/null && exit 0; \
	done; echo "No working C compiler to build the vehicle FMU." \
		"On Debian or Ubuntu: apt install gcc libc6-dev" >&2; exit 1
	$(BIN)/platoon fmu build
	@touch $@
