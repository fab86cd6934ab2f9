# .isf/env.sh: the environment of every command and node, as plain assignments (fast, and the same in every shell).

write_environment() {
  local file=$isf_state/env.sh name value underlay=":"
  if [ "$isf_kind" = apt ]; then
    underlay=". '$isf_ros_prefix/setup.bash'"
  fi
  local -A ros=()
  while IFS='=' read -r -d '' name value; do
    ros[$name]=$value
  done < <(env -i HOME="${HOME:-/}" PATH=/usr/bin:/bin bash --noprofile --norc -c \
    "$underlay; . '$isf_workspace/install/setup.bash'; env -0" 2>/dev/null)
  if [ -z "${ros[AMENT_PREFIX_PATH]:-}" ]; then
    fail "ros_ws/install/setup.bash does not give a ROS environment." "Remove ros_ws/install and run the same command again."
  fi
  {
    printf '# Environment of the forming cell; made by scripts/setup.sh. Use: . .isf/env.sh\n'
    printf 'export ISF_ROOT=%q\n' "$ISF_ROOT"
    printf 'export VIRTUAL_ENV=%q\n' "$isf_venv"
    for name in AMENT_PREFIX_PATH CMAKE_PREFIX_PATH COLCON_PREFIX_PATH PYTHONPATH LD_LIBRARY_PATH; do
      write_search_path "$name" "${ros[$name]:-}"
    done
    for name in ROS_DISTRO ROS_VERSION ROS_PYTHON_VERSION _ROS_WHEELS_BOOTSTRAP_COMPLETE; do
      if [ -n "${ros[$name]:-}" ]; then
        printf 'export %s=%q\n' "$name" "${ros[$name]}"
      fi
    done
    value=$isf_venv/bin:${ros[PATH]%/usr/bin:/bin}
    printf 'case ":$PATH:" in *%q*) ;; *) export PATH=%q:"$PATH" ;; esac\n' ":$isf_venv/bin:" "${value%:}"
    write_fixed_part
  } >"$file.new"
  mv "$file.new" "$file"
}

# Beside an installed ROS the user's own overlays stay reachable, behind ours; the wheels stand alone, since a
# foreign PYTHONPATH would hide their rclpy.
write_search_path() {
  if [ "$isf_kind" = apt ]; then
    printf 'case ":${%s:-}:" in %q*) ;; *) export %s=%q"${%s:+:$%s}" ;; esac\n' "$1" ":$2:" "$1" "$2" "$1" "$1"
  elif [ -n "$2" ]; then
    printf 'export %s=%q\n' "$1" "$2"
  else
    printf 'unset %s\n' "$1"
  fi
}

write_fixed_part() {
  cat <<'EOF'
export PYTHONNOUSERSITE=1
unset PYTHONHOME

# A middleware that is not installed here would stop every node at its start.
if [ -n "${RMW_IMPLEMENTATION:-}" ] && [ "$RMW_IMPLEMENTATION" != rmw_fastrtps_cpp ]; then
  isf_found=""
  isf_rest=$AMENT_PREFIX_PATH:
  while [ -n "$isf_rest" ]; do
    if [ -e "${isf_rest%%:*}/share/$RMW_IMPLEMENTATION" ]; then isf_found=1; fi
    isf_rest=${isf_rest#*:}
  done
  if [ -z "$isf_found" ]; then
    echo "note: RMW_IMPLEMENTATION=$RMW_IMPLEMENTATION is not installed here; rmw_fastrtps_cpp is used instead" >&2
    export RMW_IMPLEMENTATION=rmw_fastrtps_cpp
  fi
  unset isf_found isf_rest
fi
# A cell stays on its own computer unless it is told otherwise: with Fast DDS by the profile below, as LOCALHOST would add
# shared memory to it; with a profile of the user's own, or another middleware, by LOCALHOST.
isf_range=LOCALHOST
case ${FASTRTPS_DEFAULT_PROFILES_FILE:-}${RMW_IMPLEMENTATION:-rmw_fastrtps_cpp} in
  rmw_fastrtps*) isf_range=SYSTEM_DEFAULT ;;
esac
export ROS_AUTOMATIC_DISCOVERY_RANGE="${ROS_AUTOMATIC_DISCOVERY_RANGE:-$isf_range}"
# Nodes end at once, a lost message is soon sent again, nobody else is heard: see the files.
isf_local=_local
[ "$ROS_AUTOMATIC_DISCOVERY_RANGE" != SUBNET ] || isf_local=""
export FASTRTPS_DEFAULT_PROFILES_FILE="${FASTRTPS_DEFAULT_PROFILES_FILE:-$ISF_ROOT/ros_ws/src/isf_cell/config/fastdds$isf_local.xml}"
unset isf_local isf_range
export ROS_LOG_DIR="${ROS_LOG_DIR:-$ISF_ROOT/.isf/log/ros}"

# Matrices of the cell are small: more BLAS threads only take time from the control loop.
export OMP_NUM_THREADS="${OMP_NUM_THREADS:-1}" OPENBLAS_NUM_THREADS="${OPENBLAS_NUM_THREADS:-1}"
export NUMBA_CACHE_DIR="$ISF_ROOT/.isf/cache/numba"
export MPLCONFIGDIR="$ISF_ROOT/.isf/cache/matplotlib" MPLBACKEND=Agg

# Bytecode stands here too, so that sources stay clean, and a wish for none (PYTHONDONTWRITEBYTECODE) is met by that:
# without bytecode every node compiles all its libraries at each start, which takes seconds.
export PYTHONPYCACHEPREFIX="$ISF_ROOT/.isf/cache/python"
unset PYTHONDONTWRITEBYTECODE
EOF
}

# The installed graph can be imported: catches a half-broken installation here and not in the first node.
check_installation() {
  local log=$isf_state/log/check.log
  step "Check: rclpy and isf_msgs load"
  # what the user has in the environment (a domain that does not exist, security) is told by the commands
  if ! (unset ROS_DOMAIN_ID ROS_SECURITY_ENABLE && . "$isf_state/env.sh" && logged "$log" python -c 'import isf_core, rclpy, rclpy.action
from isf_msgs.msg import Contour
rclpy.init()
rclpy.create_node("isf_setup_check").create_publisher(Contour, "isf_setup_check", 1)
rclpy.shutdown()'); then
    show_end "$log"
    fail "the installation does not load." "Remove the folders .isf and ros_ws/install and run the same command again."
  fi
}

# Compiles the hexapod's kinematics, the planner's geometry, the sheet mechanics of the simulated machine and the elastic
# shell once, so that the first part does not wait for them. A help, not a condition: it may fail or take too long
# without stopping the set-up.
warm_up() {
  step "Compiling geometry and sheet mechanics"
  start_warm_up
  end_warm_up
}

# One process each: they compile side by side. At set-up this begins as soon as the packages in Python are there.
isf_warm_ups=()
start_warm_up() {
  local module
  kernels_current && return
  for module in isf_planner isf_sim isf_springback.shell; do # isf_sim's is the core's, too
    (. "$isf_state/env.sh" && exec timeout --kill-after=5 300 python -m "$module.warm_up" \
      >"$isf_state/log/warm_up_$module.log" 2>&1 </dev/null) &
    isf_warm_ups+=($!)
  done
}

end_warm_up() {
  local process
  for process in "${isf_warm_ups[@]}"; do
    wait "$process" || note "not done (see .isf/log/warm_up_*.log); it happens at first use instead"
  done
  isf_warm_ups=()
  kernels_fingerprint >"$isf_state/kernels.stamp"
}
