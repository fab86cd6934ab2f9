# Checks of the machine before anything is written: each ends with what to do about it.

isf_needed_mb=2500

check_machine() {
  check_tools
  check_platform
  check_writable
  check_disk
  check_compiler
}

check_tools() {
  local tool
  for tool in sha256sum find sort xargs df tail sed flock; do
    command -v "$tool" >/dev/null ||
      fail "the command '$tool' is missing." "Install coreutils, findutils, sed and util-linux with the system's package manager."
  done
}

check_platform() {
  local system
  system=$(uname -s)/$(uname -m)
  if [ "$isf_kind" = wheels ] && [ "$system" != Linux/x86_64 ]; then
    fail "there are no ROS 2 wheels for $system, only for Linux/x86_64." \
      "On this machine install ROS 2 Jazzy on Ubuntu 24.04 (packages ros-jazzy-ros-base and ros-dev-tools); set-up finds it in /opt/ros/jazzy and uses it."
  fi
  case $ISF_ROOT in
    *[[:space:]:]*)
      fail "the folder '$ISF_ROOT' has a space or a colon in its path, which CMake and the ROS search paths do not take." \
        "Move the repository to a path without them, for example $HOME/isf."
      ;;
  esac
}

check_writable() {
  if ! { mkdir -p "$isf_state/log" && : >"$isf_state/log/.writable"; } 2>/dev/null; then
    fail "cannot write to $isf_state: the folder is read-only or belongs to someone else." \
      "Copy the repository to a folder of your own and run it there; set-up writes to .isf/ and ros_ws/ only."
  fi
  rm -f "$isf_state/log/.writable"
}

check_disk() {
  local free_mb
  # A finished environment needs no second copy of itself: only a first set-up is checked.
  if packages_current; then
    return
  fi
  free_mb=${ISF_SETUP_FREE_MB:-$(df -Pm "$ISF_ROOT" | awk 'NR == 2 { print $4 }')}
  if [ "$free_mb" -lt "$isf_needed_mb" ]; then
    fail "only $free_mb MB are free on the disk of $ISF_ROOT, set-up needs about $isf_needed_mb MB." \
      "Free some space or move the repository to another disk."
  fi
}

check_compiler() {
  local compiler source
  for compiler in "${CC:-cc}" "${CXX:-c++}"; do
    source='int main(void) { return 0; }'
    # shellcheck disable=SC2086  # CC may hold arguments
    if ! printf '#include <stdlib.h>\n%s\n' "$source" | $compiler -x c++ -fsyntax-only - >/dev/null 2>&1 &&
      ! printf '#include <stdlib.h>\n%s\n' "$source" | $compiler -x c -fsyntax-only - >/dev/null 2>&1; then
      fail "no working C/C++ compiler ('$compiler' cannot compile a one-line program)." \
        "The message package is compiled on this machine. On Debian and Ubuntu: sudo apt install build-essential"
    fi
  done
}

# What apt's ROS needs beside itself to build a workspace; isf_python is known.
check_apt_tools() {
  local missing=()
  command -v cmake >/dev/null || missing+=(cmake)
  (set +u && . "$isf_ros_prefix/setup.bash" && "$isf_python" -c 'import colcon_core, colcon_ros, colcon_cmake') >/dev/null 2>&1 ||
    missing+=(python3-colcon-common-extensions)
  (set +u && . "$isf_ros_prefix/setup.bash" && "$isf_python" -c 'import rclpy') >/dev/null 2>&1 || missing+=(ros-jazzy-ros-base)
  [ ${#missing[@]} -eq 0 ] ||
    fail "ROS 2 is in $isf_ros_prefix, but what builds a workspace is not complete." \
      "sudo apt install ${missing[*]} ros-dev-tools   (or ISF_ROS=wheels $0 to do without the installed ROS)"
}
