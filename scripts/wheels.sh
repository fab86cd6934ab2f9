#!/usr/bin/env bash
# Wheels of all packages that do something without ROS, for a Python of one's own: the command isf then plans,
# simulates, reads bags, reports, replays and compares. `isf form` and the nodes need the ROS workspace.
#
# usage: scripts/wheels.sh [DIR]          default: dist/
# then:  pip install --find-links DIR isf-cell
set -euo pipefail

root=$(cd "$(dirname "${BASH_SOURCE[0]}")/.." && pwd -P)
"$root/scripts/setup.sh"
mkdir -p "${1:-$root/dist}"
output=$(cd "${1:-$root/dist}" && pwd -P)
packages=(core ros planner sim springback force_ctrl identify load_cell analysis dashboard description cell)

# built from a copy: builds leave folders beside the sources
copy=$(mktemp -d)
trap 'rm -rf "$copy"' EXIT
folders=()
for name in "${packages[@]}"; do
  cp -r "$root/ros_ws/src/isf_$name" "$copy/"
  rm -rf "$copy/isf_$name"/{build,test,*.egg-info}
  folders+=("$copy/isf_$name")
done
mkdir -p "$copy/isf_analysis/isf_analysis/bag/msg" # a bag is read by these, without ROS
cp "$root"/ros_ws/src/isf_msgs/msg/*.msg "$copy/isf_analysis/isf_analysis/bag/msg/"

python=$root/.isf/venv/bin/python
isolation=(--no-build-isolation) # else what builds a wheel is fetched for every package
"$python" -c 'import setuptools.command.bdist_wheel' 2>/dev/null || "$python" -c 'import wheel' 2>/dev/null || isolation=()
"$python" -m pip --disable-pip-version-check wheel --quiet --no-deps "${isolation[@]}" --wheel-dir "$output" "${folders[@]}"
echo "wheels in $output: pip install --find-links $output isf-cell"
