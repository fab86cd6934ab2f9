# colcon build of ros_ws, quiet; its output goes to .isf/log/build.log. The packages in Python come first: their kernels
# are compiled while the messages are. The wheels have no tf2: where ROS comes from them its one message is built too.

build_workspace() {
  local log=$isf_state/log/build.log unfinished=$isf_state/build.unfinished
  step "ROS workspace: colcon build of $(find "$isf_workspace/src" -name package.xml | wc -l) packages"
  rm -f "$isf_state/workspace.stamp"
  # A build that was cut off, or made by another interpreter or in another folder, is not built upon.
  if [ -e "$unfinished" ] || [ "$(cat "$isf_state/build.kind" 2>/dev/null)" != "$(build_kind)" ]; then
    rm -rf "$isf_workspace/build" "$isf_workspace/install" "$isf_workspace/log"
  fi
  : >"$unfinished"
  build_kind >"$isf_state/build.kind"
  if ! python_packages >"$log" 2>&1 </dev/null || ! message_packages >>"$log" 2>&1 </dev/null; then
    show_end "$log"
    fail "the ROS workspace does not build (all output is in $log)." \
      "The end of the log above names the package and file. After mending it run the same command again."
  fi
  rm -f "$unfinished"
}

python_packages() {
  (colcon_build --packages-ignore isf_msgs) && write_environment && start_warm_up
}

message_packages() {
  if [ "$isf_kind" = wheels ]; then
    (colcon_build --base-paths . "$ISF_ROOT/scripts/setup/tf2_msgs" --packages-select isf_msgs tf2_msgs)
  else
    (colcon_build --packages-select isf_msgs)
  fi
}

build_kind() {
  cat "$isf_state/packages.stamp"
  printf '%s\n' "${CC:-}" "${CXX:-}"
}

# colcon_build OPTIONS...
colcon_build() {
  local cmake=(-DCMAKE_BUILD_TYPE=Release -DBUILD_TESTING=OFF "-DPython3_EXECUTABLE=$isf_venv/bin/python")
  [ "$isf_kind" != wheels ] || cmake+=(-DISF_MSGS_CPP=OFF)
  # Other ROS installations of the calling shell must not leak into the build.
  unset AMENT_PREFIX_PATH CMAKE_PREFIX_PATH COLCON_PREFIX_PATH PYTHONPATH PYTHONHOME COLCON_DEFAULTS_FILE
  export PYTHONNOUSERSITE=1 VIRTUAL_ENV=$isf_venv
  set +u
  if [ "$isf_kind" = apt ]; then
    # shellcheck disable=SC1091
    source "$isf_ros_prefix/setup.bash"
  else
    # shellcheck disable=SC1091
    source "$isf_venv/local_setup.bash"
  fi
  set -u
  export PATH=$isf_venv/bin:$PATH
  if command -v ninja >/dev/null; then
    cmake+=(-GNinja)
  fi
  # Without it colcon limits compilers by the load of the computer, which two of them reach on two cores: one at a time.
  export MAKEFLAGS=${MAKEFLAGS:--j$(getconf _NPROCESSORS_ONLN)}
  cd "$isf_workspace"
  # Run by the environment's own interpreter, so that the nodes' executables start with it.
  python -m colcon build --symlink-install --parallel-workers "$(getconf _NPROCESSORS_ONLN)" \
    --event-handlers console_cohesion+ "$@" --cmake-args "${cmake[@]}"
}
