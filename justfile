# What the project is built, tested and measured with; `just` lists it.

default:
    @just --list

# Every test, the processes and shared memory included
test:
    cargo test --workspace --release

# Format, lints and documentation, as they must be to land
check:
    cargo fmt --all --check
    cargo clippy --workspace --all-targets --release -- -D warnings
    RUSTDOCFLAGS="-D warnings" cargo doc --workspace --no-deps --release

# A training to its end
train maneuver="lane_change":
    cargo run --release -- train {{maneuver}}

# A tick of the pipeline beside a bare ring
bench:
    cargo run --release -- bench

# All of what must pass before anything lands
ci:
    .ci/run
