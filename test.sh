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
idle_group= # folder of the processes of "idle", empty: there is none
clean() {
  rm -rf "$ISF_CACHE_DIR"
  [ -z "$idle_group" ] || rmdir "$idle_group" 2>/dev/null
}
trap clean EXIT

end_all() {
  local code=0
  python scripts/end_processes.py "$ISF_TEST_RUN.clock" || code=1
  python scripts/end_processes.py "$ISF_TEST_RUN" || code=1
  return "$code"
}
trap 'end_all; exit 130' INT TERM

started=$SECONDS
failed=()
passed=()
number=0
cores=$(getconf _NPROCESSORS_ONLN)
[ "$cores" -le 4 ] || cores=4
total=7
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

# A control group whose processes run while nobody else wants a processor. The idle class of a process alone (chrt) is
# not that: every node has a session of its own, and a kernel that shares processors between sessions (autogroup) gives
# the session of idle processes as much as that of a node, in slices of milliseconds. Needs root.
make_idle_group() {
  local parent
  for parent in /sys/fs/cgroup/cpu /sys/fs/cgroup; do
    mkdir "$parent/isf_tests.$$" 2>/dev/null || continue
    idle_group=$parent/isf_tests.$$
    { echo 1 >"$idle_group/cpu.idle" && (echo "$BASHPID" >"$idle_group/cgroup.procs"); } 2>/dev/null && return
    rmdir "$idle_group"
    idle_group=
  done
  return 1
}

# What is in the group takes its share from here on: else tests would stand still for minutes beside those with a graph.
end_idle() {
  echo 0 >"$idle_group/cpu.idle"
}

# idle COMMAND... - run it, in a subshell of its own, in the time that the tests with a node graph leave
idle() {
  if [ -n "$idle_group" ]; then
    echo "$BASHPID" >"$idle_group/cgroup.procs"
    "$@"
  elif chrt --idle 0 true 2>/dev/null; then
    chrt --idle 0 "$@"
  else
    nice -n 19 "$@"
  fi
}

now() {
  "$@"
}

# beside NAME COMMAND... - run the command of a gate beside the tests; "gate NAME result NAME" waits for it
declare -A process taken
beside() {
  local name=$1
  shift
  (
    begin=$SECONDS code=0
    idle env -u COVERAGE_PROCESS_START "$@" >".isf/log/gate_$name.log" 2>&1 || code=$?
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

# tests WAY MARKERS ARGUMENTS... ; WAY: now or idle
tests() {
  # Plugins are named, so that what happens to be installed (launch_testing of an apt ROS) does not take part.
  PYTEST_DISABLE_PLUGIN_AUTOLOAD=1 "$1" python -m pytest -p pytest_cov.plugin -p xdist.plugin \
    -p _hypothesis_pytestplugin -m "$2" "${random[@]}" "${@:3}"
}

run_tests() {
  local code=0
  tests now "$markers" "$@" || code=1
  end_all || code=1
  return "$code"
}

# Tests without a node graph run beside those with one. A file is a unit, since tests of a file may share their nodes.
without_log=.isf/log/tests_without_graph.log
begin_without_graph() {
  ISF_TEST_DOMAINS="${domains[*]:4}" COVERAGE_FILE="$root/.isf/coverage.without" \
    tests idle "not graph${markers:+ and $markers}" --dist loadfile -n "$cores" >"$without_log" 2>&1 &
  process[without]=$!
}

# Cells that tick by the clock, one after the other, beside an idle group at most: what keeps them waiting is a fault to
# them, and runs in the idle class do keep them waiting (wrenches 30 ms late, forces twice as large).
run_clock() {
  local code=0
  ISF_TEST_RUN=$ISF_TEST_RUN.clock COVERAGE_FILE="$root/.isf/coverage.with" \
    tests now "graph and clock${markers:+ and $markers}" || code=1
  python scripts/end_processes.py "$ISF_TEST_RUN.clock" || code=1
  return "$code"
}

# The other tests with a node graph mostly wait for their processes: several at a time, in a domain each.
run_all() {
  local code=0
  ISF_TEST_DOMAINS="${domains[*]::4}" COVERAGE_FILE="$root/.isf/coverage.with" \
    tests now "graph and not clock${markers:+ and $markers}" --dist loadfile -n "$((cores < 4 ? cores + 1 : 4))" || code=1
  printf '\nTests without a node graph, run meanwhile (%s):\n' "$without_log"
  if wait "${process[without]}"; then
    sed -n '/short test summary info/,$p' "$without_log"
  else
    cat "$without_log"
    code=1
  fi
  unset COVERAGE_PROCESS_START
  end_all || code=1
  export COVERAGE_FILE=.isf/coverage.all
  python scripts/combine_coverage.py "$COVERAGE_FILE" coverage.with || code=1
  printf 'coverage: '
  coverage report --format=total || code=1 # fails below the share of pyproject.toml
  return "$code"
}

begin_beside() {
  [ -n "$quick" ] || begin_without_graph
  beside "types" python -m mypy
  beside "imports" lint-imports
  beside "docs" scripts/site.sh
}

if [ $# -gt 0 ]; then
  gate "tests" run_tests "$@"
else
  gate "format" ruff format --check --quiet .
  gate "lint" ruff check --quiet .
  if [ -n "$quick" ]; then
    begin_beside
    gate "tests" run_tests
  else
    export COVERAGE_PROCESS_START="$root/pyproject.toml" # every Python process measures itself
    rm -f .isf/coverage.*
    make_idle_group && begin_beside
    gate "tests by the clock" run_clock
    if [ -n "$idle_group" ]; then end_idle; else begin_beside; fi
    gate "tests" run_all
  fi
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
