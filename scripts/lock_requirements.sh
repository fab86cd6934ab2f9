#!/usr/bin/env bash
# Resolves requirements/*.in into the exact pins of requirements/wheels.txt and apt.txt.
set -euo pipefail
cd "$(dirname "${BASH_SOURCE[0]}")/../requirements"
uv=${UV:-../.isf/venv/bin/uv}

lock() {  # lock OUTPUT PYTHON INPUT...
  local output=$1 python=$2
  shift 2
  local header="# Exact pins made by scripts/lock_requirements.sh from: $*"
  "$uv" pip compile --quiet --universal --python-version "$python" --no-header --no-annotate --upgrade \
    --no-emit-index-url --no-emit-find-links --output-file "$output.new" "$@" >/dev/null
  { echo "$header"; grep -v "sys_platform == 'win32'$" "$output.new"; } >"$output"
  rm -f "$output.new"
}

lock wheels.txt 3.10 ros-wheels.in runtime.in optional.in dev.in
lock apt.txt 3.12 apt.in
