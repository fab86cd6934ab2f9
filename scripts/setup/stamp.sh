# Is the set-up still what the sources ask for? Three fingerprints: of the Python environment, of the built workspace and
# of the sources with compiled kernels.

isf_state=$ISF_ROOT/.isf
isf_venv=$isf_state/venv
isf_workspace=$ISF_ROOT/ros_ws

# Choices of an earlier set-up hold until another one is made.
if [ -f "$isf_state/choices.sh" ]; then
  # shellcheck source=/dev/null
  source "$isf_state/choices.sh"
fi

# Kind of machine: "apt" where ROS 2 Jazzy is installed, else "wheels". ISF_ROS=wheels ignores an installed ROS.
isf_ros_prefix=${ISF_ROS_PREFIX:-/opt/ros/jazzy}
if [ "${ISF_ROS:-}" != wheels ] && [ -f "$isf_ros_prefix/setup.bash" ]; then
  isf_kind=apt
else
  isf_kind=wheels
fi

isf_requirements=$ISF_ROOT/requirements/$isf_kind.txt

# The folder is part of it: a virtual environment and a colcon install do not survive being moved.
packages_fingerprint() {
  {
    printf '%s\n' "$isf_kind" "$ISF_ROOT" "$isf_ros_prefix" "${ISF_PYTHON:-}"
    cat "$isf_requirements" "$ISF_ROOT/requirements/bootstrap.txt" "$ISF_ROOT/scripts/setup/packages.sh"
  } | sha256sum
}

# Contents of everything that colcon reads, names of the files that are only linked.
workspace_fingerprint() {
  {
    packages_fingerprint
    cat "$ISF_ROOT/scripts/setup/workspace.sh" "$ISF_ROOT/scripts/setup/environment.sh"
    cat "$ISF_ROOT"/scripts/setup/tf2_msgs/*.* "$ISF_ROOT"/scripts/setup/tf2_msgs/msg/*
    cd "$isf_workspace/src" || return 1
    find . -type f \( -name package.xml -o -name setup.py -o -name setup.cfg -o -name CMakeLists.txt -o -name '*.cmake' \
      -o -name '*.c' -o -name '*.msg' -o -name '*.srv' -o -name '*.action' \) -print0 | LC_ALL=C sort -z | xargs -0 sha256sum
    find . -type f \( -path '*/materials/*' -o -path './isf_core/adsif/*' -o -path './isf_core/tools/*' -o -path './isf_core/blanks/*' -o -path './isf_core/plates/*' -o -path '*/rigs/*' -o -path '*/launch/*.py' -o -path '*/config/*' -o -path '*/layouts/*' \) |
      LC_ALL=C sort
  } | sha256sum
}

packages_current() {
  [ -x "$isf_venv/bin/python" ] && [ "$(cat "$isf_state/packages.stamp" 2>/dev/null)" = "$(packages_fingerprint)" ]
}

workspace_current() {
  [ -x "$isf_venv/bin/python" ] && [ -f "$isf_state/env.sh" ] && [ -f "$isf_workspace/install/setup.bash" ] &&
    [ "$(cat "$isf_state/workspace.stamp" 2>/dev/null)" = "$(workspace_fingerprint)" ]
}

# Sources of kernels: numba compiles all kernels of a package again when one of them changes.
kernels_fingerprint() {
  {
    cd "$isf_workspace/src" || return 1
    grep -rlE --include='*.py' 'jit import kernel|import kernels_of' . | LC_ALL=C sort | xargs -r sha256sum
  } | sha256sum
}

# True as well where there is nothing to compile.
kernels_current() {
  [ ! -f "$isf_workspace/src/isf_sim/isf_sim/warm_up.py" ] ||
    [ "$(cat "$isf_state/kernels.stamp" 2>/dev/null)" = "$(kernels_fingerprint)" ]
}
