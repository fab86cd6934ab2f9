# Which Python runs the cell: 3.12 (that of ROS 2 Jazzy) first, then its neighbours; with headers, since isf_msgs is compiled.

# find_python - sets isf_python, or ends with every interpreter that was looked at and why it does not do
find_python() {
  local candidate verdict looked_at=""
  isf_python=""
  while IFS= read -r candidate; do
    verdict=$(judge_python "$candidate")
    case $verdict in
      /*)
        isf_python=$verdict
        return
        ;;
    esac
    looked_at+=" $candidate ($verdict);"
  done < <(python_candidates)
  fail "no usable Python 3.10-3.14 with its headers and the venv module. Looked at:${looked_at:- nothing found;}" \
    "On Ubuntu and Debian: sudo apt install python3 python3-dev python3-venv. Any other installation can be named: ISF_PYTHON=/path/to/python3 $0"
}

python_candidates() {
  local minor path
  if [ -n "${ISF_PYTHON:-}" ]; then
    command -v "$ISF_PYTHON" || echo "$ISF_PYTHON"
    return
  fi
  if [ "$isf_kind" = apt ]; then
    echo /usr/bin/python3 # the only one that apt's rclpy is compiled for
    return
  fi
  for minor in 12 11 13 14 10; do
    for path in "/usr/bin/python3.$minor" "${PYENV_ROOT:-${HOME:-}/.pyenv}/versions/3.$minor".*/bin/python; do
      if [ -x "$path" ]; then
        echo "$path"
      fi
    done
    command -v "python3.$minor" || true
  done
  command -v python3 || true
}

# judge_python PATH - prints the interpreter to use (of a virtual environment: the one behind it) or the reason
# against it; the snippet also runs on very old interpreters
judge_python() {
  "$1" -c '
import os, sys, sysconfig
version = "%d.%d" % sys.version_info[:2]
if not (3, 10) <= sys.version_info[:2] <= (3, 14):
    print("is Python " + version)
elif getattr(sys, "_is_gil_enabled", lambda: True)() is False:
    print("is a free-threaded build")
elif not os.path.exists(os.path.join(sysconfig.get_path("include"), "Python.h")):
    print("has no Python.h, package python%s-dev" % version)
else:
    try:
        import ensurepip, venv
        print(getattr(sys, "_base_executable", sys.executable))
    except ImportError:
        print("has no venv module, package python%s-venv" % version)
' 2>/dev/null || echo "does not run"
}
