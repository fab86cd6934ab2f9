#!/usr/bin/env bash
# Every quality gate: format, lint, types, import contracts, tests with coverage.
#
# usage: ./test.sh [--quick | --slow] [pytest arguments]
#   --quick   only the tests without a node graph, no coverage
#   --slow    also the tests marked "slow" (long parts), and new random examples of the properties
#   Any pytest argument (a path, -k ...) runs only those tests, without the other gates.
set -uo pipefail
root=$(cd "$(dirname "$(readlink -f "${BASH_SOURCE[0]}")")" && pwd -P)
cd "$root" || exit 1

selection=(-m "not slow")
# The table of files would stand between a failure and who looks for it; `coverage report` shows it.
coverage=(--cov --cov-report=xml:.isf/coverage.xml)
case ${1:-} in
  --quick) selection=(-m "not graph and not slow") coverage=() && shift ;;
  --slow) selection=(--hypothesis-profile=random) && shift ;;
  -h | --help) sed -n '2,8s/^# \{0,1\}//p' "$0" && exit 0 ;;
esac
[ $# -eq 0 ] || coverage=()

"$root/scripts/setup.sh" || exit
# shellcheck source=/dev/null
source "$root/.isf/env.sh"

# A ROS domain of its own, on this computer only: neither a running cell nor another test run takes part.
ROS_DOMAIN_ID=$(python scripts/free_domain.py)
ISF_TEST_RUN=$(date +%s).$$ # marks every process this run starts
export ROS_DOMAIN_ID ISF_TEST_RUN ROS_AUTOMATIC_DISCOVERY_RANGE=LOCALHOST
export PYTHONFAULTHANDLER=1 # a process that crashes says where

end_all() {
  python scripts/end_processes.py "$ISF_TEST_RUN"
}
trap 'end_all; exit 130' INT TERM

started=$SECONDS
failed=()
passed=()
number=0
total=5
[ $# -eq 0 ] || total=1

# gate NAME COMMAND...
gate() {
  local name=$1 begin=$SECONDS
  shift
  number=$((number + 1))
  printf '\n[%d/%d] %s\n' "$number" "$total" "$name"
  if "$@"; then
    passed+=("$name")
    printf '      passed in %d s\n' "$((SECONDS - begin))"
  else
    failed+=("$name")
    printf '      FAILED in %d s\n' "$((SECONDS - begin))"
  fi
}

run_tests() {
  # Plugins are named, so that what happens to be installed (launch_testing of an apt ROS) does not take part.
  PYTEST_DISABLE_PLUGIN_AUTOLOAD=1 python -m pytest -p pytest_cov.plugin -p _hypothesis_pytestplugin \
    "${selection[@]}" "${coverage[@]}" "$@"
  local code=$?
  if ! end_all; then
    return 1
  fi
  return "$code"
}

if [ $# -eq 0 ]; then
  gate "format" ruff format --check --quiet .
  gate "lint" ruff check --quiet .
  gate "types" python -m mypy
  gate "imports" lint-imports
fi
gate "tests" run_tests "$@"

printf '\n'
if [ ${#failed[@]} -eq 0 ]; then
  printf 'PASSED: %s (%d s)\n' "${passed[*]}" "$((SECONDS - started))"
else
  printf 'FAILED: %s; passed: %s (%d s)\n' "${failed[*]}" "${passed[*]:-none}" "$((SECONDS - started))"
  exit 1
fi
