# The Python environment .isf/venv: ROS 2 from wheels, or libraries beside an apt-installed ROS 2.

make_packages() {
  rm -f "$isf_state/packages.stamp" "$isf_state/workspace.stamp"
  rm -rf "$isf_venv"
  make_virtual_environment
  install_libraries
  if [ "$isf_kind" = wheels ]; then
    write_prefix_scripts
  fi
  keep_choices
  packages_fingerprint >"$isf_state/packages.stamp"
}

# What was chosen by variables is written down, so that the next command needs no variables.
keep_choices() {
  local name
  for name in ISF_PYTHON ISF_ROS ISF_ROS_PREFIX; do
    if [ -n "${!name:-}" ]; then
      printf ': "${%s:=%q}"\n' "$name" "${!name}"
    fi
  done >"$isf_state/choices.sh"
}

make_virtual_environment() {
  local log=$isf_state/log/venv.log options=()
  if [ "$isf_kind" = apt ]; then
    # rclpy, colcon, numpy and scipy of the system stay visible
    options=(--system-site-packages)
  fi
  step "Virtual environment with $("$isf_python" --version) ($isf_python)"
  logged "$log" "$isf_python" -m venv "${options[@]}" "$isf_venv" || {
    show_end "$log"
    fail "$isf_python cannot make a virtual environment." \
      "On Debian and Ubuntu: sudo apt install python3-venv. Another Python can be named: ISF_PYTHON=/path/to/python3 $0"
  }
}

install_libraries() {
  local log=$isf_state/log/packages.log
  local pip=("$isf_venv/bin/python" -m pip --disable-pip-version-check --no-input --retries 1 --timeout 20
    --cache-dir "$isf_state/cache/pip" install --quiet)
  if [ "$isf_kind" = apt ]; then
    step "Libraries that Ubuntu lacks or has too old ($(grep -c == "$isf_requirements") pins)"
    # pip, not uv: it sees the system's numpy and scipy and leaves them alone.
    logged "$log" "${pip[@]}" --requirement "$isf_requirements" || explain_install_failure "$log"
    return
  fi
  step "ROS 2 Jazzy and libraries from wheels ($(grep -c == "$isf_requirements") pins)"
  logged "$log" "${pip[@]}" --requirement "$ISF_ROOT/requirements/bootstrap.txt" || explain_install_failure "$log"
  use_pip_index
  # The cache is kept here: same disk, so files are hard links, and a repair needs no network.
  if ! VIRTUAL_ENV=$isf_venv UV_CACHE_DIR=${UV_CACHE_DIR:-$isf_state/cache/uv} \
    logged "$log" "$isf_venv/bin/uv" pip install --quiet --requirement "$isf_requirements"; then
    # pip knows mirrors, certificates and proxies that are configured only for it
    note "uv could not install (see .isf/log/packages.log), trying pip"
    logged "$isf_state/log/packages-pip.log" "${pip[@]}" --requirement "$isf_requirements" || explain_install_failure "$log"
  fi
}

# A package index configured for pip only is used by uv as well.
use_pip_index() {
  local index
  if [ -z "${UV_DEFAULT_INDEX:-}${UV_INDEX_URL:-}" ]; then
    index=${PIP_INDEX_URL:-$("$isf_venv/bin/python" -m pip config get global.index-url 2>/dev/null || true)}
    if [ -n "$index" ]; then
      export UV_DEFAULT_INDEX=$index
    fi
  fi
}

explain_install_failure() {
  local log=$1
  show_end "$log"
  if grep -qiE 'connection|connect error|timed out|timeout|name resolution|dns error|proxy|certificate|unreachable|error sending request|from versions: none' "$log"; then
    fail "the Python package index cannot be reached, so libraries cannot be installed." \
      "Check the network; behind a proxy set HTTPS_PROXY, with a certificate of your own SSL_CERT_FILE, with a mirror PIP_INDEX_URL. Then run the same command again: it goes on where it stopped."
  fi
  if grep -qi 'no space left' "$log"; then
    fail "the disk is full." "Free about $isf_needed_mb MB and run the same command again."
  fi
  fail "a library could not be installed (all output is in $log)." \
    "If a wheel is missing for this Python, name another one: ISF_PYTHON=/path/to/python3.12 $0"
}

# A ROS prefix has local_setup scripts; with these colcon chains the wheels, and ros_ws/install/setup.bash is
# complete by itself.
write_prefix_scripts() {
  local site libraries
  site=$("$isf_venv/bin/python" -c 'import sysconfig; print(sysconfig.get_path("purelib"))')
  libraries=$isf_venv/lib$(find "$site" -maxdepth 1 -type d -name 'ros_*.libs' | LC_ALL=C sort | sed 's/^/:/' | tr -d '\n')
  cat >"$isf_venv/local_setup.sh" <<EOF
# ROS 2 Jazzy from wheels; made by scripts/setup.sh
case ":\${AMENT_PREFIX_PATH:-}:" in
  *":$isf_venv:"*) ;;
  *)
    export AMENT_PREFIX_PATH="$isf_venv\${AMENT_PREFIX_PATH:+:\$AMENT_PREFIX_PATH}"
    export CMAKE_PREFIX_PATH="$isf_venv\${CMAKE_PREFIX_PATH:+:\$CMAKE_PREFIX_PATH}"
    export LD_LIBRARY_PATH="$libraries\${LD_LIBRARY_PATH:+:\$LD_LIBRARY_PATH}"
    export PATH="$isf_venv/bin:\$PATH"
    ;;
esac
export ROS_DISTRO=jazzy ROS_VERSION=2 ROS_PYTHON_VERSION=3
# LD_LIBRARY_PATH is set: no need for the wheels to start every interpreter twice
export _ROS_WHEELS_BOOTSTRAP_COMPLETE=1
EOF
  cp "$isf_venv/local_setup.sh" "$isf_venv/local_setup.bash"
  cp "$isf_venv/local_setup.sh" "$isf_venv/setup.sh"
  cp "$isf_venv/local_setup.sh" "$isf_venv/setup.bash"
}
