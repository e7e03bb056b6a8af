# albireo: the two commands are `make demo` and `make test`; `make help` lists the rest.

SHELL := /bin/bash
.DEFAULT_GOAL := help

CACHE := .cache
ONNXRUNTIME := $(CACHE)/onnxruntime/.ready
PYTHON_ENVIRONMENT := $(CACHE)/python/.ready
VENDORS := $(CACHE)/vendors/bin
VENDORS_ENVIRONMENT := $(CACHE)/vendors/.ready
WHEEL := target/wheels/.built$(if $(TARGET),-$(TARGET))
WHEEL_ENVIRONMENT := $(CACHE)/wheel/.ready
WHEEL_SOURCES := $(wildcard Cargo.toml crates/core/Cargo.toml crates/python/*.* crates/python/src/*) \
	$(shell find crates/core/src crates/python/python -type f ! -name '*.pyc')
DEMO_SECONDS ?=
# Python's ONNX Runtime, like ours, must not collect telemetry.
export ORT_DISABLE_TELEMETRY := 1

.PHONY: help needs demo test build-tests web browser lint deny fuzz simulate soak board onnxruntime python wheel wheel-tests debian release dist bench bench-counted bench-peers peers gpu parity clean

help: ## list the commands
	@awk -F':.*## ' '/^[a-z-]+:.*## /{printf "  make %-13s %s\n", $$1, $$2}' $(MAKEFILE_LIST)

demo: needs onnxruntime web ## run camera, node and hub in one process, with nothing to configure (DEMO_SECONDS=N stops it)
	@bash tests/build.sh
	@exec target/debug/albireo demo $(if $(DEMO_SECONDS),--seconds $(DEMO_SECONDS))

# First of all, so that nothing is compiled for minutes before it is said.
needs:
	@bash tests/needs.sh

# Downloads wait for the network and builds for the processor, so both run in parallel.
test: needs onnxruntime web ## fetch what the tests need and run them all
	@$(MAKE) --no-print-directory -j4 debian python wheel-tests build-tests
	@bash tests/run.sh

build-tests: debian
	cargo test --locked $$(bash tests/features.sh) --no-run

lint: ## check formatting, and run clippy for every shipped combination of features, as in CI
	cargo fmt --check
	cargo clippy --locked --workspace --all-targets -- -D warnings
	cargo clippy --locked --no-default-features -- -D warnings
	cargo clippy --locked --all-targets $$(bash tests/features.sh) -- -D warnings
	cargo fmt --check --manifest-path crates/python/Cargo.toml
	CARGO_TARGET_DIR=target/python cargo clippy --locked --manifest-path crates/python/Cargo.toml -- -D warnings
	RUSTDOCFLAGS="-D warnings" cargo doc --locked --no-deps -p albireo-core

deny: ## check licences, sources and bans of all dependencies (ADVISORIES=1: known vulnerabilities too)
	@cargo deny --version >/dev/null 2>&1 || cargo install --locked cargo-deny
	cargo deny --locked check licenses bans sources $(if $(ADVISORIES),advisories)
	cargo deny --locked --manifest-path crates/python/Cargo.toml --config deny.toml check licenses bans sources $(if $(ADVISORIES),advisories)

fuzz: ## fuzz every parser with coverage guidance, 20 minutes each (MINUTES=N); needs nightly Rust and cargo-fuzz
	@bash fuzz/run.sh

# Each day has a million seeds of its own, so that nightly runs try others.
simulate: ## simulate delivery from seeds: crashes, losses, wrong clocks, damaged state (SEEDS=10000; SEED=7 prints one run)
	ALBIREO_WITHOUT_PAGES=1 ALBIREO_SEEDS=$(or $(SEEDS),10000) ALBIREO_SEED=$(SEED) \
		ALBIREO_FIRST_SEED=$(or $(FIRST),$$(($$(date +%s) / 86400 * 1000000))) cargo test --locked --profile bench -p albireo-node --lib \
		delivery::tests::no_seed -- --nocapture

soak: onnxruntime python ## run a node and a hub under faults for half an hour, by hand (MINUTES=N for another length)
	cargo build --locked $$(bash tests/features.sh)
	ORT_DYLIB_PATH="$${ORT_DYLIB_PATH:-$(abspath $(CACHE))/onnxruntime}" $(CACHE)/python/bin/python tests/soak.py --minutes $(or $(MINUTES),30)

bench: onnxruntime web ## run the benches, optimised (slow the first time)
	cargo bench --locked

bench-counted: ## count the instructions of the frames that must not become dearer unseen (ACCEPT=1 takes the new counts)
	@bash benches/counted.sh

bench-peers: ## compare the decision core with other trackers, and the JPEG decoder with others
	cargo run --release --locked --manifest-path benches/standalone/Cargo.toml
	cargo run --release --locked --manifest-path benches/decoders/Cargo.toml

peers: $(WHEEL) $(VENDORS_ENVIRONMENT) ## compare Python's trackers with ours on the recordings, into EVALUATION.md (by hand: fetches 6.5 GB)
	cargo build --locked $$(bash tests/features.sh)
	$(VENDORS)/pip install --quiet --disable-pip-version-check --force-reinstall --no-deps target/wheels/albireo-*.whl
	$(VENDORS)/python tests/peers/compare.py --shared "$${ALBIREO_SHARED:-../shared}" --page EVALUATION.md

gpu: onnxruntime ## measure the node on an NVIDIA GPU, write benches/gpu.md (PROVIDER=cpu: a trial without one)
	@ORT_DYLIB_PATH="$${ORT_DYLIB_PATH:-$(abspath $(CACHE))/onnxruntime}" bash benches/gpu.sh

parity: onnxruntime $(WHEEL) $(VENDORS_ENVIRONMENT) ## compare with the vendors' own detector code (by hand: fetches 6.5 GB), write models/PARITY.md
	cargo build --locked $$(bash tests/features.sh)
	ORT_DYLIB_PATH="$${ORT_DYLIB_PATH:-$(abspath $(CACHE))/onnxruntime}" YOLO_OFFLINE=true \
		YOLO_CONFIG_DIR="$(abspath $(CACHE))/vendors/config" $(VENDORS)/python \
		tests/parity/compare.py --shared "$${ALBIREO_SHARED:-../shared}"
	$(VENDORS)/pip install --quiet --disable-pip-version-check --force-reinstall --no-deps target/wheels/albireo-*.whl
	YOLO_OFFLINE=true YOLO_CONFIG_DIR="$(abspath $(CACHE))/vendors/config" $(VENDORS)/python tests/parity/python_results.py

# Installed without their dependencies: Norfair's conflict with those of trackers, BoxMOT's pin an older OpenCV, and TrackEval's
# serve only its data sets.
$(VENDORS_ENVIRONMENT): tests/parity/requirements.txt
	python3 -m venv $(CACHE)/vendors
	$(VENDORS)/pip install --quiet --disable-pip-version-check -r tests/parity/requirements.txt
	$(VENDORS)/pip install --quiet --disable-pip-version-check --no-deps boxmot==25.0.0 norfair==2.3.0 trackeval==1.3.0
	@touch $@

board: ## build the node for a small board: without hub, simulator, evaluation and renderer
	cargo build --locked --no-default-features

web: ## build the web pages with Node.js and npm; everything else works without them
	@bash web/build.sh

browser: onnxruntime web ## test the pages in Debian's Chromium against the program, by hand (on a busy machine a step may be too slow)
	cargo build --locked $$(bash tests/features.sh)
	ORT_DYLIB_PATH="$${ORT_DYLIB_PATH:-$(abspath $(CACHE))/onnxruntime}" ALBIREO_BIN="$(abspath target/debug/albireo)" npm --prefix web run browser

release: web ## build the optimised program in target/release/albireo
	cargo build --locked --release

dist: web ## build the release in target/dist: programs, packages, licences, checksums (TARGET=… for another machine)
	bash deploy/dist.sh

onnxruntime: $(ONNXRUNTIME) ## fetch the ONNX Runtime library from its Python wheel
$(ONNXRUNTIME): deploy/fetch-onnxruntime.sh
	bash deploy/fetch-onnxruntime.sh $(CACHE)/onnxruntime
	@touch $@

python: $(PYTHON_ENVIRONMENT) ## create the Python environment for the tests' independent clients
$(PYTHON_ENVIRONMENT): tests/requirements.txt
	python3 -m venv $(CACHE)/python
	$(CACHE)/python/bin/python -m pip install --quiet --no-compile --disable-pip-version-check -r tests/requirements.txt
	@touch $@

wheel: $(WHEEL) ## build the Python package in target/wheels, with its sources (TARGET=aarch64 for another machine)
$(WHEEL): $(WHEEL_SOURCES)
	bash crates/python/build.sh $(TARGET)
	@touch $@

wheel-tests: $(WHEEL_ENVIRONMENT) ## create the Python environment in which the package is tested
$(WHEEL_ENVIRONMENT): $(addprefix crates/python/tests/,requirements.txt environment.sh) $(WHEEL)
	bash crates/python/tests/environment.sh $(CACHE)/wheel
	@touch $@

debian: ## install the Debian packages that the tests use, if missing and allowed
	@bash tests/debian-packages.sh ffmpeg:ffmpeg promtool:prometheus curl:curl cmake:cmake nasm:nasm initdb:postgresql \
		strace:strace gst-launch-1.0:gstreamer1.0-tools :gstreamer1.0-plugins-base :gstreamer1.0-plugins-good \
		:gstreamer1.0-plugins-ugly :gir1.2-gst-rtsp-server-1.0 :python3-gi \
		systemd-analyze:systemd caddy:caddy mosquitto:mosquitto mosquitto_sub:mosquitto-clients docker-compose:docker-compose shellcheck:shellcheck valgrind:valgrind

clean: ## remove what was built and fetched
	cargo clean
	rm -rf $(CACHE) web/node_modules
	find web/dist -mindepth 1 ! -name .gitignore -delete
