#!/usr/bin/env bash
# Every quality gate: format, lint, types, import contracts, the manual's site with its links, tests with coverage.
#
# usage: ./test.sh [--quick | --slow] [pytest arguments]
#   --quick   only the tests without a node graph, no coverage
#   --slow    also the tests marked "slow" (long parts), and new random examples of the properties
#   Any pytest argument (a path, -k ...) runs only those tests, without the other gates.
set -uo pipefail
root=$(cd "$(dirname "$(readlink -f "${BASH_SOURCE[0]}")")" && pwd -P)
cd "$root" || exit 1

markers="not slow" random=() quick=
case ${1:-} in
  --quick) markers="not graph and not slow" quick=yes && shift ;;
  --slow) markers="" random=(--hypothesis-profile=random) && shift ;;
  -h | --help) sed -n '2,8s/^# \{0,1\}//p' "$0" && exit 0 ;;
esac

"$root/scripts/setup.sh" || exit
unset ROS_AUTOMATIC_DISCOVERY_RANGE FASTRTPS_DEFAULT_PROFILES_FILE # tests are as closed as a cell is by default
# shellcheck source=/dev/null
source "$root/.isf/env.sh"

# ROS domains of its own, on this computer only: neither a running cell nor another test run takes part.
read -ra domains < <(python scripts/free_domain.py 8)
ROS_DOMAIN_ID=${domains[0]}
ISF_TEST_RUN=$(date +%s).$$ # marks every process this run starts
export ROS_DOMAIN_ID ISF_TEST_RUN
export PYTHONFAULTHANDLER=1 # a process that crashes says where
export ISF_SHELL_THREADS=1 # several tests share the processors
ISF_CACHE_DIR=$(mktemp -d) # nothing that was computed before takes part
export ISF_CACHE_DIR
trap 'rm -rf "$ISF_CACHE_DIR"' EXIT

end_all() {
  python scripts/end_processes.py "$ISF_TEST_RUN"
}
interrupted() {
  kill "${process[@]}" 2>/dev/null
  for name in "${!process[@]}"; do
    python scripts/end_processes.py "$(mark_of "$name")" 0
  done
  end_all
  exit 130
}
trap interrupted INT TERM

