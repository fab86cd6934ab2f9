#!/usr/bin/env bash
# The tests without a node graph on the library versions of Ubuntu 24.04 (requirements/apt.txt), on a machine that has
# the wheels. ROS itself comes from the wheels; half an hour.
#
# usage: scripts/test_apt_versions.sh [pytest arguments]
set -euo pipefail
root=$(cd "$(dirname "$(readlink -f "${BASH_SOURCE[0]}")")/.." && pwd -P)
cd "$root"
scripts/setup.sh
# shellcheck source=/dev/null
source .isf/env.sh
if ! python -c 'import sys; sys.exit(sys.version_info[:2] != (3, 12))'; then
  echo "Ubuntu 24.04 has Python 3.12 and .isf/venv another: remove .isf and set up with python3.12 first in PATH" >&2
  exit 2
fi
venv=$root/.isf/apt-venv
wheels=$(python -c 'import sysconfig; print(sysconfig.get_path("purelib"))')
uv=$(command -v uv)
"$uv" venv --quiet --allow-existing --python "$(command -v python)" "$venv"
UV_CACHE_DIR=$root/.isf/cache/uv "$uv" pip install --quiet --python "$venv/bin/python" --requirement requirements/apt.txt
echo "$wheels" >"$venv/lib/python3.12/site-packages/zz_ros.pth" # behind the libraries of its own
export PATH=$venv/bin:$PATH VIRTUAL_ENV=$venv NUMBA_CACHE_DIR=$root/.isf/cache/numba-apt PYTEST_DISABLE_PLUGIN_AUTOLOAD=1
python -c 'import numpy, scipy; print("numpy", numpy.__version__, "scipy", scipy.__version__)'
[ $# -gt 0 ] || set -- ros_ws/src
python -m pytest -p _hypothesis_pytestplugin -m "not graph and not slow" "$@"
