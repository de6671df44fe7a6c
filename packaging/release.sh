#!/bin/sh
# Everything that a release consists of, in target/release-VERSION: release.sh [--no-checks]
# Publishes nothing; its last lines are the commands that would.
# --no-checks: without .ci/run and the fresh Debian root, to try the script itself.
set -eu
cd "$(dirname "$0")/.."
fail() { echo "release: $*" >&2; exit 1; }
step() { printf '\n== %s\n' "$*"; }
case ${1:-} in
  "") checks=yes ;;
  --no-checks) checks=no ;;
  *) fail "unknown option $1; only --no-checks is known" ;;
esac

# The version is stated in Cargo.toml and described at the top of CHANGELOG.md.
version=$(sed -n 's/^version = "\(.*\)"/\1/p' Cargo.toml | head -n 1)
described=$(sed -n 's/^## //p' CHANGELOG.md | head -n 1)
out=target/release-$version
[ -z "$(git status --porcelain)" ] || fail "there are changes that are not committed; git status lists them"
[ "${described%% *}" = "$version" ] || fail "CHANGELOG.md begins with \"$described\", Cargo.toml has version $version"
if tagged=$(git rev-parse --quiet --verify "refs/tags/v$version^{commit}"); then
  [ "$tagged" = "$(git rev-parse HEAD)" ] || fail "tag v$version is another commit; raise the version"
fi
rm -rf "$out"
mkdir -p "$out"

if [ "$checks" = yes ]; then
  step "checks"
  .ci/run
fi

step "source"
git archive --prefix="rig-$version/" --output "$out/rig-$version.tar.gz" HEAD

step "Debian package"
rm -rf target/debian
make deb
[ "$checks" = no ] || make test-deb
cp target/debian/*.deb "$out/"

step "Python package"
make python-wheel
cp target/wheels/rig_reflectometry-"$version"-*.whl "$out/"

step "notes and checksums"
awk -v heading="## $version" '$0 == heading || index($0, heading " ") == 1 { on = 1; next } /^## / { on = 0 } on' \
  CHANGELOG.md >"$out/NOTES.md"
[ -s "$out/NOTES.md" ] || fail "CHANGELOG.md says nothing about $version"
(cd "$out" && sha256sum -- *.tar.gz *.deb *.whl >SHA256SUMS && sha256sum --check --quiet SHA256SUMS && ls -l)

grep -q '^maintainer = .*example.org' Cargo.toml &&
  echo "Before publishing: state a maintainer who can be reached (Cargo.toml, packaging/deb.sh)."
cat <<EOF

Nothing has been published. To publish:
  git tag --sign v$version --file $out/NOTES.md && git push origin v$version
  make python-wheel on macOS and on Windows (Rust, Python and make, nothing else), and copy
  target/wheels/*.whl of each to $out;
  python3 -m twine upload $out/*.whl, with the token of a project on pypi.org (first with
  --repository testpypi);
  and put the other files of $out where users find them, with SHA256SUMS.
EOF
