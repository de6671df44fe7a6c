# `make demo`: build, then the whole pipeline on the simulated rig.
# `make test`: all tests.
# `make test-long`: coverage of the intervals and rates of warnings, in full; the core's tests
#   with all paths and materials; captures cut at every record and 200 killed at random
#   moments; 200 under a constant lamp; a session of a camera of five megapixels, and memory
#   of a 20 MP sensor.
# `make test-console`: the operator's console in a browser (tests/browser/README.md).
# `make test-vm`: the program against the kernel's own drivers in a virtual machine.
# `make docs`: the documentation as a site, target/book/index.html.
# `make deb`: the Debian package, target/debian/rig-reflectometry_*.deb (docs/install.md).
# `make test-deb`: that package in a fresh Debian root; needs root or sudo.
# `make release`: everything that a release consists of, in target/release-VERSION; publishes nothing.
# `make python`: the Python package as a wheel, installed into a fresh environment, its tests.
# `make test-external`: exports loaded in the programs they are for (tests/external/README.md).

CARGO ?= cargo
SUDO := $(if $(filter 0,$(shell id -u)),,sudo)

.PHONY: deb demo docs python python-tests python-wheel release test test-deb test-long test-vm test-external test-console console-pictures build deps deps-test deps-console deps-genicam

demo: build
	target/release/rig demo

build: deps
	$(CARGO) build --locked --release

# Features beyond the default ones, such as `rig/genicam`.
FEATURES ?=

