#!/usr/bin/env bash
# tests/run.sh LOG CARGO test ARGUMENTS... [-- OPTIONS OF THE TESTS]
#
# Runs all tests, also where one fails. Many talk to simulated devices that must answer in time,
# and a machine that stands still for seconds fails those: at most five that failed run a second
# time, one after the other, and the output names them.
set -uo pipefail
log=$1
shift
command=() options=()
while [ $# -gt 0 ] && [ "$1" != "--" ]; do
  command+=("$1")
  shift
done
[ $# -gt 0 ] && options=("${@:2}")

"${command[@]}" --no-fail-fast -- "${options[@]}" 2>&1 | tee "$log"
status=${PIPESTATUS[0]}
[ "$status" -eq 0 ] && exit 0

# Each program lists the tests that failed below its last "failures:".
mapfile -t failed < <(awk '/^failures:$/ { names = "" } /^    [A-Za-z0-9_:]+$/ { names = names $1 "\n" }
  /^test result: FAILED/ { printf "%s", names }' "$log" | sort -u)
# A program that died lists none.
died=$(($(grep -c '^    `.*`$' "$log") - $(grep -c '^test result: FAILED' "$log")))
if [ "$died" -ne 0 ] || [ ${#failed[@]} -eq 0 ] || [ ${#failed[@]} -gt 5 ]; then
  exit "$status"
fi
printf '\nRun a second time, one after the other, because they failed:\n'
printf '  %s\n' "${failed[@]}"
"${command[@]}" --no-fail-fast -- --exact --test-threads 1 "${failed[@]}"