started=$SECONDS
failed=()
passed=()
number=0
and=${markers:+ and $markers}
workers=$(getconf _NPROCESSORS_ONLN)
[ "$workers" -le 4 ] || workers=4
total=9
[ -z "$quick" ] || total=6
[ $# -eq 0 ] || total=1

# gate NAME COMMAND...
gate() {
  local name=$1 begin=$SECONDS seconds
  shift
  number=$((number + 1))
  printf '\n[%d/%d] %s\n' "$number" "$total" "$name"
  if "$@"; then
    passed+=("$name")
    seconds=${taken[$name]:-$((SECONDS - begin))}
    printf '      passed in %d s\n' "$seconds"
  else
    failed+=("$name")
    seconds=${taken[$name]:-$((SECONDS - begin))}
    printf '      FAILED in %d s\n' "$seconds"
  fi
}

mark_of() {
  printf '%s.%s' "$ISF_TEST_RUN" "${1// /_}"
}

# beside NAME COMMAND... - run the command of a gate beside those that follow, with what they leave of the processors;
# "gate NAME result NAME" waits for it. SCHED_IDLE goes out of the way of tests by the clock at once, which nice does not.
declare -A process taken
beside() {
  local name=$1
  shift
  (
    ISF_TEST_RUN=$(mark_of "$name") # the end of other tests is not its own
    chrt --all-tasks --idle --pid 0 "$BASHPID" 2>/dev/null || renice -n 19 -p "$BASHPID" >/dev/null
    begin=$SECONDS code=0
    "$@" >".isf/log/gate_$name.log" 2>&1 || code=$?
    printf '%d' "$((SECONDS - begin))" >".isf/log/gate_$name.seconds"
    exit "$code"
  ) &
  process[$name]=$!
}

result() {
  local code=0
  wait "${process[$1]}" || code=1
  cat ".isf/log/gate_$1.log"
  taken[$1]=$(cat ".isf/log/gate_$1.seconds")
  return "$code"
}

# tests NICENESS MARKERS ARGUMENTS...
tests() {
  # Plugins are named, so that what happens to be installed (launch_testing of an apt ROS) does not take part.
  PYTEST_DISABLE_PLUGIN_AUTOLOAD=1 nice -n "$1" python -m pytest -p pytest_cov.plugin -p xdist.plugin \
    -p _hypothesis_pytestplugin -m "$2" "${random[@]}" "${@:3}"
}

run_tests() {
  local code=0
  tests 0 "$markers" "$@" || code=1
  end_all || code=1
  return "$code"
}

# Every Python process of the tests measures itself.
# measured NAME NICENESS MARKERS ARGUMENTS... - as "tests"
measured() {
  COVERAGE_PROCESS_START="$root/pyproject.toml" COVERAGE_FILE="$root/.isf/coverage.$1" \
    tests "${@:2}"
}

# Cells that tick by the clock have the computer to themselves: what keeps them waiting is a fault to them.
run_clock() {
  local code=0
  measured with 0 "graph and clock$and" || code=1
  end_all || code=1
  return "$code"
}

# briefly NAME COMMAND... - of tests that run beside others, all that they print where one fails, else what they sum up
briefly() {
  local log=.isf/log/tests_of_$1.log code=0
  "${@:2}" >"$log" 2>&1 || code=1
  printf '\nTests of %s without a node graph, run meanwhile (%s):\n' "$1" "$log"
  if [ "$code" -eq 0 ]; then
    sed -n '/short test summary info/,$p' "$log"
  else
    cat "$log"
  fi
  return "$code"
}

# Tests of packages without a node graph calculate: they can wait, which those of commands, with their limits, cannot.
run_packages() {
  local code=0
  ISF_TEST_DOMAINS="${domains[*]:6}" \
    briefly packages measured packages 0 "not graph$and" --dist loadfile -n "$workers" ros_ws/src || code=1
  end_all || code=1
  return "$code"
}

# Tests with a node graph mostly wait for their processes: several at a time, in a domain each. Those of commands without
# one run beside them, at a lower priority. A file is a unit, since tests of a file may share their nodes.
run_others() {
  local code=0
  ISF_TEST_DOMAINS="${domains[*]:4:2}" \
    briefly commands measured commands 10 "not graph$and" --dist loadfile -n "$workers" tests >.isf/log/commands.log 2>&1 &
  local commands=$!
  ISF_TEST_DOMAINS="${domains[*]::4}" \
    measured with 0 "graph and not clock$and" --dist loadfile -n "$((workers < 4 ? workers + 1 : 4))" || code=1
  wait "$commands" || code=1
  cat .isf/log/commands.log
  end_all || code=1
  return "$code"
}

run_coverage() {
  export COVERAGE_FILE=.isf/coverage
  python scripts/combine_coverage.py "$COVERAGE_FILE" coverage. || return
  coverage report --format=total # fails below the share of pyproject.toml
}

if [ $# -eq 0 ]; then
  gate "format" ruff format --check --quiet .
  gate "lint" ruff check --quiet .
  beside "types" python -m mypy
  beside "imports" lint-imports
  beside "docs" scripts/site.sh
fi
if [ $# -eq 0 ] && [ -z "$quick" ]; then
  rm -f .isf/coverage.*
  beside "tests of packages" run_packages
  gate "tests by the clock" run_clock
  gate "tests of nodes and commands" run_others
  gate "tests of packages" result "tests of packages"
  gate "coverage" run_coverage
else
  gate "tests" run_tests "$@"
fi
for name in types imports docs; do
  [ -z "${process[$name]:-}" ] || gate "$name" result "$name"
done

printf '\n'
if [ ${#failed[@]} -eq 0 ]; then
  printf 'PASSED: %s (%d s)\n' "${passed[*]}" "$((SECONDS - started))"
else
  printf 'FAILED: %s; passed: %s (%d s)\n' "${failed[*]}" "${passed[*]:-none}" "$((SECONDS - started))"
  exit 1
fi