# Every test program is a folder with a main.rs.
PROGRAMS := $(notdir $(patsubst %/main.rs,%,$(wildcard tests/*/main.rs */tests/*/main.rs)))
# These mostly wait for devices, and run next to those that compute.
WAITING := console devices
COMPUTING := $(filter-out $(WAITING) $(if $(findstring genicam,$(FEATURES)),,genicam),$(PROGRAMS))
CARGO_TEST = $(CARGO) test --locked --release --workspace --features "$(FEATURES)"

test: deps-test
	$(CARGO_TEST) --no-run
	@env --default-signal=INT,QUIT tests/run.sh target/waiting-tests.log \
	  $(CARGO_TEST) $(addprefix --test ,$(WAITING)) -- --test-threads 6 >target/waiting.log 2>&1 & waiting=$$!; \
	nice -n 5 tests/run.sh target/computing-tests.log \
	  $(CARGO_TEST) --lib --bins $(addprefix --test ,$(COMPUTING)) && $(CARGO_TEST) --doc; passed=$$?; \
	wait $$waiting || passed=1; cat target/waiting.log; exit $$passed

# mdBook is built quickly rather than well: it runs for a second. Its warnings are errors;
# links and anchors are checked by `cargo test --test source`.
MDBOOK = $(shell command -v mdbook || echo "$${CARGO_HOME:-$$HOME/.cargo}/bin/mdbook")

docs:
	@$(MDBOOK) --version >/dev/null 2>&1 || \
	  CARGO_PROFILE_RELEASE_LTO=off CARGO_PROFILE_RELEASE_CODEGEN_UNITS=16 \
	  CARGO_PROFILE_RELEASE_OPT_LEVEL=0 \
	  $(CARGO) install mdbook@0.5.4 --locked --no-default-features --features search
	@mkdir -p target
	@$(MDBOOK) build docs 2>&1 | tee target/book.log; ! grep -E 'WARN|ERROR' target/book.log

# The cameras that operators have: Debian stable has libaravis in the version that `genicam` needs.
DEB_FEATURES := genicam,webcam

deb: docs
	@$(MAKE) --no-print-directory deps EXTRA_DEPS="binutils dpkg-dev $(GENICAM_DEPS)"
	$(CARGO) build --locked --release --features $(DEB_FEATURES)
	packaging/deb.sh target/release/rig $(DEB_FEATURES)

test-deb: deb
	@$(MAKE) --no-print-directory deps EXTRA_DEPS="mmdebstrap"
	$(SUDO) packaging/try-deb.sh target/debian/rig-reflectometry_*.deb

release:
	packaging/release.sh

test-external: build python-wheel
	tests/external/run.sh target/release/rig target/wheels/rig_reflectometry-*.whl

# The package is compared with the program that RIG names.
PYTHON ?= python3
RIG ?= target/release/rig
PYTHON_VENV := target/python-venv
PYTHON_FRESH := target/python-fresh

# Features of the wheel, none as it ships. With those of the workspace's tests (.ci/run) nothing
# of them is compiled again; such a wheel is for this machine.
PYTHON_FEATURES ?=
WHEEL_OPTIONS := $(if $(PYTHON_FEATURES),--features $(PYTHON_FEATURES) --compatibility linux --auditwheel skip)

# maturin, in an environment of its own; of several wheels only the newest is kept.
python-wheel:
	@[ -x $(PYTHON_VENV)/bin/maturin ] || $(PYTHON) -m venv $(PYTHON_VENV)
	@$(PYTHON_VENV)/bin/pip install --quiet maturin==1.16.0
	@rm -f target/wheels/rig_reflectometry-*.whl
	$(PYTHON_VENV)/bin/maturin build --quiet --release --locked --manifest-path python/Cargo.toml $(WHEEL_OPTIONS)

python: python-wheel
	@[ -x $(RIG) ] || $(MAKE) --no-print-directory build
	@$(MAKE) --no-print-directory python-tests

# Of the wheel and the program that are there.
python-tests:
	@rm -rf $(PYTHON_FRESH) && $(PYTHON) -m venv $(PYTHON_FRESH)
	@$(PYTHON_FRESH)/bin/pip install --quiet "$$(echo target/wheels/rig_reflectometry-*.whl)[test]"
	RIG=$(RIG) $(PYTHON_FRESH)/bin/python -m pytest -q python/tests

# A browser and Node 18.20 or newer. npm installs what the lock file states.
CONSOLE_DEPS := $(if $(shell command -v chromium),,chromium) $(if $(shell command -v node),,nodejs) \
  $(if $(shell command -v npm),,npm)

deps-console:
	@$(MAKE) --no-print-directory deps EXTRA_DEPS="$(CONSOLE_DEPS)"

test-console: deps-console build
	cd tests/browser && npm ci --no-audit --no-fund && node --test

# The pictures of docs/console.md, made anew.
console-pictures: build
	cd tests/browser && npm ci --no-audit --no-fund && node pictures.mjs ../../docs/images

# Cameras and serial ports as the kernel shows them; needs root or sudo once, for apt.
test-vm: deps
	$(CARGO) build --locked --release --features webcam
	$(CARGO) build --locked --release --package mock-cameras --example usb_devices
	tests/vm/run.sh target/release/rig target/release/examples/usb_devices

# Hours of one core at full size; an interrupted run goes on where it stopped.
test-long: build
	RIG_KILLS=200 RIG_CUTS=all $(CARGO) test --locked --release --test captures \
	  -- --nocapture resume::a_capture
	RIG_CAMERA=full $(CARGO) test --locked --release --test captures \
	  -- --nocapture a_bayer_camera
	RIG_DRIFT_CAPTURES=200 $(CARGO) test --locked --release --test physics \
	  -- --nocapture constant_lamps
	RIG_LONG=1 $(CARGO) test --locked --release --package rig-core
	RIG_LARGE=1 $(CARGO) test --locked --release --test fuzz_corpus \
	  -- --nocapture large_sensor
	target/release/rig evaluate intervals --out target/long/intervals
	target/release/rig evaluate diagnosis --out target/long/diagnosis

# What the feature `genicam` needs.
GENICAM_DEPS := libaravis-dev libusb-1.0-0-dev aravis-tools-cli

deps-genicam:
	@$(MAKE) deps EXTRA_DEPS="$(GENICAM_DEPS)"

# The clients of the simulated still camera.
TEST_DEPS := gphoto2 libraw-bin

deps-test:
	@$(MAKE) --no-print-directory deps EXTRA_DEPS="$(TEST_DEPS)"

# What the build needs from the system: a C compiler to link, libclang for the
# Video4Linux bindings. Nothing happens if it is there.
deps:
	@command -v $(CARGO) >/dev/null || { \
	  echo "error: cargo was not found" >&2; echo >&2; \
	  echo "hint: install a Rust toolchain (https://rustup.rs)" >&2; exit 1; }
	@if ! command -v dpkg-query >/dev/null; then \
	  echo "note: not a Debian system; a C compiler and libclang are needed" >&2; \
	else \
	  missing=; \
	  command -v cc >/dev/null || missing="$$missing build-essential"; \
	  dpkg-query -W -f='$${Status}' libclang-dev 2>/dev/null | grep -q 'ok installed' \
	    || missing="$$missing libclang-dev"; \
	  for package in $(EXTRA_DEPS); do \
	    dpkg-query -W -f='$${Status}' $$package 2>/dev/null | grep -q 'ok installed' \
	      || missing="$$missing $$package"; \
	  done; \
	  if [ -n "$$missing" ]; then \
	    $(SUDO) apt-get update && \
	    $(SUDO) env DEBIAN_FRONTEND=noninteractive apt-get install -y --no-install-recommends $$missing; \
	  fi; \
	fi
