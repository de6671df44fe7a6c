#!/bin/sh
# Builds target/debian/rig-reflectometry_*.deb: deb.sh BINARY FEATURES
# BINARY: the program to pack, built already, and with which FEATURES.
set -eu
cd "$(dirname "$0")/.."
binary=$1 features=$2
package=rig-reflectometry
stage=target/package
command -v cargo-deb >/dev/null ||
  CARGO_PROFILE_RELEASE_LTO=off CARGO_PROFILE_RELEASE_OPT_LEVEL=0 \
    cargo install cargo-deb@3.8.0 --locked

rm -rf "$stage"
mkdir -p "$stage/man" "$stage/completions"
install -m 755 "$binary" "$stage/rig"
strip "$stage/rig"

# What the program says about itself.
"$stage/rig" man --out "$stage/man" >/dev/null
for shell in bash zsh fish; do
  "$stage/rig" completions "$shell" >"$stage/completions/$shell"
done

# Licences: ours, those of the data, those of the crates.
{
  cat packaging/copyright.head
  paragraph() { printf 'License: %s\n' "$1"; sed 's/^[[:space:]]*$/./; s/^/ /'; echo; }
  paragraph Expat <LICENSE-MIT
  sed -n '/^Permission is hereby/,$p' data/fonts/NOTICE.md | paragraph Bitstream-Vera
} >"$stage/copyright"
cargo tree --locked --package rig --features "$features" -e normal --prefix none --no-dedupe >"$stage/crates"
cargo metadata --locked --format-version 1 |
  python3 packaging/third_party.py "$stage/crates" | gzip -9n >"$stage/THIRD-PARTY.txt.gz"

# Debian's form of the list of changes, which refers to ours.
version=$(sed -n 's/^version = "\(.*\)"/\1/p' Cargo.toml | head -n 1)
cat >"$stage/changelog" <<EOF
$package ($version-1) unstable; urgency=medium

  * Version $version; what has changed is in changelog.gz next to this file.

 -- The rig contributors <rig@example.org>  $(git log -1 --format=%aD)
EOF

cargo deb --no-build --locked --output target/debian/
